/// Runs work in a child process, because a damaged file may crash the library that reads it.
#pragma once

#include <functional>
#include <string>

namespace palpate::importer {

/// Sends reports from the child process to the user. The child's own standard output and standard
/// error are discarded, because libraries write to them without control.
class Teller {
 public:
  explicit Teller(int pipe) : pipe_(pipe) {}

  /// Prints to standard output, after the work has ended successfully.
  void out(const std::string& text);
  void error(const std::string& line);  ///< Prints "palpate: LINE" to standard error.
  /// Sets the stage of the work that the next calls of progress() refer to.
  void stage(const std::string& what);
  void progress(double done);  ///< Reports the progress of the stage, from 0 to 1.
  /// Announces that the work will write the file `partial`. If the whole work succeeds, it is
  /// renamed to `file`; otherwise it is removed. Throws Error if `file` exists and is not a regular
  /// file.
  void file(const std::string& partial, const std::string& file);

 private:
  void send(char kind, const std::string& text);

  int pipe_;
  int told_ = -1;  ///< Last reported progress [%].
};

/// Runs `work` in a child process and returns its exit status.
///
/// If `work` throws, or a signal ends it, one line on standard error reports this. The status is 2
/// for Error, 1 for a lack of memory, 2 for a crash (because the file is at fault), and 3
/// otherwise. If this process is interrupted or terminated, the child ends at once with status 130,
/// unless its work is already complete. The files that the child has announced appear together if
/// it succeeds, or not at all.
/// @param what    The file that is read, for the line about a crash.
/// @param silent  The line for a child that ends without a message; if empty, the line says that
///                the file is damaged.
[[nodiscard]] int runGuarded(const std::string& what, const std::function<int(Teller&)>& work,
                             const std::string& silent = "");

}  // namespace palpate::importer
