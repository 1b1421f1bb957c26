#include "palpate/devices/plugins/plugin_child.h"

#include <array>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstring>
#include <fcntl.h>
#include <poll.h>
#include <span>
#include <spawn.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <system_error>
#include <thread>
#include <unistd.h>

namespace palpate {
namespace {

/// Throws DeviceError for a descriptor that the system refuses, with the reason in errno.
[[noreturn]] void throwNoDescriptor() {
  throw DeviceError(
      kPluginProgram,
      std::string("its sockets or memory cannot be opened (") + std::strerror(errno) + ")",
      "close files, or raise the limit of open files (ulimit -n)");
}

}  // namespace

OwnedDescriptor::OwnedDescriptor(int own) : own_(own) {
  if (own_ < 0) throwNoDescriptor();
  constexpr int kAbove = 16;
  if (own_ < kAbove) {
    const int moved = fcntl(own_, F_DUPFD_CLOEXEC, kAbove);
    close(std::exchange(own_, moved));
  }
  if (own_ < 0) throwNoDescriptor();
}

OwnedDescriptor::~OwnedDescriptor() {
  if (own_ >= 0) close(own_);
}

std::pair<OwnedDescriptor, OwnedDescriptor> pluginSocketPair() {
  std::array<int, 2> ends{-1, -1};
  const int made = socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends.data());
  if (made != 0) throwNoDescriptor();
  OwnedDescriptor first(ends[0]);
  return {std::move(first), OwnedDescriptor(ends[1])};
}

std::filesystem::path programBeside() {
  std::error_code error;
  const auto self = std::filesystem::read_symlink("/proc/self/exe", error);
  return self.parent_path() / kPluginProgram;
}

