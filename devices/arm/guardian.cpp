#include "palpate/devices/arm/guardian.h"

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fcntl.h>
#include <new>
#include <poll.h>
#include <sched.h>
#include <string>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>
#include <utility>

#include "palpate/engine/error.h"
#include "palpate/engine/loop/realtime.h"

namespace palpate {

/// Memory that the program, the guardian's process and its watchers share.
struct Guardian::Shared {
  struct Loop {
    std::atomic<std::uint64_t> heart{0};
    /// Incremented by this loop's watcher in each pass, unless Shared::pulse has stopped.
    std::atomic<std::uint64_t> pulse{0};
    std::atomic<std::uint32_t> cuts{0};
  };
  std::array<Loop, kMostLoops> loops;
  std::atomic<std::uint32_t> stops{0};
  /// Incremented in each pass by the guardian, the process that starts the watchers.
  std::atomic<std::uint64_t> pulse{0};
  std::atomic<bool> over{false};      ///< The program's socket is closed.
  std::atomic<bool> punctual{false};  ///< The guardian has a real-time priority.
  static_assert(std::atomic<std::uint64_t>::is_always_lock_free);
};

namespace {

/// A device to watch. The program sends it to the guardian with a descriptor of the device. An
/// order without bytes ends the watch of its slot.
struct Order {
  std::size_t slot = 0;
  std::size_t size = 0;
  std::array<std::byte, ZeroForce::kMostBytes> bytes{};
};

std::string reason() {
  return std::strerror(errno);
}

bool writeWhole(int descriptor, const Order& order) noexcept {
  ssize_t written = -1;
  do {
    written = ::write(descriptor, order.bytes.data(), order.size);
  } while (written < 0 && errno == EINTR);
  return written == static_cast<ssize_t>(order.size);
}

class Message {
 public:
  explicit Message(Order& order) noexcept : part_{&order, sizeof(order)} {
    head_.msg_iov = &part_;
    head_.msg_iovlen = 1;
    head_.msg_control = control_.data();
    head_.msg_controllen = control_.size();
  }
  Message(const Message&) = delete;
  Message& operator=(const Message&) = delete;

  [[nodiscard]] bool send(int socket, int descriptor) noexcept {
    cmsghdr* beside = CMSG_FIRSTHDR(&head_);
    beside->cmsg_level = SOL_SOCKET;
    beside->cmsg_type = SCM_RIGHTS;
    beside->cmsg_len = CMSG_LEN(sizeof(int));
    std::memcpy(CMSG_DATA(beside), &descriptor, sizeof(int));
    return sendmsg(socket, &head_, MSG_NOSIGNAL) == static_cast<ssize_t>(part_.iov_len);
  }
  /// Returns false if the other side has closed the socket, or if the socket fails.
  [[nodiscard]] bool take(int socket, int& descriptor) noexcept {
    const ssize_t size = recvmsg(socket, &head_, 0);
    if (size < 0 && errno == EINTR) return true;
    if (size <= 0) return false;
    const cmsghdr* beside = CMSG_FIRSTHDR(&head_);
    if (beside != nullptr && beside->cmsg_type == SCM_RIGHTS) {
      std::memcpy(&descriptor, CMSG_DATA(beside), sizeof(int));
    }
    return true;
  }

