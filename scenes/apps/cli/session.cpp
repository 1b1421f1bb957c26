#include "palpate/scenes/apps/cli/session.h"

#include <algorithm>
#include <chrono>
#include <thread>

#include <fmt/format.h>

#include "palpate/engine/loop/hand_tick.h"
#include "palpate/engine/loop/haptic_thread.h"
#include "palpate/scenes/apps/cli/keys.h"
#include "palpate/scenes/apps/cli/watcher.h"

namespace palpate::cli {
namespace {

/// The real-time loop of one hand, with the state that the main thread has reported.
class OnTime {
 public:
  OnTime(const Run& run, std::size_t number, Guardian& guardian, const PlayClock& clock)
      : run_(run), hand_(*run.hands[number]), name_(run.nameOf(number)), guardian_(guardian) {
    LoopParams params;
    params.rate = run.options.rate;
    params.clock = &clock;
    params.reengage = run.options.reengage.value_or(kReengage);
    if (run.sites != nullptr && number == 0) params.links = run.sites->links();
    if (run.window != nullptr && number == 0) params.realtime.core = loopsCore();
    const ZeroForce zero = hand_.device->zeroForce();
    if (zero.descriptor >= 0) params.watch = guardian.watch(zero);
    watch_ = params.watch;
    plugging_ = zero.version;
    thread_.emplace(*hand_.device, params, &hand_.log);
    if (!thread_->realtime().refused.empty()) {
      sayAside("{}: the loop runs without {}\n", name_, thread_->realtime().refused);
    }
  }
  [[nodiscard]] HapticThread& thread() { return *thread_; }
  [[nodiscard]] const IgtlHand& shown() const { return shown_; }
  /// Prints new faults and warnings. Returns false after the loop has stopped or run all its ticks.
  bool look() {
    hand_.drain();
    hand_.tellUnwritten(name_);
    const Telemetry& now = thread_->latest();
    shown_ = {now.probe, now.report.proxy, now.report.force, now.fault, now.tick > 0};
    if (now.fault != told_ && now.fault != Fault::kNone) {
      complain(fmt::format("{}: the force is cut: {}: {}{}", name_, wordsFor(now.fault),
                           remedyFor(now.fault), now.fault == Fault::kLate ? returns() : ""));
    }
    if (now.fault == Fault::kNone && told_ != Fault::kNone)
      complain(name_ + ": the force is on again");
    told_ = now.fault;
    // While the hand trembles, `moving` stays above 0.5.
    const bool still = now.report.moving < 0.5;
    if (still && !told_still_) {
      complain(name_ +
               ": the encoder counts do not change under force: the force fades until they change: "
               "check the firmware and the encoders");
    }
    told_still_ = still;
    // At less than half of the requested force, a surface feels too soft.
    const bool weak = now.fault == Fault::kNone && now.input.given < 0.5;
    if (weak && !told_weak_) {
      complain(name_ +
               ": the motors give less than half of the requested force, because they are too weak "
               "or too hot: let the arm rest, or use weaker modes");
    }
    told_weak_ = weak;
    if (const ZeroForce another = hand_.device->zeroForce(); another.version != plugging_) {
      plugging_ = another.version;
      guardian_.renew(watch_, another);
      constexpr auto kSeldom = std::chrono::seconds(2);
      const auto at = std::chrono::steady_clock::now();
      if (at - told_plugged_ > kSeldom) {
        told_plugged_ = at;
        complain(name_ + ": the arm is connected again: press Enter when the hand is ready");
      }
    }
    stood_ = thread_->running() && now.tick == last_tick_ ? stood_ + 1 : 0;
    last_tick_ = now.tick;
    return thread_->running() && now.tick < run_.ticks;
  }
  /// Returns true if the last kStanding calls of look() found no new tick.
  [[nodiscard]] bool stands() const { return stood_ >= kStanding; }
  void feel(const std::shared_ptr<const Scene>& scene, const std::vector<LiveDial>& dials) {
    hand_.log.expect(*scene, dials);
    thread_->publish(scene);
  }
  /// Waits for the end of the loop. Returns false if the loop stands still.
  [[nodiscard]] bool ends() {
    constexpr double kPatience = 1.0;  // [s]
    if (thread_->stopWithin(kPatience)) return true;
    complain(name_ +
             ": the loop stands still, because the arm's driver or a mode does not return: palpate "
             "ends without its files: run a plug-in in its own process (--device plugin:NAME)");
    return false;
  }
  /// Ends the guardian's watch, which could overwrite the profile's final output. Call this only
  /// after all loops have ended: the guardian writes zero if the program ends before.
  void forget() {
    if (watch_.heart != nullptr) guardian_.forget(watch_);
  }
  void end() {
    hand_.drain();
    const std::int64_t lost = hand_.log.lost();
    if (lost > 0) {
      const bool traced = !run_.options.trace.empty();
      const char* const from = !traced                    ? "picture"
                               : hand_.picture != nullptr ? "trace and the picture"
                                                          : "trace";
      complain(
          fmt::format("{}: {} ticks were lost from the {}, because the disk or the processor was "
                      "too slow: use a lower rate or a faster disk, or end other programs",
                      name_, lost, from));
    }
    const RealtimeReport& got = thread_->realtime();
    hand_.granted = {{"priority", got.priority},
                     {"memory_locked", got.memory},
                     {"cores_awake", got.awake},
                     {"early_us", 1e6 * thread_->early()},
                     {"refused", got.refused.empty() ? OrderedJson() : OrderedJson(got.refused)},
                     {"page_faults", thread_->pageFaultsSinceStart()},
                     {"rows_lost", lost}};
  }

