#include "palpate/devices/plugins/plugin_server.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <fcntl.h>
#include <poll.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <sys/un.h>
#include <thread>
#include <unistd.h>
#include <utility>
#include <vector>

#include "palpate/engine/error.h"
#include "palpate/engine/loop/realtime.h"

namespace palpate {
namespace {

bool isZero(const palpate_plugin_force& force) noexcept {
  return force.force[0] == 0.0 && force.force[1] == 0.0 && force.force[2] == 0.0;
}

std::int64_t nsOf(double seconds) noexcept {
  return static_cast<std::int64_t>(1e9 * seconds);
}

}  // namespace

bool GrowthCheck::look(double size, double dt) noexcept {
  constexpr double kRounding = 1e-9;
  room_ = std::min(room_, slew_ * kLate) + slew_ * dt;
  room_ -= std::max(0.0, size - std::exchange(size_, size));
  return room_ >= -kRounding;
}

void PluginServer::stop() noexcept {
  stopped_ = true;
  device_.stop();
}

bool PluginServer::isSound(const PluginOrder& order, std::int64_t now) noexcept {
  const auto& force = order.force.force;
  // In libstdc++, std::hypot of three numbers may ignore a NaN.
  const double size = std::sqrt(force[0] * force[0] + force[1] * force[1] + force[2] * force[2]);
  const double dt = ordered_at_ == 0 ? 0.0 : 1e-9 * static_cast<double>(now - ordered_at_);
  const bool force_grows = force_growth_.look(size, dt);
  const bool carry_grows = carry_growth_.look(order.carry, dt);
  constexpr double kRounding = 1e-9;
  // A comparison with NaN is false, so NaN is not sound.
  const bool sound = size <= peak_ * (1.0 + kRounding) && force_grows && order.carry >= 0.0 &&
                     order.carry <= 1.0 && carry_grows;
  if (!sound) {
    force_growth_.forget();
    carry_growth_.forget();
  }
  return sound;
}

void PluginServer::give(std::int64_t now) noexcept {
  const std::uint32_t count = link_.orders.load(std::memory_order_acquire);
  if (count != seen_ && link_.order.load(order_)) {
    seen_ = count;
    const bool sound = isSound(order_, now);
    ordered_at_ = now;
    const bool zero = isZero(order_.force) && order_.carry == 0.0;
    if (zero) stopped_ = blamed_ = false;
    if (!sound) stopped_ = true;
    const bool stopped = stopped_;
    if (stopped) ++news_.withheld;
    const palpate_plugin_force none{sizeof(palpate_plugin_force), 0, {}, {}};
    device_.carry(stopped ? 0.0 : order_.carry);
    news_.wrote = device_.write(stopped ? none : order_.force);
    // A negative result makes the program report kWrite instead of kLate. It stands for an unsound
    // order or a plug-in that hung.
    if (!sound || (stopped && blamed_)) news_.wrote = -1;
    news_.written = order_.number;
    news_.given = stopped ? 0.0 : device_.given();
    drives_ = !stopped && !zero;
    // If stop() was called during the write, the force may have been sent after the zero.
    if (!stopped && stopped_) takeOff();
    link_.news.store(news_);
  } else if (drives_ && now - ordered_at_ > nsOf(kSilent)) {
    drives_ = false;
    stopped_ = true;
    takeOff();
  }
}

void PluginServer::takeOff() noexcept {
  const palpate_plugin_force none{sizeof(palpate_plugin_force), 0, {}, {}};
  device_.carry(0.0);
  (void)device_.write(none);
  device_.stop();
}

void PluginServer::read() noexcept {
  news_.read = device_.read(news_.reading);
  link_.news.store(news_);
}

std::int64_t PluginServer::nextReading(std::int64_t now) noexcept {
  const std::int64_t ticked = link_.ticked_at.load(std::memory_order_relaxed);
  constexpr std::int64_t kShortest = 50'000;
  constexpr std::int64_t kLongest = 20'000'000;
  const std::int64_t since = ticked - ticked_at_;
  if (ticked_at_ != 0 && since >= kShortest && since <= kLongest) period_ = since;
  ticked_at_ = ticked;
  return std::max(ticked + period_ - std::min(kLead, period_ / 4), now);
}

void PluginServer::loop() noexcept {
  std::int64_t due = nowNs();
  while (!ended_) {
    const std::int64_t now = nowNs();
    give(now);
    if (now >= due) {
      read();
      due = now + period_;
    }
    link_.heart.fetch_add(1, std::memory_order_relaxed);
    if (link_.ticked_at.load(std::memory_order_relaxed) != ticked_at_) due = nextReading(now);
    waitForWord(link_.orders, seen_, due);
  }
  stopped_ = true;
  takeOff();
  done_ = true;
}

PluginServer::Look PluginServer::look(std::int64_t now) noexcept {
  const std::int64_t since = now - std::exchange(looked_at_, now);
  if (since > nsOf(kPunctual)) held_up_ += since;
  const std::uint64_t beat = link_.heart.load(std::memory_order_relaxed);
  if (beat != beat_ || beat_at_ == 0) {
    beat_ = beat;
    beat_at_ = now;
    held_up_ = 0;
    hung_ = false;
  }
  const std::int64_t still = now - beat_at_ - 2 * period_;
  if (still > nsOf(kHung)) return Look::kEnd;
  if (still <= nsOf(kSilent)) return Look::kTurns;
  if (still - held_up_ > nsOf(kSilent)) blamed_ = true;
  return std::exchange(hung_, true) ? Look::kTurns : Look::kStop;
}

namespace {

/// The open arm, for signal handlers: they take the force off before the process ends.
std::atomic<const PluginDevice*> the_device{nullptr};

/// Longest time for stop() [us]. If stop() takes longer, this process ends, and the next process
/// takes the force off.
constexpr long kStopTime = 30000;
void endIn(long us) noexcept {
  const itimerval time{{0, 0}, {us / 1000000, us % 1000000}};
  setitimer(ITIMER_REAL, &time, nullptr);
}

extern "C" void stopThenEnd(int signal) {
  // The process ends even if stop() also crashes or hangs.
  if (const PluginDevice* device = the_device.exchange(nullptr)) {
    endIn(kStopTime);
    device->stop();
  }
  ::signal(signal, SIG_DFL);
  raise(signal);
}

extern "C" void stopAtExit() {
  if (const PluginDevice* device = the_device.exchange(nullptr)) {
    endIn(kStopTime);
    device->stop();
    endIn(0);
  }
}

/// An alternative stack for signal handlers: after a stack overflow the normal stack is unusable.
class HandlerStack {
 public:
  HandlerStack() : memory_(65536) {
    stack_t other{};
    other.ss_sp = memory_.data();
    other.ss_size = memory_.size();
    sigaltstack(&other, nullptr);
  }
  HandlerStack(const HandlerStack&) = delete;
  HandlerStack& operator=(const HandlerStack&) = delete;
  ~HandlerStack() {
    stack_t none{};
    none.ss_flags = SS_DISABLE;
    sigaltstack(&none, nullptr);
  }

