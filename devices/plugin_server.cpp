#include "palpate/devices/plugin_server.h"

#include <algorithm>
#include <array>
#include <csignal>
#include <cstring>
#include <poll.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <thread>
#include <unistd.h>

#include "palpate/engine/error.h"
#include "palpate/engine/realtime.h"

namespace palpate {
namespace {

bool isZero(const palpate_plugin_force& force) noexcept {
  return force.force[0] == 0.0 && force.force[1] == 0.0 && force.force[2] == 0.0;
}

std::int64_t nsOf(double seconds) noexcept {
  return static_cast<std::int64_t>(1e9 * seconds);
}

}  // namespace

void PluginServer::stop() noexcept {
  stopped_ = true;
  device_.stop();
}

void PluginServer::give(std::int64_t now) noexcept {
  const std::uint32_t count = link_.orders.load(std::memory_order_acquire);
  if (count != seen_ && link_.order.load(order_)) {
    seen_ = count;
    ordered_at_ = now;
    const bool zero = isZero(order_.force);
    if (zero) stopped_ = false;
    const bool stopped = stopped_;
    if (stopped) ++news_.withheld;
    const palpate_plugin_force none{sizeof(palpate_plugin_force), 0, {}, {}};
    device_.carry(stopped ? 0.0 : order_.carry);
    news_.wrote = device_.write(stopped ? none : order_.force);
    news_.written = order_.number;
    news_.given = stopped ? 0.0 : device_.given();
    drives_ = !stopped && (!zero || order_.carry > 0.0);
    link_.news.store(news_);
  } else if (drives_ && now - ordered_at_ > nsOf(kSilent)) {
    // Nobody gives orders any more.
    drives_ = false;
    device_.carry(0.0);
    stop();
  }
}

void PluginServer::read() noexcept {
  news_.read = device_.read(news_.reading);
  link_.news.store(news_);
}

std::int64_t PluginServer::nextReading(std::int64_t now) noexcept {
  const std::int64_t ticked = link_.ticked_at.load(std::memory_order_relaxed);
  if (ticked == ticked_at_) return read_at_ + period_;
  constexpr std::int64_t kShortest = 50'000;
  constexpr std::int64_t kLongest = 20'000'000;
  const std::int64_t since = ticked - ticked_at_;
  if (ticked_at_ != 0 && since >= kShortest && since <= kLongest) period_ = since;
  ticked_at_ = ticked;
  return std::max(ticked + period_ - std::min(kLead, period_ / 4), now);
}

void PluginServer::loop() noexcept {
  read_at_ = nowNs();
  std::int64_t due = read_at_;
  while (!ended_) {
    const std::int64_t now = nowNs();
    give(now);
    if (now >= due) {
      read();
      read_at_ = now;
      due = now + period_;
    }
    link_.heart.fetch_add(1, std::memory_order_relaxed);
    if (link_.ticked_at.load(std::memory_order_relaxed) != ticked_at_) due = nextReading(now);
    waitForWord(link_.orders, seen_, due);
  }
  stop();
}

bool PluginServer::look(std::int64_t now) noexcept {
  const std::uint64_t beat = link_.heart.load(std::memory_order_relaxed);
  if (beat != beat_ || beat_at_ == 0) {
    beat_ = beat;
    beat_at_ = now;
    hung_ = false;
  }
  if (!hung_ && now - beat_at_ > nsOf(kSilent) + 2 * period_) {
    hung_ = true;
    stop();
  }
  return now - beat_at_ <= nsOf(kHung) + 2 * period_;
}

namespace {

/// For signal handlers: a plug-in that crashes takes its force off before its process ends.
std::atomic<const PluginDevice*> the_device{nullptr};

extern "C" void stopThenEnd(int signal) {
  // Where that crashes as well, or hangs, the process ends all the same.
  if (const PluginDevice* device = the_device.exchange(nullptr)) {
    alarm(1);
    device->stop();
  }
  ::signal(signal, SIG_DFL);
  raise(signal);
}

void catchCrashes() {
  static std::array<std::byte, 65536> stack;
  stack_t other{};
  other.ss_sp = stack.data();
  other.ss_size = stack.size();
  sigaltstack(&other, nullptr);
  struct sigaction action {};
  action.sa_handler = stopThenEnd;
  action.sa_flags = SA_ONSTACK | static_cast<int>(SA_RESETHAND);
  sigemptyset(&action.sa_mask);
  for (const int signal : {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT, SIGTERM}) {
    sigaction(signal, &action, nullptr);
  }
  // A second stack for the thread that ticks is not needed: a plug-in that runs out of it is gone.
}

/// The program has closed its end: nobody waits for anything any more.
bool programEnded() {
  pollfd control{kPluginControl, POLLIN, 0};
  return poll(&control, 1, 0) > 0 && (control.revents & (POLLHUP | POLLERR)) != 0;
}

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

void sendFacts(const PluginDevice& device) {
  const palpate_plugin_facts facts = device.facts();
  std::array<std::byte, sizeof(facts) + 1> bytes{};
  std::memcpy(bytes.data(), &facts, sizeof(facts));
  bytes.back() = device.carries() ? std::byte{1} : std::byte{0};
  (void)sendPluginMessage(kPluginControl, PluginMessage::kFacts, bytes);
}

}  // namespace

int listPlugin(const std::filesystem::path& file) try {
  const PluginLibrary plugin(file, host());
  introduce(plugin);
  for (const palpate_plugin_found& found : plugin.find()) {
    (void)sendPluginMessage(kPluginControl, PluginMessage::kFound,
                            std::as_bytes(std::span(&found, 1)));
    try {
      sendFacts(plugin.open(found.serial));
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
  catchCrashes();
  void* memory =
      mmap(nullptr, sizeof(PluginLink), PROT_READ | PROT_WRITE, MAP_SHARED, kPluginMemory, 0);
  if (memory == MAP_FAILED) throw DeviceError("palpate-plugin", "no memory", "free some");
  auto& link = *static_cast<PluginLink*>(memory);
  if (link.magic != PluginLink::kMagic || link.size != sizeof(PluginLink)) {
    throw DeviceError("palpate-plugin", "it is of another version than palpate",
                      "install both anew");
  }
  const PluginLibrary plugin(file, host());
  introduce(plugin);
  palpate_plugin_found chosen{sizeof(palpate_plugin_found), {}, {}};
  const std::string own = plugin.only(serial);
  own.copy(chosen.serial, sizeof(chosen.serial) - 1);
  (void)sendPluginMessage(kPluginControl, PluginMessage::kFound,
                          std::as_bytes(std::span(&chosen, 1)));
  const PluginDevice device = plugin.open(own);
  the_device = &device;
  sendFacts(device);
  device.prepare();
  PluginServer server(link, device, 1e-3);
  std::thread haptic([&] {
    (void)becomeRealtime({}, StayAwake(false));
    server.loop();
  });
  // Ready is what turns: locking its memory may have taken a while.
  while (link.heart == 0 && !programEnded()) std::this_thread::yield();
  (void)sendPluginMessage(kPluginControl, PluginMessage::kDone, std::string());
  std::array<pollfd, 2> ends{{{kPluginControl, POLLIN, 0}, {kPluginZero, POLLIN, 0}}};
  constexpr int kLook = 2;  // [ms]
  bool lives = true;
  for (bool over = false; !over && lives;) {
    (void)poll(ends.data(), ends.size(), kLook);
    std::array<char, 64> any{};
    if ((ends[1].revents & POLLIN) != 0 && recv(kPluginZero, any.data(), any.size(), 0) > 0) {
      server.stop();
    }
    over = ((ends[0].revents | ends[1].revents) & (POLLHUP | POLLERR)) != 0;
    lives = server.look(nowNs());
  }
  if (!lives) {
    // Its haptic thread is in the plug-in and does not come back.
    alarm(1);
    device.stop();
    _exit(3);
  }
  server.end();
  wakeWord(link.orders);
  haptic.join();
  the_device = nullptr;
  return 0;
} catch (const Error& error) {
  the_device = nullptr;
  return failed(error);
}

}  // namespace palpate