 private:
  [[nodiscard]] std::string returns() const {
    const double after = run_.options.reengage.value_or(kReengage);
    if (!(after > 0.0)) return "";
    return fmt::format(
        "; unless another fault or a pause over 0.5 s occurs, the force returns {} s after the "
        "last late tick, at most {} times a minute",
        after, Reengagement::kMost);
  }

  const Run& run_;
  Hand& hand_;
  std::string name_;
  Guardian& guardian_;
  LoopWatch watch_;
  std::uint32_t plugging_ = 1;
  std::chrono::steady_clock::time_point told_plugged_;
  /// Calls of look() without a new tick after which the loop counts as standing still: about 3 s.
  static constexpr int kStanding = 300;
  int stood_ = 0;
  std::int64_t last_tick_ = 0;
  Fault told_ = Fault::kNone;
  bool told_still_ = false;
  bool told_weak_ = false;
  IgtlHand shown_;
  std::optional<HapticThread> thread_;
};

/// Delays the ticks of a replay to their recorded times, divided by the replay's speed.
class Pacer {
 public:
  explicit Pacer(std::optional<double> speed) : speed_(speed) {}
  /// Waits until a tick at `time` [s] is due. The first call starts the clock, and returns at once.
  void wait(double time) {
    if (!speed_) return;
    using Clock = std::chrono::steady_clock;
    if (!begun_) begun_ = Begin{Clock::now(), time};
    const std::chrono::duration<double> since((time - begun_->time) / *speed_);
    std::this_thread::sleep_until(begun_->at + std::chrono::duration_cast<Clock::duration>(since));
  }

