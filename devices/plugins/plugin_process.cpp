#include "palpate/devices/plugins/plugin_process.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstring>
#include <fcntl.h>
#include <functional>
#include <new>
#include <poll.h>
#include <spawn.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <system_error>
#include <thread>
#include <unistd.h>
#include <utility>

#include <fmt/format.h>

#include "palpate/devices/arm/tested_arms.h"
#include "palpate/devices/plugins/plugin_library.h"
#include "palpate/devices/plugins/plugin_link.h"
#include "palpate/engine/error.h"
#include "palpate/engine/loop/realtime.h"

namespace palpate {
namespace {

constexpr int kLook = 10;         // [ms] between checks of a process
constexpr double kEnds = 1.0;     // [s] for a process to end on request
constexpr double kHung = 0.5;     // [s] without a turn of its haptic thread
constexpr int kTriesAgain = 500;  // [ms] after a start that failed
constexpr const char* kProgram = "palpate-plugin";
constexpr std::array<std::byte, 4> kZero{};  // written by a guardian: any message means zero

/// A descriptor; the destructor closes it.
class Descriptor {
 public:
  Descriptor() = default;
  /// Moves the descriptor above the numbers that a child gets.
  explicit Descriptor(int own) : own_(own) {
    if (own_ < 0) throw DeviceError(kProgram, std::strerror(errno), "close some files");
    constexpr int kAbove = 16;
    if (own_ < kAbove) {
      const int moved = fcntl(own_, F_DUPFD_CLOEXEC, kAbove);
      close(std::exchange(own_, moved));
    }
    if (own_ < 0) throw DeviceError(kProgram, std::strerror(errno), "close some files");
  }
  Descriptor(Descriptor&& other) noexcept : own_(std::exchange(other.own_, -1)) {}
  Descriptor& operator=(Descriptor&& other) noexcept {
    std::swap(own_, other.own_);
    return *this;
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  ~Descriptor() {
    if (own_ >= 0) close(own_);
  }
  [[nodiscard]] int get() const noexcept { return own_; }

 private:
  int own_ = -1;
};

std::pair<Descriptor, Descriptor> socketPair() {
  std::array<int, 2> ends{-1, -1};
  const int made = socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends.data());
  if (made != 0) throw DeviceError(kProgram, std::strerror(errno), "close some files");
  Descriptor first(ends[0]);
  return {std::move(first), Descriptor(ends[1])};
}

std::filesystem::path programBeside() {
  std::error_code error;
  const auto self = std::filesystem::read_symlink("/proc/self/exe", error);
  return self.parent_path() / kProgram;
}

/// A process of palpate-plugin.
class Child {
 public:
  /// @param given  Descriptors that the process gets as 3, 4, ...
  Child(const std::filesystem::path& program, const std::vector<std::string>& words,
        std::initializer_list<int> given) {
    posix_spawn_file_actions_t files;
    posix_spawn_file_actions_init(&files);
    posix_spawn_file_actions_addopen(&files, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
    // The output of a maker's library must not mix with the program's.
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
    // A terminal's Ctrl-C is for the program.
    posix_spawnattr_setflags(&how,
                             POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETSID);
    std::vector<std::string> all_words{kProgram};
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
      throw DeviceError(program.string(), std::strerror(failed), "check the installation");
    }
  }
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;
  ~Child() { end(0.0); }

