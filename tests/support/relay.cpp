/// Runs two programs in separate networks, with a faulty link between them.
///
///     palpate_relay [--delay-ms D] [--jitter-ms J] [--loss P] [--twice P] [--overtaken P]
///                   [--mbit R] [--seed N] [--seconds S] -- ONE... -- OTHER...
///
/// ONE has the address 10.77.0.1, OTHER 10.77.0.2; they reach no other network. The seed and the
/// number of a packet determine whether it is lost, delayed, doubled or overtaken. Ends with OTHER
/// and its status, or after S seconds with status 124; then also ends ONE. Ends with status 77 if
/// it cannot create the networks. SIGUSR1 disconnects the two, the next SIGUSR1 connects them. At
/// the end prints a line of JSON on stderr: the numbers of packets.
#include <algorithm>
#include <arpa/inet.h>
#include <array>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <fcntl.h>
#include <linux/if_tun.h>
#include <map>
#include <net/if.h>
#include <netinet/in.h>
#include <poll.h>
#include <random>
#include <sched.h>
#include <stdexcept>
#include <string>
#include <sys/ioctl.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>
#include <vector>

#include <CLI/CLI.hpp>

namespace {

using Clock = std::chrono::steady_clock;
using Seconds = std::chrono::duration<double>;

volatile std::sig_atomic_t parted = 0;
void part(int /*signal*/) {
  parted = parted == 0 ? 1 : 0;
}

[[noreturn]] void fail(const char* what) {
  throw std::runtime_error(std::string(what) + ": " + std::strerror(errno));
}

void write(const char* file, const std::string& text) {
  const int fd = open(file, O_WRONLY | O_CLOEXEC);
  if (fd < 0) fail(file);
  const bool done = ::write(fd, text.data(), text.size()) == static_cast<ssize_t>(text.size());
  close(fd);
  if (!done) fail(file);
}

/// Moves this process into a new network namespace, in which it has full rights, and its future
/// children into a new process namespace. When the first child ends, the kernel ends the others.
void leaveNetworks() {
  const std::string user = "0 " + std::to_string(getuid()) + " 1";
  const std::string group = "0 " + std::to_string(getgid()) + " 1";
  if (getuid() == 0) {
    if (unshare(CLONE_NEWNET | CLONE_NEWPID) != 0) fail("cannot create namespaces");
    return;
  }
  if (unshare(CLONE_NEWUSER | CLONE_NEWNET | CLONE_NEWPID) != 0) fail("cannot create namespaces");
  write("/proc/self/setgroups", "deny");
  write("/proc/self/uid_map", user);
  write("/proc/self/gid_map", group);
}

void ask(int socket, unsigned long what, ifreq& of, const char* name) {
  if (ioctl(socket, what, &of) != 0) fail(name);
}

/// Creates a network device with this address. Returns a descriptor to read and write its packets.
int makeTun(const std::string& address) {
  const int tun = open("/dev/net/tun", O_RDWR | O_NONBLOCK | O_CLOEXEC);
  if (tun < 0) fail("/dev/net/tun");
  ifreq of{};
  std::strncpy(of.ifr_name, "way", IFNAMSIZ - 1);
  of.ifr_flags = IFF_TUN | IFF_NO_PI;
  if (ioctl(tun, TUNSETIFF, &of) != 0) fail("cannot create a TUN device");
  const int socket = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (socket < 0) fail("cannot create a socket");
  const auto set = [&](unsigned long what, const std::string& text) {
    ifreq one{};
    std::memcpy(one.ifr_name, of.ifr_name, IFNAMSIZ);
    sockaddr_in to{};
    to.sin_family = AF_INET;
    inet_pton(AF_INET, text.c_str(), &to.sin_addr);
    std::memcpy(&one.ifr_addr, &to, sizeof to);
    ask(socket, what, one, "cannot set an address");
  };
  set(SIOCSIFADDR, address);
  set(SIOCSIFNETMASK, "255.255.255.0");
  for (const char* name : {"way", "lo"}) {
    ifreq one{};
    std::strncpy(one.ifr_name, name, IFNAMSIZ - 1);
    ask(socket, SIOCGIFFLAGS, one, "cannot read the flags of a network device");
    one.ifr_flags = static_cast<short>(one.ifr_flags | IFF_UP | IFF_RUNNING | IFF_MULTICAST);
    ask(socket, SIOCSIFFLAGS, one, "cannot start a network device");
  }
  close(socket);
  return tun;
}

/// A message that passes a file descriptor.
struct Handing {
  char byte = 0;
  iovec data{&byte, 1};
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int))> room{};
  msghdr message{};

  Handing() {
    message.msg_iov = &data;
    message.msg_iovlen = 1;
    message.msg_control = room.data();
    message.msg_controllen = room.size();
  }
  Handing(const Handing&) = delete;
  Handing& operator=(const Handing&) = delete;
  ~Handing() = default;
};

