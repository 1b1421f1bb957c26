#include "palpate/scenes/cli/script.h"

#include <cerrno>
#include <sys/wait.h>
#include <unistd.h>

#include "palpate/engine/error.h"

namespace palpate::cli {
namespace {

/// Runs a program with `input` on its standard input and its standard output to a descriptor; its
/// exit status, or -1.
int run(std::vector<std::string> command, const std::string& input, int output) {
  int pipe_ends[2];
  if (pipe(pipe_ends) != 0) return -1;
  const pid_t child = fork();
  if (child < 0) return -1;
  if (child == 0) {
    dup2(pipe_ends[0], STDIN_FILENO);
    dup2(output, STDOUT_FILENO);
    close(pipe_ends[0]);
    close(pipe_ends[1]);
    const std::vector<char*> argv = argumentsOf(command);
    execvp(argv[0], argv.data());
    _exit(127);
  }
  close(pipe_ends[0]);
  std::size_t written = 0;
  while (written < input.size()) {
    const ssize_t n = write(pipe_ends[1], input.data() + written, input.size() - written);
    if (n <= 0) break;
    written += static_cast<std::size_t>(n);
  }
  close(pipe_ends[1]);
  int status = 0;
  while (waitpid(child, &status, 0) < 0) {
    if (errno != EINTR) return -1;
  }
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

}  // namespace

Script::Script(const std::string& name, const std::string& option)
    : script_(programFolder() / name) {
  if (!std::filesystem::exists(script_)) {
    script_ = programFolder().parent_path() / "share" / "palpate" / name;
  }
  if (run({script_.string(), "--check"}, "", STDERR_FILENO) != 0) {
    throw Error(option, "python3 with matplotlib is not there", "install python3-matplotlib");
  }
}

void Script::draw(const OrderedJson& json, const WholeFile& file, const std::string& path,
                  const std::vector<std::string>& arguments) const {
  std::vector<std::string> command{script_.string()};
  command.insert(command.end(), arguments.begin(), arguments.end());
  if (run(command, dump(json), file.descriptor()) != 0) {
    throw Error(path, "the picture could not be drawn", "see the message of matplotlib above");
  }
}

}  // namespace palpate::cli
