#include "palpate/scenes/apps/view/display.h"

#include <GL/glx.h>
#include <X11/Xlib.h>
#include <X11/Xproto.h>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <fcntl.h>
#include <poll.h>
#include <spawn.h>
#include <string>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/random.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/descriptor.h"
#include "palpate/scenes/apps/common/say.h"

namespace palpate::view {
namespace {

/// This program's own connection to the X server, besides VTK's. It stays open until the end: when
/// the last client disconnects, a server may restart and reject new clients for a moment.
Display* connection = nullptr;

/// Opens the connection. Returns the reason why the display cannot show OpenGL; empty if it can.
std::string problem() {
  const char* name = std::getenv("DISPLAY");
  if (name == nullptr || *name == '\0') return "the variable DISPLAY is empty or not set";
  connection = XOpenDisplay(nullptr);
  if (connection == nullptr) return std::string(name) + " cannot be opened";
  // VTK requests this configuration, and aborts without a message if the display does not have it.
  const std::array<int, 5> wanted{GLX_DEPTH_SIZE, 1, GLX_ALPHA_SIZE, 1, None};
  int count = 0;
  int unused = 0;
  if (glXQueryExtension(connection, &unused, &unused) != 0) {
    XFree(glXChooseFBConfig(connection, DefaultScreen(connection), wanted.data(), &count));
  }
  return count > 0 ? "" : std::string(name) + " has no OpenGL";
}

pid_t server = -1;

void endServer() {
  if (server < 0) return;
  kill(server, SIGTERM);
  waitpid(server, nullptr, 0);
}

/// Creates an authority file, so that Xvfb accepts only this program as a client. The file has no
/// name, and disappears with its last descriptor. Returns no descriptor on failure.
Descriptor authority() {
  std::string name = "MIT-MAGIC-COOKIE-1";
  std::array<char, 16> cookie{};
  if (getrandom(cookie.data(), cookie.size(), 0) != static_cast<ssize_t>(cookie.size())) {
    return Descriptor();
  }
  // Format of Xau: family (here: any), then address, display, name and cookie with their lengths.
  std::string record = "\xff\xff";
  for (const std::string& part :
       {std::string(), std::string(), name, std::string(cookie.data(), cookie.size())}) {
    record += '\0';
    record += static_cast<char>(part.size());
    record += part;
  }
  Descriptor file(memfd_create("palpate-authority", 0));
  if (file.get() < 0) return file;
  (void)!write(file.get(), record.data(), record.size());
  XSetAuthorization(name.data(), static_cast<int>(name.size()), cookie.data(),
                    static_cast<int>(cookie.size()));
  return file;
}

std::string startServer() {
  Descriptor known = authority();
  int ends[2];
  if (known.get() < 0 || pipe(ends) != 0) return "";
  const Descriptor from(ends[0]);
  Descriptor to(ends[1]);
  const pid_t parent = getpid();
  server = fork();
  if (server == 0) {
    // The kernel ends Xvfb when this program ends for any reason.
    prctl(PR_SET_PDEATHSIG, SIGTERM);
    if (getppid() != parent) _exit(1);
    // Ctrl-C must not end Xvfb: the loop's process handles it and ends this program.
    setpgid(0, 0);
    dup2(to.get(), 3);
    // Discards Xvfb's messages about display numbers in use.
    const int nowhere = open("/dev/null", O_WRONLY);
    dup2(nowhere, STDERR_FILENO);
    const std::string place = "/proc/self/fd/" + std::to_string(known.get());
    execlp("Xvfb", "Xvfb", "-displayfd", "3", "-screen", "0", "64x64x24", "-nolisten", "tcp",
           "-auth", place.c_str(), nullptr);
    _exit(127);
  }
  to.close();
  known.close();
  std::string number;
  constexpr int kPatience = 10000;  // [ms]: longest wait until Xvfb has started
  pollfd wait{from.get(), POLLIN, 0};
  while (poll(&wait, 1, kPatience) > 0) {
    std::array<char, 16> text{};
    const ssize_t size = read(from.get(), text.data(), text.size());
    if (size <= 0) break;
    number.append(text.data(), static_cast<std::size_t>(size));
    if (number.back() == '\n') break;
  }
  if (number.empty() || number.back() != '\n') return "";
  number.pop_back();
  return number;
}

/// Effect of a lost or failing display, for messages.
const char* effect = "the window closes";

int lost(Display* /*display*/) {
  cli::complain(fmt::format("display: the connection to the X server is lost: {}", effect));
  _exit(1);
}

int refused(Display* display, XErrorEvent* error) {
  // VTK may request the focus for a window that was hidden meanwhile. This is harmless.
  if (error->request_code == X_SetInputFocus) return 0;
  std::array<char, 128> why{};
  XGetErrorText(display, error->error_code, why.data(), static_cast<int>(why.size()));
  cli::complain(fmt::format("display: the X server rejected request {}.{}, {}: {}",
                            error->request_code, error->minor_code, why.data(), effect));
  _exit(1);
}

}  // namespace

void needDisplay(bool picture) {
  if (picture) effect = "the picture is not drawn";
  XSetIOErrorHandler(lost);
  XSetErrorHandler(refused);
  std::string why = problem();
  if (why.empty()) return;
  if (!picture) {
    throw Error("display", why,
                "run palpate view on a desktop with OpenGL, or add --picture FILE.png");
  }
  const std::string number = startServer();
  if (number.empty()) {
    throw Error("display", why,
                "install xvfb, which draws pictures without a desktop; if xvfb is installed, run "
                "Xvfb -displayfd 1 to see why Xvfb does not start");
  }
  std::atexit(endServer);
  setenv("DISPLAY", (":" + number).c_str(), 1);
  why = problem();
  if (!why.empty()) {
    throw Error("display", "the display of Xvfb, which palpate started, fails: " + why,
                "install or reinstall xvfb and libgl1-mesa-dri");
  }
}

Sight::Sight(unsigned long window) {
  XSelectInput(connection, window, StructureNotifyMask | VisibilityChangeMask);
  XFlush(connection);
}

bool Sight::now() {
  while (XPending(connection) > 0) {
    XEvent event;
    XNextEvent(connection, &event);
    if (event.type == UnmapNotify) mapped_ = false;
    // If another window covers this one, a VisibilityNotify follows. A destroyed window counts as
    // visible, so that the next drawing fails and the program ends.
    if (event.type == MapNotify || event.type == DestroyNotify) {
      mapped_ = true;
      covered_ = false;
    }
    if (event.type == VisibilityNotify) {
      covered_ = event.xvisibility.state == VisibilityFullyObscured;
    }
  }
  return mapped_ && !covered_;
}

}  // namespace palpate::view
