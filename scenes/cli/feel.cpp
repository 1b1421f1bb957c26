/// palpate feel: runs a scene under a hand, in virtual time or on time.
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <fstream>
#include <future>
#include <limits>
#include <new>
#include <optional>
#include <poll.h>
#include <readerwriterqueue.h>
#include <string>
#include <system_error>
#include <termios.h>
#include <thread>
#include <unistd.h>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "palpate/devices/guardian.h"
#include "palpate/devices/open_arm.h"
#include "palpate/devices/path_device.h"
#include "palpate/devices/simulated_device.h"
#include "palpate/engine/error.h"
#include "palpate/engine/haptic_thread.h"
#include "palpate/engine/telemetry.h"
#include "palpate/scenes/cli/common.h"
#include "palpate/scenes/cli/felt.h"
#include "palpate/scenes/cli/picture.h"
#include "palpate/scenes/cli/room.h"
#include "palpate/scenes/cli/touch.h"
#include "palpate/scenes/scene_cache.h"
#include "palpate/scenes/scene_file.h"
#include "palpate/scenes/version.h"

namespace palpate::cli {
namespace {

constexpr double kDefaultSeconds = 10.0;

struct FeelOptions {
  std::string scene;
  std::vector<std::string> devices{"simulated"};
  std::optional<double> seconds;
  double rate = 1000.0;
  bool realtime = false;
  bool watch = false;
  bool passive = false;
  double refill = 0.0;
  std::string trace;
  std::string summary;
  std::string picture;
  bool json = false;
};

std::unique_ptr<Device> makeDevice(const FeelOptions& options, const std::string& name,
                                   const Box& bounds) {
  if (name == "simulated") {
    const auto target = explore(bounds, options.seconds.value_or(kDefaultSeconds));
    // On time all is as at a hand that a force could hurt.
    ArmParams arm;
    arm.hand = options.realtime;
    if (options.passive) arm.tank = TankUse::kAct;
    arm.refill = options.refill;
    return std::make_unique<SimulatedDevice>(arm, GripParams{}, target, options.rate);
  }
  if (name.rfind("path:", 0) == 0) {
    const std::string file = name.substr(5);
    std::ifstream holder;
    std::istream& in = openInput(file, holder);
    return std::make_unique<PathDevice>(readPath(in, file == "-" ? "standard input" : file),
                                        options.rate);
  }
  if (parseArmName(name)) {
    if (!options.realtime) {
      throw DeviceError("--device", "an arm lives in real time", "add --realtime");
    }
    HidHost host;
    host.say = [](const std::string& words) { complain("feel: " + words); };
    host.stop = [] { return interrupted != 0; };
    if (options.passive) host.tank = TankUse::kAct;
    host.refill = options.refill;
    auto arm = openArm(name, std::move(host)).device;
    if (options.passive && arm->info().limits.tank.use != TankUse::kAct) {
      throw Error("--passive",
                  "the friction of " + arm->info().name + " is not known, or less than its steps",
                  "run palpate devices --test " + name + "; where it has passed, it is too coarse");
    }
    if (const double most = arm->profile().output_rate; options.rate > most && most > 0.0) {
      complain(fmt::format("feel: {} takes {} forces a second of {}: --rate {} leaves none out",
                           arm->info().name, most, options.rate, most));
    }
    return arm;
  }
  throw DeviceError("--device", "\"" + name + "\" is not in this version",
                    "use simulated, path:FILE.csv or hid:PROFILE");
}

/// The trace, row by row; a file that is not asked for costs nothing.
class Trace {
 public:
  explicit Trace(const std::string& path) {
    if (path.empty()) return;
    file_.emplace(path);
    text_ =
        "t,probe_x,probe_y,probe_z,proxy_x,proxy_y,proxy_z,force_x,force_y,force_z,error_bound,"
        "iterations,substeps,primitives,tick_ns,status,limited\n";
  }