 private:
  iovec part_;
  alignas(cmsghdr) std::array<std::byte, CMSG_SPACE(sizeof(int))> control_{};
  msghdr head_{};
};

/// Replaces both descriptors by numbers above 2, because standApart() replaces 0 to 2.
bool aboveStandard(std::array<int, 2>& ends) noexcept {
  bool good = true;
  for (int& end : ends) {
    const int moved = fcntl(end, F_DUPFD_CLOEXEC, 3);
    good = good && moved >= 0;
    close(end);
    end = moved;
  }
  return good;
}

/// Detaches from the program's signals, terminal and open files. Returns true if it got real-time
/// priority.
bool standApart(int socket) noexcept {
  setsid();
  for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGTSTP, SIGTTIN, SIGTTOU, SIGPIPE,
                           SIGXCPU, SIGUSR1, SIGUSR2}) {
    ::signal(signal, SIG_IGN);
  }
  prctl(PR_SET_NAME, "palpate-guard");
  const int null = open("/dev/null", O_RDWR);
  for (int standard = 0; standard < 3; ++standard) dup2(null, standard);
  const auto own = static_cast<unsigned>(socket);
  if (own > 3) close_range(3, own - 1, 0);
  close_range(own + 1, ~0U, 0);
  // A loop that hangs keeps its core, so the guardian needs a higher priority than the loop.
  bool punctual = false;
  for (int priority = kMostPriority + 5; priority > 0 && !punctual; priority -= 5) {
    sched_param wanted{};
    wanted.sched_priority = priority;
    punctual = sched_setscheduler(0, SCHED_FIFO, &wanted) == 0;
  }
  mlockall(MCL_CURRENT);
  return punctual;
}

std::atomic<Guardian*> the_guardian{nullptr};
volatile std::sig_atomic_t* the_flag = nullptr;
std::atomic<std::int64_t> asked_at{0};  ///< Time of the first request to end [ns].

extern "C" void zeroThenGoOn(int signal) {
  const int saved = errno;
  if (Guardian* guardian = the_guardian.load()) guardian->zero();
  const bool livable =
      signal == SIGINT || signal == SIGTERM || signal == SIGHUP || signal == SIGQUIT;
  // If the program hangs, a second request ends it. Requests within kAtOnce count as one, because a
  // terminal and a parent process may both send one.
  constexpr std::int64_t kAtOnce = 500'000'000;  // [ns]
  if (livable && the_flag != nullptr && *the_flag == 0) {
    *the_flag = 1;
    asked_at = nowNs();
  } else if (!livable || nowNs() - asked_at > kAtOnce) {
    // Takes the default action. SIGTSTP keeps the handler, for the next stop.
    struct sigaction usual {};
    usual.sa_handler = SIG_DFL;
    if (signal == SIGTSTP) {
      raise(SIGSTOP);
    } else {
      sigaction(signal, &usual, nullptr);
      raise(signal);
    }
  }
  errno = saved;
}

extern "C" void zeroAtExit() {
  if (Guardian* guardian = the_guardian.load()) guardian->zero();
}

}  // namespace

Guardian::Guardian() : maker_(getpid()) {
  void* memory =
      mmap(nullptr, sizeof(Shared), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  if (memory == MAP_FAILED) {
    throw DeviceError("guardian", "shared memory cannot be created (" + reason() + ")",
                      "end other programs to free memory");
  }
  shared_ = new (memory) Shared;
  std::array<int, 2> ends{-1, -1};
  if (socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends.data()) != 0 ||
      !aboveStandard(ends)) {
    const std::string why = reason();
    for (const int end : ends) {
      if (end >= 0) close(end);
    }
    munmap(shared_, sizeof(Shared));
    throw DeviceError("guardian", "its sockets cannot be opened (" + why + ")",
                      "close files, or raise the limit of open files (ulimit -n)");
  }
  child_ = fork();
  if (child_ == 0) {
    close(ends[0]);
    guard(ends[1]);
  }
  close(ends[1]);
  socket_ = ends[0];
  if (child_ < 0) {
    const std::string why = reason();
    close(socket_);
    munmap(shared_, sizeof(Shared));
    throw DeviceError("guardian", "its process cannot start (" + why + ")",
                      "end other programs, or raise the limit of processes (ulimit -u)");
  }
}