 private:
  struct Begin {
    std::chrono::steady_clock::time_point at;
    double time;
  };
  std::optional<double> speed_;
  std::optional<Begin> begun_;
};

/// Returns the times of the sequences that have at least two frames.
std::vector<FrameTimes> playedTimes(const Fetched& of) {
  std::vector<FrameTimes> played;
  for (const auto& [name, sequence] : of.sequences()) {
    if (sequence->times().times.size() > 1) played.push_back(sequence->times());
  }
  return played;
}

/// Announces the next scene to all recordings. Call record() before the hands use the scene.
void record(const Run& run, const BuiltScene& built, const Watcher& watcher) {
  const auto recorded = [](const auto& hand) { return hand->recorder != nullptr; };
  if (std::none_of(run.hands.begin(), run.hands.end(), recorded)) return;
  const std::string& read = watcher.text().empty() ? run.from.text : watcher.text();
  const std::string text =
      recordedScene(run.from.file, read, watcher.spec(), watcher.dials(), built.windows);
  for (const auto& hand : run.hands) hand->recorder->expect({built.scene->id, text});
}

/// Lets clients of the OpenIGTLink server cut the force, until this object is destroyed.
class Obeyed {
 public:
  Obeyed(IgtlServer* server, const std::vector<HapticThread*>& hands) : server_(server) {
    if (server_ != nullptr) server_->cuts(hands);
  }
  ~Obeyed() {
    if (server_ != nullptr) server_->cuts({});
  }
  Obeyed(const Obeyed&) = delete;
  Obeyed& operator=(const Obeyed&) = delete;