  void add(const Telemetry& tick) {
    if (!file_) return;
    const StepReport& r = tick.report;
    const auto vector = [&](const Vec3& v) {
      for (int a = 0; a < 3; ++a) text_ += number(v[a]) + ",";
    };
    text_ += number(tick.time) + ",";
    vector(tick.probe);
    vector(r.proxy);
    vector(r.force);
    text_ += fmt::format("{},{},{},{},{},{},{}\n", number(r.error_bound), r.iterations, r.substeps,
                         r.primitives, tick.tick_ns, wordFor(r.status), r.limited ? 1 : 0);
    if (text_.size() > 1U << 20U) flush();
  }

  void commit() {
    if (!file_) return;
    flush();
    file_->commit();
  }

 private:
  void flush() {
    file_->write(text_);
    text_.clear();
  }
  std::optional<WholeFile> file_;
  std::string text_;
};

OrderedJson machine() {
  OrderedJson json;
  std::ifstream cpuinfo("/proc/cpuinfo");
  std::string line;
  std::string model = "unknown";
  while (std::getline(cpuinfo, line)) {
    if (line.rfind("model name", 0) == 0) {
      model = line.substr(std::min(line.size(), line.find(':') + 2));
      break;
    }
  }
  json["processor"] = model;
  json["cores"] = std::thread::hardware_concurrency();
  json["compiler"] = kCompiler;
  json["build"] = kBuildType;
  return json;
}

/// A line on a terminal that says how far the run is; nothing in a pipe.
class Progress {
 public:
  explicit Progress(std::int64_t ticks) : ticks_(ticks), shown_(isatty(2) != 0) {}
  ~Progress() {
    if (drawn_) sayAside("\r\033[K");
  }
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  void at(std::int64_t tick) {
    if (!shown_ || ticks_ <= 0 || tick % 50000 != 0 || tick == 0) return;
    drawn_ = true;
    sayAside("\rfeeling {} %", 100 * tick / ticks_);
  }

 private:
  std::int64_t ticks_;
  bool shown_;
  bool drawn_ = false;
};

/// How well time was kept.
Legible timeWords(const OrderedJson& summary) {
  const auto us = [&](const char* key) {
    return rounded(1e-3 * summary["wake_ns"][key].get<double>());
  };
  const OrderedJson& got = summary["realtime"];
  return cli::words(
      "clock     {} Hz kept; {} late ticks; woken {} us after time (median), {} p99, {} p99.9, {} "
      "worst; {} page faults; {}, {}\n",
      rounded(summary["rate_kept"].is_null() ? 0.0 : summary["rate_kept"].get<double>()),
      summary["late_ticks"].get<std::int64_t>(), us("p50"), us("p99"), us("p99.9"), us("max"),
      got["page_faults"].get<std::int64_t>(),
      got["priority"].get<bool>() ? "real-time priority" : "no real-time priority",
      got["memory_locked"].get<bool>() ? "memory locked" : "memory not locked");
}

/// The trace of one hand of several: T.csv, T.2.csv, ...
std::string traceOf(const FeelOptions& options, std::size_t hand) {
  if (options.trace.empty() || hand == 0) return options.trace;
  std::filesystem::path place(options.trace);
  const std::string end = place.extension().string();
  place.replace_extension();
  return place.string() + "." + std::to_string(hand + 1) + end;
}

/// No two outputs may go to one place, and none to what is read.
void checkOutputs(const FeelOptions& options, const SceneSpec& spec) {
  std::vector<std::string> places{options.summary, options.picture};
  for (std::size_t i = 0; i < options.devices.size(); ++i) places.push_back(traceOf(options, i));
  if (options.json) places.emplace_back("-");
  std::vector<std::filesystem::path> inputs = inputsOf(options.scene, spec);
  for (const std::string& device : options.devices) {
    if (device.rfind("path:", 0) == 0) inputs.emplace_back(device.substr(5));
  }
  checkOutputsApart(places, inputs);
}

/// Every tick as it comes: counted on the spot, handed to the thread that writes if it is asked
/// for.
class Log final : public TickSink {
 public:
  Log(const Scene& scene, double rate, bool rows) : felt(scene, rate) {
    if (rows) ring_.emplace(kRows);
  }
  void take(const Telemetry& tick, const ProxyState& state) noexcept override {
    felt.add(tick, state);
    if (ring_ && !ring_->try_enqueue(tick)) ++lost_;
  }
  /// On the thread that writes.
  template <class Take>
  void drain(const Take& row) {
    Telemetry tick;
    while (ring_ && ring_->try_dequeue(tick)) row(tick);
  }
  /// Rows for which there was no room.
  [[nodiscard]] std::int64_t lost() const noexcept { return lost_; }

