/// Functions that the programs of palpate share.
#pragma once

#include <cmath>
#include <csignal>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "palpate/engine/types.h"
#include "palpate/scenes/apps/common/say.h"

namespace palpate::cli {

/// Exit statuses; docs/verbs.md describes them.
inline constexpr int kDone = 0;
inline constexpr int kEndedEarly = 1;
inline constexpr int kBadInput = 2;
inline constexpr int kInternal = 3;
inline constexpr int kNothingFelt = 4;
inline constexpr int kInterrupted = 130;

/// Not 0 after SIGINT, SIGTERM or SIGHUP, once noteInterrupts() or another function has installed a
/// handler that sets it.
extern volatile std::sig_atomic_t interrupted;

/// Returns the number, or null if it is not finite.
[[nodiscard]] inline OrderedJson finite(double value) {
  return std::isfinite(value) ? OrderedJson(value) : OrderedJson();
}

/// Returns a callback that shows the progress, 0 to 1, on a terminal, after 1 s. The line
/// disappears with the callback's last copy. Returns null if standard error is not a terminal.
[[nodiscard]] std::function<void(double done)> showProgress(const std::string& what);

/// Returns the shortest text that converts back to the same double; empty if the number is not
/// finite.
[[nodiscard]] std::string number(double value);
/// Returns a number with its noun: "1 touch", "2 touches".
[[nodiscard]] inline std::string counted(std::int64_t count, const char* one, const char* more) {
  return std::to_string(count) + " " + (count == 1 ? one : more);
}
/// Returns the number with at most four significant digits.
[[nodiscard]] std::string rounded(double value);
[[nodiscard]] OrderedJson toJson(const Vec3& v);

/// Returns the time of the last write; no value if it is unknown, as for a missing file.
[[nodiscard]] std::optional<std::filesystem::file_time_type> writtenAt(const std::string& file);

/// Returns a null-terminated argv for exec and posix_spawn, valid while `words` is unchanged.
[[nodiscard]] std::vector<char*> argumentsOf(std::vector<std::string>& words);

/// Returns a text as one word of a shell's command line, quoted if necessary.
[[nodiscard]] std::string shellWord(const std::string& text);

/// Returns the target of symbolic links, so that a new file replaces the target and not the link. A
/// link to an object without a path, such as a pipe, stays.
[[nodiscard]] std::filesystem::path behindLinks(std::filesystem::path path);

/// Throws Error if the path exists but is not a regular file, because the output would replace it.
void checkReplaceable(const std::filesystem::path& file);

/// An output file that appears complete or not at all: commit() renames a temporary file in the
/// same folder. The path `-` is standard output, which may get incomplete output.
class WholeFile {
 public:
  /// Creates the temporary file. Throws Error, also if the path is a pipe, device or folder.
  explicit WholeFile(std::filesystem::path path);
  WholeFile(const WholeFile&) = delete;
  WholeFile& operator=(const WholeFile&) = delete;
  ~WholeFile();

  /// Appends text. Throws Error if writing fails.
  void write(const std::string& text);
  /// Returns the descriptor of the file, for a child process that writes to it.
  [[nodiscard]] int descriptor() const;
  /// Returns the temporary path, for a library that writes to it. Throws Error for standard output.
  [[nodiscard]] std::filesystem::path place() const;
  /// Completes the file; only flushes standard output, whose errors flushOutput() reports at the
  /// program's end. Throws Error if the file cannot be completed.
  void commit();

 private:
  std::filesystem::path path_;
  std::filesystem::path partial_;
  std::FILE* file_ = nullptr;
};

/// Returns true if both paths name the same file, which need not exist.
[[nodiscard]] bool isSamePlace(const std::filesystem::path& a, const std::filesystem::path& b);

/// Throws Error if two outputs are the same file or are both standard output, or if an output is
/// also an input. Ignores empty outputs.
void checkOutputsApart(const std::vector<std::string>& outputs,
                       const std::vector<std::filesystem::path>& inputs);

/// Removes uncommitted files, and ends the program without destructors.
[[noreturn]] void endWithoutFiles(int status) noexcept;

/// Lets SIGINT, SIGTERM and SIGHUP remove uncommitted files and end the program with kInterrupted.
/// Signals that the parent process ignores, as nohup does, stay ignored.
void endAtInterrupts() noexcept;
/// Lets SIGINT, SIGTERM and SIGHUP only set `interrupted`, so that the program can finish its work.
/// Ignored signals stay ignored here too.
void noteInterrupts() noexcept;
/// Thrown after an interrupt. Unless a caller handles it, the program drops unfinished output and
/// ends with kInterrupted.
struct Interrupted {};
/// Throws Interrupted if `interrupted` is not 0.
void endIfInterrupted();

/// Returns the folder of the running program, or "." if it is unknown.
[[nodiscard]] std::filesystem::path programFolder();

}  // namespace palpate::cli
