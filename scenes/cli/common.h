/// What the verbs of `palpate` share.
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
#include "palpate/scenes/cli/say.h"

namespace palpate::cli {

/// Exit status, as INTERFACES has it.
inline constexpr int kDone = 0;
inline constexpr int kEndedEarly = 1;
inline constexpr int kBadInput = 2;
inline constexpr int kInternal = 3;
inline constexpr int kNothingFelt = 4;
inline constexpr int kInterrupted = 130;

/// Not 0 once a signal has asked the program to stop.
extern volatile std::sig_atomic_t interrupted;

/// A number, or null for what has no end.
[[nodiscard]] inline OrderedJson finite(double value) {
  return std::isfinite(value) ? OrderedJson(value) : OrderedJson();
}

/// Shows on a terminal what long work is at, for how long, and how far of 1 it says it is; its line
/// is cleared when the last copy goes. Silent in the first second. Null in a pipe.
[[nodiscard]] std::function<void(double done)> showProgress(const std::string& what);

/// The shortest text that reads back the same double; empty for NaN and infinities.
[[nodiscard]] std::string number(double value);
/// For people: a few digits.
[[nodiscard]] std::string rounded(double value);
[[nodiscard]] OrderedJson toJson(const Vec3& v);

/// When it was last written; nothing where it is not there.
[[nodiscard]] std::optional<std::filesystem::file_time_type> writtenAt(const std::string& file);

/// Words as exec and posix_spawn take them, which stay `words`' own.
[[nodiscard]] std::vector<char*> argumentsOf(std::vector<std::string>& words);

/// A word of a shell's command line, quoted where it has to be.
[[nodiscard]] std::string shellWord(const std::string& text);

/// What stands behind a symbolic link, that is to change when a file of this name is replaced.
[[nodiscard]] std::filesystem::path behindLinks(std::filesystem::path path);

/// Throws Error where something of this name is no file, which a file would replace.
void checkReplaceable(const std::filesystem::path& file);

/// A file that appears whole or not at all: written beside its place, as a new file of a name that
/// nobody has taken, and renamed by commit(). `-` is standard output.
class WholeFile {
 public:
  /// Opens at once, so that a path that cannot be written is known before any work is done. Throws
  /// Error, for a pipe, a device or a folder as well.
  explicit WholeFile(std::filesystem::path path);
  WholeFile(const WholeFile&) = delete;
  WholeFile& operator=(const WholeFile&) = delete;
  ~WholeFile();

  void write(const std::string& text);
  /// For a program that writes it by itself.
  [[nodiscard]] int descriptor() const;
  /// A name until commit(), for a library that writes it by name; throws Error for standard output.
  [[nodiscard]] std::filesystem::path place() const;
  /// Throws Error where the disk is full and the like.
  void commit();

 private:
  std::filesystem::path path_;
  std::filesystem::path partial_;
  std::FILE* file_ = nullptr;
};

/// A folder that appears whole or not at all: filled beside its place and renamed by commit().
class WholeFolder {
 public:
  /// Throws Error where there is something of this name, and where it cannot be made.
  explicit WholeFolder(const std::filesystem::path& path);
  WholeFolder(const WholeFolder&) = delete;
  WholeFolder& operator=(const WholeFolder&) = delete;
  ~WholeFolder();

  /// Where it is until commit().
  [[nodiscard]] const std::filesystem::path& place() const noexcept { return partial_; }
  /// Throws Error where somebody else was faster.
  void commit();

 private:
  std::filesystem::path path_;
  std::filesystem::path partial_;
};

/// Would the same file stand there, however the two are written? Also where none stands yet.
[[nodiscard]] bool isSamePlace(const std::filesystem::path& a, const std::filesystem::path& b);

/// Throws Error where two outputs (empty is none, - standard output) go to one place, or one is
/// also an input, under whatever name.
void checkOutputsApart(const std::vector<std::string>& outputs,
                       const std::vector<std::filesystem::path>& inputs);

/// From here on Ctrl-C, SIGTERM and SIGHUP end the program at once with kInterrupted; what
/// WholeFile has not committed is removed.
void endAtInterrupts() noexcept;
/// From here on they are only noted: for what has more to end than files.
void noteInterrupts() noexcept;
/// Thrown where the user ended a run: nothing is written, and the program ends with kInterrupted.
struct Interrupted {};
/// Throws Interrupted if there was one.
void endIfInterrupted();

/// The folder of this program, where its companions are.
[[nodiscard]] std::filesystem::path programFolder();

}  // namespace palpate::cli