  Felt felt;

 private:
  static constexpr std::size_t kRows = 32768;  // 3 s at 10 kHz
  // Never grows: try_enqueue takes no memory.
  std::optional<moodycamel::ReaderWriterQueue<Telemetry>> ring_;
  std::int64_t lost_ = 0;
};

/// Keys of a terminal while a hand is on the arm: Esc cuts the force, Enter lets it out again. On a
/// thread of their own, which waits for nothing else: a program that cannot print is still obeyed.
/// The terminal is left alone while it is another program's.
class Keys {
 public:
  explicit Keys(const std::vector<HapticThread*>& hands)
      : hands_(hands), shown_(isatty(0) != 0 && tcgetattr(0, &usual_) == 0) {
    if (!shown_) return;
    sayAside("Esc: force off; Enter: on again; Ctrl-C: end\n");
    thread_ = std::thread([this] { run(); });
  }
  ~Keys() {
    quit_ = true;
    if (thread_.joinable()) thread_.join();
    if (raw_ && ours()) tcsetattr(0, TCSANOW, &usual_);
  }
  Keys(const Keys&) = delete;
  Keys& operator=(const Keys&) = delete;

 private:
  void run() {
    constexpr int kLook = 10;  // [ms]
    while (!quit_) {
      if (ours()) {
        look();
        pollfd terminal{0, POLLIN, 0};
        (void)poll(&terminal, 1, kLook);
      } else {
        raw_ = false;
        std::this_thread::sleep_for(std::chrono::milliseconds(kLook));
      }
    }
  }
  void look() {
    // Also after it has been stopped and gone on: a shell may have put its own way back.
    if (termios now{}; !raw_ || (tcgetattr(0, &now) == 0 && (now.c_lflag & ICANON) != 0)) {
      termios raw = usual_;
      raw.c_lflag &= ~static_cast<tcflag_t>(ICANON | ECHO);
      raw.c_cc[VMIN] = 0;
      raw.c_cc[VTIME] = 0;
      raw_ = tcsetattr(0, TCSANOW, &raw) == 0;
    }
    constexpr char kEscape = 27;
    char key = 0;
    while (raw_ && read(0, &key, 1) == 1) {
      for (HapticThread* hand : hands_) {
        if (key == kEscape) hand->cut();
        if (key == '\n' || key == '\r') hand->clear();
      }
    }
  }
  /// In the background its settings are not to be touched, nor may it be read.
  static bool ours() { return tcgetpgrp(0) == getpgrp(); }

  std::vector<HapticThread*> hands_;
  termios usual_{};
  bool shown_;
  bool raw_ = false;  ///< It gives every key at once.
  std::atomic<bool> quit_{false};
  std::thread thread_;
};

std::optional<std::filesystem::file_time_type> writtenAt(const std::string& file) {
  std::error_code error;
  const auto time = std::filesystem::last_write_time(file, error);
  if (error) return std::nullopt;
  return time;
}

/// A coupling that all of them render: lowered where nobody has asked for it, else refused. True
/// where it was lowered.
template <class Devices>
bool fitToAll(SceneSpec& spec, const Devices& devices) {
  bool lowered = false;
  for (const auto& device : devices) {
    const std::string note = fitCoupling(spec, device->info());
    if (!note.empty()) complain("feel: " + note);
    lowered = lowered || !note.empty();
    checkDevice(spec, device->info());
  }
  return lowered;
}

/// A scene file that is made anew when it changes, on a thread of its own, so that keys and faults
/// are looked at meanwhile; what is wrong with it is said, and the scene that runs goes on.
class Watcher {
 public:
  /// `seen`: when the scene that runs was written.
  Watcher(std::string file, std::optional<std::filesystem::file_time_type> seen,
          std::vector<const Device*> devices, SceneCache& cache)
      : file_(std::move(file)), devices_(std::move(devices)), cache_(cache), seen_(seen) {}