PluginChild::PluginChild(const std::filesystem::path& program,
                         const std::vector<std::string>& words, std::initializer_list<int> given) {
  posix_spawn_file_actions_t files;
  posix_spawn_file_actions_init(&files);
  posix_spawn_file_actions_addopen(&files, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  // Sends the output of the maker's library to stderr, because stdout has the program's own output.
  posix_spawn_file_actions_adddup2(&files, STDERR_FILENO, STDOUT_FILENO);
  int next = kPluginControl;
  for (const int own : given) posix_spawn_file_actions_adddup2(&files, own, next++);
  posix_spawn_file_actions_addclosefrom_np(&files, next);
  posix_spawnattr_t how;
  posix_spawnattr_init(&how);
  sigset_t none;
  sigset_t all;
  sigemptyset(&none);
  sigfillset(&all);
  posix_spawnattr_setsigmask(&how, &none);
  posix_spawnattr_setsigdefault(&how, &all);
  // A Ctrl-C in the terminal must reach the program only.
  posix_spawnattr_setflags(&how,
                           POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETSID);
  std::vector<std::string> all_words{kPluginProgram};
  all_words.insert(all_words.end(), words.begin(), words.end());
  std::vector<char*> arguments;
  arguments.reserve(all_words.size() + 1);
  for (std::string& word : all_words) arguments.push_back(word.data());
  arguments.push_back(nullptr);
  const int failed =
      posix_spawn(&process_, program.c_str(), &files, &how, arguments.data(), environ);
  posix_spawnattr_destroy(&how);
  posix_spawn_file_actions_destroy(&files);
  if (failed != 0) {
    process_ = -1;
    const bool busy = failed == EAGAIN || failed == ENOMEM;
    throw DeviceError(program.string(),
                      std::string("it cannot start (") + std::strerror(failed) + ")",
                      busy ? "end other programs, or raise the limit of processes (ulimit -u)"
                           : "install this program again");
  }
}

bool PluginChild::lives() {
  // If the program ignores SIGCHLD, the number process_ may belong to another process by now. Then
  // waitpid() fails.
  int what = 0;
  const pid_t changed = process_ > 0 ? waitpid(process_, &what, WNOHANG | WUNTRACED) : 0;
  if (changed > 0 && WIFSTOPPED(what)) {
    // A stopped process would leave its last force on the arm.
    stopped_ = kill(process_, SIGCONT) == 0;
  } else if (changed != 0) {
    process_ = -1;
  }
  return process_ > 0;
}

void PluginChild::end(double patience) {
  constexpr double kKernel = 1.0;  // [s] for the kernel to end a killed process
  bool killed = false;
  for (double waited = 0.0; lives() && waited < patience + kKernel; waited += 1e-3) {
    if (!killed && waited >= patience) killed = kill(process_, SIGKILL) == 0;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  process_ = -1;
}

std::vector<std::string> pluginLinesOf(const PluginMessage& message) {
  constexpr std::size_t kLines = 3;
  const std::string text = message.text();
  std::vector<std::string> lines;
  std::size_t at = 0;
  for (std::size_t end = 0; end != std::string::npos; at = end + 1) {
    end = text.find('\n', at);
    lines.push_back(text.substr(at, end - at));
    if (end == std::string::npos) break;
  }
  lines.resize(kLines);
  return lines;
}

DeviceError pluginErrorOf(const PluginMessage& message) {
  const std::vector<std::string> parts = pluginLinesOf(message);
  return {parts[0], parts[1], parts[2]};
}

PluginReceived receivePluginMessage(int control, std::optional<PluginMessage>& message) {
  std::array<std::byte, sizeof(PluginMessage) + 1> buffer{};
  message.reset();
  const ssize_t size = recv(control, buffer.data(), buffer.size(), MSG_DONTWAIT);
  if (size < 0 && (errno == EAGAIN || errno == EINTR)) return PluginReceived::kNothing;
  if (size <= 0) return PluginReceived::kEnd;
  message = pluginMessageOf(std::span(buffer).first(static_cast<std::size_t>(size)));
  return PluginReceived::kMessage;
}

PluginAnswer receivePluginMessages(int control, PluginChild& child, double patience,
                                   const std::function<bool()>& stop,
                                   const std::function<void(const PluginMessage&)>& take) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(patience);
  for (bool lives = true;;) {
    if (stop && stop()) return PluginAnswer::kStopped;
    if (patience > 0.0 && std::chrono::steady_clock::now() > end) return PluginAnswer::kLate;
    pollfd waits{control, POLLIN, 0};
    (void)poll(&waits, 1, kPluginPoll);
    std::optional<PluginMessage> message;
    const PluginReceived took = receivePluginMessage(control, message);
    // A process that the child has started may keep the socket open. So also ends when the child
    // has ended and no message waits.
    const bool silent = took == PluginReceived::kNothing;
    if (took == PluginReceived::kEnd || (silent && !lives)) return PluginAnswer::kEnded;
    lives = child.lives();
    if (!message) continue;
    if (message->kind == PluginMessage::kDone) return PluginAnswer::kAll;
    take(*message);
  }
}

std::optional<SentPluginFacts> pluginFactsIn(const PluginMessage& message) {
  SentPluginFacts sent{};
  if (message.size != sizeof(sent.facts) + sizeof(sent.carries)) return std::nullopt;
  std::memcpy(&sent.facts, message.bytes.data(), sizeof(sent.facts));
  std::memcpy(&sent.carries, message.bytes.data() + sizeof(sent.facts), sizeof(sent.carries));
  sent.facts.source[sizeof(sent.facts.source) - 1] = '\0';
  for (auto& name : sent.facts.button) name[sizeof(name) - 1] = '\0';
  return sent;
}

std::optional<palpate_plugin_found> pluginFoundIn(const PluginMessage& message) {
  palpate_plugin_found one{};
  if (message.kind != PluginMessage::kFound || message.size != sizeof(one)) return std::nullopt;
  std::memcpy(&one, message.bytes.data(), sizeof(one));
  one.serial[sizeof(one.serial) - 1] = one.model[sizeof(one.model) - 1] = '\0';
  return one;
}

}  // namespace palpate