void send(int to, int descriptor) {
  Handing of;
  cmsghdr* head = CMSG_FIRSTHDR(&of.message);
  head->cmsg_level = SOL_SOCKET;
  head->cmsg_type = SCM_RIGHTS;
  head->cmsg_len = CMSG_LEN(sizeof(int));
  std::memcpy(CMSG_DATA(head), &descriptor, sizeof descriptor);
  if (sendmsg(to, &of.message, 0) != 1) fail("cannot pass the TUN device on");
}

int receive(int from) {
  Handing of;
  if (recvmsg(from, &of.message, MSG_CMSG_CLOEXEC) != 1) {
    throw std::runtime_error("the child process has sent no TUN device");
  }
  int descriptor = -1;
  std::memcpy(&descriptor, CMSG_DATA(CMSG_FIRSTHDR(&of.message)), sizeof descriptor);
  return descriptor;
}

struct End {
  pid_t child = 0;
  int tun = -1;
  int go = -1;  ///< a byte written to it starts the program
};

int statusOf(int how) {
  return WIFEXITED(how) ? WEXITSTATUS(how) : 128 + WTERMSIG(how);
}

End begin(const std::vector<std::string>& words, const std::string& address) {
  std::array<int, 2> pair{};
  if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair.data()) != 0)
    fail("cannot create a socket pair");
  End end;
  end.child = fork();
  if (end.child < 0) fail("cannot fork");
  if (end.child == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    try {
      leaveNetworks();
      send(pair[1], makeTun(address));
    } catch (const std::exception& e) {
      std::fprintf(stderr, "palpate_relay: %s\n", e.what());
      _exit(77);
    }
    char byte = 0;
    if (read(pair[1], &byte, 1) != 1) _exit(77);
    // This child is the first process of the new process namespace.
    const pid_t first = fork();
    if (first != 0) {
      int how = 0;
      _exit(first > 0 && waitpid(first, &how, 0) == first ? statusOf(how) : 77);
    }
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    std::vector<char*> argv;
    for (const std::string& word : words) argv.push_back(const_cast<char*>(word.c_str()));
    argv.push_back(nullptr);
    execvp(argv[0], argv.data());
    std::fprintf(stderr, "palpate_relay: %s: %s\n", argv[0], std::strerror(errno));
    _exit(127);
  }
  close(pair[1]);
  end.go = pair[0];
  end.tun = receive(end.go);
  return end;
}

struct Badness {
  double delay = 0.0;      // [ms]
  double jitter = 0.0;     // [ms]; uniform addition to the delay
  double loss = 0.0;       // share of packets that are lost
  double twice = 0.0;      // share of packets that arrive twice
  double overtaken = 0.0;  // share of packets that are delayed once more
  double mbit = 0.0;       // [Mbit/s]; 0: unlimited
  std::uint64_t seed = 1;
};

/// One direction of the link, with the packets on their way.
class Way {
 public:
  Way(const Badness& of, std::uint64_t seed) : of_(of), random_(seed) {}

  void take(std::string packet, Clock::time_point now) {
    ++sent_;
    // Draws all numbers for each packet, so that one packet's fate does not change that of others.
    const std::array<double, 4> draw{uniform(), uniform(), uniform(), uniform()};
    constexpr std::size_t kMost = 1U << 16U;
    if (parted != 0 || draw[0] < of_.loss || waiting_.size() >= kMost) {
      ++lost_;
      return;
    }
    double wait = 1e-3 * (of_.delay + of_.jitter * draw[1]);
    if (draw[2] < of_.overtaken) {
      wait += 1e-3 * of_.delay;
      ++overtaken_;
    }
    Clock::time_point due = now + std::chrono::duration_cast<Clock::duration>(Seconds(wait));
    if (of_.mbit > 0.0) {
      const Seconds takes(8e-6 * static_cast<double>(packet.size()) / of_.mbit);
      free_ = std::max(free_, now) + std::chrono::duration_cast<Clock::duration>(takes);
      due = std::max(due, free_);
    }
    if (draw[3] < of_.twice) {
      waiting_.emplace(due, packet);
      ++doubled_;
    }
    waiting_.emplace(due, std::move(packet));
  }
  /// Writes the packets that are due.
  void give(int tun, Clock::time_point now) {
    while (!waiting_.empty() && waiting_.begin()->first <= now) {
      const std::string& packet = waiting_.begin()->second;
      if (::write(tun, packet.data(), packet.size()) < 0 && errno == EAGAIN) ++lost_;
      waiting_.erase(waiting_.begin());
    }
  }
  /// Returns the time until the next packet is due, at most `most` [ms].
  [[nodiscard]] int until(Clock::time_point now, int most) const {
    if (waiting_.empty()) return most;
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(waiting_.begin()->first - now);
    return static_cast<int>(std::clamp<std::int64_t>(left.count(), 0, most));
  }
  void print(const char* name) const {
    std::fprintf(stderr,
                 "\"%s\": {\"sent\": %ld, \"lost\": %ld, \"twice\": %ld, \"overtaken\": %ld}", name,
                 sent_, lost_, doubled_, overtaken_);
  }