  /// Returns true while the process lives.
  [[nodiscard]] bool lives() {
    // If the program has told the kernel to forget its children, an ended child's number may be
    // another process'.
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
  /// Returns true once after the process was stopped; lives() has let it continue.
  [[nodiscard]] bool wasStopped() noexcept { return std::exchange(stopped_, false); }
  /// Waits for the process to end, and kills it after `patience` [s]. If the kernel does not end
  /// it, leaves it.
  void end(double patience) {
    constexpr double kKernel = 1.0;  // [s]
    bool killed = false;
    for (double waited = 0.0; lives() && waited < patience + kKernel; waited += 1e-3) {
      if (!killed && waited >= patience) killed = kill(process_, SIGKILL) == 0;
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    process_ = -1;
  }

 private:
  pid_t process_ = -1;
  bool stopped_ = false;
};

std::vector<std::string> linesOf(const std::string& text) {
  std::vector<std::string> lines;
  std::size_t at = 0;
  for (std::size_t end = 0; end != std::string::npos; at = end + 1) {
    end = text.find('\n', at);
    lines.push_back(text.substr(at, end - at));
    if (end == std::string::npos) break;
  }
  return lines;
}

DeviceError errorOf(const PluginMessage& message) {
  std::vector<std::string> parts = linesOf(message.text());
  parts.resize(3);
  return {parts[0], parts[1], parts[2]};
}

/// Takes one waiting message. `message` is empty if there is none, or if it is invalid.
enum class Took : std::uint8_t { kMessage, kNothing, kEnd };
Took takeOne(int control, std::optional<PluginMessage>& message) {
  std::array<std::byte, sizeof(PluginMessage) + 1> buffer{};
  message.reset();
  const ssize_t size = recv(control, buffer.data(), buffer.size(), MSG_DONTWAIT);
  if (size < 0 && (errno == EAGAIN || errno == EINTR)) return Took::kNothing;
  if (size <= 0) return Took::kEnd;
  message = pluginMessageOf(std::span(buffer).first(static_cast<std::size_t>(size)));
  return Took::kMessage;
}

/// Receives the messages of a process until it has sent all, `patience` [s] are over (0: no limit),
/// or it has ended.
enum class Heard : std::uint8_t { kAll, kLate, kEnded, kStopped };
Heard hear(int control, Child& child, double patience, const std::function<bool()>& stop,
           const std::function<void(const PluginMessage&)>& take) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(patience);
  for (bool lives = true;;) {
    if (stop && stop()) return Heard::kStopped;
    if (patience > 0.0 && std::chrono::steady_clock::now() > end) return Heard::kLate;
    pollfd waits{control, POLLIN, 0};
    (void)poll(&waits, 1, kLook);
    std::optional<PluginMessage> message;
    const Took took = takeOne(control, message);
    // A process that the child has started may keep the socket open. So the child counts as ended
    // when it has ended and all messages are read.
    if (took == Took::kEnd || (took == Took::kNothing && !lives)) return Heard::kEnded;
    lives = child.lives();
    if (!message) continue;
    if (message->kind == PluginMessage::kDone) return Heard::kAll;
    take(*message);
  }
}

/// Facts as received; nullopt if they are incomplete.
struct SentFacts {
  palpate_plugin_facts facts;
  double carries;
};
std::optional<SentFacts> factsIn(const PluginMessage& message) {
  SentFacts sent{};
  if (message.size != sizeof(sent.facts) + sizeof(sent.carries)) return std::nullopt;
  std::memcpy(&sent.facts, message.bytes.data(), sizeof(sent.facts));
  std::memcpy(&sent.carries, message.bytes.data() + sizeof(sent.facts), sizeof(sent.carries));
  sent.facts.source[sizeof(sent.facts.source) - 1] = '\0';
  for (auto& name : sent.facts.button) name[sizeof(name) - 1] = '\0';
  return sent;
}

/// Returns the found arm of a message; nullopt if the message is another one or incomplete.
std::optional<palpate_plugin_found> foundIn(const PluginMessage& message) {
  palpate_plugin_found one{};
  if (message.kind != PluginMessage::kFound || message.size != sizeof(one)) return std::nullopt;
  std::memcpy(&one, message.bytes.data(), sizeof(one));
  one.serial[sizeof(one.serial) - 1] = one.model[sizeof(one.model) - 1] = '\0';
  return one;
}

/// Memory of a PluginLink, shared with a child.
class SharedLink {
 public:
  SharedLink() : file_(memfd_create("palpate-plugin", MFD_CLOEXEC | MFD_ALLOW_SEALING)) {
    void* at = MAP_FAILED;
    // Without the seal, a plug-in that shortened the file would end the program by SIGBUS.
    if (ftruncate(file_.get(), sizeof(PluginLink)) == 0 &&
        fcntl(file_.get(), F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_SEAL) == 0) {
      at = mmap(nullptr, sizeof(PluginLink), PROT_READ | PROT_WRITE, MAP_SHARED, file_.get(), 0);
    }
    if (at == MAP_FAILED) throw DeviceError(kProgram, std::strerror(errno), "free some memory");
    link_ = new (at) PluginLink;
  }
  SharedLink(const SharedLink&) = delete;
  SharedLink& operator=(const SharedLink&) = delete;
  ~SharedLink() { munmap(link_, sizeof(PluginLink)); }
  [[nodiscard]] PluginLink& operator*() const noexcept { return *link_; }
  [[nodiscard]] PluginLink* operator->() const noexcept { return link_; }
  [[nodiscard]] int file() const noexcept { return file_.get(); }