  /// The new scene; none where there is none yet.
  std::optional<BuiltScene> look() {
    if (made_.valid()) {
      if (made_.wait_for(std::chrono::seconds(0)) != std::future_status::ready) return std::nullopt;
      try {
        BuiltScene built = made_.get();
        sayAside("feel: {} has changed: it is felt now\n", file_);
        return built;
      } catch (const std::bad_alloc&) {
        complain(file_ +
                 ": there is not enough memory for a second scene: use smaller volumes; the "
                 "scene before it goes on");
      } catch (const std::exception& error) {
        complain(std::string(error.what()) + "; the scene before it goes on");
      }
      return std::nullopt;
    }
    const auto now = writtenAt(file_);
    if (!now || now == seen_) return std::nullopt;
    seen_ = now;
    std::error_code error;
    if (!std::filesystem::is_regular_file(file_, error) &&
        !std::filesystem::is_directory(file_, error)) {
      complain(file_ + ": it is not a file any more; the scene before it goes on");
      return std::nullopt;
    }
    made_ = std::async(std::launch::async, [this] {
      SceneSpec spec = openScene(file_, {});
      (void)fitToAll(spec, devices_);
      BuiltScene built = buildScene(spec, {}, &cache_);
      for (const std::string& note : spec.notes) complain(note);
      for (const std::string& note : built.notes) complain(note);
      return built;
    });
    return std::nullopt;
  }

 private:
  std::string file_;
  std::vector<const Device*> devices_;
  SceneCache& cache_;
  std::optional<std::filesystem::file_time_type> seen_;
  std::future<BuiltScene> made_;
};

/// One hand: where it is, what it has felt, and where that is written.
struct Hand {
  Log log;  // first: its ring has cache lines of its own
  std::unique_ptr<Device> device;
  Trace trace;
  Picture* picture = nullptr;  ///< The first one's.
  OrderedJson granted;

  Hand(std::unique_ptr<Device> d, const Scene& scene, const FeelOptions& options,
       const std::string& trace_place, Picture* drawn)
      : log(scene, options.rate, !trace_place.empty() || drawn != nullptr),
        device(std::move(d)),
        trace(trace_place),
        picture(drawn) {}
  void drain() {
    log.drain([this](const Telemetry& tick) {
      trace.add(tick);
      if (picture != nullptr) picture->add(tick);
    });
  }
};
using Hands = std::vector<std::unique_ptr<Hand>>;

/// What a run asks for, once it is known to be good.
struct Run {
  const FeelOptions& options;
  Hands& hands;
  std::shared_ptr<const Scene> scene;
  std::optional<std::filesystem::file_time_type> written;  ///< The scene's file.
  SceneCache& cache;
  std::int64_t ticks = 0;  ///< At most.
  bool whole_path = false;

