#include "palpate/devices/plugins/plugin_process.h"

#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <fcntl.h>
#include <functional>
#include <future>
#include <new>
#include <optional>
#include <poll.h>
#include <sys/mman.h>
#include <system_error>
#include <thread>
#include <unistd.h>
#include <utility>

#include <fmt/format.h>

#include "palpate/devices/arm/tested_arms.h"
#include "palpate/devices/plugins/plugin_child.h"
#include "palpate/devices/plugins/plugin_library.h"
#include "palpate/devices/plugins/plugin_link.h"
#include "palpate/engine/error.h"
#include "palpate/engine/loop/realtime.h"

namespace palpate {
namespace {

constexpr auto kLongPreparation = std::chrono::seconds(3);
constexpr double kEnds = 1.0;  // [s] for a process to end after a request
// [s]: if a process's haptic thread makes no pass for this time, the process hangs.
constexpr double kHung = 0.5;
constexpr int kTriesAgain = 500;             // [ms] between two attempts to start a process
constexpr std::array<std::byte, 4> kZero{};  // message of a guardian; any message means zero force

class SharedLink {
 public:
  SharedLink() : file_(memfd_create("palpate-plugin", MFD_CLOEXEC | MFD_ALLOW_SEALING)) {
    void* at = MAP_FAILED;
    // Seals the file's size: a plug-in that shortened the file would end the program with SIGBUS.
    if (ftruncate(file_.get(), sizeof(PluginLink)) == 0 &&
        fcntl(file_.get(), F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_SEAL) == 0) {
      at = mmap(nullptr, sizeof(PluginLink), PROT_READ | PROT_WRITE, MAP_SHARED, file_.get(), 0);
    }
    if (at == MAP_FAILED) {
      throw DeviceError(
          kPluginProgram,
          std::string("its shared memory cannot be created (") + std::strerror(errno) + ")",
          "end other programs to free memory");
    }
    link_ = new (at) PluginLink;
  }
  SharedLink(const SharedLink&) = delete;
  SharedLink& operator=(const SharedLink&) = delete;
  ~SharedLink() { munmap(link_, sizeof(PluginLink)); }
  [[nodiscard]] PluginLink& operator*() const noexcept { return *link_; }
  [[nodiscard]] PluginLink* operator->() const noexcept { return link_; }
  [[nodiscard]] int file() const noexcept { return file_.get(); }

 private:
  OwnedDescriptor file_;
  PluginLink* link_;
};

/// One run of a plug-in's process. The constructor returns when the arm is ready.
struct Life {
  SharedLink link;
  OwnedDescriptor control, zero;
  std::unique_ptr<PluginChild> child;
  SentPluginFacts facts{};
  std::string version;
  std::string own;

  Life(const std::filesystem::path& program, const std::filesystem::path& file,
       const std::string& serial, const std::function<void(const std::string&)>& say,
       const std::function<bool()>& stop) {
    auto [control_here, control_there] = pluginSocketPair();
    auto [zero_here, zero_there] = pluginSocketPair();
    control = std::move(control_here);
    zero = std::move(zero_here);
    // A guardian must not wait for a process that does not read.
    (void)fcntl(zero.get(), F_SETFL, O_NONBLOCK);
    child = std::make_unique<PluginChild>(
        program, std::vector<std::string>{"serve", file.string(), serial},
        std::initializer_list<int>{control_there.get(), link.file(), zero_there.get()});
    control_there = OwnedDescriptor();
    zero_there = OwnedDescriptor();
    const std::string name = "plugin:" + file.stem().string();
    const auto begun = std::chrono::steady_clock::now();
    bool told = false;
    const auto stops = [&] {
      if (say && !told && std::chrono::steady_clock::now() - begun > kLongPreparation) {
        told = true;
        say(name +
            ": its arm is not ready yet: follow the messages of the plug-in, or end with "
            "Ctrl-C");
      }
      return stop && stop();
    };
    std::optional<DeviceError> error;
    bool known = false;
    const PluginAnswer heard =
        receivePluginMessages(control.get(), *child, 0.0, stops, [&](const PluginMessage& message) {
          if (message.kind == PluginMessage::kSay && say) say(name + ": " + message.text());
          if (message.kind == PluginMessage::kFailed) error = pluginErrorOf(message);
          if (message.kind == PluginMessage::kPlugin) version = pluginLinesOf(message)[1];
          if (const auto found = pluginFoundIn(message)) own = found->serial;
          if (message.kind == PluginMessage::kFacts) {
            if (const auto sent = pluginFactsIn(message)) {
              facts = *sent;
              known = true;
            }
          }
        });
    if (error) throw *error;
    if (heard == PluginAnswer::kStopped) {
      throw DeviceError(name, "the program was stopped before the arm was ready",
                        "start the program again");
    }
    if (heard != PluginAnswer::kAll || !known) {
      throw DeviceError(name, "its process ended before its arm was ready",
                        "read its messages, and run palpate devices");
    }
  }
  Life(const Life&) = delete;
  Life& operator=(const Life&) = delete;
  ~Life() {
    control = OwnedDescriptor();
    if (child) child->end(kEnds);
  }
};

class ProcessPort final : public PluginPort {
 public:
  ProcessPort(std::filesystem::path program, std::filesystem::path file, std::string serial,
              const ArmHost& host)
      : program_(std::move(program)),
        file_(std::move(file)),
        serial_(std::move(serial)),
        host_(host),
        life_(std::make_unique<Life>(program_, file_, serial_, host_.say, host_.stop)),
        version_(life_->version),
        facts_(life_->facts),
        guard_(fcntl(life_->zero.get(), F_DUPFD_CLOEXEC, 3)) {
    own_ = life_->own;
    // A restarted process must open the same arm.
    if (!own_.empty()) serial_ = own_;
    now_ = life_.get();
    mender_ = std::thread([this] { mendLoop(); });
  }
  ~ProcessPort() override {
    quit_ = true;
    mender_.join();
  }

