/// Functions that several verbs of `palpate` use.
#pragma once

#include <cmath>
#include <csignal>
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

/// Not 0 after a signal has interrupted the program.
extern volatile std::sig_atomic_t interrupted;

/// Returns null if the number is not finite.
[[nodiscard]] inline OrderedJson finite(double value) {
  return std::isfinite(value) ? OrderedJson(value) : OrderedJson();
}

/// Returns a callback that shows the progress, 0 to 1, on a terminal. The line appears after 1 s,
/// and disappears with the last copy. Returns null if standard error is not a terminal.
[[nodiscard]] std::function<void(double done)> showProgress(const std::string& what);

/// Returns the shortest text that converts back to the same double; empty if it is not finite.
[[nodiscard]] std::string number(double value);
/// Returns the number with four significant digits.
[[nodiscard]] std::string rounded(double value);
[[nodiscard]] OrderedJson toJson(const Vec3& v);

/// Returns the time of the last write; no value if the file cannot be read.
[[nodiscard]] std::optional<std::filesystem::file_time_type> writtenAt(const std::string& file);

/// Returns a null-terminated argv for exec and posix_spawn, valid while `words` is unchanged.
[[nodiscard]] std::vector<char*> argumentsOf(std::vector<std::string>& words);

/// Quotes a text for a shell's command line if necessary.
[[nodiscard]] std::string shellWord(const std::string& text);

/// Follows symbolic links, so that a new file replaces the target and not the link.
[[nodiscard]] std::filesystem::path behindLinks(std::filesystem::path path);

/// Throws Error if the path exists but is not a regular file, because an output would replace it.
void checkReplaceable(const std::filesystem::path& file);

/// An output file that appears complete or not at all: commit() renames a temporary file in the
/// same folder. The path `-` is standard output.
class WholeFile {
 public:
  /// Creates the temporary file. Throws Error, even if the path is a pipe, a device or a folder.
  explicit WholeFile(std::filesystem::path path);
  WholeFile(const WholeFile&) = delete;
  WholeFile& operator=(const WholeFile&) = delete;
  ~WholeFile();

  void write(const std::string& text);
  /// Returns the file descriptor, for a child process that writes the file.
  [[nodiscard]] int descriptor() const;
  /// Returns the temporary path, for a library. Throws Error for standard output.
  [[nodiscard]] std::filesystem::path place() const;
  /// Completes the file. Throws Error if writing has failed.
  void commit();

 private:
  std::filesystem::path path_;
  std::filesystem::path partial_;
  std::FILE* file_ = nullptr;
};

/// Returns true if both paths lead to the same file, which need not exist.
[[nodiscard]] bool isSamePlace(const std::filesystem::path& a, const std::filesystem::path& b);

/// Throws Error if two outputs are the same file, or if an output is also an input.
void checkOutputsApart(const std::vector<std::string>& outputs,
                       const std::vector<std::filesystem::path>& inputs);

/// Lets Ctrl-C, SIGTERM and SIGHUP remove uncommitted files and end the program with kInterrupted.
void endAtInterrupts() noexcept;
/// Lets these signals only set `interrupted`, for programs with more work to do at the end.
void noteInterrupts() noexcept;
/// Thrown after an interrupt: the program writes no output and ends with kInterrupted.
struct Interrupted {};
void endIfInterrupted();

[[nodiscard]] std::filesystem::path programFolder();

}  // namespace palpate::cli
