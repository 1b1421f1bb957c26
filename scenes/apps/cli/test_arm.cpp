#include "palpate/scenes/apps/cli/test_arm.h"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <optional>
#include <poll.h>
#include <termios.h>
#include <unistd.h>

#include <fmt/format.h>

#include "palpate/devices/arm/guardian.h"
#include "palpate/devices/arm/self_test.h"
#include "palpate/devices/arm/tested_arms.h"
#include "palpate/devices/open_device.h"
#include "palpate/devices/plugins/plugin_process.h"
#include "palpate/devices/simulated/virtual_arm.h"
#include "palpate/engine/error.h"
#include "palpate/engine/loop/haptic_loop.h"
#include "palpate/engine/loop/realtime.h"
#include "palpate/engine/safety/limit_force.h"
#include "palpate/scenes/apps/cli/room.h"

namespace palpate::cli {
namespace {

constexpr double kRate = 1000.0;
constexpr auto kPeriod = static_cast<std::int64_t>(1e9 / kRate);
constexpr double kSlew = 100.0;     // [N/s]: slew of all forces of the test
constexpr double kMostForce = 3.0;  // [N]: largest force of a test
constexpr double kPatience = 5.0;   // [s]: longest wait until the arm is ready

struct Tested {
  ArmAxes axes;
  SelfTestResult result;
  Fault fault = Fault::kNone;
  std::string not_ready;  ///< Why the arm was not ready; empty if the arm was ready.
};

/// Sends zero force until the user presses Enter; ignores keys pressed before. Returns the tip's
/// position [m], or no value after an interrupt. Throws Error at the end of standard input: without
/// a user, the arm must not move.
std::optional<Vec3> atEnter(Arm& arm) {
  (void)tcflush(STDIN_FILENO, TCIFLUSH);
  for (std::int64_t next = nowNs(); interrupted == 0; next += kPeriod) {
    sleepUntil(next);
    const HandState hand = arm.read();
    arm.write(Vec3::Zero());  // some firmware reports only in reply to a force
    pollfd keys{STDIN_FILENO, POLLIN, 0};
    if (poll(&keys, 1, 0) <= 0) continue;
    char key = 0;
    const ssize_t got = ::read(STDIN_FILENO, &key, 1);
    if (got < 0 && (errno == EINTR || errno == EAGAIN)) continue;
    if (got != 1) {
      throw Error("--test", "standard input has ended, and nobody has pressed Enter",
                  "run the test in a terminal, with a user at the arm");
    }
    if (key != '\n') continue;
    const bool old = hand.age > arm.info().watch.stale;
    if (!hand.ready || hand.fault != Fault::kNone || old || !hand.position.allFinite()) {
      const bool lost = hand.fault == Fault::kNone && !hand.position.allFinite();
      const Fault fault = old ? Fault::kStale : lost ? Fault::kNotFinite : hand.fault;
      complain("devices: the arm is not ready: " +
               (fault == Fault::kNone ? arm.whyNotReady()
                                      : wordsFor(fault) + std::string(": ") + remedyFor(fault)) +
               ": then press Enter again");
      continue;
    }
    return hand.position;
  }
  return std::nullopt;
}

struct Ruled {
  /// Measured distance divided by the ruler's length, for each axis.
  std::array<double, 3> scale{};
  std::string trouble;  ///< First error reported by rulerTrouble.
};

/// Lets the user move the tip by a ruler's length along each movable axis. Each move starts at the
/// end of the previous move. Returns no value if the length is 0, or after an interrupt.
std::optional<Ruled> measureWays(Arm& arm, double ruler) {
  if (ruler == 0.0) {
    complain("devices: hold the tip at the centre of its workspace, and press Enter");
    (void)atEnter(arm);
    return std::nullopt;
  }
  const ArmAxes axes = axesWithin(arm.traits().moves);
  Ruled ruled;
  std::string ways;
  for (int a = 0; a < 3; ++a) {
    if (axes.has[static_cast<std::size_t>(a)]) ways += (ways.empty() ? "+" : ", +") + axes.name(a);
  }
  complain(
      fmt::format("devices: hold the tip still at a place with {} m of free path along {} (the "
                  "profile's mount, or the plug-in, defines these directions), and press Enter",
                  ruler, ways));
  std::optional<Vec3> from = atEnter(arm);
  for (int a = 0; a < 3 && from; ++a) {
    if (!axes.has[static_cast<std::size_t>(a)]) continue;
    complain(fmt::format(
        "devices: now move the tip {} m along a ruler in direction +{}, then press Enter", ruler,
        axes.name(a)));
    const std::optional<Vec3> to = atEnter(arm);
    if (!to) return std::nullopt;
    ruled.scale[static_cast<std::size_t>(a)] = (*to - *from).norm() / ruler;
    ruled.trouble = rulerTrouble(*to - *from, ruler, axes, a);
    if (!ruled.trouble.empty()) return ruled;
    from = to;
  }
  if (!from) return std::nullopt;
  complain("devices: move the tip to the centre of its workspace, hold it still, and press Enter");
  if (!atEnter(arm)) return std::nullopt;
  return ruled;
}

/// Returns the ruler's length [m]. Three moves of this length in a row fit into the arm's
/// workspace, unless its radius is below about 17 mm.
double rulerFor(const ArmTraits& traits) {
  const double most = 2.0 / std::sqrt(3.0) * traits.workspace_radius;
  return most >= 0.1 ? 0.1 : most >= 0.05 ? 0.05 : 0.02;
}

/// Observes the guardian: look() returns the guardian's fault, or kNone while the loop may
/// continue.
class GuardianSays {
 public:
  explicit GuardianSays(const LoopWatch& watch)
      : watch_(watch), cuts_(of(watch.cuts)), stops_(of(watch.stops)) {}
  [[nodiscard]] Fault look(double now) noexcept {
    if (of(watch_.stops) != stops_) return Fault::kStopped;
    if (of(watch_.cuts) != cuts_) return Fault::kLate;
    const bool still =
        watch_.guard != nullptr && guard_.still(watch_.guard->load(), now) > watch_.patience();
    return still ? Fault::kUnguarded : Fault::kNone;
  }