 private:
  Descriptor file_;
  PluginLink* link_;
};

/// One run of a plug-in's process. The constructor returns when the arm is ready.
struct Life {
  SharedLink link;
  Descriptor control, zero;
  std::unique_ptr<Child> child;
  SentFacts facts{};
  std::string version;
  std::string own;  ///< Serial number.

  Life(const std::filesystem::path& program, const std::filesystem::path& file,
       const std::string& serial, const std::function<void(const std::string&)>& say,
       const std::function<bool()>& stop) {
    auto [control_here, control_there] = socketPair();
    auto [zero_here, zero_there] = socketPair();
    control = std::move(control_here);
    zero = std::move(zero_here);
    // A guardian must never wait for a process that does not read.
    (void)fcntl(zero.get(), F_SETFL, O_NONBLOCK);
    child = std::make_unique<Child>(
        program, std::vector<std::string>{"serve", file.string(), serial},
        std::initializer_list<int>{control_there.get(), link.file(), zero_there.get()});
    control_there = Descriptor();
    zero_there = Descriptor();
    const std::string name = "plugin:" + file.stem().string();
    std::optional<DeviceError> error;
    bool known = false;
    const Heard heard = hear(control.get(), *child, 0.0, stop, [&](const PluginMessage& message) {
      if (message.kind == PluginMessage::kSay && say) say(name + ": " + message.text());
      if (message.kind == PluginMessage::kFailed) error = errorOf(message);
      if (message.kind == PluginMessage::kPlugin) {
        std::vector<std::string> lines = linesOf(message.text());
        lines.resize(3);
        version = lines[1];
      }
      if (const auto found = foundIn(message)) own = found->serial;
      if (message.kind == PluginMessage::kFacts) {
        if (const auto sent = factsIn(message)) {
          facts = *sent;
          known = true;
        }
      }
    });
    if (error) throw *error;
    if (heard == Heard::kStopped) {
      throw DeviceError(name, "it was not made ready", "the program has ended");
    }
    if (heard != Heard::kAll || !known) {
      throw DeviceError(name, "its process has ended before its arm was ready",
                        "see what it has printed, and what palpate devices says of it");
    }
  }
  Life(const Life&) = delete;
  Life& operator=(const Life&) = delete;
  ~Life() {
    control = Descriptor();
    if (child) child->end(kEnds);
  }
};

/// A plug-in in a process of its own.
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
    // A later start must open this very arm.
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
    // If news is just being written, the next tick reads it.
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
  /// Prevents the end of a life while it is used.
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

  /// Prints a line for the user. Ignores exceptions of the user's program.
  void tell(const std::string& words) noexcept {
    try {
      // A message that repeats is printed once.
      if (host_.say && words != told_) host_.say("plugin:" + file_.stem().string() + ": " + words);
      told_ = words;
    } catch (const std::exception&) {
      return;
    }
  }