 private:
  double uniform() { return static_cast<double>(random_() >> 11U) * 0x1p-53; }

  Badness of_;
  std::mt19937_64 random_;
  std::multimap<Clock::time_point, std::string> waiting_;
  Clock::time_point free_;
  long sent_ = 0;
  long lost_ = 0;
  long doubled_ = 0;
  long overtaken_ = 0;
};

/// Moves all packets from `tun` to `way`.
void drain(int tun, Way& way, Clock::time_point now) {
  std::array<char, 1U << 16U> packet{};
  while (true) {
    const ssize_t got = read(tun, packet.data(), packet.size());
    if (got <= 0) return;
    way.take(std::string(packet.data(), static_cast<std::size_t>(got)), now);
  }
}

int relay(const Badness& of, double seconds, const std::vector<std::string>& one,
          const std::vector<std::string>& other) {
  std::array<End, 2> ends{begin(one, "10.77.0.1"), begin(other, "10.77.0.2")};
  std::array<Way, 2> ways{Way(of, of.seed), Way(of, of.seed + 0x9e3779b97f4a7c15U)};
  for (const End& end : ends) {
    if (::write(end.go, "", 1) != 1) fail("cannot start a program");
  }
  const Clock::time_point last =
      Clock::now() + std::chrono::duration_cast<Clock::duration>(Seconds(seconds));
  int status = 124;
  while (Clock::now() < last) {
    int how = 0;
    if (waitpid(ends[1].child, &how, WNOHANG) == ends[1].child) {
      status = statusOf(how);
      ends[1].child = 0;
      break;
    }
    constexpr int kTurnMs = 20;
    const Clock::time_point before = Clock::now();
    const int wait = std::min(ways[0].until(before, kTurnMs), ways[1].until(before, kTurnMs));
    std::array<pollfd, 2> ready{pollfd{ends[0].tun, POLLIN, 0}, pollfd{ends[1].tun, POLLIN, 0}};
    (void)poll(ready.data(), ready.size(), wait);
    const Clock::time_point now = Clock::now();
    for (std::size_t i = 0; i < 2; ++i) {
      drain(ends[i].tun, ways[i], now);
      ways[i].give(ends[1 - i].tun, now);
    }
  }
  for (const End& end : ends) {
    if (end.child == 0) continue;
    kill(end.child, SIGKILL);
    (void)waitpid(end.child, nullptr, 0);
  }
  std::fputc('{', stderr);
  ways[0].print("from_one");
  std::fputs(", ", stderr);
  ways[1].print("from_other");
  std::fputs("}\n", stderr);
  return status;
}

}  // namespace

int main(int argc, char** argv) {
  std::vector<std::string> options;
  std::array<std::vector<std::string>, 2> commands;
  int which = -1;
  for (int i = 1; i < argc; ++i) {
    if (std::string(argv[i]) == "--" && which < 1) {
      ++which;
    } else if (which < 0) {
      options.emplace_back(argv[i]);
    } else {
      commands[static_cast<std::size_t>(which)].emplace_back(argv[i]);
    }
  }
  CLI::App app{"Runs two programs in separate networks, with a faulty link between them"};
  Badness of;
  double seconds = 600.0;
  const CLI::Range share(0.0, 1.0);
  app.add_option("--delay-ms", of.delay, "Delay in each direction [ms]")
      ->check(CLI::NonNegativeNumber);
  app.add_option("--jitter-ms", of.jitter, "Largest random addition to the delay, uniform [ms]")
      ->check(CLI::NonNegativeNumber);
  app.add_option("--loss", of.loss, "Share of packets that are lost")->check(share);
  app.add_option("--twice", of.twice, "Share of packets that arrive twice")->check(share);
  app.add_option("--overtaken", of.overtaken, "Share of packets that are delayed twice")
      ->check(share);
  app.add_option("--mbit", of.mbit, "Rate in each direction [Mbit/s]; 0: unlimited")
      ->check(CLI::NonNegativeNumber);
  app.add_option("--seed", of.seed, "Seed of the random numbers");
  app.add_option("--seconds", seconds, "Largest duration [s]")->check(CLI::Range(0.0, 3600.0));
  std::reverse(options.begin(), options.end());
  try {
    app.parse(options);
  } catch (const CLI::ParseError& e) {
    return app.exit(e);
  }
  if (commands[0].empty() || commands[1].empty()) {
    std::fputs("palpate_relay: two programs are needed: OPTIONS -- ONE... -- OTHER...\n", stderr);
    return 2;
  }
  struct sigaction action {};
  action.sa_handler = part;
  sigaction(SIGUSR1, &action, nullptr);
  std::signal(SIGPIPE, SIG_IGN);
  try {
    return relay(of, seconds, commands[0], commands[1]);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "palpate_relay: %s\n", e.what());
    return 77;
  }
}