  [[nodiscard]] const palpate_plugin_facts& facts() const noexcept override { return facts_.facts; }
  [[nodiscard]] std::string version() const override { return version_; }
  [[nodiscard]] std::string serial() const override { return own_; }
  [[nodiscard]] double carries() const noexcept override { return facts_.carries; }
  [[nodiscard]] std::uint32_t openings() const noexcept override { return openings_; }

  [[nodiscard]] bool read(PluginNews& news) noexcept override {
    const Using life(now_, using_);
    if (life.life() == nullptr) return false;
    PluginLink& link = *life.life()->link;
    link.ticked_at.store(nowNs(), std::memory_order_relaxed);
    // If the process is just writing its news, keeps the old news until the next tick.
    (void)link.news.load(news);
    return true;
  }
  void write(const PluginOrder& order) noexcept override {
    const Using life(now_, using_);
    if (life.life() == nullptr) return;
    PluginLink& link = *life.life()->link;
    link.order.store(order);
    link.orders.fetch_add(1, std::memory_order_release);
    wakeWord(link.orders);
  }
  [[nodiscard]] ZeroForce zeroForce() const noexcept override {
    ZeroForce zero{guard_.get(), kZero};
    zero.version = openings_;
    return zero;
  }

 private:
  /// Prevents the destruction of `life_` while this object exists.
  class Using {
   public:
    Using(std::atomic<Life*>& life, std::atomic<bool>& in) noexcept : in_(in) {
      in_.store(true);
      life_ = life.load();
    }
    Using(const Using&) = delete;
    Using& operator=(const Using&) = delete;
    ~Using() { in_.store(false); }
    [[nodiscard]] Life* life() const noexcept { return life_; }

   private:
    std::atomic<bool>& in_;
    Life* life_;
  };

  [[nodiscard]] bool over() const noexcept { return quit_ || (host_.stop && host_.stop()); }

  /// Prints a line for the user, unless it repeats the last one. Drops exceptions of host_.say,
  /// because they would end the program.
  void tell(const std::string& words) noexcept {
    try {
      if (host_.say && words != told_) host_.say("plugin:" + file_.stem().string() + ": " + words);
      told_ = words;
    } catch (const std::exception&) {
      return;
    }
  }

  void mendLoop() noexcept {
    std::uint64_t heart = 0;
    std::int64_t beat_at = nowNs();
    while (!quit_) {
      pollfd waits{life_->control.get(), POLLIN, 0};
      (void)poll(&waits, 1, kPluginPoll);
      std::optional<PluginMessage> message;
      bool ended = receivePluginMessage(life_->control.get(), message) == PluginReceived::kEnd ||
                   !life_->child->lives();
      if (life_->child->wasStopped()) tell("its process was stopped: palpate lets it continue");
      if (message && message->kind == PluginMessage::kSay) {
        tell(message->text());
        constexpr int kReads = 5;  // checks of the process between two lines
        for (int i = 0; i < kReads && life_->child->lives(); ++i) {
          std::this_thread::sleep_for(std::chrono::milliseconds(kPluginPoll));
        }
      }
      if (const std::uint64_t seen = life_->link->heart; seen != heart) {
        heart = seen;
        beat_at = nowNs();
      }
      const bool hangs = nowNs() - beat_at > static_cast<std::int64_t>(1e9 * kHung);
      if (!ended && !hangs) continue;
      now_ = nullptr;
      while (using_) std::this_thread::sleep_for(std::chrono::microseconds(100));
      life_->child->end(hangs ? 0.0 : kEnds);
      if (!quit_) {
        tell(hangs ? "its process hung: palpate starts it again"
                   : "its process has ended: palpate starts it again");
      }
      // Starts the new process at once, because it takes off the force that the old process has
      // left.
      while (!quit_ && !mend()) std::this_thread::sleep_for(std::chrono::milliseconds(kTriesAgain));
      beat_at = nowNs();
    }
  }
  [[nodiscard]] static std::uint64_t printOf(const Life& life) {
    const SentPluginFacts& sent = life.facts;
    return identityOf(sent.facts, sent.carries, "", life.version, "").fingerprint;
  }
  [[nodiscard]] bool mend() noexcept {
    try {
      if (over()) return false;
      auto life =
          std::make_unique<Life>(program_, file_, serial_, host_.say, [this] { return over(); });
      // The user has agreed to the first arm only, so another arm is refused.
      const bool same = printOf(*life) == printOf(*life_) && life->own == own_;
      if (!same) tell("the arm or its plug-in has changed: start the program again");
      if (!same || dup3(life->zero.get(), guard_.get(), O_CLOEXEC) < 0) return false;
      life_ = std::move(life);
      ++openings_;
      now_ = life_.get();
      return true;
    } catch (const std::exception&) {
      return false;  // the caller tries again
    }
  }