  /// Watches the process, and starts it again after it has ended.
  void mendLoop() noexcept {
    std::uint64_t heart = 0;
    std::int64_t beat_at = nowNs();
    while (!quit_) {
      pollfd waits{life_->control.get(), POLLIN, 0};
      (void)poll(&waits, 1, kLook);
      std::optional<PluginMessage> message;
      bool ended = takeOne(life_->control.get(), message) == Took::kEnd || !life_->child->lives();
      if (life_->child->wasStopped()) tell("its process was stopped: it goes on");
      if (message && message->kind == PluginMessage::kSay) {
        tell(message->text());
        // Limits the rate of lines.
        constexpr int kReads = 5;  // checks
        for (int i = 0; i < kReads && life_->child->lives(); ++i) {
          std::this_thread::sleep_for(std::chrono::milliseconds(kLook));
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
        tell(hangs ? "its process hung: it is started again"
                   : "its process has ended: it is started again");
      }
      // At once: the new process takes off the force that the old one has left.
      while (!quit_ && !mend()) std::this_thread::sleep_for(std::chrono::milliseconds(kTriesAgain));
      beat_at = nowNs();
    }
  }
  /// Returns the fingerprint of all properties that identify the arm.
  [[nodiscard]] static std::uint64_t printOf(const Life& life) {
    const SentFacts& sent = life.facts;
    return identityOf(sent.facts, sent.carries, "", life.version, "").fingerprint;
  }
  [[nodiscard]] bool mend() noexcept {
    try {
      if (over()) return false;
      auto life =
          std::make_unique<Life>(program_, file_, serial_, host_.say, [this] { return over(); });
      // Another arm than before has not been admitted.
      const bool same = printOf(*life) == printOf(*life_) && life->own == own_;
      if (!same) tell("it is another arm now, or another plug-in: start the program again");
      if (!same || dup3(life->zero.get(), guard_.get(), O_CLOEXEC) < 0) return false;
      life_ = std::move(life);
      ++openings_;
      now_ = life_.get();
      return true;
    } catch (const std::exception&) {
      return false;  // it is tried again
    }
  }

  std::filesystem::path program_;
  std::filesystem::path file_;
  std::string serial_;
  ArmHost host_;
  std::unique_ptr<Life> life_;  ///< Used by the mending thread.
  std::string version_;
  std::string own_;   ///< The arm's serial number.
  std::string told_;  ///< The last line, by the mending thread.
  SentFacts facts_;
  Descriptor guard_;  ///< Its number stays; its target may change.
  std::atomic<Life*> now_{nullptr};
  std::atomic<bool> using_{false};
  std::atomic<bool> quit_{false};
  std::atomic<std::uint32_t> openings_{1};
  std::thread mender_;
};

/// A plug-in in this process. Created and destroyed on one thread.
class InsidePort final : public PluginPort {
 public:
  InsidePort(const std::filesystem::path& file, const std::string& serial, const ArmHost& host)
      : library_(file, {host.say, host.stop}),
        serial_(library_.only(serial)),
        device_(library_.open(serial_.empty() ? serial : serial_)),
        facts_(device_.facts()) {
    if ((facts_.has & PALPATE_PLUGIN_FORCE) != 0 &&
        !(facts_.watchdog > 0.0 && facts_.watchdog <= kLongestWatchdog)) {
      throw DeviceError(
          "plugin-inside:" + file.stem().string(),
          "the arm has no watchdog of its own that takes its force off in 0.05 s when "
          "the program dies",
          "name it plugin:" + file.stem().string() + ", in a process of its own");
    }
    device_.prepare();
  }
  [[nodiscard]] const palpate_plugin_facts& facts() const noexcept override { return facts_; }
  [[nodiscard]] std::string version() const override { return library_.version(); }
  [[nodiscard]] std::string serial() const override { return serial_; }
  [[nodiscard]] double carries() const noexcept override { return device_.carries(); }
  [[nodiscard]] bool read(PluginNews& news) noexcept override {
    news_.read = device_.read(news_.reading);
    news = news_;
    return true;
  }
  void write(const PluginOrder& order) noexcept override {
    device_.carry(order.carry);
    news_.wrote = device_.write(order.force);
    news_.written = order.number;
    news_.given = device_.given();
  }

 private:
  PluginLibrary library_;
  std::string serial_;
  PluginDevice device_;
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
      auto [here, there] = socketPair();
      Child child(programBeside(), {"list", found.file.string()}, {there.get()});
      there = Descriptor();
      const Heard heard =
          hear(here.get(), child, patience, nullptr, [&](const PluginMessage& message) {
            std::vector<std::string> lines = linesOf(message.text());
            lines.resize(3);
            if (message.kind == PluginMessage::kPlugin) {
              found.what = lines[0];
              found.version = lines[1];
              found.licence = lines[2];
            } else if (message.kind == PluginMessage::kFailed) {
              (found.arms.empty() ? found.trouble : found.arms.back().trouble) =
                  errorOf(message).what();
            } else if (const auto one = foundIn(message);
                       one && found.arms.size() < PluginLibrary::kMostFound) {
              found.arms.push_back({one->serial, one->model, std::nullopt, 0.0, {}});
            } else if (message.kind == PluginMessage::kFacts && !found.arms.empty()) {
              if (const auto sent = factsIn(message)) {
                found.arms.back().facts = sent->facts;
                found.arms.back().carries = sent->carries;
              }
            }
          });
      if (heard == Heard::kLate) found.trouble = "it does not answer: end what it waits for";
      if (heard == Heard::kEnded && found.trouble.empty()) {
        found.trouble = "its process has ended while it was asked: mend the plug-in";
      }
      child.end(heard == Heard::kLate ? 0.0 : kEnds);
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
  if (!parsed)
    throw DeviceError(name, "it is no plug-in", "write plugin:NAME or plugin:NAME@SERIAL");
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
    asked.say(fmt::format("{}: held to {} N and {} N/m: run palpate devices --test {}@{}", name,
                          kUntestedForce, kUntestedStiffness, known, identity.own));
  }
  return arm;
}

}  // namespace palpate