Guardian::~Guardian() {
  zero();
  Guardian* self = this;
  the_guardian.compare_exchange_strong(self, nullptr);
  if (getpid() == maker_) {
    shutdown(socket_, SHUT_RDWR);  // the child then makes its watchers write zero and ends
    // [ms]: longest wait for the child, longer than kLast, for which a blocked device may need it
    constexpr int kPatience = 1500;
    for (int ms = 0; waitpid(child_, nullptr, WNOHANG) == 0; ++ms) {
      if (ms == kPatience) {
        kill(child_, SIGKILL);
        waitpid(child_, nullptr, 0);
        break;
      }
      usleep(1000);
    }
  }
  close(socket_);
  munmap(shared_, sizeof(Shared));
}

LoopWatch Guardian::watch(const ZeroForce& zero) {
  const auto free = std::find(used_.begin(), used_.end(), false);
  if (free == used_.end()) {
    throw DeviceError("guardian", "it already watches 8 loops, its limit", "use fewer devices");
  }
  const auto slot = static_cast<std::size_t>(free - used_.begin());
  tell(slot, zero);
  *free = true;
  Shared::Loop& loop = shared_->loops[slot];
  return {&loop.heart, &shared_->stops, &loop.pulse, &loop.cuts, &shared_->punctual};
}

void Guardian::renew(const LoopWatch& loop, const ZeroForce& zero) {
  tell(slotOf(loop), zero);
}

void Guardian::forget(const LoopWatch& loop) {
  const std::size_t slot = slotOf(loop);
  Order order;
  order.slot = slot;
  (void)Message(order).send(socket_, socket_);
  used_[slot] = false;
}

std::size_t Guardian::slotOf(const LoopWatch& loop) const {
  for (std::size_t slot = 0; slot < kMostLoops; ++slot) {
    if (used_[slot] && loop.heart == &shared_->loops[slot].heart) return slot;
  }
  throw DeviceError("guardian", "it does not watch this loop", "call watch() first");
}

void Guardian::tell(std::size_t slot, const ZeroForce& zero) {
  if (zero.bytes.empty() || zero.bytes.size() > ZeroForce::kMostBytes) {
    throw DeviceError(
        "guardian", "the report of zero force has " + std::to_string(zero.bytes.size()) + " bytes",
        "give 1 to 256 bytes");
  }
  Order order;
  order.slot = slot;
  order.size = zero.bytes.size();
  std::copy(zero.bytes.begin(), zero.bytes.end(), order.bytes.begin());
  if (!Message(order).send(socket_, zero.descriptor)) {
    throw DeviceError("guardian", "its process cannot get the device (" + reason() + ")",
                      "start the program again");
  }
}

void Guardian::zero() noexcept {
  if (getpid() != maker_) return;  // called in a fork of the program
  shared_->stops.fetch_add(1, std::memory_order_relaxed);
}

void Guardian::catchSignals(volatile std::sig_atomic_t* interrupted) {
  static const bool once = [] { return std::atexit(zeroAtExit) == 0; }();
  (void)once;
  the_flag = interrupted;
  the_guardian = this;
  struct sigaction action {};
  action.sa_handler = zeroThenGoOn;
  action.sa_flags = SA_RESTART;
  sigemptyset(&action.sa_mask);
  for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGSEGV, SIGBUS, SIGFPE, SIGILL,
                           SIGABRT, SIGXCPU, SIGTSTP}) {
    sigaction(signal, &action, nullptr);
  }
}

