#include "palpate/engine/loop/haptic_loop.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <string>
#include <utility>

#include "palpate/engine/error.h"
#include "palpate/engine/scoped_float_mode.h"

namespace palpate {

namespace {

constexpr double kWriteTime = 0.020;  ///< [s]: a write that takes longer counts as blocked

constexpr double kClock = 1.2;  ///< default of ArmDissipation::period, in periods of the loop

ForceLimits limitsAt(const DeviceInfo& info, double rate) noexcept {
  ForceLimits limits = info.limits;
  if (info.hand && !(limits.engage >= kEngage)) limits.engage = kEngage;
  ArmDissipation& arm = limits.tank.arm;
  if (arm.period == 0.0) arm.period = kClock / rate;
  // If the loop sends more forces than the device accepts, a force may wait for the device's next
  // output. The stated delay may or may not include these waits, so `doubt` covers both cases.
  if (info.output_rate > 0.0 && info.output_rate < rate) {
    const double waits = 1.0 / info.output_rate;
    const double early = std::max(0.0, arm.delay - arm.doubt - waits);
    const double late = arm.delay + arm.doubt + waits;
    arm.delay = 0.5 * (early + late);
    arm.doubt = 0.5 * (late - early);
  }
  return limits;
}

void require(const DeviceInfo& info, bool good, const char* what, double value,
             const char* remedy = "give a finite number above 0") {
  if (good) return;
  throw DeviceError(info.name, std::string(what) + " is " + std::to_string(value), remedy);
}

std::string shortly(double value, const char* unit) {
  char text[40];
  (void)std::snprintf(text, sizeof text, "%.6g %s", value, unit);
  return text;
}

/// Returns the fault that keeps the force from returning by itself after a tick; kLate or kNone if
/// it may return. `jumped` is true if the position jumped while no force was sent.
Fault whyNotBack(const TickInput& in, bool deaf, bool jumped) noexcept {
  const auto late = [](Fault one) { return one == Fault::kNone || one == Fault::kLate; };
  if (jumped) return Fault::kJump;
  if (deaf) return Fault::kWrite;
  Fault why = Fault::kNone;
  for (const Fault one : {in.wrong, in.order, in.unsent, in.hand.fault}) {
    if (late(why) && one != Fault::kNone) why = one;
  }
  return why;
}

bool noLess(double x) noexcept {
  return x >= 0.0 && std::isfinite(x);
}

}  // namespace

ForceLimits limitsInLoop(const DeviceInfo& info, double rate) {
  const auto require = [&](auto&&... words) { palpate::require(info, words...); };
  const auto positive = [](double x) { return x > 0.0 && std::isfinite(x); };
  require(positive(info.watch.stale), "the age of a stale position [s]", info.watch.stale);
  require(positive(info.watch.max_speed), "the highest speed [m/s]", info.watch.max_speed);
  require(positive(info.watch.late), "the delay of a late tick [s]", info.watch.late);
  require(noLess(info.output_rate), "the rate at which the device takes forces [Hz]",
          info.output_rate, "give a rate > 0, or 0 if the device takes any");
  const ForceLimits limits = limitsAt(info, rate);
  require(positive(limits.peak), "the peak force [N]", limits.peak);
  require(positive(limits.slew), "the slew [N/s]", limits.slew);
  const bool cool = limits.continuous == 0.0;
  require(cool || positive(limits.continuous), "the continuous force [N]", limits.continuous);
  require(cool || positive(limits.heating), "the heating time [s]", limits.heating);
  if (limits.tank.use != TankUse::kOff) {
    const ArmDissipation& arm = limits.tank.arm;
    require(positive(arm.viscous), "the viscous friction for the tank [N s/m]", arm.viscous);
    require(positive(limits.tank.soft), "the stiffness of the tank's spring [N/m]",
            limits.tank.soft);
    const std::pair<const char*, double> numbers[] = {
        {"the tank's Coulomb friction [N]", arm.coulomb},
        {"the tank's encoder step [m]", arm.step},
        {"the tank's delay [s]", arm.delay},
        {"the delay's uncertainty [s]", arm.doubt},
        {"the positions' jitter [s]", arm.jitter},
        {"the amplifiers' lag [s]", arm.lag},
        {"the tank's longest period [s]", arm.period},
        {"the tank's refill [W]", limits.tank.refill}};
    for (const auto& [what, x] : numbers) require(noLess(x), what, x, "give zero or more");
    require(arm.doubt <= arm.delay, "the delay's uncertainty [s]", arm.doubt,
            "give at most the delay, because no force comes before its reading");
    require(arm.jitter <= arm.doubt, "the positions' jitter [s]", arm.jitter,
            "give at most the delay's uncertainty, which includes the jitter");
    const double most = static_cast<double>(Tank::kForces - 2) / (arm.delay + arm.doubt);
    if (rate >= most) {
      throw DeviceError(info.name,
                        "at " + std::to_string(std::lround(rate)) +
                            " Hz the energy tank cannot store all forces that are still delayed",
                        "use less than " + std::to_string(std::lround(most)) + " Hz");
    }
    require(arm.period == 0.0 || arm.period * rate >= 1.0, "the longest time between ticks [s]",
            arm.period, "give at least 1/rate, or 0 for the default");
  }
  return limits;
}

void checkCoupling(const DeviceInfo& info, const Scene* scene) {
  if (scene == nullptr) return;
  double stiffness = scene->coupling.stiffness;
  if (const auto& factors = scene->graph.stiffness.factors; !factors.empty()) {
    stiffness = 1.0;  // Scene::coupling has the lowest value of a varying stiffness
    for (const Transfer::Factor& factor : factors) stiffness *= factor.curve.highest();
  }
  constexpr double kRounding = 1.0 + 1e-9;
  const auto check = [&](const char* what, double value, const char* unit, double most) {
    if (value <= most * kRounding) return;
    throw DeviceError(info.name,
                      "the scene's " + std::string(what) + ", " + shortly(value, unit) +
                          ", is more than the device renders stably",
                      "use at most " + shortly(most, unit));
  };
  check("coupling stiffness", stiffness, "N/m", info.max_stiffness);
  check("coupling damping", scene->coupling.damping, "N s/m", info.max_damping);
}

HapticLoop::HapticLoop(Device& device, double rate, TickSink* sink, double heartbeat,
                       const LoopWatch& watch)
    : device_(device),
      sink_(sink),
      late_(std::max(device.info().watch.late, 3.0 / rate)),
      heartbeat_(heartbeat),
      watch_by_(watch),
      watch_(device.info().watch),
      hand_(limitsInLoop(device.info(), rate)) {
  require(device.info(), noLess(heartbeat), "the heartbeat [s]", heartbeat,
          "give seconds, or 0 for no limit");
}

void HapticLoop::publish(std::shared_ptr<const Scene> scene) noexcept {
  scenes_.draft() = std::move(scene);
  scenes_.publish();
  // The draft contains a scene that the haptic thread has never used, or no longer uses.
  scenes_.draft().reset();
}

double LoopWatch::patience() const noexcept {
  const bool soon = punctual != nullptr && punctual->load(std::memory_order_relaxed);
  return soon ? kUnguardedTime : kUnguardedUsual;
}

void HapticLoop::reengageAfter(double seconds) {
  constexpr double kLongest = 60.0;
  require(device_.info(), noLess(seconds) && seconds <= kLongest, "the time to reengage [s]",
          seconds, "give 0 to 60 s");
  reengagement_ = Reengagement(seconds);
}

Fault HapticLoop::ordered() noexcept {
  const auto count = [](const std::atomic<std::uint32_t>* of, std::uint32_t seen) {
    return of != nullptr ? of->load(std::memory_order_relaxed) : seen;
  };
  if (stop_.load(std::memory_order_relaxed) || count(watch_by_.stops, stops_seen_) != stops_seen_) {
    return Fault::kStopped;
  }
  const std::uint32_t cuts = count(watch_by_.cuts, cuts_seen_);
  return std::exchange(cuts_seen_, cuts) != cuts ? Fault::kLate : Fault::kNone;
}

Fault HapticLoop::whatIsWrong(HandState& hand, const TickTime& time) noexcept {
  if (const Fault order = ordered(); order != Fault::kNone) return order;
  if (time.late > late_) {
    // The cause may have delayed the guardian as well, so its pause counts from now.
    guard_.since = time.now;
    return Fault::kLate;
  }
  if (heartbeat_ > 0.0 &&
      beat_.still(beats_.load(std::memory_order_relaxed), time.now) > heartbeat_) {
    return Fault::kHeartbeat;
  }
  if (watch_by_.guard != nullptr && guard_.still(watch_by_.guard->load(std::memory_order_relaxed),
                                                 time.now) > watch_by_.patience()) {
    return Fault::kUnguarded;
  }
  const Scene* scene = scenes_.current().get();
  if (scene != nullptr && dataLost(scene->graph)) return Fault::kVolume;
  // A recorded path may jump, because the force moves no arm.
  if (!device_.info().hand) return hand.fault;
  Fault wrong = watch_.look(hand, time.now);
  // Homing may change the position. After a tick without force, a jump only begins a new path.
  if (wrong == Fault::kJump && !hand_.mayPull()) {
    jumped_ = true;
    watch_.forget();
    wrong = watch_.look(hand, time.now);
  }
  return hand.ready ? wrong : hand.fault;
}

Fault HapticLoop::withheld(double took, const TickTime& time) noexcept {
  // If the tick took too long, as in a stopped process, the guardian may have removed the force.
  if (!device_.info().hand) return Fault::kNone;
  return time.real && took > late_ ? Fault::kLate : ordered();
}

void HapticLoop::tick(const TickTime& time) noexcept {
  const ScopedFloatMode plain;
  scenes_.refresh();
  const Scene* scene = scenes_.current().get();
  TickInput& in = told_.input;
  const Fault wrong = whyNotBack(in, deaf_, std::exchange(jumped_, false));
  in = {};
  in.dt = time.dt;
  if (clock_ != nullptr) {
    in.play = clock_->next(head_, time.dt);
    in.play_rate = head_.rate;
  }
  if (clear_.exchange(false, std::memory_order_acquire)) {
    stops_seen_ = stops_cleared_;
    cuts_seen_ = cuts_cleared_;
    watch_.forget();
    deaf_ = false;
    in.cleared = true;
  }
  if (reengagement_.look(hand_.state().fault(), wrong, time.now)) {
    watch_.forget();
    in.cleared = true;
  }

  const auto begin = std::chrono::steady_clock::now();
  HandState& hand = in.hand;
  hand = device_.read();
  deaf_ = deaf_ || hand.fault == Fault::kWrite || hand.fault == Fault::kGone ||
          hand.fault == Fault::kMiscounted;
  in.wrong = whatIsWrong(hand, time);
  const bool linked = links_ != nullptr && scene != nullptr && hand.ready &&
                      in.wrong == Fault::kNone && !hand_.state().faulted();
  if (linked) {
    // A proxy that is not yet placed begins at the hand.
    const Vec3& proxy = told_.tick > 0 && hand_.mayPull() ? hand_.state().proxy() : hand.position;
    in.pull = links_->pull(proxy, hand, time.dt);
  } else if (links_ != nullptr) {
    links_->rest(hand);
  }

  const auto start = std::chrono::steady_clock::now();
  told_.report = hand_.step(scene, in);
  const auto end = std::chrono::steady_clock::now();
  if (warmup_) warmup_->look(hand, told_.report);
  in.order = withheld(std::chrono::duration<double>(end - begin).count(), time);
  hand_.withhold(in, told_.report);
  send(told_.report.force, time.real, in);
  hand_.sent(in);
  if (linked) {
    // After a failed write the acting force is unknown. A share of 0 states this.
    const double left = in.unsent == Fault::kNone ? in.given * told_.report.left : 0.0;
    links_->pulled(left, hand, hand_.state().proxy(), told_.report.force);
  }

  ++told_.tick;
  told_.time = time.now;
  told_.probe = hand.position;
  told_.tick_ns = std::chrono::nanoseconds(end - start).count();
  told_.wake_ns = time.wake_ns;
  told_.missed = time.missed;
  told_.late_ticks += time.missed ? 1 : 0;
  told_.fault = hand_.state().fault();
  told_.scene = scene == nullptr ? 0 : scene->id;
  telemetry_.draft() = told_;
  telemetry_.publish();
  if (sink_ != nullptr) sink_->take(told_, hand_.state());
}

bool HapticLoop::warmUp(double dt, double lead) noexcept {
  const ScopedFloatMode as_in_a_tick;
  const Scene* scene = scenes_.current().get();
  const bool soon_enough = 4e-9 * static_cast<double>(told_.tick_ns) <= lead;
  return warmup_ && scene != nullptr && soon_enough && warmup_->run(*scene, hand_.state(), dt);
}

void HapticLoop::send(const Vec3& force, bool timed, TickInput& in) noexcept {
  const auto start = std::chrono::steady_clock::now();
  device_.carry(hand_.mayPull());
  device_.write(force);
  const std::chrono::duration<double> took = std::chrono::steady_clock::now() - start;
  in.given = device_.given();
  if (timed && device_.info().hand && took.count() > kWriteTime) {
    in.unsent = Fault::kWrite;
    deaf_ = true;
  }
  // If the loop stops `heart`, the guardian cuts the force through its own descriptor.
  if (watch_by_.heart != nullptr && !deaf_) {
    watch_by_.heart->fetch_add(1, std::memory_order_release);
  }
}

void HapticLoop::end() noexcept {
  device_.carry(false);
  device_.write(Vec3::Zero());
}

}  // namespace palpate