 private:
  std::vector<std::byte> memory_;
};

/// Makes the signals below, and exit(), stop the arm before the process ends. Ignores SIGPIPE
/// (writes to closed pipes).
void catchCrashes() {
  struct sigaction action {};
  action.sa_handler = stopThenEnd;
  action.sa_flags = SA_ONSTACK | static_cast<int>(SA_RESETHAND);
  sigemptyset(&action.sa_mask);
  for (const int signal :
       {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT, SIGTERM, SIGINT, SIGHUP, SIGQUIT, SIGSYS, SIGTRAP,
        SIGXCPU, SIGXFSZ, SIGUSR1, SIGUSR2, SIGVTALRM, SIGPROF}) {
    sigaction(signal, &action, nullptr);
  }
  ::signal(SIGPIPE, SIG_IGN);
  std::atexit(stopAtExit);
}

bool programEnded() {
  pollfd control{kPluginControl, POLLIN, 0};
  return poll(&control, 1, 0) > 0 && (control.revents & (POLLHUP | POLLERR)) != 0;
}

/// Ends this process shortly after the program has ended, even if the plug-in hangs.
void endWithProgram() {
  std::thread([] {
    pollfd control{kPluginControl, 0, 0};
    while ((control.revents & (POLLHUP | POLLERR | POLLNVAL)) == 0) (void)poll(&control, 1, -1);
    constexpr auto kOrderly = std::chrono::milliseconds(500);
    std::this_thread::sleep_for(kOrderly);
    stopAtExit();
    _exit(4);
  }).detach();
}

/// Processes that the plug-in starts must not inherit the descriptors.
void keepDescriptors() {
  for (const int own : {kPluginControl, kPluginMemory, kPluginZero}) {
    (void)fcntl(own, F_SETFD, FD_CLOEXEC);
  }
}

/// Claims an arm by an abstract socket name, which the kernel frees when the process ends.
class Claim {
 public:
  Claim(const std::string& plugin, const std::string& serial) {
    const std::string arm = "plugin:" + plugin + (serial.empty() ? "" : "@" + serial);
    const std::string name = "palpate-" + arm;
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    name.copy(address.sun_path + 1, sizeof(address.sun_path) - 1);
    own_ = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    if (own_ < 0 || bind(own_, reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0) {
      const int error = errno;
      if (own_ >= 0) close(own_);
      if (error == EADDRINUSE) {
        throw DeviceError(arm, "another program uses this arm, or another hand of this program",
                          "end that program, or name another arm for this hand");
      }
      throw DeviceError(arm, std::string("it cannot be claimed (") + std::strerror(error) + ")",
                        "end other programs, or permit Unix sockets to this process");
    }
  }
  Claim(const Claim&) = delete;
  Claim& operator=(const Claim&) = delete;
  ~Claim() { close(own_); }

 private:
  int own_;
};

PluginHost host() {
  PluginHost out;
  out.say = [](const std::string& words) {
    (void)sendPluginMessage(kPluginControl, PluginMessage::kSay, words);
  };
  out.ends = [] { return programEnded(); };
  return out;
}

int failed(const Error& error) {
  (void)sendPluginMessage(kPluginControl, PluginMessage::kFailed,
                          error.subject() + "\n" + error.reason() + "\n" + error.remedy());
  return 1;
}

void introduce(const PluginLibrary& plugin) {
  (void)sendPluginMessage(kPluginControl, PluginMessage::kPlugin,
                          plugin.what() + "\n" + plugin.version() + "\n" + plugin.licence());
}

palpate_plugin_facts sendFacts(const PluginDevice& device) {
  const palpate_plugin_facts facts = device.facts();
  const double carries = device.carries();
  std::array<std::byte, sizeof(facts) + sizeof(carries)> bytes{};
  std::memcpy(bytes.data(), &facts, sizeof(facts));
  std::memcpy(bytes.data() + sizeof(facts), &carries, sizeof(carries));
  (void)sendPluginMessage(kPluginControl, PluginMessage::kFacts, bytes);
  return facts;
}

/// Maps the shared memory and write-protects the program's part. Throws DeviceError.
PluginLink& mapLink() {
  void* memory =
      mmap(nullptr, sizeof(PluginLink), PROT_READ | PROT_WRITE, MAP_SHARED, kPluginMemory, 0);
  if (memory == MAP_FAILED) {
    throw DeviceError("palpate-plugin",
                      std::string("memory shared with palpate cannot be mapped (mmap: ") +
                          std::strerror(errno) + ")",
                      "end other programs");
  }
  auto& link = *static_cast<PluginLink*>(memory);
  if (link.magic != PluginLink::kMagic || link.size != sizeof(PluginLink)) {
    throw DeviceError("palpate-plugin", "its version differs from palpate's",
                      "install palpate and palpate-plugin of the same release");
  }
  const auto page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  const auto orders = static_cast<std::size_t>(reinterpret_cast<const char*>(&link.news) -
                                               static_cast<const char*>(memory));
  if (mprotect(memory, orders / page * page, PROT_READ) != 0) {
    throw DeviceError(
        "palpate-plugin",
        std::string("memory shared with palpate cannot be made read-only (mprotect: ") +
            std::strerror(errno) + ")",
        "report this message and the output of `uname -r`");
  }
  close(kPluginMemory);
  return link;
}

void sendFound(const palpate_plugin_found& found) {
  (void)sendPluginMessage(kPluginControl, PluginMessage::kFound,
                          std::as_bytes(std::span(&found, 1)));
}

/// Reports the arm to the program and returns its serial number.
std::string chooseArm(const PluginLibrary& plugin, const std::string& serial) {
  palpate_plugin_found chosen{sizeof(palpate_plugin_found), {}, {}};
  const std::string own = plugin.only(serial);
  own.copy(chosen.serial, sizeof(chosen.serial) - 1);
  sendFound(chosen);
  return own.empty() ? serial : own;
}

/// Stops the arm. If the plug-in does not stop in time, ends the process.
void stopInTime(PluginServer& server) {
  endIn(kStopTime);
  server.stop();
  endIn(0);
}

/// Watches the haptic thread. Stops the arm at a request of zero force, or if the thread hangs.
void watchServer(PluginServer& server) {
  // Needs a priority above the haptic thread's, because a hung thread keeps its core.
  RealtimeRequest above;
  above.priority = kMostPriority;
  above.lock_memory = false;
  (void)becomeRealtime(above, StayAwake(false));
  std::array<pollfd, 2> ends{{{kPluginControl, POLLIN, 0}, {kPluginZero, POLLIN, 0}}};
  constexpr int kLook = 2;  // [ms] between two checks
  bool over = false;
  while (!over) {
    (void)poll(ends.data(), ends.size(), kLook);
    std::array<char, 64> any{};
    if ((ends[1].revents & POLLIN) != 0 && recv(kPluginZero, any.data(), any.size(), 0) > 0) {
      stopInTime(server);
    }
    over = ((ends[0].revents | ends[1].revents) & (POLLHUP | POLLERR)) != 0;
    const PluginServer::Look look = server.look(nowNs());
    if (look == PluginServer::Look::kStop) stopInTime(server);
    if (look == PluginServer::Look::kEnd) _exit(3);
  }
}

/// Stops the arm and ends the haptic thread's loop. If the loop does not end, ends this process.
void endServer(PluginServer& server, PluginLink& link) {
  stopInTime(server);
  server.end();
  wakeWord(link.orders);
  constexpr int kPatience = 200;  // [ms] for the loop to end
  for (int ms = 0; !server.done() && ms < kPatience; ++ms) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  if (!server.done()) _exit(3);
}

}  // namespace

int listPlugin(const std::filesystem::path& file) try {
  keepDescriptors();
  endWithProgram();
  const PluginLibrary plugin(file, host());
  introduce(plugin);
  for (const palpate_plugin_found& found : plugin.find()) {
    sendFound(found);
    try {
      const Claim claim(file.stem(), found.serial);
      (void)sendFacts(plugin.open(found.serial));
    } catch (const Error& error) {
      (void)failed(error);
    }
  }
  (void)sendPluginMessage(kPluginControl, PluginMessage::kDone, std::string());
  return 0;
} catch (const Error& error) {
  return failed(error);
}

int servePlugin(const std::filesystem::path& file, const std::string& serial) try {
  keepDescriptors();
  catchCrashes();
  const HandlerStack own_stack;
  endWithProgram();
  PluginLink& link = mapLink();
  const PluginLibrary plugin(file, host());
  introduce(plugin);
  const std::string asked = chooseArm(plugin, serial);
  const Claim claim(file.stem(), asked);
  const PluginDevice device = plugin.open(asked);
  the_device = &device;
  const palpate_plugin_facts facts = sendFacts(device);
  device.prepare();
  PluginServer server(link, device, 1e-3, facts.force, facts.slew > 0.0 ? facts.slew : kPluginSlew);
  std::thread haptic([&] {
    const HandlerStack stack;
    (void)becomeRealtime({}, StayAwake(false));
    server.loop();
  });
  // Waits for the loop's first pass, because locking the memory may take a while.
  while (link.heart == 0 && !programEnded()) std::this_thread::yield();
  (void)sendPluginMessage(kPluginControl, PluginMessage::kDone, std::string());
  watchServer(server);
  endServer(server, link);
  haptic.join();
  the_device = nullptr;
  return 0;
} catch (const Error& error) {
  the_device = nullptr;
  return failed(error);
}

}  // namespace palpate