  /// Before a message about one of several.
  [[nodiscard]] std::string nameOf(std::size_t hand) const {
    return hands.size() == 1 ? "feel" : fmt::format("feel: hand {}", hand + 1);
  }
};

/// As fast as it goes; the same every time.
void runInVirtualTime(const Run& run) {
  std::vector<std::unique_ptr<HapticLoop>> loops;
  for (const auto& hand : run.hands) {
    loops.push_back(std::make_unique<HapticLoop>(*hand->device, run.options.rate, &hand->log));
    loops.back()->publish(run.scene);
  }
  Progress progress(run.whole_path ? 0 : run.ticks);
  TickTime time;
  time.dt = 1.0 / run.options.rate;
  bool feeling = true;
  for (std::int64_t i = 0; i < run.ticks && feeling && interrupted == 0; ++i) {
    time.now = static_cast<double>(i) / run.options.rate;
    feeling = false;
    for (std::size_t h = 0; h < loops.size(); ++h) {
      Hand& hand = *run.hands[h];
      if (hand.device->ended()) continue;
      loops[h]->tick(time);
      hand.drain();
      feeling = true;
    }
    progress.at(i);
  }
}

/// A hand's loop on time, and what its owner keeps an eye on.
class OnTime {
 public:
  OnTime(const Run& run, std::size_t number, Guardian& guardian)
      : run_(run), hand_(*run.hands[number]), name_(run.nameOf(number)), guardian_(guardian) {
    LoopParams params;
    params.rate = run.options.rate;
    const ZeroForce zero = hand_.device->zeroForce();
    if (zero.descriptor >= 0) params.watch = guardian.watch(zero);
    watch_ = params.watch;
    plugging_ = zero.version;
    thread_.emplace(*hand_.device, params, &hand_.log);
    if (!thread_->realtime().refused.empty()) {
      sayAside("{}: {}: the loop runs without it\n", name_, thread_->realtime().refused);
    }
  }
  [[nodiscard]] HapticThread& thread() { return *thread_; }
  /// False once it has nothing more to do.
  bool look() {
    hand_.drain();
    const Telemetry& now = thread_->latest();
    if (now.fault != told_ && now.fault != Fault::kNone) {
      complain(fmt::format("{}: the force is cut: {}: {}", name_, wordsFor(now.fault),
                           remedyFor(now.fault)));
    }
    if (now.fault == Fault::kNone && told_ != Fault::kNone)
      complain(name_ + ": the force is on again");
    told_ = now.fault;
    // Half of it gone is no trembling hand.
    const bool still = now.report.moving < 0.5;
    if (still && !told_still_) {
      complain(name_ +
               ": its counters stand still under the force, which fades until they move: "
               "see to its firmware and encoders");
    }
    told_still_ = still;
    if (const ZeroForce another = hand_.device->zeroForce(); another.version != plugging_) {
      plugging_ = another.version;
      guardian_.renew(watch_, another);
      complain(name_ + ": the arm is back: Enter when the hand is ready");
    }
    return thread_->running() && now.tick < run_.ticks;
  }
  void feel(const std::shared_ptr<const Scene>& scene) {
    hand_.log.felt.expect(*scene);
    thread_->publish(scene);
  }
  void end() {
    thread_->stop();
    // What the profile has done afterwards is not to be overwritten.
    if (watch_.heart != nullptr) guardian_.forget(watch_);
    hand_.drain();
    const std::int64_t lost = hand_.log.lost();
    if (lost > 0) {
      complain(
          fmt::format("{}: {} rows of the trace came too fast to be written: use a lower rate "
                      "or a faster place",
                      name_, lost));
    }
    const RealtimeReport& got = thread_->realtime();
    hand_.granted = {{"priority", got.priority},
                     {"memory_locked", got.memory},
                     {"cores_awake", got.awake},
                     {"refused", got.refused.empty() ? OrderedJson() : OrderedJson(got.refused)},
                     {"page_faults", thread_->pageFaultsSinceStart()},
                     {"rows_lost", lost}};
  }

