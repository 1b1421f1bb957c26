#include "devices/guardian.h"

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

#include "engine/error.h"
#include "engine/realtime.h"

namespace palpate {

/// What both processes see.
struct Guardian::Shared {
  std::array<std::atomic<std::uint64_t>, kMostLoops> hearts{};
  std::atomic<std::uint32_t> stops{0};
  std::atomic<std::uint64_t> pulse{0};  ///< Of the child.
  static_assert(std::atomic<std::uint64_t>::is_always_lock_free);
};

namespace {

/// A device to watch, as it is told to the child; its descriptor comes along.
struct Order {
  std::size_t slot = 0;
  std::size_t size = 0;
  std::array<std::byte, ZeroForce::kMostBytes> bytes{};
};

std::string reason() {
  return std::strerror(errno);
}

/// Signal-safe. What a device does not take now it will not take either: nothing is tried again
/// but what a signal has interrupted.
void writeOnce(int descriptor, const std::byte* bytes, std::size_t size) noexcept {
  while (::write(descriptor, bytes, size) < 0 && errno == EINTR) {
  }
}

/// An order and room for a descriptor beside it.
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
  /// False at the other side's end.
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

/// A program may have been started with its input or output closed: their numbers are not ours.
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

/// Nothing that is meant for the program ends its guardian.
void standApart(int socket) noexcept {
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
  // Above the loop, which keeps its core when it hangs; as high as is permitted.
  for (int priority = 90; priority > 0; priority -= 5) {
    sched_param wanted{};
    wanted.sched_priority = priority;
    if (sched_setscheduler(0, SCHED_FIFO, &wanted) == 0) break;
  }
  mlockall(MCL_CURRENT);
}

// What signal handlers know.
std::atomic<Guardian*> the_guardian{nullptr};
volatile std::sig_atomic_t* the_flag = nullptr;

extern "C" void zeroThenGoOn(int signal) {
  const int saved = errno;
  if (Guardian* guardian = the_guardian.load()) guardian->zero();
  const bool livable =
      signal == SIGINT || signal == SIGTERM || signal == SIGHUP || signal == SIGQUIT;
  // Asked a second time the program ends as if it had not been caught: it may hang.
  if (livable && the_flag != nullptr && *the_flag == 0) {
    *the_flag = 1;
  } else {
    // As if it had not been caught; a stop that is taken back finds the handler again.
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
  if (memory == MAP_FAILED) throw DeviceError("guardian", reason(), "free some memory");
  shared_ = new (memory) Shared;
  std::array<int, 2> ends{-1, -1};
  if (socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends.data()) != 0 ||
      !aboveStandard(ends)) {
    const std::string why = reason();
    for (const int end : ends) {
      if (end >= 0) close(end);
    }
    munmap(shared_, sizeof(Shared));
    throw DeviceError("guardian", why, "close some files");
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
    throw DeviceError("guardian", why, "end other programs");
  }
}

Guardian::~Guardian() {
  zero();
  Guardian* self = this;
  the_guardian.compare_exchange_strong(self, nullptr);
  if (getpid() == maker_) {
    shutdown(socket_, SHUT_RDWR);  // the child sees it, writes zero once more, and ends
    while (waitpid(child_, nullptr, 0) < 0 && errno == EINTR) {
    }
  }
  close(socket_);
  for (std::size_t i = 0; i < count_; ++i) close(watched_[i].descriptor);
  munmap(shared_, sizeof(Shared));
}

LoopWatch Guardian::watch(const ZeroForce& zero) {
  const std::size_t slot = count_;
  if (slot == kMostLoops) throw DeviceError("guardian", "it watches 8 loops", "use fewer devices");
  tell(slot, zero);
  count_.store(slot + 1, std::memory_order_release);
  return {&shared_->hearts[slot], &shared_->stops, &shared_->pulse};
}

void Guardian::renew(const LoopWatch& loop, const ZeroForce& zero) {
  for (std::size_t slot = 0; slot < count_; ++slot) {
    if (loop.heart == &shared_->hearts[slot]) return tell(slot, zero);
  }
  throw DeviceError("guardian", "it does not watch this loop", "watch it first");
}

void Guardian::tell(std::size_t slot, const ZeroForce& zero) {
  if (zero.bytes.empty() || zero.bytes.size() > ZeroForce::kMostBytes) {
    throw DeviceError("guardian", "a zero force of " + std::to_string(zero.bytes.size()) + " bytes",
                      "give 1 to 256");
  }
  Watched& watched = watched_[slot];
  // Its own: the device may be gone before the guardian is. A signal handler may be about to write:
  // the number stays.
  if (watched.descriptor < 0) {
    watched.descriptor = fcntl(zero.descriptor, F_DUPFD_CLOEXEC, 3);
  } else if (dup3(zero.descriptor, watched.descriptor, O_CLOEXEC) < 0) {
    throw DeviceError("guardian", reason(), "close some files");
  }
  if (watched.descriptor < 0) throw DeviceError("guardian", reason(), "close some files");
  watched.size = zero.bytes.size();
  std::copy(zero.bytes.begin(), zero.bytes.end(), watched.bytes.begin());
  Order order;
  order.slot = slot;
  order.size = watched.size;
  order.bytes = watched.bytes;
  if (!Message(order).send(socket_, zero.descriptor)) {
    throw DeviceError("guardian", reason(), "start the program again");
  }
}

void Guardian::zero() noexcept {
  const std::size_t count = count_.load(std::memory_order_acquire);
  if (getpid() != maker_) return;  // a copy that the program made of itself
  shared_->stops.fetch_add(1, std::memory_order_relaxed);
  for (std::size_t i = 0; i < count; ++i) {
    writeOnce(watched_[i].descriptor, watched_[i].bytes.data(), watched_[i].size);
  }
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
  standApart(socket);
  struct Ward {
    int descriptor = -1;
    Order order;
    std::uint64_t beats = 0;
    std::int64_t alive = 0;  // [ns]
    bool zeroed = true;
  };
  static std::array<Ward, kMostLoops> wards;
  constexpr int kLook = 1;  // [ms]
  for (bool living = true; living;) {
    pollfd other{socket, POLLIN, 0};
    if (poll(&other, 1, kLook) > 0) {
      Order order;
      int descriptor = -1;
      living = Message(order).take(socket, descriptor);
      if (living && descriptor >= 0 && order.slot < kMostLoops) {
        if (wards[order.slot].descriptor >= 0) close(wards[order.slot].descriptor);
        wards[order.slot] = {descriptor, order, 0, nowNs(), true};
      }
    }
    shared_->pulse.fetch_add(1, std::memory_order_relaxed);
    for (std::size_t i = 0; i < kMostLoops; ++i) {
      Ward& ward = wards[i];
      if (ward.descriptor < 0) continue;
      const std::uint64_t beats = shared_->hearts[i].load(std::memory_order_relaxed);
      const std::int64_t time = nowNs();
      if (beats != ward.beats) {
        ward.beats = beats;
        ward.alive = time;
        ward.zeroed = false;
      }
      if (living && (ward.zeroed || 1e-9 * static_cast<double>(time - ward.alive) < kGuardTime))
        continue;
      writeOnce(ward.descriptor, ward.order.bytes.data(), ward.order.size);
      ward.zeroed = true;
    }
  }
  _exit(0);
}

}  // namespace palpate
