/// Functions that the verbs of `palpate` share.
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

/// Exit status; see INTERFACES.
inline constexpr int kDone = 0;
inline constexpr int kEndedEarly = 1;
inline constexpr int kBadInput = 2;
inline constexpr int kInternal = 3;
inline constexpr int kNothingFelt = 4;
inline constexpr int kInterrupted = 130;

/// Not 0 once a signal has asked the program to stop.
extern volatile std::sig_atomic_t interrupted;

/// Returns a number, or null if it is not finite.
[[nodiscard]] inline OrderedJson finite(double value) {
  return std::isfinite(value) ? OrderedJson(value) : OrderedJson();
}

/// Returns a callback that shows on a terminal the current work, its duration and its progress from
/// 0 to 1. The line appears after one second. The last copy clears the line when it is
/// destroyed. Returns null in a pipe.
[[nodiscard]] std::function<void(double done)> showProgress(const std::string& what);

/// Returns the shortest text that reads back the same double; empty for NaN and infinities.
[[nodiscard]] std::string number(double value);
/// Returns a few digits, for people.
[[nodiscard]] std::string rounded(double value);
[[nodiscard]] OrderedJson toJson(const Vec3& v);

/// Returns the time of the last write; no value if the file does not exist.
[[nodiscard]] std::optional<std::filesystem::file_time_type> writtenAt(const std::string& file);

/// Returns pointers into `words` in the form that exec and posix_spawn take.
[[nodiscard]] std::vector<char*> argumentsOf(std::vector<std::string>& words);

/// Returns a word for a shell's command line, quoted if necessary.
[[nodiscard]] std::string shellWord(const std::string& text);

/// Follows symbolic links to the file that must change when a file of this name is replaced.
[[nodiscard]] std::filesystem::path behindLinks(std::filesystem::path path);

/// Throws Error if the name exists but is not a regular file, because a file would replace it.
void checkReplaceable(const std::filesystem::path& file);

/// Writes a file that appears complete or not at all. The file is written beside its place under an
/// unused name; commit() renames it. `-` is standard output.
class WholeFile {
 public:
  /// Opens the file, so that an unwritable path is reported before any work is done. Throws Error,
  /// also for a pipe, a device or a folder.
  explicit WholeFile(std::filesystem::path path);
  WholeFile(const WholeFile&) = delete;
  WholeFile& operator=(const WholeFile&) = delete;
  ~WholeFile();

  void write(const std::string& text);
  /// Returns the descriptor for a program that writes the file itself.
  [[nodiscard]] int descriptor() const;
  /// Returns the name until commit(), for a library that writes by name. Throws Error for standard
  /// output.
  [[nodiscard]] std::filesystem::path place() const;
  /// Completes the file. Throws Error if writing failed, for instance on a full disk.
  void commit();

 private:
  std::filesystem::path path_;
  std::filesystem::path partial_;
  std::FILE* file_ = nullptr;
};

/// Returns true if two paths, however written, lead to the same file. The file need not exist.
[[nodiscard]] bool isSamePlace(const std::filesystem::path& a, const std::filesystem::path& b);

/// Throws Error if two outputs go to one place, or if an output is also an input, under any name.
/// An empty output does not count; - is standard output.
void checkOutputsApart(const std::vector<std::string>& outputs,
                       const std::vector<std::filesystem::path>& inputs);

/// From now on Ctrl-C, SIGTERM and SIGHUP end the program at once with kInterrupted. They remove
/// files that WholeFile has not committed.
void endAtInterrupts() noexcept;
/// From now on these signals are only recorded, for programs that must end more than files.
void noteInterrupts() noexcept;
/// Thrown if the user ended a run: the program writes no output and ends with kInterrupted.
struct Interrupted {};
/// Throws Interrupted if a signal was recorded.
void endIfInterrupted();

/// Returns the folder of this program and of its companion programs.
[[nodiscard]] std::filesystem::path programFolder();

}  // namespace palpate::cli