 private:
  const Run& run_;
  Hand& hand_;
  std::string name_;
  Guardian& guardian_;
  LoopWatch watch_;
  std::uint32_t plugging_ = 1;
  Fault told_ = Fault::kNone;
  bool told_still_ = false;
  std::optional<HapticThread> thread_;
};

/// With a clock, in a thread each.
void runOnTime(const Run& run, Guardian& guardian) {
  std::vector<const Device*> devices;
  for (const auto& hand : run.hands) devices.push_back(hand->device.get());
  std::optional<Watcher> watcher;
  if (run.options.watch) watcher.emplace(run.options.scene, run.written, devices, run.cache);
  std::vector<std::unique_ptr<OnTime>> hands;
  std::vector<HapticThread*> threads;
  for (std::size_t h = 0; h < run.hands.size(); ++h) {
    hands.push_back(std::make_unique<OnTime>(run, h, guardian));
    threads.push_back(&hands.back()->thread());
  }
  const Keys keys(threads);
  for (HapticThread* thread : threads) thread->publish(run.scene);
  constexpr auto kLook = std::chrono::milliseconds(10);
  constexpr int kWatch = 25;  // looks
  bool feeling = true;
  for (int looks = 0; feeling && interrupted == 0; ++looks) {
    std::this_thread::sleep_for(kLook);
    feeling = false;
    for (const auto& hand : hands) feeling = hand->look() || feeling;
    if (!watcher || looks % kWatch != 0) continue;
    if (const auto built = watcher->look()) {
      for (const auto& hand : hands) hand->feel(built->scene);
    }
  }
  for (const auto& hand : hands) hand->end();
}

void checkOptions(const FeelOptions& options) {
  const double slowest = options.realtime ? 500.0 : 10.0;
  const double fastest = options.realtime ? 20000.0 : 100000.0;
  if (!(options.rate >= slowest && options.rate <= fastest)) {
    throw Error("--rate", fmt::format("{} Hz is not {} to {}", options.rate, slowest, fastest),
                "use 1000");
  }
  if (options.seconds && !(*options.seconds > 0.0 && *options.seconds <= 1e6)) {
    throw Error("--seconds",
                fmt::format("{} is not more than 0 and at most 1000000", *options.seconds),
                "use 10");
  }
  constexpr std::size_t kMostHands = 4;
  if (options.devices.empty() || options.devices.size() > kMostHands) {
    throw Error("--device", fmt::format("{} hands", options.devices.size()), "give one to four");
  }
  if (options.devices.size() > 1 && options.trace == "-") {
    throw Error("--trace", "the rows of several hands would be mixed", "give a file");
  }
  const bool paths = std::any_of(options.devices.begin(), options.devices.end(),
                                 [](const std::string& d) { return d.rfind("path:", 0) == 0; });
  if (options.passive && paths) {
    throw Error("--passive", "a recorded path is no hand that could be given energy",
                "leave it out");
  }
  constexpr double kMostRefill = 10.0;  // [W]: a hand gives less
  if (!(options.refill >= 0.0 && options.refill <= kMostRefill)) {
    throw Error("--refill", fmt::format("{} W is not 0 to {}", options.refill, kMostRefill),
                "use 0.1");
  }
  if (options.refill > 0.0 && !options.passive) {
    throw Error("--refill", "nothing is held back that it would let through", "add --passive");
  }
  if (options.watch && !options.realtime) {
    throw Error("--watch", "virtual time is over before a file changes", "add --realtime");
  }
}

OrderedJson summaryOf(const FeelOptions& options, const Hand& hand, const SceneSpec& spec) {
  OrderedJson summary;
  summary["version"] = kVersion;
  summary["scene"] = spec.source;
  summary["device"] = hand.device->info().name;
  summary["clock"] = options.realtime ? "real" : "virtual";
  const OrderedJson counted = hand.log.felt.summary();
  for (const auto& [key, value] : counted.items()) summary[key] = value;
  summary["room"] = roomFor(hand.device->info(), options.rate, stiffestCoupling(spec));
  if (options.realtime) {
    summary["realtime"] = hand.granted;
  } else {
    // In virtual time no tick is late, and the rate is kept by definition: there is no clock.
    for (const char* key : {"rate_kept", "late_ticks", "wake_ns"}) summary[key] = nullptr;
  }
  return summary;
}

void tell(const FeelOptions& options, const Hand& hand, const OrderedJson& summary) {
  say("run       {} s at {} Hz {}, device {}, {} ticks\n{}",
      rounded(summary["seconds"].get<double>()), rounded(options.rate),
      options.realtime ? "on time" : "in virtual time", hand.device->info().name,
      summary["ticks"].get<std::int64_t>(), hand.log.felt.words());
  if (!summary["room"].is_null()) say("room      {}\n", sentence(roomWords(summary["room"])));
  if (options.realtime) say("{}", timeWords(summary));
}

int feel(const FeelOptions& options) {
  checkOptions(options);
  // Before there is much memory, and before there are threads.
  std::optional<Guardian> guardian;
  if (options.realtime) guardian.emplace();
  noteInterrupts();

  // Everything that can be refused is refused before anything runs.
  const auto written = writtenAt(options.scene);
  SceneSpec spec = openScene(options.scene, showProgress("loading"));
  checkOutputs(options, spec);
  for (const std::string& note : spec.notes) complain(note);
  SceneCache cache;
  BuiltScene built = buildScene(spec, showProgress("loading"), &cache);
  for (const std::string& note : built.notes) complain(note);
  std::vector<std::unique_ptr<Device>> devices;
  for (const std::string& name : options.devices) {
    devices.push_back(makeDevice(options, name, built.bounds));
  }
  if (fitToAll(spec, devices)) built = buildScene(spec, {}, &cache);
  std::optional<Picture> picture;
  if (!options.picture.empty()) picture.emplace(options.picture);
  std::optional<WholeFile> summary_file;
  if (!options.summary.empty()) summary_file.emplace(options.summary);
  Hands hands;
  for (std::size_t h = 0; h < devices.size(); ++h) {
    hands.push_back(std::make_unique<Hand>(std::move(devices[h]), *built.scene, options,
                                           traceOf(options, h),
                                           picture && h == 0 ? &*picture : nullptr));
  }

  Run run{options, hands, built.scene, written, cache};
  run.whole_path = !options.seconds &&
                   std::all_of(options.devices.begin(), options.devices.end(),
                               [](const std::string& d) { return d.rfind("path:", 0) == 0; });
  run.ticks = run.whole_path ? std::numeric_limits<std::int64_t>::max()
                             : static_cast<std::int64_t>(std::llround(
                                   options.seconds.value_or(kDefaultSeconds) * options.rate));
  if (options.realtime) {
    guardian->catchSignals(&interrupted);
    runOnTime(run, *guardian);
  } else {
    runInVirtualTime(run);
  }

  std::vector<OrderedJson> felt;
  for (const auto& hand : hands) felt.push_back(summaryOf(options, *hand, spec));
  OrderedJson summary = felt[0];
  if (felt.size() > 1) summary["hands"] = felt;
  summary["machine"] = machine();
  for (const auto& hand : hands) hand->trace.commit();
  if (summary_file) {
    summary_file->write(dump(summary, 2) + "\n");
    summary_file->commit();
  }
  if (picture) picture->draw(spec, built);
  if (options.json) {
    sayJson(summary);
  } else if (options.trace != "-" && options.summary != "-") {
    for (std::size_t h = 0; h < hands.size(); ++h) tell(options, *hands[h], felt[h]);
  }
  if (std::none_of(hands.begin(), hands.end(),
                   [](const auto& hand) { return hand->log.felt.anything(); })) {
    complain(
        "feel: nothing was felt: the hand met no mode that acts: palpate check shows where the "
        "volumes are");
  }
  if (interrupted != 0) return kInterrupted;
  int status = kDone;
  for (std::size_t h = 0; h < hands.size(); ++h) {
    const Fault fault = hands[h]->log.felt.fault();
    if (fault == Fault::kNone) continue;
    complain(fmt::format("{}: the force was cut: {}: {}", run.nameOf(h), wordsFor(fault),
                         remedyFor(fault)));
    status = kEndedEarly;
  }
  return status;
}

}  // namespace

void addFeel(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand("feel", "Feels a scene and says what was felt, and how well");
  auto options = std::make_shared<FeelOptions>();
  verb->add_option("SCENE", options->scene, "A scene file, a .vdb or a folder of .vdb")->required();
  verb->add_option("--device", options->devices,
                   "simulated (arm and hand with dynamics), path:FILE.csv (header t,x,y,z), or "
                   "hid[:PROFILE[@SERIAL]] (palpate devices); again for another hand")
      ->take_all()
      ->type_name("D");
  verb->add_option("--seconds", options->seconds,
                   "How long (default: 10, or to the end of the path)");
  verb->add_option("--rate", options->rate, "Ticks a second (default 1000)");
  verb->add_flag("--realtime", options->realtime,
                 "On time, in a thread of its own with real-time priority (rate 500 to 20000)");
  verb->add_flag("--passive", options->passive,
                 "Let no energy out that the hand has not put in (docs/stability.md)");
  verb->add_option("--refill", options->refill,
                   "But what primitives that do work add (a moving volume pushes), at most [W]; "
                   "with --passive (default 0)");
  verb->add_flag("--watch", options->watch, "Take the scene file anew when it changes");
  verb->add_option("--trace", options->trace, "CSV, one row a tick");
  verb->add_option("--summary", options->summary, "JSON");
  verb->add_option("--picture", options->picture, "PNG: path over the slices, force over time");
  verb->add_flag("--json", options->json, "Print the summary as JSON");
  verb->footer(
      "Example:\n  palpate feel head.json --seconds 10 --trace trace.csv --summary "
      "summary.json --picture felt.png");
  verb->callback([=, &body] { body = [=] { return feel(*options); }; });
}

}  // namespace palpate::cli
