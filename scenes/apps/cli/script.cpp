#include "palpate/scenes/apps/cli/script.h"

#include <cerrno>
#include <csignal>
#include <fcntl.h>
#include <poll.h>
#include <string_view>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/descriptor.h"

namespace palpate::cli {
namespace {

/// Runs a program that reads `input` from a pipe and writes to the descriptor `output`. Returns the
/// program's exit status; -1 if no process could be started or a signal ended it; 127 if the
/// program could not be executed. After an interrupt, kills the program and throws Interrupted.
int run(std::vector<std::string> command, const std::string& input, int output) {
  int pipe_ends[2];
  if (pipe(pipe_ends) != 0) return -1;
  Descriptor from(pipe_ends[0]);
  Descriptor to(pipe_ends[1]);
  const pid_t child = fork();
  if (child < 0) return -1;
  if (child == 0) {
    // Ctrl-C reaches parent and child. The child starts with SIGINT ignored: the parent ends it.
    signal(SIGINT, SIG_IGN);
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    dup2(from.get(), STDIN_FILENO);
    dup2(output, STDOUT_FILENO);
    from.close();
    to.close();
    const std::vector<char*> argv = argumentsOf(command);
    execvp(argv[0], argv.data());
    _exit(127);
  }
  from.close();
  fcntl(to.get(), F_SETFL, O_NONBLOCK);
  constexpr int kLook = 10;  // [ms]: time between two checks for an interrupt
  std::string_view rest = input;
  pollfd ear{to.get(), POLLOUT, 0};
  int status = 0;
  pid_t ended = 0;
  while (ended == 0) {
    if (interrupted != 0) kill(child, SIGKILL);
    if (ear.fd >= 0) {
      const ssize_t n = write(ear.fd, rest.data(), rest.size());
      if (n > 0) rest.remove_prefix(static_cast<std::size_t>(n));
      if (rest.empty() || (n < 0 && errno != EAGAIN && errno != EINTR)) {
        to.close();
        ear.fd = -1;
      }
    }
    (void)poll(&ear, 1, kLook);
    ended = waitpid(child, &status, WNOHANG);
  }
  if (ended < 0) return -1;
  if (interrupted != 0) throw Interrupted{};
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

}  // namespace

Script::Script(const std::string& name, const std::string& option)
    : script_(programFolder() / name) {
  if (!std::filesystem::exists(script_)) {
    script_ = programFolder().parent_path() / "share" / "palpate" / name;
  }
  if (!std::filesystem::exists(script_)) {
    throw Error(option, script_.string() + ", which draws pictures, is missing",
                "install palpate again");
  }
  if (run({script_.string(), "--check"}, "", STDERR_FILENO) != 0) {
    throw Error(option, "/usr/bin/python3 with matplotlib is missing or does not start",
                "install python3-matplotlib, or correct the error that python3 has printed");
  }
}

void Script::draw(const OrderedJson& json, const WholeFile& file, const std::string& path,
                  const std::vector<std::string>& arguments) const {
  std::vector<std::string> command{script_.string()};
  command.insert(command.end(), arguments.begin(), arguments.end());
  const auto progress = showProgress("drawing");
  const int status = run(command, dump(json), file.descriptor());
  if (status < 0) {
    throw Error(path, "the picture could not be drawn, because python3 was killed or did not start",
                "end other programs, and try again");
  }
  if (status > 0) {
    throw Error(path, "the picture could not be drawn", "read the message of python3 above");
  }
}

}  // namespace palpate::cli
