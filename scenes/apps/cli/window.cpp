#include "palpate/scenes/apps/cli/window.h"

#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstring>
#include <spawn.h>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {
namespace {

constexpr auto kLook = std::chrono::milliseconds(10);  ///< Time between two checks.

std::string programPath() {
  return (programFolder() / "palpate-view").string();
}

[[noreturn]] void refuse(int error) {
  throw Error("palpate-view",
              error == ENOENT ? "this program, which draws the window, is not installed"
                              : fmt::format("it cannot be started ({})", std::strerror(error)),
              error == ENOENT ? "install the package palpate-view, or build with VTK"
                              : "check its permissions, or end other programs");
}

/// Describes how palpate-view has ended, for example "it was ended by signal 9 (Killed)".
std::string endOf(int status) {
  if (status < 0) return "its exit status is unknown";
  if (WIFSIGNALED(status)) {
    return fmt::format("it was ended by signal {} ({})", WTERMSIG(status),
                       strsignal(WTERMSIG(status)));
  }
  return fmt::format("its exit status is {}", WEXITSTATUS(status));
}

}  // namespace

Window::Window(double rate) : writer_(share_.block(), rate) {
  if (access(programPath().c_str(), X_OK) != 0) refuse(errno);
}

Window::~Window() {
  share_.block().over = 1;
  if (child_ < 0) return;
  // The window checks 30 times a second whether the run has ended.
  constexpr auto kPatience = std::chrono::milliseconds(1500);
  const auto end = std::chrono::steady_clock::now() + kPatience;
  while (!ended()) {
    if (std::chrono::steady_clock::now() > end) {
      kill(child_, SIGKILL);
      waitpid(child_, nullptr, 0);
      return;
    }
    std::this_thread::sleep_for(kLook);
  }
}

std::optional<int> Window::ended() {
  int status = 0;
  const pid_t child = waitpid(child_, &status, WNOHANG);
  if (child == 0) return std::nullopt;
  child_ = -1;
  return child < 0 ? -1 : status;
}

void Window::start(const std::vector<std::string>& arguments) {
  std::vector<std::string> words{"palpate-view", "--live", std::to_string(share_.descriptor())};
  words.insert(words.end(), arguments.begin(), arguments.end());
  posix_spawn_file_actions_t files;
  posix_spawn_file_actions_init(&files);
  // Duplicating a descriptor to itself clears its close-on-exec flag.
  posix_spawn_file_actions_adddup2(&files, share_.descriptor(), share_.descriptor());
  posix_spawnattr_t with;
  posix_spawnattr_init(&with);
  sigset_t usual;
  sigemptyset(&usual);
  for (const int signal : {SIGPIPE, SIGXFSZ, SIGINT, SIGTERM, SIGHUP, SIGQUIT}) {
    sigaddset(&usual, signal);
  }
  posix_spawnattr_setsigdefault(&with, &usual);
  posix_spawnattr_setflags(&with, POSIX_SPAWN_SETSIGDEF);
  pid_t child = -1;
  const int error =
      posix_spawn(&child, programPath().c_str(), &files, &with, argumentsOf(words).data(), environ);
  posix_spawnattr_destroy(&with);
  posix_spawn_file_actions_destroy(&files);
  if (error != 0) refuse(error);
  child_ = child;
}

void Window::open(const std::string& scene, bool watch, bool only, double reengage) {
  only_ = only;
  std::vector<std::string> words{scene, "--reengage", fmt::format("{}", reengage)};
  if (watch) words.emplace_back("--watch");
  start(words);
}

void Window::draw(const std::string& scene, const std::string& picture,
                  const std::vector<std::string>& view) {
  std::vector<std::string> words{scene, "--picture", picture};
  words.insert(words.end(), view.begin(), view.end());
  start(words);
  std::optional<int> status;
  while (!(status = ended()) && interrupted == 0) std::this_thread::sleep_for(kLook);
  if (interrupted != 0) {
    if (!status) kill(child_, SIGTERM);
    throw Interrupted{};
  }
  if (*status != 0) {
    throw Error("palpate-view", "the picture was not drawn: " + endOf(*status),
                WIFEXITED(*status) ? "read its message above"
                : WTERMSIG(*status) == SIGKILL
                    ? "end other programs, because memory may have run out, and "
                      "try again"
                    : "try again; if this repeats, report this message and your "
                      "command line");
  }
}

Asked Window::look(const std::vector<HapticThread*>& hands) {
  const std::optional<int> status = child_ >= 0 ? ended() : std::nullopt;
  LiveWishes now;
  const bool told = share_.block().wishes.read(now);
  if (status && (!told || now.closed == 0)) {
    lost_ = only_;
    complain("view: the window has ended: " + endOf(*status) +
             (lost_ ? ": its mouse was the only hand: the run ends"
                    : ": the run continues without it; Ctrl-C ends the run"));
  }
  if (!told) return {};
  Asked asked = cli::asked(wishes_, now);
  wishes_ = now;
  for (HapticThread* hand : hands) {
    if (asked.cut) hand->cut();
    if (asked.clear) hand->clear();
  }
  return asked;
}

}  // namespace palpate::cli