void Guardian::guard(int socket) noexcept {
  shared_->punctual = standApart(socket);
  std::array<pid_t, kMostLoops> watchers{};
  // Does not wait for the watcher, which may hang in a driver: this process must serve other arms.
  const auto end = [](pid_t& watcher) {
    if (watcher > 0) kill(watcher, SIGKILL);
    watcher = 0;
  };
  for (;;) {
    constexpr int kLook = 5;  // [ms]: longest time between two passes
    shared_->pulse.fetch_add(1, std::memory_order_relaxed);
    // Forgets ended watchers: the system may give their numbers to other processes.
    for (pid_t gone = 0; (gone = waitpid(-1, nullptr, WNOHANG)) > 0;) {
      std::replace(watchers.begin(), watchers.end(), gone, pid_t{0});
    }
    pollfd waits{socket, POLLIN, 0};
    if (poll(&waits, 1, kLook) <= 0) continue;
    Order order;
    int descriptor = -1;
    if (!Message(order).take(socket, descriptor)) break;
    if (descriptor < 0 || order.slot >= kMostLoops) continue;
    end(watchers[order.slot]);
    // One watcher per device, so a device that does not answer does not delay another.
    if (order.size > 0) {
      const pid_t watcher = fork();
      if (watcher == 0) {
        close(socket);
        watchOver(descriptor, order.slot, order.bytes.data(), order.size);
      }
      watchers[order.slot] = watcher;
    }
    close(descriptor);
  }
  shared_->over = true;
  constexpr int kLast = 1200;  // [ms]: longer than kTries, for which a watcher tries to write zero
  for (int ms = 0; ms < kLast; ++ms) {
    bool busy = false;
    for (pid_t& watcher : watchers) {
      if (watcher > 0 && waitpid(watcher, nullptr, WNOHANG) != 0) watcher = 0;
      busy = busy || watcher > 0;
    }
    if (!busy) break;
    usleep(1000);
  }
  for (pid_t& watcher : watchers) {
    if (watcher > 0) kill(watcher, SIGKILL);
  }
  _exit(0);
}

void Guardian::watchOver(int descriptor, std::size_t slot, const std::byte* bytes,
                         std::size_t size) noexcept {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  Order zero;
  zero.size = size;
  std::copy(bytes, bytes + size, zero.bytes.begin());
  Shared::Loop& loop = shared_->loops[slot];
  constexpr std::int64_t kLook = 1000000;  // [ns] between two passes
  // [ns]: time for which a watcher tries to write zero after the program's end.
  constexpr std::int64_t kTries = 1000000000;
  constexpr auto kStill = static_cast<std::int64_t>(1e9 * kGuardTime);
  // [ns]: if the guardian's pulse stops for this time, the guardian has ended or hangs.
  constexpr std::int64_t kAlone = 25000000;
  std::uint64_t beats = loop.heart;
  std::uint32_t stops = shared_->stops;
  bool beating = false;  // the loop has ticked since its last pause of kStill
  bool wanted = false;   // zero force must still be written to the device
  std::int64_t alive = nowNs();
  std::uint64_t pulse = 0;
  std::int64_t kept_at = alive;
  std::int64_t over_at = 0;
  for (;;) {
    sleepUntil(nowNs() + kLook);
    const std::int64_t now = nowNs();
    if (std::exchange(pulse, shared_->pulse.load(std::memory_order_relaxed)) != pulse) {
      kept_at = now;
    }
    // If the guardian hangs, this watcher stops the pulse, so that the loop cuts its force: only
    // the guardian can start a watcher for an arm that is plugged in again.
    if (now - kept_at < kAlone) loop.pulse.fetch_add(1, std::memory_order_relaxed);
    if (const std::uint64_t seen = loop.heart.load(std::memory_order_relaxed); seen != beats) {
      beats = seen;
      alive = now;
      beating = true;
    }
    if (const std::uint32_t seen = shared_->stops.load(std::memory_order_relaxed); seen != stops) {
      stops = seen;
      wanted = true;
    }
    // Repeats the zero, because a loop that hangs may still write its last force.
    if (now - alive >= kStill) {
      if (beating) loop.cuts.fetch_add(1, std::memory_order_relaxed);
      wanted = true;
      beating = false;
      alive = now;
    }
    if (over_at == 0 && shared_->over) {
      over_at = now;
      wanted = true;
    }
    if (wanted) wanted = !writeWhole(descriptor, zero);
    if (over_at != 0 && (!wanted || now - over_at > kTries)) _exit(0);
  }
}

}  // namespace palpate