  std::filesystem::path program_;
  std::filesystem::path file_;
  std::string serial_;
  ArmHost host_;
  std::unique_ptr<Life> life_;  ///< Only the thread that restarts the process changes it.
  std::string version_;
  std::string own_;
  /// The line that was printed last; used by the thread that restarts the process.
  std::string told_;
  SentPluginFacts facts_;
  OwnedDescriptor guard_;  ///< Its number stays the same; its target changes with each restart.
  std::atomic<Life*> now_{nullptr};
  std::atomic<bool> using_{false};
  std::atomic<bool> quit_{false};
  std::atomic<std::uint32_t> openings_{1};
  std::thread mender_;
};

/// Ends the program if a scope takes longer than 5 s, as a plug-in that does not close its arm.
class ClosingTime {
 public:
  ClosingTime(const ArmHost& host, const std::string& name) {
    try {
      watcher_ = std::thread([until = closed_.get_future(), host, name] {
        constexpr auto kPatience = std::chrono::seconds(5);
        if (until.wait_for(kPatience) == std::future_status::ready) return;
        if (host.say) {
          host.say(name +
                   ": the arm does not close, because the plug-in does not return: the "
                   "program ends: run the plug-in in its own process (plugin:NAME)");
        }
        if (host.stuck) host.stuck();
        std::_Exit(1);
      });
    } catch (const std::system_error&) {
      // no thread: closes without a limit of time
    }
  }
  ClosingTime(const ClosingTime&) = delete;
  ClosingTime& operator=(const ClosingTime&) = delete;
  ~ClosingTime() {
    closed_.set_value();
    if (watcher_.joinable()) watcher_.join();
  }

 private:
  std::promise<void> closed_;
  std::thread watcher_;
};

/// A plug-in in this process. Must be made and destroyed on the same thread.
class InsidePort final : public PluginPort {
 public:
  InsidePort(const std::filesystem::path& file, const std::string& serial, const ArmHost& host)
      : host_(host),
        name_("plugin-inside:" + file.stem().string()),
        library_(std::in_place, file, PluginHost{host.say, host.stop}),
        serial_(library_->only(serial)),
        device_(library_->open(serial_.empty() ? serial : serial_)),
        facts_(device_->facts()) {
    if ((facts_.has & PALPATE_PLUGIN_FORCE) != 0 &&
        !(facts_.watchdog > 0.0 && facts_.watchdog <= kLongestWatchdog)) {
      throw DeviceError(
          name_, "the arm has no watchdog that removes its force within 0.05 s if the program dies",
          "use plugin:" + file.stem().string() + ", which runs in a process of its own");
    }
    device_->prepare();
  }
  InsidePort(const InsidePort&) = delete;
  InsidePort& operator=(const InsidePort&) = delete;
  ~InsidePort() override {
    const ClosingTime limit(host_, name_);
    device_.reset();
    library_.reset();
  }
  [[nodiscard]] const palpate_plugin_facts& facts() const noexcept override { return facts_; }
  [[nodiscard]] std::string version() const override { return library_->version(); }
  [[nodiscard]] std::string serial() const override { return serial_; }
  [[nodiscard]] double carries() const noexcept override { return device_->carries(); }
  [[nodiscard]] bool read(PluginNews& news) noexcept override {
    news_.read = device_->read(news_.reading);
    news = news_;
    return true;
  }
  void write(const PluginOrder& order) noexcept override {
    device_->carry(order.carry);
    news_.wrote = device_->write(order.force);
    news_.written = order.number;
    news_.given = device_->given();
  }

