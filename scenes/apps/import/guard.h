/// Runs work in a child process, because a damaged file may crash the library that reads it.
#pragma once

#include <functional>
#include <string>

namespace palpate::importer {

/// Sends reports of the child process to the parent process, which prints them. Other output of the
/// child process, such as that of libraries, is discarded.
class Teller {
 public:
  explicit Teller(int pipe) : pipe_(pipe) {}

  /// Prints to standard output, once the work has succeeded.
  void out(const std::string& text);
  void error(const std::string& line);  ///< Prints "palpate: LINE" to standard error.
  /// Sets the stage whose progress the next calls of progress() report.
  void stage(const std::string& what);
  void progress(double done);  ///< Reports the progress of the stage, 0 to 1.
  /// Announces the output file `partial`. It is renamed to `file` if the whole work succeeds,
  /// otherwise removed. Throws Error if `file` exists and is not a regular file.
  void file(const std::string& partial, const std::string& file);

 private:
  void send(char kind, const std::string& text);

  int pipe_;
  int told_ = -1;
};

/// Runs `work` in a child process and returns its exit status. If the work fails, prints one line
/// on standard error. The status is then 2 for Error, for an error of the file system and for a
/// crash (the file is at fault), 1 for a lack of memory, 3 for other failures. A child that another
/// process kills (SIGKILL) counts as a lack of memory. If this process is interrupted, terminated
/// or hung up, it kills the child. The status is then 130, unless the work is complete. The
/// announced files appear only if the child succeeds, all or none; on a file system that cannot
/// exchange two names (NFS), replaced files stay replaced. Throws Error if a pipe, a process or a
/// file cannot be created, or if standard output cannot be written. `what` is the file that is
/// read, `need_less` the remedy for a lack of memory. If the child exits with a failure but without
/// a message, the parent prints `silent`; if `silent` is empty, a message that the file is probably
/// damaged.
[[nodiscard]] int runGuarded(const std::string& what, const std::string& need_less,
                             const std::function<int(Teller&)>& work,
                             const std::string& silent = "");

}  // namespace palpate::importer
