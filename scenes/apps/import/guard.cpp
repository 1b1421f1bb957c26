#include "palpate/scenes/apps/import/guard.h"

#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <exception>
#include <fcntl.h>
#include <filesystem>
#include <new>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <system_error>
#include <unistd.h>
#include <vector>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/descriptor.h"
#include "palpate/samplers/fork_at_rest.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::importer {
namespace {

volatile sig_atomic_t child_of_signals = 0;
volatile sig_atomic_t was_interrupted = 0;

void passOn(int /*signal*/) {
  was_interrupted = 1;
  if (child_of_signals != 0) kill(static_cast<pid_t>(child_of_signals), SIGKILL);
}

/// Length of a message's head [bytes]: a letter, and the length of the text in 8 hexadecimal
/// digits.
constexpr std::size_t kHead = 9;

bool writeAll(int file, const char* data, std::size_t count) {
  while (count > 0) {
    const ssize_t wrote = write(file, data, count);
    if (wrote < 0 && errno == EINTR) continue;
    if (wrote <= 0) return false;
    data += wrote;
    count -= static_cast<std::size_t>(wrote);
  }
  return true;
}

[[noreturn]] void runChild(const std::string& what, const std::string& need_less, int pipe,
                           const std::function<int(Teller&)>& work) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  signal(SIGINT, SIG_IGN);  // a terminal sends SIGINT to both processes; the parent kills the child
  signal(SIGTERM, SIG_DFL);
  signal(SIGHUP, SIG_DFL);
  signal(SIGXFSZ, SIG_IGN);  // a write beyond the limit of file sizes then returns an error
  const int nowhere = open("/dev/null", O_WRONLY);
  if (nowhere >= 0) {
    dup2(nowhere, STDOUT_FILENO);
    dup2(nowhere, STDERR_FILENO);
  }
  Teller teller(pipe);
  int status = cli::kInternal;
  const auto complain = [&](const std::string& line) { teller.error(line); };
  try {
    status = work(teller);
  } catch (const Error& e) {
    complain(e.what());
    status = cli::kBadInput;
  } catch (const std::filesystem::filesystem_error& e) {
    complain(
        fmt::format("{}: the file system reports an error ({}): check the path and its permissions",
                    e.path1().string(), e.code().message()));
    status = cli::kBadInput;
  } catch (const std::bad_alloc&) {
    complain(fmt::format("{}: memory ran out: {}", what, need_less));
    status = cli::kEndedEarly;
  } catch (const std::exception& e) {
    complain(fmt::format("internal error: {}: please report this message and your command line",
                         e.what()));
    status = cli::kInternal;
  }
  _exit(status);
}

struct Written {
  std::filesystem::path partial;
  std::filesystem::path file;
};

/// An output file that has its final name.
struct Appeared {
  std::filesystem::path partial;
  std::filesystem::path target;
  bool keeps_old = false;  ///< True if `partial` now names the older file of `target`.
  bool replaced = false;   ///< True if the older file of `target` is lost.
};

/// Gives a file its final name. An older file of this name gets the partial file's name, unless the
/// file system cannot exchange two names (NFS). Throws Error, and then changes no file.
Appeared appearOne(const Written& one) {
  cli::checkReplaceable(one.file);
  const std::filesystem::path target = cli::behindLinks(one.file);
  if (renameat2(AT_FDCWD, one.partial.c_str(), AT_FDCWD, target.c_str(), RENAME_EXCHANGE) == 0) {
    return {one.partial, target, true, false};
  }
  std::error_code error;
  const bool was_there = std::filesystem::exists(target, error);
  error.clear();
  std::filesystem::rename(one.partial, target, error);
  if (error) {
    throw Error(one.file.string(), fmt::format("the file cannot be written ({})", error.message()),
                "choose another path");
  }
  return {one.partial, target, false, was_there};
}

/// Gives all files their final names. If one fails, removes the new files, restores the older
/// files, and throws Error. On a file system that cannot exchange two names, replaced files stay
/// replaced.
void appear(const std::vector<Written>& files) {
  std::error_code error;
  std::vector<Appeared> done;
  done.reserve(files.size());
  try {
    for (const Written& one : files) done.push_back(appearOne(one));
  } catch (...) {
    for (auto one = done.rbegin(); one != done.rend(); ++one) {
      if (one->keeps_old) std::filesystem::rename(one->partial, one->target, error);
      if (!one->keeps_old && !one->replaced) std::filesystem::remove(one->target, error);
    }
    for (std::size_t i = done.size(); i < files.size(); ++i) {
      std::filesystem::remove(files[i].partial, error);
    }
    throw;
  }
  for (const Appeared& one : done) {
    if (one.keeps_old) std::filesystem::remove(one.partial, error);
  }
}