 private:
  static std::uint32_t of(const std::atomic<std::uint32_t>* count) noexcept {
    return count != nullptr ? count->load() : 0;
  }
  LoopWatch watch_;
  std::uint32_t cuts_, stops_;
  Pulse guard_;
};

/// Runs the test with force limiter and guardian, in real time or in the time of a simulated arm.
Tested run(Arm& arm, Guardian& guardian, double force, bool simulated) {
  LoopWatch watch;
  if (const ZeroForce zero = arm.zeroForce(); zero.descriptor >= 0) watch = guardian.watch(zero);
  const StayAwake awake(!simulated);
  if (!simulated) (void)becomeRealtime({}, awake);
  SelfTestParams params;
  params.axes = axesWithin(arm.read().drives);
  params.down = arm.traits().down_W;
  params.force = force;
  params.input_rate = arm.traits().input_rate;
  params.stale = arm.info().watch.stale;
  SelfTest test(params);
  GuardianSays guardian_says(watch);
  ForceLimits limits = arm.info().limits;
  limits.peak = std::min(limits.peak, force);
  limits.slew = std::min(limits.slew, kSlew);
  LimiterState limiter;
  HandWatch hand_watch(arm.info().watch);
  Tested out;
  out.axes = params.axes;
  const std::int64_t begin = nowNs();
  std::int64_t last = begin - kPeriod;
  for (std::int64_t i = 0; !test.done() && interrupted == 0; ++i) {
    const std::int64_t due = begin + i * kPeriod;
    if (!simulated) sleepUntil(due);
    const std::int64_t now = simulated ? due : nowNs();
    const double t = 1e-9 * static_cast<double>(now - begin);
    const double dt = 1e-9 * static_cast<double>(now - last);
    last = now;
    if (dt > 2.0 / kRate) i = (now - begin) / kPeriod;
    HandState hand = arm.read();
    out.fault = hand_watch.look(hand, t);
    if (dt > arm.info().watch.late) out.fault = Fault::kLate;
    if (const Fault said = guardian_says.look(t); said != Fault::kNone) out.fault = said;
    if (out.fault != Fault::kNone) break;
    // Waits until the arm is ready, at most kPatience.
    arm.carry(hand.ready);
    if (!hand.ready) {
      arm.write(Vec3::Zero());
      if (test.begun() || t > kPatience) {
        out.not_ready = arm.whyNotReady();
        break;
      }
      if (watch.heart != nullptr) watch.heart->fetch_add(1);
      hand_watch.forget();
      continue;
    }
    const Vec3 wanted = test.next(hand, t, limiter.sent);
    arm.write(limitForce(wanted, hand.position, dt, limits, limiter).force);
    if (watch.heart != nullptr) watch.heart->fetch_add(1);
  }
  arm.carry(false);
  arm.write(Vec3::Zero());
  // Without forget(), the guardian could overwrite the profile's final output.
  if (watch.heart != nullptr) guardian.forget(watch);
  out.result = test.result();
  return out;
}

/// Returns the stability margin of the measured arm with the largest stiffness that the arm allows;
/// null if the friction of a driven axis was not measured.
OrderedJson roomOf(const SelfTestResult& result, const Arm& arm) {
  DeviceInfo info = arm.info();
  ArmDissipation& known = info.limits.tank.arm;
  known = {};
  bool first = true;
  for (const AxisResult& axis : result.axes) {
    if (!axis.driven) continue;
    if (!axis.fitted) return nullptr;
    const auto least = [&](double& value, double another) {
      value = first ? std::max(0.0, another) : std::min(value, std::max(0.0, another));
    };
    least(info.mass, axis.mass);
    least(known.viscous, axis.viscous);
    least(known.coulomb, axis.coulomb);
    known.delay = std::max(known.delay, axis.delay);
    first = false;
  }
  for (const double step : arm.steps()) known.step += step;
  info.max_stiffness = arm.traits().stiffness;  // an untested arm has a lower limit
  return roomFor(info, kRate, {arm.traits().stiffness, 0.0});
}

OrderedJson describe(const Tested& tested, const Arm& arm, bool passed) {
  const SelfTestResult& r = tested.result;
  OrderedJson json;
  json["device"] = arm.info().name;
  json["passed"] = passed;
  json["problems"] = r.problems;
  json["fault"] = wordFor(tested.fault);
  json["not_ready"] = tested.not_ready;
  json["scale"] = OrderedJson::array();
  for (const double scale : r.scale) {
    json["scale"].push_back(scale > 0.0 ? OrderedJson(scale) : OrderedJson());
  }
  json["input_rate"] = r.seconds > 0.0 ? static_cast<double>(r.positions) / r.seconds : 0.0;
  json["longest_pause"] = r.slowest;
  json["reports_dropped"] = arm.traffic().dropped;
  json["writes"] = arm.traffic().writes;
  json["longest_write"] = 1e-9 * static_cast<double>(arm.traffic().longest_ns);
  json["noise"] = r.noise;
  json["falls"] = r.weight > 0.0 ? toJson(r.falls) : OrderedJson();
  json["weight"] = r.weight > 0.0 ? OrderedJson(r.weight) : OrderedJson();
  json["resolution"] = arm.steps();
  json["room"] = roomOf(r, arm);
  json["axes"] = OrderedJson::array();
  for (const AxisResult& axis : r.axes) {
    OrderedJson one;
    one["driven"] = axis.driven;
    one["pushed"] = axis.pushed;
    one["moved"] = axis.moved;
    one["breakaway"] = axis.breakaway;
    one["along"] = axis.along;
    const auto number = [&](double value) {
      return axis.fitted ? OrderedJson(value) : OrderedJson();
    };
    one["viscous"] = number(axis.viscous);
    one["viscous_error"] = number(axis.viscous_error);
    one["coulomb"] = number(axis.coulomb);
    one["coulomb_error"] = number(axis.coulomb_error);
    one["mass"] = number(axis.mass);
    one["bias"] = number(axis.bias);
    one["delay"] = number(axis.delay);
    one["delay_error"] = number(axis.delay_error);
    json["axes"].push_back(one);
  }
  return json;
}

void sayMeasured(const Tested& tested, const Arm& arm) {
  const SelfTestResult& r = tested.result;
  const ArmAxes moves = axesWithin(arm.traits().moves);
  say("input      {} positions a second, longest pause {} ms, {} reports dropped\n",
      rounded(static_cast<double>(r.positions) / std::max(r.seconds, 1e-9)),
      rounded(1e3 * r.slowest), arm.traffic().dropped);
  say("output     {} writes, longest write {} ms\n", arm.traffic().writes,
      rounded(1e-6 * static_cast<double>(arm.traffic().longest_ns)));
  const std::vector<double> steps = arm.steps();
  say("position   resolution ");
  if (steps.empty()) say("not reported");
  for (const double& step : steps) {
    say("{}{}", &step == &steps[0] ? "" : ", ", rounded(1e6 * step));
  }
  say("{}, noise {} um rms at rest\n", steps.empty() ? "" : " um a count", rounded(1e6 * r.noise));
  for (std::size_t a = 0; a < 3; ++a) {
    if (r.scale[a] == 0.0) continue;
    say("ruler      1 m along {} is reported as {} m\n", moves.name(static_cast<int>(a)),
        rounded(r.scale[a]));
  }
  for (std::size_t a = 0; a < 3; ++a) {
    const AxisResult& axis = r.axes[a];
    const std::string name = tested.axes.name(static_cast<int>(a));
    if (!axis.fitted) {
      say("{:<10} {}\n", name, axis.driven ? "not measured" : kNoMotor);
      continue;
    }
    say("{:<10} moves along the force (cosine {}); breakaway {} N; friction {} +- {} N and {} +- "
        "{} N s/m; mass {} kg; bias {} N; force delay {} +- {} ms\n",
        name, rounded(axis.along), rounded(axis.breakaway), rounded(axis.coulomb),
        rounded(axis.coulomb_error), rounded(axis.viscous), rounded(axis.viscous_error),
        rounded(axis.mass), rounded(axis.bias), rounded(1e3 * axis.delay),
        rounded(1e3 * axis.delay_error));
  }
}

void complainOf(const Tested& tested) {
  if (tested.fault == Fault::kNone && tested.not_ready.empty()) {
    for (const std::string& problem : tested.result.problems) complain("devices: " + problem);
  }
  if (tested.fault != Fault::kNone) {
    complain(fmt::format("devices: the test ended early: {}: {}", wordsFor(tested.fault),
                         remedyFor(tested.fault)));
  }
  if (!tested.not_ready.empty()) {
    complain("devices: the test ended early: the arm is not ready: " + tested.not_ready);
  }
}

/// Deletes the record of an earlier test of an arm that has not passed, and prints the arm's
/// limits.
void notPassed(const ArmIdentity& identity) {
  forgetTest(identity);
  complain(
      fmt::format("devices: the arm has not passed: palpate limits it to at most {} N and {} N/m "
                  "until it passes",
                  kUntestedForce, kUntestedStiffness));
}

/// Stores that an arm has passed, if its scale was measured and its identity is known.
void remember(const ArmIdentity& identity, const SelfTestResult& r, bool ruled, bool json) {
  if (!ruled) {
    complain(fmt::format(
        "devices: the arm has passed, but the test is not saved, because the scale was not "
        "measured; an untested arm stays limited to at most {} N and {} N/m: repeat the "
        "test with a ruler",
        kUntestedForce, kUntestedStiffness));
    return;
  }
  if (identity.own.empty()) {
    complain(
        fmt::format("devices: the arm has passed, but has neither a serial number nor a port to "
                    "identify it: the arm stays limited to at most {} N and {} N/m",
                    kUntestedForce, kUntestedStiffness));
    return;
  }
  rememberTest(identity, r);
  if (!identity.numbered) {
    complain(
        "devices: the arm has no serial number and is identified by its port, " + identity.own +
        ": if you move it to another port, or connect another arm to this port, repeat the test");
  }
  if (!json) say("passed     saved in {}\n", testedArmsFile().string());
}

}  // namespace

OrderedJson axisNames(const ArmAxes& axes) {
  OrderedJson names = OrderedJson::array();
  for (int a = 0; a < 3; ++a) {
    if (axes.has[static_cast<std::size_t>(a)]) names.push_back(axes.name(a));
  }
  return names;
}

int testArm(const DevicesOptions& options) {
  if (!(options.force > 0.0 && options.force <= kMostForce)) {
    throw Error("--force",
                fmt::format("{} N is not above 0 and at most {} N", options.force, kMostForce),
                "use 0.5");
  }
  if (const double r = options.ruler.value_or(0.0); r != 0.0 && !(r >= 0.02 && r <= 0.5)) {
    throw Error("--ruler", fmt::format("{} m is not in 0.02 to 0.5 m", r),
                "use 0.1, or 0 to skip the measurement");
  }
  Guardian guardian;
  guardian.catchSignals(&interrupted);
  ArmHost host;
  host.say = [](const std::string& words) { complain("devices: " + words); };
  host.stop = [] { return interrupted != 0; };
  host.stuck = [] { endWithoutFiles(kEndedEarly); };
  host.tests = true;
  // The test moves the arm by a few centimetres, after the program has asked the user to let go of
  // the arm.
  host.carries = kMostForce;
  const auto [arm, identity] = options.virtual_arm ? OpenedArm{makeVirtualArm(), ArmIdentity{}}
                                                   : openAnyArm(options.test, host);
  if (!arm->traits().drives) {
    throw Error("--test", arm->info().name + " gives no force", "name an arm that gives force");
  }
  const std::optional<Ruled> ruled =
      options.virtual_arm ? std::nullopt
                          : measureWays(*arm, options.ruler.value_or(rulerFor(arm->traits())));
  if (interrupted != 0) return kInterrupted;
  if (ruled && !ruled->trouble.empty()) {
    complain("devices: " + ruled->trouble);
    notPassed(identity);
    return kEndedEarly;
  }
  const double force = std::min(options.force, arm->info().limits.peak);
  if (force < options.force) {
    complain(fmt::format("devices: the test force is limited to {} N, {}", force,
                         isTested(identity) || force < kUntestedForce
                             ? "the largest force of the arm"
                             : "because the arm has not passed a test yet"));
  }
  if (options.virtual_arm) {
    if (!options.json) say("arm        simulated, in simulated time; nobody holds it\n");
  } else {
    complain(
        fmt::format("devices: let go of the arm within a second{}: the test pushes it with at most "
                    "{} N by a few centimetres for about 25 s; Ctrl-C ends the test",
                    arm->traits().carries ? " (its motors carry its weight)" : "", force));
  }
  Tested tested = run(*arm, guardian, force, options.virtual_arm);
  if (ruled) tested.result.scale = ruled->scale;
  const bool passed = tested.fault == Fault::kNone && tested.not_ready.empty() &&
                      tested.result.problems.empty() && interrupted == 0;
  const SelfTestResult& r = tested.result;
  if (options.json) {
    sayJson(describe(tested, *arm, passed));
  } else {
    sayMeasured(tested, *arm);
  }
  if (!options.json) sayRoom(roomOf(r, *arm), 11, options.verbose);
  complainOf(tested);
  if (interrupted != 0) return kInterrupted;
  if (options.virtual_arm) {
    if (passed && !options.json) say("passed     a real arm that passes is saved as tested\n");
    return passed ? kDone : kEndedEarly;
  }
  if (!passed) {
    notPassed(identity);
    return kEndedEarly;
  }
  remember(identity, r, ruled.has_value(), options.json);
  return kDone;
}

}  // namespace palpate::cli
