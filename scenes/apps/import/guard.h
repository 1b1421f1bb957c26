/// Runs work in a child process, because a damaged file may crash the library that reads it.
#pragma once

#include <functional>
#include <string>

namespace palpate::importer {

/// Sends reports from the child process to the user. The child's own output and errors are
/// discarded, because libraries write to them without control.
class Teller {
 public:
  explicit Teller(int pipe) : pipe_(pipe) {}

  /// Prints to standard output, after the work has ended successfully.
  void out(const std::string& text);
  void error(const std::string& line);  ///< Prints "palpate: LINE" to standard error.
  /// Sets the stage to which the next calls of progress() refer.
  void stage(const std::string& what);
  void progress(double done);  ///< Reports the progress of the stage, from 0 to 1.
  /// Announces the output file `partial`. If the whole work succeeds, it is renamed to `file`;
  /// otherwise it is removed. Throws Error if `file` exists and is not a regular file.
  void file(const std::string& partial, const std::string& file);

 private:
  void send(char kind, const std::string& text);

  int pipe_;
  int told_ = -1;
};

/// Runs `work` in a child process and returns its exit status: 2 for Error and for a crash (the
/// file is at fault), 1 for a lack of memory, and 3 for other failures, with one line on standard
/// error. If this process is interrupted or terminated, the child ends with status 130, unless its
/// work is complete. The announced files appear together if the child succeeds, or not at all.
/// `what` is the file that is read. If a child ends without a message, `silent` is its line; if
/// `silent` is empty, the line says that the file is damaged.
[[nodiscard]] int runGuarded(const std::string& what, const std::function<int(Teller&)>& work,
                             const std::string& silent = "");

}  // namespace palpate::importer