 private:
  ArmHost host_;
  std::string name_;
  std::optional<PluginLibrary> library_;  ///< Unset only in the destructor.
  std::string serial_;
  std::optional<PluginDevice> device_;  ///< Unset only in the destructor.
  palpate_plugin_facts facts_;
  PluginNews news_;
};

}  // namespace

std::optional<PluginName> parsePluginName(const std::string& name) {
  PluginName parsed;
  std::string rest;
  if (name.rfind("plugin:", 0) == 0) {
    rest = name.substr(7);
  } else if (name.rfind("plugin-inside:", 0) == 0) {
    parsed.inside = true;
    rest = name.substr(14);
  } else {
    return std::nullopt;
  }
  const std::size_t end = rest.find('@');
  parsed.name = rest.substr(0, end);
  if (end != std::string::npos) parsed.serial = rest.substr(end + 1);
  return parsed;
}

std::vector<FoundPlugin> findPlugins(double patience) {
  std::vector<FoundPlugin> all;
  for (const std::string& name : pluginNames()) {
    FoundPlugin& found = all.emplace_back();
    found.name = name;
    try {
      found.file = pluginFile(name);
      auto [here, there] = pluginSocketPair();
      PluginChild child(programBeside(), {"list", found.file.string()}, {there.get()});
      there = OwnedDescriptor();
      std::string said;
      const PluginAnswer heard = receivePluginMessages(
          here.get(), child, patience, nullptr, [&](const PluginMessage& message) {
            const std::vector<std::string> lines = pluginLinesOf(message);
            if (message.kind == PluginMessage::kSay) said = lines[0];
            if (message.kind == PluginMessage::kPlugin) {
              found.what = lines[0];
              found.version = lines[1];
              found.licence = lines[2];
            } else if (message.kind == PluginMessage::kFailed) {
              (found.arms.empty() ? found.trouble : found.arms.back().trouble) =
                  pluginErrorOf(message).what();
            } else if (const auto one = pluginFoundIn(message);
                       one && found.arms.size() < PluginLibrary::kMostFound) {
              found.arms.push_back({one->serial, one->model, std::nullopt, 0.0, {}});
            } else if (message.kind == PluginMessage::kFacts && !found.arms.empty()) {
              if (const auto sent = pluginFactsIn(message)) {
                found.arms.back().facts = sent->facts;
                found.arms.back().carries = sent->carries;
              }
            }
          });
      if (heard == PluginAnswer::kLate) {
        found.trouble = fmt::format(
            "plugin:{}: it does not answer within {} s: end the program that it waits for, or "
            "switch its arm off and on",
            name, patience);
      }
      if (heard == PluginAnswer::kEnded && found.trouble.empty()) {
        found.trouble =
            fmt::format("plugin:{}: its process ended during the query: correct the plug-in", name);
      }
      if (!found.trouble.empty() && !said.empty()) found.trouble += " (it said: " + said + ")";
      child.end(heard == PluginAnswer::kLate ? 0.0 : kEnds);
    } catch (const Error& error) {
      found.trouble = error.what();
    }
  }
  return all;
}

std::unique_ptr<PluginPort> openPluginProcess(const std::filesystem::path& file,
                                              const std::string& serial, const ArmHost& host,
                                              const std::filesystem::path& program) {
  return std::make_unique<ProcessPort>(program.empty() ? programBeside() : program, file, serial,
                                       host);
}

std::unique_ptr<PluginPort> openPluginInside(const std::filesystem::path& file,
                                             const std::string& serial, const ArmHost& host) {
  return std::make_unique<InsidePort>(file, serial, host);
}

OpenedArm openPluginArm(const std::string& name, const ArmHost& asked) {
  const std::optional<PluginName> parsed = parsePluginName(name);
  if (!parsed) {
    throw DeviceError(name, "it is not the name of a plug-in",
                      "write plugin:NAME or plugin:NAME@SERIAL");
  }
  const std::filesystem::path file = pluginFile(parsed->name);
  auto port = parsed->inside ? openPluginInside(file, parsed->serial, asked)
                             : openPluginProcess(file, parsed->serial, asked);
  const std::string known = "plugin:" + parsed->name;
  const ArmIdentity identity =
      identityOf(port->facts(), port->carries(), known, port->version(), port->serial());
  ArmHost host = asked;
  const bool good = isTested(identity);
  host.measured = measuredArm(identity);
  OpenedArm arm{std::make_unique<PluginArm>(std::move(port), known, good, host), identity};
  if (asked.say && !good && arm.device->traits().drives) {
    const std::string test =
        asked.tests            ? ""
        : identity.own.empty() ? ": palpate cannot store the test of an arm without a serial number"
                               : ": run palpate devices --test " + known + "@" + identity.own;
    asked.say(fmt::format("{}: limited to at most {} N and {} N/m, because it is untested{}", name,
                          kUntestedForce, kUntestedStiffness, test));
  }
  return arm;
}

}  // namespace palpate
