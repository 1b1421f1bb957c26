/// Runs work in a separate process, because a damaged file may crash it.
#pragma once

#include <functional>
#include <string>

namespace palpate::importer {

/// Reports from the work to the user. The work's own output and error streams, to which libraries
/// write freely, are discarded.
class Teller {
 public:
  explicit Teller(int pipe) : pipe_(pipe) {}

  void out(const std::string& text);    ///< To stdout, once the work has ended well.
  void error(const std::string& line);  ///< "palpate: ..." to stderr.
  void stage(const std::string& what);  ///< Names the stage that later progress belongs to.
  void progress(double done);           ///< 0 to 1.
  /// Announces that the work will write `partial`. If all of the work ends well, `partial` becomes
  /// `file`; otherwise it is removed. Throws Error if that would replace something that is not a
  /// file.
  void file(const std::string& partial, const std::string& file);

 private:
  void send(char kind, const std::string& text);

  int pipe_;
  int told_ = -1;  ///< Last reported progress [percent].
};

/// Runs `work` in a child process and returns its exit status. Errors that `work` throws, and its
/// end by a signal, become one line on stderr. Error has status 2, a lack of memory 1, a crash 2
/// (the file is at fault), anything else 3. Interrupting or terminating this process ends the child
/// at once: status 130, unless the child had done its work. The files that the child announced
/// appear together if it ends well, or not at all.
/// @param what    The file that is read, for the line about a crash.
/// @param silent  The line if the child stops without a line of its own; if empty, the line states
///                that the file is damaged.
[[nodiscard]] int runGuarded(const std::string& what, const std::function<int(Teller&)>& work,
                             const std::string& silent = "");

}  // namespace palpate::importer
