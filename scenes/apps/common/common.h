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

/// Number of the signal that has interrupted the program; 0: none.
extern volatile std::sig_atomic_t interrupted;

/// Returns the number as JSON; null if it is not finite.
[[nodiscard]] inline OrderedJson finite(double value) {
  return std::isfinite(value) ? OrderedJson(value) : OrderedJson();
}

/// Returns a callback that takes the progress from 0 to 1 and shows it on the terminal, with the
/// name and the duration of the work. The line appears after one second, and disappears when the
/// last copy of the callback is destroyed. Returns null if the output is not a terminal.
[[nodiscard]] std::function<void(double done)> showProgress(const std::string& what);

/// Returns the shortest text from which the same double can be read; an empty text for NaN and
/// infinities.
[[nodiscard]] std::string number(double value);
/// Returns the number with a few digits, for the user to read.
[[nodiscard]] std::string rounded(double value);
[[nodiscard]] OrderedJson toJson(const Vec3& v);

/// Returns the time at which the file was last written; no value if the file does not exist.
[[nodiscard]] std::optional<std::filesystem::file_time_type> writtenAt(const std::string& file);

/// Returns pointers to the texts in `words`, as exec and posix_spawn need them. The pointers are
/// valid as long as `words` is unchanged.
[[nodiscard]] std::vector<char*> argumentsOf(std::vector<std::string>& words);

/// Returns a text as a word of a shell's command line, in quotes if necessary.
[[nodiscard]] std::string shellWord(const std::string& text);

/// Follows symbolic links. Returns the path at which a new file must appear to replace the file
/// that `path` leads to.
[[nodiscard]] std::filesystem::path behindLinks(std::filesystem::path path);

/// Throws Error if the path exists but is not a regular file, so that an output file cannot replace
/// a folder or a device.
void checkReplaceable(const std::filesystem::path& file);

/// Writes an output file that appears complete or not at all. The file is written in the same
/// folder under an unused name, and commit() renames it. The path `-` is standard output.
class WholeFile {
 public:
  /// Opens the file, so that a path that cannot be written is reported before any work is done.
  /// Throws Error, even if the path is a pipe, a device or a folder.
  explicit WholeFile(std::filesystem::path path);
  WholeFile(const WholeFile&) = delete;
  WholeFile& operator=(const WholeFile&) = delete;
  ~WholeFile();

  void write(const std::string& text);
  /// Returns the file descriptor, for a program that writes the file itself.
  [[nodiscard]] int descriptor() const;
  /// Returns the temporary path of the file until commit(), for a library that opens files by name.
  /// Throws Error for standard output.
  [[nodiscard]] std::filesystem::path place() const;
  /// Completes the file. Throws Error if writing has failed, for example because the disk is full.
  void commit();

 private:
  std::filesystem::path path_;
  std::filesystem::path partial_;
  std::FILE* file_ = nullptr;
};

/// Returns true if both paths lead to the same file, even if they are written differently. The file
/// need not exist.
[[nodiscard]] bool isSamePlace(const std::filesystem::path& a, const std::filesystem::path& b);

/// Throws Error if two outputs have the same path, or if an output is also an input. Links and
/// different spellings of a path count as the same path. An empty path and `-` (standard output)
/// are not checked.
void checkOutputsApart(const std::vector<std::string>& outputs,
                       const std::vector<std::filesystem::path>& inputs);

/// After this call, Ctrl-C, SIGTERM and SIGHUP end the program at once with status kInterrupted.
/// Files that WholeFile has not committed are removed.
void endAtInterrupts() noexcept;
/// After this call, these signals only set `interrupted`. For programs that must do more before the
/// end than remove files.
void noteInterrupts() noexcept;
/// Thrown if the user has ended a run. The program then writes no output and ends with status
/// kInterrupted.
struct Interrupted {};
/// Throws Interrupted if a signal has set `interrupted`.
void endIfInterrupted();

/// Returns the folder that contains this program and its companion programs.
[[nodiscard]] std::filesystem::path programFolder();

}  // namespace palpate::cli