/// Prints the child's output. Throws Error if it cannot be written.
void print(const std::string& text) {
  try {
    cli::sayRaw(text);
  } catch (const std::system_error&) {  // flushOutput() reports it
  }
  cli::flushOutput();
}

class Listener {
 public:
  void hear(const char* data, std::size_t count) {
    heard_.append(data, count);
    while (heard_.size() >= kHead) {
      const std::size_t length = std::stoul(heard_.substr(1, kHead - 1), nullptr, 16);
      if (heard_.size() < kHead + length) return;
      act(heard_[0], heard_.substr(kHead, length));
      heard_.erase(0, kHead + length);
    }
  }
  void endProgress() { show_ = nullptr; }
  [[nodiscard]] const std::vector<Written>& files() const { return files_; }
  [[nodiscard]] const std::string& output() const { return output_; }
  [[nodiscard]] bool complained() const { return complained_; }

 private:
  void act(char kind, const std::string& text) {
    switch (kind) {
      case 'o':
        output_ += text;
        break;
      case 'e':
        show_ = nullptr;
        cli::complain(text);
        complained_ = true;
        break;
      case 's':
        show_ = cli::showProgress(text);
        break;
      case 'p':
        if (show_) show_(std::stod(text));
        break;
      case 'f':
        files_.push_back({text.substr(0, text.find('\0')), text.substr(text.find('\0') + 1)});
        break;
      default:
        break;
    }
  }

  std::string heard_;
  std::string output_;
  std::vector<Written> files_;
  std::function<void(double)> show_;
  bool complained_ = false;
};

}  // namespace

void Teller::send(char kind, const std::string& text) {
  const std::string message = fmt::format("{}{:08x}{}", kind, text.size(), text);
  if (!writeAll(pipe_, message.data(), message.size())) _exit(cli::kInternal);
}
void Teller::out(const std::string& text) {
  send('o', text);
}
void Teller::error(const std::string& line) {
  send('e', line);
}
void Teller::stage(const std::string& what) {
  told_ = -1;
  send('s', what);
}
void Teller::progress(double done) {
  const int percent = static_cast<int>(100.0 * done);
  if (percent == told_) return;
  told_ = percent;
  send('p', fmt::format("{}", done));
}
void Teller::file(const std::string& partial, const std::string& file) {
  cli::checkReplaceable(file);
  send('f', partial + '\0' + file);
}

int runGuarded(const std::string& what, const std::string& need_less,
               const std::function<int(Teller&)>& work, const std::string& silent) {
  std::fflush(nullptr);
  int ends[2];
  if (pipe(ends) != 0) {
    throw Error("import", fmt::format("a pipe cannot be opened ({})", std::strerror(errno)),
                "end other programs, or raise the limit of open files (ulimit -n)");
  }
  Descriptor from(ends[0]);
  Descriptor to(ends[1]);
  struct sigaction action {};
  action.sa_handler = passOn;
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) sigaction(signal, &action, nullptr);
  const pid_t child = forkAtRest();
  if (child < 0) {
    throw Error("import", fmt::format("a process cannot be started ({})", std::strerror(errno)),
                "end other programs, or raise the limit of processes (ulimit -u)");
  }
  if (child == 0) {
    from.close();
    runChild(what, need_less, to.get(), work);
  }
  child_of_signals = child;
  if (was_interrupted != 0) kill(child, SIGKILL);
  to.close();

  Listener listener;
  std::vector<char> buffer(1U << 16U);
  for (;;) {
    const ssize_t count = read(from.get(), buffer.data(), buffer.size());
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) break;
    listener.hear(buffer.data(), static_cast<std::size_t>(count));
  }
  listener.endProgress();
  int result = 0;
  while (waitpid(child, &result, 0) < 0 && errno == EINTR) {
  }
  child_of_signals = 0;

  const bool ended = WIFEXITED(result);
  const int status = ended ? WEXITSTATUS(result) : cli::kBadInput;
  if (status == cli::kDone) {
    appear(listener.files());
    print(listener.output());
    return cli::kDone;
  }
  std::error_code error;
  for (const Written& one : listener.files()) std::filesystem::remove(one.partial, error);
  if (was_interrupted != 0) return cli::kInterrupted;
  if (!ended) {
    const int signal = WTERMSIG(result);
    if (signal == SIGKILL) {
      cli::complain(fmt::format(
          "{}: the system ended the import, probably because memory ran out: {}", what, need_less));
      return cli::kEndedEarly;
    }
    cli::complain(fmt::format(
        "{}: the reader crashed ({}): the file is probably damaged: export it again, or report "
        "this message",
        what, strsignal(signal)));
  } else if (!listener.complained()) {
    cli::complain(silent.empty() ? what +
                                       ": the reader stopped without a message: the file is "
                                       "probably damaged: export it again"
                                 : silent);
  }
  return status;
}

}  // namespace palpate::importer