 private:
  IgtlServer* server_;
};

/// Sends the state of the hands to the clients, and passes a client's image to the watcher.
void serve(IgtlServer& server, const std::vector<std::unique_ptr<OnTime>>& hands, Watcher& watcher,
           std::chrono::steady_clock::time_point& next_image) {
  IgtlShown shown;
  for (const auto& hand : hands) {
    if (shown.count < shown.hands.size()) shown.hands[shown.count++] = hand->shown();
  }
  server.show(shown);
  // The server sends the answer to the client whose image was taken last. So the answer precedes
  // the next takeImage().
  const Watcher::ImageNews news = watcher.takeNews();
  if (!news.text.empty()) server.tell(news.text, news.refused);
  // Each new image can start an engagement, which must end before the next image.
  constexpr auto kBetweenImages = std::chrono::seconds(2);
  const auto now = std::chrono::steady_clock::now();
  if (watcher.takesImage() && now >= next_image) {
    if (auto image = server.takeImage()) {
      watcher.replace(std::move(image));
      next_image = now + kBetweenImages;
    }
  }
}

}  // namespace

void RunSoFar::add(const Telemetry& tick, const ProxyState& state) {
  constexpr double kNothing = 1e-6;  // [N]
  ticks.push_back({tick.input, tick.scene != 0});
  time = tick.time;
  edited = edited || (scene != 0 && tick.scene != scene);
  scene = tick.scene;
  if (tick.report.wanted.norm() < kNothing) near = {};
  near.add(state, tick.report);
}

void Fetched::tellTroubles() const {
  const auto tell = [](const auto& all) {
    for (const auto& [name, of] : all) {
      for (const std::string& trouble : of->takeTroubles()) complain(trouble);
    }
  };
  tell(windows_);
  tell(sequences_);
}

void Fetched::addTo(OrderedJson& summary) const {
  for (const auto& [name, window] : windows_) {
    const WindowState state = window->state();
    summary["bricks"][name] = {{"slots", state.slots},   {"resident", state.resident},
                               {"bytes", state.bytes},   {"fetched", state.fetched},
                               {"failed", state.failed}, {"locked", state.locked},
                               {"gone", state.gone}};
  }
  for (const auto& [name, sequence] : sequences_) {
    const SequenceState state = sequence->state();
    summary["sequences"][name] = {{"frames", state.frames},     {"slots", state.slots},
                                  {"resident", state.resident}, {"bytes", state.bytes},
                                  {"fetched", state.fetched},   {"failed", state.failed}};
  }
}

void Fetched::sayThem() const {
  for (const auto& [name, window] : windows_) {
    const WindowState state = window->state();
    say("bricks    {}: {} loaded, {} in memory, in a window of {} bricks ({} MB){}\n", name,
        state.fetched, state.resident, state.slots, rounded(static_cast<double>(state.bytes) / 1e6),
        state.failed > 0
            ? fmt::format("; {} failed to load and were replaced by coarser data", state.failed)
            : "");
  }
  for (const auto& [name, sequence] : sequences_) {
    const SequenceState state = sequence->state();
    say("frames    {}: {} of {} in memory ({} MB), {} loaded{}\n", name, state.resident,
        state.frames, rounded(static_cast<double>(state.bytes) / 1e6), state.fetched,
        state.failed > 0 ? fmt::format("; {} failed to load", state.failed) : "");
  }
}

WithSites::WithSites(const FeelOptions& options, const DeviceInfo& device, const SceneInput& from) {
  if (options.site.empty()) return;
  SiteParams params = siteFrom(options.site, options.with);
  params.keys = options.site_keys;
  name_ = params.name;
  // Only trusted sites may edit the scene: sites on this machine, or with the same keys.
  const bool known = options.with.empty() || !options.site_keys.empty();
  params.scene = shares_ = known && !options.own_scene && !from.text.empty();
  if (!known && options.watch && !options.own_scene) {
    complain(
        "feel: edits of the scene are neither sent nor received, because --with is given without "
        "--site-keys: add --site-keys FOLDER");
  } else if (!options.own_scene && !shares_ && known) {
    complain("feel: " + from.file + ": it is not a scene file: edits of other sites are ignored");
  }
  // `life` is the time since 1970 [ns], so a restarted program gets a greater `life` than before.
  const auto now = std::chrono::system_clock::now().time_since_epoch();
  const auto life = std::chrono::duration_cast<std::chrono::nanoseconds>(now).count();
  LinkParams link;
  // Limits the links to other sites, so that the coupling to the scene remains stable.
  link.stiffness = std::min(link.stiffness, 0.25 * device.max_stiffness);
  link.peak = std::min(link.peak, 0.5 * device.limits.peak);
  // Step 0 means exact positions only if no force can act on a hand; otherwise the step is unknown.
  const double step = device.limits.tank.arm.step;
  if (step > 0.0 || !device.hand) link.step = step;
  links_.emplace(static_cast<std::uint64_t>(life), link);
  site_ = openSite(params, *links_);
}

void WithSites::tellNews() {
  if (!site_) return;
  for (const std::string& line : site_->takeNews()) complain("feel: " + line);
}

void WithSites::begin(Watcher& watcher, const SceneInput& from) const {
  watcher.share(name_, from.file, from.text);
}

void WithSites::hear(Watcher& watcher) {
  for (const auto& [name, text] : site_->takeScenes()) watcher.hear(name, text);
}

void WithSites::tell(Watcher& watcher) {
  if (auto told = watcher.takeTold()) site_->tellScene(std::move(*told));
}

void WithSites::addTo(OrderedJson& summary) const {
  if (!site_) return;
  OrderedJson& sites = summary["sites"] = OrderedJson::object();
  for (const auto& [name, other] : site_->others()) {
    sites[name] = {{"here", other.here},     {"lives", other.lives},       {"heard", other.heard},
                   {"missed", other.missed}, {"presence", other.presence}, {"paid", other.paid},
                   {"energy", other.energy}};
  }
}

void WithSites::sayThem() const {
  if (!site_) return;
  for (const auto& [name, other] : site_->others()) {
    say("site      {}: {} messages received, {} late or lost{}\n", name, other.heard, other.missed,
        other.here ? "" : "; disconnected");
  }
}

void runInVirtualTime(const Run& run) {
  const PlayClock clock(run.play);
  std::vector<std::unique_ptr<HapticLoop>> loops;
  for (const auto& hand : run.hands) {
    loops.push_back(std::make_unique<HapticLoop>(*hand->device, run.options.rate, &hand->log));
    loops.back()->playBy(&clock);
    loops.back()->publish(run.scene);
  }
  const auto progress = showProgress("running");
  TickTime time;
  time.dt = 1.0 / run.options.rate;
  bool feeling = true;
  for (std::int64_t i = 0; i < run.ticks && feeling && interrupted == 0; ++i) {
    time.now = static_cast<double>(i) / run.options.rate;
    feeling = false;
    for (std::size_t h = 0; h < loops.size(); ++h) {
      Hand& hand = *run.hands[h];
      if (hand.device->ended()) continue;
      if (hand.recorder) hand.recorder->wait();
      loops[h]->tick(time);
      hand.drain();
      feeling = true;
    }
    if (progress && !run.whole_path) {
      progress(static_cast<double>(i) / static_cast<double>(run.ticks));
    }
  }
}

void runAgain(const Run& run, const ScenesById& scenes) {
  const auto progress = run.window == nullptr ? showProgress("replaying") : Progress();
  constexpr std::int64_t kLook = 10;  // [ticks]: interval between two checks of the window
  for (const auto& hand : run.hands) {
    const auto& device = dynamic_cast<const ReplayDevice&>(*hand->device);
    const Recording& recording = device.recording();
    HandTick tick(recording.setting().device.limits);
    const std::int64_t end =
        device.begin() + std::min(recording.size() - device.begin(), run.ticks);
    std::uint64_t id = 0;
    const Scene* scene = nullptr;
    Pacer pacer(run.options.speed);
    for (std::int64_t i = device.begin(); i < end && interrupted == 0; ++i) {
      if (run.window != nullptr && i % kLook == 0) {
        if (run.window->look({}).closed || run.window->lost()) return;
      }
      Telemetry told = telemetryOf(recording.tick(i));
      pacer.wait(told.time);
      if (told.scene != id) {
        id = told.scene;
        const auto found = scenes.find(id);
        const Scene* next = id == 0 ? nullptr : run.scene.get();
        if (found != scenes.end()) next = found->second.scene.get();
        if (id != 0 && found == scenes.end() && !scenes.empty()) {
          complain(fmt::format(
              "{}: tick {}: its scene is not in the recording: the first scene of {} is used "
              "instead",
              run.nameOf(static_cast<std::size_t>(&hand - run.hands.data())), told.tick,
              run.options.scene));
        }
        if (next != nullptr && next != run.scene.get() && next != scene) {
          hand->log.expect(*next, {});
          if (hand->recorder) hand->recorder->expect({next->id, found->second.text});
        }
        scene = next;
      }
      if (hand->recorder) hand->recorder->wait();
      const auto begin = std::chrono::steady_clock::now();
      told.report = tick.step(scene, told.input);
      told.tick_ns = std::chrono::nanoseconds(std::chrono::steady_clock::now() - begin).count();
      tick.withhold(told.input, told.report);
      tick.sent(told.input);
      told.fault = tick.state().fault();
      told.scene = scene == nullptr ? 0 : scene->id;
      hand->log.take(told, tick.state());
      hand->drain();
      if (progress) {
        const double all = static_cast<double>(end - device.begin());
        progress(static_cast<double>(i - device.begin()) / all);
      }
    }
  }
}

/// Shows the ticks of the hands and publishes edited scenes, until the run ends.
void watchHands(Run& run, const std::vector<std::unique_ptr<OnTime>>& hands,
                const std::vector<HapticThread*>& threads, std::optional<Watcher>& watcher,
                PlayClock& clock, Keys& keys) {
  const bool shared = run.sites != nullptr && run.sites->share();
  constexpr auto kLook = std::chrono::milliseconds(10);
  constexpr int kWatch = 25;  // The scene file is checked for changes once per this number of polls
  // If ticks are late, a run takes longer, at most by this time. Counts looks instead of time,
  // because a time in which the process is stopped must not count.
  constexpr double kExtra = 5.0;  // [s]
  const double longest = (static_cast<double>(run.ticks) / run.options.rate + kExtra) /
                         std::chrono::duration<double>(kLook).count();
  std::chrono::steady_clock::time_point next_image;
  bool feeling = true;
  for (int looks = 0; feeling && interrupted == 0; ++looks) {
    std::this_thread::sleep_for(kLook);
    if (looks > longest) {
      complain("feel: the run ends, because its ticks are 5 s late");
      return;
    }
    feeling = false;
    for (const auto& hand : hands) {
      feeling = hand->look() || feeling;
      if (hand->stands()) return;
    }
    if (run.sites != nullptr) run.sites->tellNews();
    if (run.window != nullptr) {
      const Asked asked = run.window->look(threads);
      if (asked.closed || run.window->lost()) break;
      if (asked.dialled != 0) watcher->turn(asked.dials, asked.dialled);
      run.window->tellRefused(watcher->refused());
    }
    if (run.igtl != nullptr) serve(*run.igtl, hands, *watcher, next_image);
    if (looks % kWatch != 0) continue;
    run.fetched.tellTroubles();
    if (!watcher) continue;
    if (shared) run.sites->hear(*watcher);
    if (const auto built = watcher->look()) {
      run.fetched.now(*built);
      keys.play(playedTimes(run.fetched));
      // If an edit does not change the scene's playback, the user's own changes of the playback
      // remain.
      if (!(built->play == run.play)) clock.steer(run.play = built->play);
      record(run, *built, *watcher);
      run.edited = EditedScene{watcher->spec(), *built};
      const CouplingParams coupling = stiffestCoupling(watcher->spec());
      if (coupling.stiffness > run.stiffest.stiffness) run.stiffest = coupling;
      if (run.igtl != nullptr) run.igtl->expect(*built);
      for (const auto& hand : hands) hand->feel(built->scene, watcher->dials());
    }
    if (shared) run.sites->tell(*watcher);
  }
}

/// Ends the loops of all hands. If one stands still, prints `error` and ends the program, because
/// the destructor of its HapticThread would wait forever.
void endLoops(const std::vector<std::unique_ptr<OnTime>>& hands, std::optional<Keys>& keys,
              const std::string& error = {}) {
  for (const auto& hand : hands) (void)hand->thread().stopWithin(0.0);
  bool ended = true;
  for (const auto& hand : hands) ended = hand->ends() && ended;
  if (ended) {
    for (const auto& hand : hands) hand->forget();
    return;
  }
  if (!error.empty()) complain(error);
  keys.reset();  // restores the terminal
  endWithoutFiles(kEndedEarly);
}

void runOnTime(Run& run, Guardian& guardian) {
  std::vector<const Device*> devices;
  for (const auto& hand : run.hands) devices.push_back(hand->device.get());
  std::optional<Watcher> watcher;
  const bool shared = run.sites != nullptr && run.sites->share();
  if (run.options.watch || run.window != nullptr || run.igtl != nullptr || shared) {
    watcher.emplace(run.spec, run.options.scene, run.written, run.options.watch, devices,
                    run.cache);
  }
  if (shared) run.sites->begin(*watcher, run.from);
  PlayClock clock(run.play);
  std::vector<std::unique_ptr<OnTime>> hands;
  std::vector<HapticThread*> threads;
  for (std::size_t h = 0; h < run.hands.size(); ++h) {
    hands.push_back(std::make_unique<OnTime>(run, h, guardian, clock));
    threads.push_back(&hands.back()->thread());
  }
  std::optional<Keys> keys(std::in_place, threads, clock, playedTimes(run.fetched));
  const Obeyed obeyed(run.igtl, threads);  // before the first force
  for (HapticThread* thread : threads) thread->publish(run.scene);
  try {
    watchHands(run, hands, threads, watcher, clock, *keys);
  } catch (const std::exception& error) {
    endLoops(hands, keys, error.what());
    throw;
  } catch (...) {
    endLoops(hands, keys);
    throw;
  }
  endLoops(hands, keys);
  for (const auto& hand : hands) hand->end();
}

}  // namespace palpate::cli
