/// Work that a damaged file may bring down runs in a process of its own.
#pragma once

#include <functional>
#include <string>

namespace palpate::importer {

/// How the work speaks to the user while its own output and error streams, which libraries write to
/// as they please, lead nowhere.
class Teller {
 public:
  explicit Teller(int pipe) : pipe_(pipe) {}

  void out(const std::string& text);    ///< To stdout, when the work has ended well.
  void error(const std::string& line);  ///< "palpate: ..." to stderr.
  void stage(const std::string& what);  ///< What progress is of from now on.
  void progress(double done);           ///< 0 to 1.
  /// Will write `partial`, which becomes `file` when all of the work has ended well, and is removed
  /// if it has not. Throws Error where that would replace what is no file.
  void file(const std::string& partial, const std::string& file);

 private:
  void send(char kind, const std::string& text);

  int pipe_;
  int told_ = -1;  ///< Percent.
};

/// Runs `work` in a child process and returns its exit status. Errors that it throws, and its end
/// by a signal as well, become one line on stderr: Error is status 2, a lack of memory 1, a crash 2
/// (the file is what is wrong), anything else 3. Interrupting or terminating this process ends the
/// child at once: status 130, unless it had done its work. The files that it announced appear
/// together at its good end, or not at all.
/// @param what    Named in the line about a crash: the file that is read.
/// @param silent  The line where it gives up without one; empty: that of a damaged file.
[[nodiscard]] int runGuarded(const std::string& what, const std::function<int(Teller&)>& work,
                             const std::string& silent = "");

}  // namespace palpate::importer
