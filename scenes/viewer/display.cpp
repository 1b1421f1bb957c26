#include "palpate/scenes/viewer/display.h"

#include <X11/Xlib.h>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <fcntl.h>
#include <poll.h>
#include <spawn.h>
#include <string>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/cli/say.h"

namespace palpate::view {
namespace {

bool isThere() {
  Display* display = XOpenDisplay(nullptr);
  if (display == nullptr) return false;
  XCloseDisplay(display);
  return true;
}

pid_t server = -1;

void endServer() {
  if (server < 0) return;
  kill(server, SIGTERM);
  waitpid(server, nullptr, 0);
}

/// The number of a new server's display; empty where it did not come up.
std::string startServer() {
  int ends[2];
  if (pipe(ends) != 0) return "";
  const pid_t parent = getpid();
  server = fork();
  if (server == 0) {
    // It ends with this program, however that does.
    prctl(PR_SET_PDEATHSIG, SIGTERM);
    if (getppid() != parent) _exit(1);
    dup2(ends[1], 3);
    // Where a display's number is taken it says so, and takes the next.
    const int nowhere = open("/dev/null", O_WRONLY);
    dup2(nowhere, STDERR_FILENO);
    execlp("Xvfb", "Xvfb", "-displayfd", "3", "-screen", "0", "64x64x24", "-nolisten", "tcp",
           nullptr);
    _exit(127);
  }
  close(ends[1]);
  std::string number;
  constexpr int kPatience = 10000;  // [ms]
  pollfd wait{ends[0], POLLIN, 0};
  while (poll(&wait, 1, kPatience) > 0) {
    std::array<char, 16> text{};
    const ssize_t size = read(ends[0], text.data(), text.size());
    if (size <= 0) break;
    number.append(text.data(), static_cast<std::size_t>(size));
    if (number.back() == '\n') break;
  }
  close(ends[0]);
  if (number.empty() || number.back() != '\n') return "";
  number.pop_back();
  return number;
}

int lost(Display* /*display*/) {
  cli::complain("display: it is gone: the loop goes on without a window");
  _exit(1);
}

}  // namespace

void needDisplay(bool picture) {
  if (isThere()) return;
  const char* name = std::getenv("DISPLAY");
  const std::string why = name == nullptr || *name == '\0' ? std::string("there is none")
                                                           : std::string(name) + " does not answer";
  if (!picture) throw Error("display", why, "start it on a desktop, or add --picture FILE.png");
  const std::string number = startServer();
  if (!number.empty()) {
    std::atexit(endServer);
    setenv("DISPLAY", (":" + number).c_str(), 1);
  }
  if (number.empty() || !isThere())
    throw Error("display", why, "install xvfb, which pictures need then");
}

void endWithDisplay() {
  XSetIOErrorHandler(lost);
}

}  // namespace palpate::view
