/// palpate devices: what is plugged in, what it may be asked for, and whether that is true.
#include <algorithm>
#include <atomic>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <poll.h>
#include <termios.h>
#include <unistd.h>

#include <fmt/format.h>

#include "palpate/devices/arm_watch.h"
#include "palpate/devices/guardian.h"
#include "palpate/devices/open_arm.h"
#include "palpate/devices/open_device.h"
#include "palpate/devices/plugin_process.h"
#include "palpate/devices/profile_facts.h"
#include "palpate/devices/self_test.h"
#include "palpate/devices/tested_arms.h"
#include "palpate/engine/error.h"
#include "palpate/engine/haptic_loop.h"
#include "palpate/engine/limit_force.h"
#include "palpate/engine/realtime.h"
#include "palpate/scenes/cli/common.h"
#include "palpate/scenes/cli/room.h"

namespace palpate::cli {
namespace {

constexpr double kRate = 1000.0;
constexpr auto kPeriod = static_cast<std::int64_t>(1e9 / kRate);
constexpr double kSlew = 100.0;     // [N/s]: nothing of a test is sudden
constexpr double kMostForce = 3.0;  // [N]
constexpr double kPatience = 5.0;   // [s] for the arm to be ready
constexpr const char* kNoMotor = "it has no motor there, and gives no force";
// A Teensy that waits for its program.
constexpr std::uint16_t kTeensyMaker = 0x16C0;
constexpr std::uint16_t kTeensyBoot = 0x0478;

struct DevicesOptions {
  std::string profile;
  std::string test;
  std::string watch;
  double seconds = 0.0;
  double force = 0.5;
  std::optional<double> ruler;
  bool verbose = false;
  bool json = false;
};

OrderedJson limitsOf(const HidProfile& profile) {
  const HidLimits& l = profile.limits;
  OrderedJson json;
  json["force"] = profile.output ? OrderedJson(l.force) : OrderedJson();
  json["stiffness"] = profile.output ? OrderedJson(l.stiffness) : OrderedJson();
  json["damping"] = profile.output ? OrderedJson(l.damping) : OrderedJson();
  json["slew"] = l.slew;
  json["workspace_radius"] = l.workspace_radius;
  json["input_rate"] = profile.input_rate;
  json["output_rate"] = profile.output_rate;
  return json;
}

/// Why it cannot be felt as it is, with a remedy; empty: it can.
std::string trouble(const FoundArm& arm) {
  if (!arm.may_open) {
    return fmt::format(
        "you may not open it: put SUBSYSTEM==\"hidraw\", KERNEL==\"hidraw*\", "
        "ATTRS{{idVendor}}==\"{:04x}\", ATTRS{{idProduct}}==\"{:04x}\", TAG+=\"uaccess\" in "
        "/etc/udev/rules.d/70-palpate-arms.rules, then udevadm control --reload, and plug it in "
        "again",
        arm.device.vendor, arm.device.product);
  }
  if (const auto others = whoHas(arm.device.path); !others.empty()) {
    return "another program has it: " + others[0] + ": end that first";
  }
  if (arm.profiles.size() > 1) {
    std::string names;
    for (const HidProfile& p : arm.profiles) names += (names.empty() ? "" : ", ") + p.name;
    return "its numbers fit several profiles: name one of " + names;
  }
  return {};
}

/// Those that are there.
OrderedJson namesOf(const ArmAxes& axes) {
  OrderedJson names = OrderedJson::array();
  for (int a = 0; a < 3; ++a) {
    if (axes.has[static_cast<std::size_t>(a)]) names.push_back(axes.name(a));
  }
  return names;
}

OrderedJson factsIn(const HidProfile& profile) {
  const ProfileFacts facts = factsOf(profile);
  OrderedJson json;
  json["home"] = {facts.home_W.x(), facts.home_W.y(), facts.home_W.z()};
  json["step"] = facts.step;
  json["carries"] = toJson(facts.carried_W);
  json["moves"] = namesOf(axesWithin(facts.moves));
  json["drives"] = namesOf(axesWithin(facts.drives));
  json["motors"] = OrderedJson::array();
  for (const MotorFact& motor : facts.motors) {
    json["motors"].push_back({{"field", motor.field},
                              {"asked", motor.asked},
                              {"most", motor.room},
                              {"continuous", motor.continuous},
                              {"carries", motor.carries}});
  }
  return json;
}

/// What was understood of one profile: a name, or a file.
int show(const DevicesOptions& options) {
  const std::optional<ArmName> parsed = parseArmName(options.profile);
  if (parsed && parsed->profile.empty()) {
    throw Error(options.profile, "it names no profile", "palpate devices lists them");
  }
  const HidProfile profile = namedProfile(parsed ? *parsed : ArmName{options.profile, ""},
                                          [](const std::string& note) { complain(note); });
  if (options.json) {
    OrderedJson out;
    out["name"] = profile.name;
    out["file"] = profile.source;
    out["firmware"] = profile.firmware;
    out["limits"] = limitsOf(profile);
    out["facts"] = factsIn(profile);
    sayJson(out);
    return kDone;
  }
  const ProfileFacts facts = factsOf(profile);
  say("{}: {} ({})\n", profile.name, sentence(profile.description), sentence(profile.source));
  say("  joints at home: the tip is at ({}, {}, {}) m in the hand's world\n",
      rounded(facts.home_W.x()), rounded(facts.home_W.y()), rounded(facts.home_W.z()));
  if (facts.step > 0.0 && profile.rate_control == 0.0) {
    say("  in the middle a count of every joint moves the tip by {} mm at most\n",
        rounded(1e3 * facts.step));
  }
  const ArmAxes moves = axesWithin(facts.moves);
  const ArmAxes drives = axesWithin(facts.drives);
  for (int a = 0; a < 3 && profile.output; ++a) {
    if (!moves.has[static_cast<std::size_t>(a)]) {
      say("  {}: it does not move there, and gives no force\n", moves.name(a));
    } else if (!drives.has[static_cast<std::size_t>(a)]) {
      say("  {}: {}\n", drives.name(a), kNoMotor);
    }
  }
  for (const MotorFact& motor : facts.motors) {
    const Legible ever = motor.continuous < motor.room
                             ? words(", {} for ever", rounded(motor.continuous))
                             : words("");
    say("  {} N in the middle ask at most {} of {}, which gives at most {}{}{}\n",
        rounded(profile.limits.force), rounded(motor.asked), motor.field, rounded(motor.room), ever,
        motor.asked > motor.continuous ? ": there it is weakened" : "");
  }
  if (!profile.masses.empty()) {
    say("  in the middle its motors carry {} N of its weight at the tip, ({}, {}, {})",
        rounded(facts.carried_W.norm()), rounded(facts.carried_W.x()), rounded(facts.carried_W.y()),
        rounded(facts.carried_W.z()));
    for (const MotorFact& motor : facts.motors) {
      say(", by {} of {}", rounded(motor.carries), motor.field);
    }
    say("\n");
  }
  if (profile.output) {
    say("  {} N, {} N/m, {} N s/m, {} m about its middle\n", rounded(profile.limits.force),
        rounded(profile.limits.stiffness), rounded(profile.limits.damping),
        rounded(profile.limits.workspace_radius));
    say("  firmware: {}\n", sentence(profile.firmware));
  }
  return kDone;
}

/// The name and the limits of a plug-in's arm, as openAnyArm has them.
struct NamedPluginArm {
  std::string name;
  std::optional<DeviceInfo> info;  ///< As once it is tested; none where it cannot be used.
  bool tested = false;
  std::string trouble;
};

NamedPluginArm namedOf(const FoundPlugin& plugin, const FoundPluginArm& arm) {
  NamedPluginArm named;
  const std::string of = "plugin:" + plugin.name;
  named.name = of + (arm.serial.empty() ? "" : "@" + arm.serial);
  named.trouble = arm.trouble;
  if (!arm.facts) return named;
  try {
    named.info = infoFor(*arm.facts, named.name, true);
    named.tested = isTested(identityOf(*arm.facts, arm.carries, of, plugin.version, arm.serial));
  } catch (const Error& error) {
    named.trouble = error.what();
  }
  return named;
}

OrderedJson inJson(const std::vector<FoundPlugin>& plugins) {
  OrderedJson all = OrderedJson::array();
  const auto or_null = [](const std::string& text) {
    return text.empty() ? OrderedJson() : OrderedJson(text);
  };
  for (const FoundPlugin& plugin : plugins) {
    OrderedJson json;
    json["name"] = plugin.name;
    json["file"] = plugin.file.string();
    json["description"] = plugin.what;
    json["version"] = plugin.version;
    json["licence"] = plugin.licence;
    json["trouble"] = or_null(plugin.trouble);
    json["arms"] = OrderedJson::array();
    for (const FoundPluginArm& arm : plugin.arms) {
      const NamedPluginArm named = namedOf(plugin, arm);
      OrderedJson one;
      one["device"] = named.name;
      one["model"] = arm.model;
      one["tested"] = named.tested;
      one["trouble"] = or_null(named.trouble);
      if (named.info) {
        const DeviceInfo& info = *named.info;
        one["limits"] = {{"force", info.limits.peak},
                         {"stiffness", info.max_stiffness},
                         {"damping", info.max_damping},
                         {"slew", info.limits.slew},
                         {"workspace_radius", info.workspace_radius},
                         {"input_rate", arm.facts->rate},
                         {"output_rate", info.output_rate}};
        one["buttons"] = info.handle.buttons;
        one["orientation"] = info.handle.orientation;
        one["gripper"] = info.handle.gripper;
        one["source"] = info.source;
      }
      json["arms"].push_back(one);
    }
    all.push_back(json);
  }
  return all;
}

void sayPlugins(const std::vector<FoundPlugin>& plugins) {
  for (const FoundPlugin& plugin : plugins) {
    if (!plugin.trouble.empty()) say("{}\n", sentence(plugin.trouble));
    for (const FoundPluginArm& arm : plugin.arms) {
      const NamedPluginArm named = namedOf(plugin, arm);
      say("{}\n  {}, by {} {}\n", named.name, sentence(arm.model), sentence(plugin.what),
          plugin.version);
      if (named.info && named.info->hand) {
        const DeviceInfo& info = *named.info;
        say("  {} N, {} N/m, {} N s/m, {} Hz in, {} Hz out, {} m about its middle\n",
            rounded(info.limits.peak), rounded(info.max_stiffness), rounded(info.max_damping),
            rounded(arm.facts->rate), rounded(info.output_rate), rounded(info.workspace_radius));
        say("    {}\n", sentence(info.source));
        if (!named.tested) {
          say("  untested: held to {} N and {} N/m: palpate devices --test {}\n", kUntestedForce,
              kUntestedStiffness, named.name);
        }
      } else if (named.info) {
        say("  moves the hand, gives no force\n");
      }
      if (!named.trouble.empty()) say("  {}\n", sentence(named.trouble));
    }
  }
}

int list(const DevicesOptions& options) {
  std::vector<std::string> notes;
  const std::vector<HidProfile> profiles = hidProfiles(hidProfileFolder(), notes);
  for (const std::string& note : notes) complain(note);
  const std::vector<FoundArm> arms = findArms(profiles);
  const std::vector<FoundPlugin> plugins = findPlugins();
  std::vector<std::string> others;
  for (const HidDeviceName& device : listHid()) {
    if (device.vendor != kTeensyMaker || device.product != kTeensyBoot) continue;
    others.push_back(device.path + ": a Teensy without a program: load its firmware");
  }
  if (options.json) {
    OrderedJson out;
    out["arms"] = OrderedJson::array();
    for (const FoundArm& arm : arms) {
      for (const HidProfile& profile : arm.profiles) {
        OrderedJson json;
        json["device"] = arm.nameAs(profile);
        json["path"] = arm.device.path;
        json["description"] = profile.description;
        json["firmware"] = profile.firmware;
        json["tested"] = isTested(identityOf(profile, arm.identity()));
        const auto wrong = arm.against(profile);
        const std::string what = wrong ? wrong->what() : trouble(arm);
        json["trouble"] = what.empty() ? OrderedJson() : OrderedJson(what);
        json["limits"] = limitsOf(profile);
        json["sources"] = profile.sources;
        out["arms"].push_back(json);
      }
    }
    out["profiles"] = OrderedJson::array();
    for (const HidProfile& profile : profiles) {
      out["profiles"].push_back({{"name", profile.name},
                                 {"description", profile.description},
                                 {"file", profile.source},
                                 {"limits", limitsOf(profile)},
                                 {"facts", factsIn(profile)},
                                 {"sources", profile.sources}});
    }
    out["plugins"] = inJson(plugins);
    out["notes"] = notes;
    out["known"] = OrderedJson::array();
    for (const KnownArm& arm : knownArms()) {
      out["known"].push_back({{"name", arm.name},
                              {"force", arm.force},
                              {"stiffness", arm.stiffness},
                              {"damping", arm.damping},
                              {"workspace_radius", arm.workspace_radius},
                              {"transport", arm.transport},
                              {"source", arm.source}});
    }
    sayJson(out);
    return kDone;
  }
  const bool none = std::all_of(plugins.begin(), plugins.end(),
                                [](const FoundPlugin& plugin) { return plugin.arms.empty(); });
  if (arms.empty()) {
    say("no arm is plugged in that a profile {}knows\n", none ? "or plug-in " : "");
  }
  sayPlugins(plugins);
  for (const FoundArm& arm : arms) {
    for (const HidProfile& profile : arm.profiles) {
      say("{}\n  {}, {} ({})\n", arm.nameAs(profile), sentence(profile.description),
          arm.device.path, arm.device.product_name);
      if (profile.output) {
        say("  {} N, {} N/m, {} N s/m, {} Hz in, {} Hz out, {} m about its middle\n",
            rounded(profile.limits.force), rounded(profile.limits.stiffness),
            rounded(profile.limits.damping), rounded(profile.input_rate),
            rounded(profile.output_rate), rounded(profile.limits.workspace_radius));
        say("  firmware: {}\n", sentence(profile.firmware));
        if (!isTested(identityOf(profile, arm.identity()))) {
          say("  untested: held to {} N and {} N/m: palpate devices --test {}\n", kUntestedForce,
              kUntestedStiffness, arm.nameAs(profile));
        }
      } else {
        say("  moves the hand, gives no force\n");
      }
      for (const auto& [pointer, source] : profile.sources) {
        say("    {}: {}\n", pointer, sentence(source));
      }
      if (const auto wrong = arm.against(profile)) say("  {}\n", sentence(wrong->what()));
    }
    if (const std::string what = trouble(arm); !what.empty()) say("  {}\n", sentence(what));
  }
  for (const std::string& other : others) say("{}\n", sentence(other));
  say("\nprofiles: ");
  for (const HidProfile& p : profiles) say("{}{}", &p == &profiles[0] ? "" : ", ", p.name);
  say("; your own in {}\nplug-ins: ", hidProfileFolder().string());
  for (const FoundPlugin& p : plugins) say("{}{}", &p == &plugins[0] ? "" : ", ", p.name);
  say("{} (docs/plugins.md)\n\nlimits of known arms, by their sources:\n",
      plugins.empty() ? "none" : "");
  for (const KnownArm& arm : knownArms()) {
    say("  {:24} {:>4} N {:>5} N/m {:>3} N s/m {:>6} m  {} ({})\n", arm.name, rounded(arm.force),
        rounded(arm.stiffness), rounded(arm.damping), rounded(arm.workspace_radius), arm.transport,
        sentence(arm.source));
  }
  return kDone;
}

struct Tested {
  ArmAxes axes;  ///< That it was pushed along.
  SelfTestResult result;
  Fault fault = Fault::kNone;
  std::string not_ready;  ///< Why the arm was not, where it was not.
};

/// Where the tip is when the user presses Enter, no motor driven; nothing: there is nobody to press
/// it. What was pressed before does not count.
std::optional<Vec3> atEnter(Arm& arm) {
  (void)tcflush(STDIN_FILENO, TCIFLUSH);
  for (std::int64_t next = nowNs(); interrupted == 0; next += kPeriod) {
    sleepUntil(next);
    const HandState hand = arm.read();
    arm.write(Vec3::Zero());  // some firmware answers only
    pollfd keys{STDIN_FILENO, POLLIN, 0};
    if (poll(&keys, 1, 0) <= 0) continue;
    char key = 0;
    if (::read(STDIN_FILENO, &key, 1) != 1) return std::nullopt;
    if (key != '\n') continue;
    const bool old = hand.age > arm.info().watch.stale;
    if (!hand.ready || hand.fault != Fault::kNone || old || !hand.position.allFinite()) {
      const Fault fault = old ? Fault::kStale : hand.fault;
      complain("devices: the arm is not ready: " +
               (fault == Fault::kNone ? arm.whyNotReady() : wordsFor(fault)) +
               ": then Enter again");
      continue;
    }
    return hand.position;
  }
  return std::nullopt;
}

/// What the user has measured.
struct Ruled {
  std::array<double, 3> scale{};  ///< SelfTestResult::scale.
  std::string trouble;            ///< rulerTrouble, the first; empty: none.
};

/// Has the user move the tip along each axis that it can be moved along, one way after the other,
/// so that each ends where the next begins; nothing: it was left out.
std::optional<Ruled> measureWays(Arm& arm, double ruler) {
  if (ruler == 0.0) return std::nullopt;
  const ArmAxes axes = axesWithin(arm.traits().moves);
  Ruled ruled;
  std::string ways;
  for (int a = 0; a < 3; ++a) {
    if (axes.has[static_cast<std::size_t>(a)]) ways += (ways.empty() ? "+" : ", +") + axes.name(a);
  }
  complain(fmt::format(
      "devices: hold the tip still where it has {} m of way to {} (the profile's mount says which "
      "way these are) and press Enter",
      ruler, ways));
  std::optional<Vec3> from = atEnter(arm);
  for (int a = 0; a < 3 && from; ++a) {
    if (!axes.has[static_cast<std::size_t>(a)]) continue;
    complain(fmt::format("devices: from there move it along a ruler {} m to +{} and press Enter",
                         ruler, axes.name(a)));
    const std::optional<Vec3> to = atEnter(arm);
    if (!to) return std::nullopt;
    ruled.scale[static_cast<std::size_t>(a)] = (*to - *from).norm() / ruler;
    ruled.trouble = rulerTrouble(*to - *from, ruler, axes, a);
    if (!ruled.trouble.empty()) return ruled;
    from = to;
  }
  if (!from) return std::nullopt;
  complain("devices: bring the tip to the middle, hold it still and press Enter");
  if (!atEnter(arm)) return std::nullopt;
  return ruled;
}

/// Three ways of it fit into the arm's space, one after the other [m].
double rulerFor(const ArmTraits& traits) {
  const double most = 2.0 / std::sqrt(3.0) * traits.workspace_radius;
  return most >= 0.1 ? 0.1 : most >= 0.05 ? 0.05 : 0.02;
}

/// What the guardian says of this loop; the loop goes on while it is nothing.
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

/// The test on time, the gate between, the guardian beside.
Tested run(Arm& arm, Guardian& guardian, double force) {
  LoopWatch watch;
  if (const ZeroForce zero = arm.zeroForce(); zero.descriptor >= 0) watch = guardian.watch(zero);
  const StayAwake awake(true);
  (void)becomeRealtime({}, awake);
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
    sleepUntil(begin + i * kPeriod);
    const std::int64_t now = nowNs();
    const double t = 1e-9 * static_cast<double>(now - begin);
    const double dt = 1e-9 * static_cast<double>(now - last);
    last = now;
    if (dt > 2.0 / kRate) i = (now - begin) / kPeriod;
    HandState hand = arm.read();
    out.fault = hand_watch.look(hand, t);
    if (dt > arm.info().watch.late) out.fault = Fault::kLate;
    if (const Fault said = guardian_says.look(t); said != Fault::kNone) out.fault = said;
    if (out.fault != Fault::kNone) break;
    // Until it has spoken, is homed, is held.
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
  // What the profile has done afterwards is not to be overwritten.
  if (watch.heart != nullptr) guardian.forget(watch);
  out.result = test.result();
  return out;
}

/// What a coupling as stiff as the profile allows has room for on this arm, as it was measured.
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

int test(const DevicesOptions& options) {
  if (!(options.force > 0.0 && options.force <= kMostForce)) {
    throw Error("--force",
                fmt::format("{} N is not above 0 and at most {}", options.force, kMostForce),
                "0.5 suffices for most arms");
  }
  if (const double r = options.ruler.value_or(0.0); r != 0.0 && !(r >= 0.02 && r <= 0.5)) {
    throw Error("--ruler", fmt::format("{} m is not 0.02 to 0.5", r), "use 0.1; 0 leaves it out");
  }
  Guardian guardian;
  guardian.catchSignals(&interrupted);
  ArmHost host;
  host.say = [](const std::string& words) { complain("devices: " + words); };
  host.stop = [] { return interrupted != 0; };
  host.tests = true;
  host.carries = kMostForce;  // in a few centimetres, and the hand has let go of it
  const auto [arm, identity] = openAnyArm(options.test, host);
  if (!arm->traits().drives) {
    throw Error("--test", arm->info().name + " gives no force", "there is nothing to test");
  }
  const std::optional<Ruled> ruled =
      measureWays(*arm, options.ruler.value_or(rulerFor(arm->traits())));
  if (interrupted != 0) return kInterrupted;
  if (ruled && !ruled->trouble.empty()) {
    complain("devices: " + ruled->trouble);
    forgetTest(identity);
    return kEndedEarly;
  }
  const double force = std::min(options.force, arm->info().limits.peak);
  if (force < options.force) {
    complain(fmt::format("devices: an arm that has not passed is pushed with {} N at most", force));
  }
  complain(
      fmt::format("devices: let go of the arm within a second{}: it is pushed with at most {} N, a "
                  "few centimetres, for 25 s; Ctrl-C ends it",
                  arm->traits().carries ? " (its motors carry its weight)" : "", force));
  Tested tested = run(*arm, guardian, force);
  if (ruled) tested.result.scale = ruled->scale;
  const bool passed = tested.fault == Fault::kNone && tested.not_ready.empty() &&
                      tested.result.problems.empty() && interrupted == 0;
  const SelfTestResult& r = tested.result;
  const ArmAxes moves = axesWithin(arm->traits().moves);
  const ArmAxes& drives = tested.axes;
  if (options.json) {
    sayJson(describe(tested, *arm, passed));
  } else {
    say("input      {} positions a second, the longest pause {} ms, {} reports thrown away\n",
        rounded(static_cast<double>(r.positions) / std::max(r.seconds, 1e-9)),
        rounded(1e3 * r.slowest), arm->traffic().dropped);
    say("output     {} writes, the longest {} ms\n", arm->traffic().writes,
        rounded(1e-6 * static_cast<double>(arm->traffic().longest_ns)));
    const std::vector<double> steps = arm->steps();
    say("position   steps of ");
    if (steps.empty()) say("not said how many");
    for (const double& step : steps) {
      say("{}{}", &step == &steps[0] ? "" : ", ", rounded(1e6 * step));
    }
    say(" um a count, trembles by {} um rms at rest\n", rounded(1e6 * r.noise));
    for (std::size_t a = 0; a < 3; ++a) {
      if (r.scale[a] == 0.0) continue;
      say("ruler      what is 1 m to {} is {} m\n", moves.name(static_cast<int>(a)),
          rounded(r.scale[a]));
    }
    for (std::size_t a = 0; a < 3; ++a) {
      const AxisResult& axis = r.axes[a];
      const std::string name = drives.name(static_cast<int>(a));
      if (!axis.fitted) {
        say("{:<10} {}\n", name, axis.driven ? "not measured" : kNoMotor);
        continue;
      }
      say("{:<10} goes where it is pushed (cosine {}); begins to move at {} N; friction "
          "{} +- {} N and {} +- {} N s/m; {} kg; {} N by itself; force {} +- {} ms late\n",
          name, rounded(axis.along), rounded(axis.breakaway), rounded(axis.coulomb),
          rounded(axis.coulomb_error), rounded(axis.viscous), rounded(axis.viscous_error),
          rounded(axis.mass), rounded(axis.bias), rounded(1e3 * axis.delay),
          rounded(1e3 * axis.delay_error));
    }
  }
  if (!options.json) sayRoom(roomOf(r, *arm), 11, options.verbose);
  for (const std::string& problem : r.problems) complain("devices: " + problem);
  if (tested.fault != Fault::kNone) {
    complain(fmt::format("devices: the test was cut off: {}: {}", wordsFor(tested.fault),
                         remedyFor(tested.fault)));
  }
  if (!tested.not_ready.empty()) {
    complain("devices: the test was cut off: the arm is not ready: " + tested.not_ready);
  }
  if (interrupted != 0) return kInterrupted;
  if (!passed) {
    forgetTest(identity);
    return kEndedEarly;
  }
  if (!ruled) {
    complain(
        fmt::format("devices: it has passed, but its scale was not measured: it stays held to {} N "
                    "and {} N/m: run it again with a ruler at hand",
                    kUntestedForce, kUntestedStiffness));
    return kDone;
  }
  if (identity.own.empty()) {
    complain(
        fmt::format("devices: it has passed, but has neither a serial number nor a port to be "
                    "remembered by: it stays held to {} N and {} N/m",
                    kUntestedForce, kUntestedStiffness));
    return kDone;
  }
  rememberTest(identity, r);
  if (!identity.numbered) {
    complain("devices: it has no serial number and is remembered by where it is plugged in, " +
             identity.own +
             ": test it again elsewhere, and every other arm that is plugged in there");
  }
  if (!options.json) say("passed     remembered in {}\n", testedArmsFile().string());
  return kDone;
}

/// Pictures of what an arm says, in place on a terminal.
class Pictures {
 public:
  explicit Pictures(double seconds) : seconds_(seconds), begin_(nowNs()), next_(often()) {
    struct sigaction action {};
    action.sa_handler = [](int signal) { interrupted = signal; };
    sigemptyset(&action.sa_mask);
    for (const int signal : {SIGINT, SIGTERM, SIGHUP}) sigaction(signal, &action, nullptr);
  }
  [[nodiscard]] double since() const { return 1e-9 * static_cast<double>(nowNs() - begin_); }
  [[nodiscard]] bool over() const { return seconds_ > 0.0 && since() >= seconds_; }
  /// True where it is time for the next one.
  [[nodiscard]] bool due() {
    const bool is = since() >= next_;
    if (is) next_ += often();
    return is;
  }
  /// False: nobody sees it.
  [[nodiscard]] bool show(const std::string& text) const {
    if (terminal_) sayRaw("\x1b[H\x1b[J");
    std::istringstream lines(text + "\n");
    for (std::string line; std::getline(lines, line);) say("{}\n", sentence(line));
    return std::fflush(stdout) == 0;
  }

 private:
  [[nodiscard]] double often() const { return terminal_ ? 0.25 : 0.5; }  // [s]
  bool terminal_ = isatty(STDOUT_FILENO) == 1;
  double seconds_;
  std::int64_t begin_;
  double next_;
};

/// One reading in words.
std::string pictureOf(const HandState& hand, const HandleInfo& info, const std::string& not_ready) {
  const Vec3& p = hand.position;
  std::string text =
      fmt::format("tip at ({:.5f}, {:.5f}, {:.5f}) m in the hand's world, {:.3f} s ago\n", p.x(),
                  p.y(), p.z(), hand.age);
  const Handle& handle = hand.handle;
  if (info.velocity) {
    text += fmt::format("velocity {:.3f} m/s\n", Vec3(handle.velocity.data()).norm());
  }
  if (info.orientation) {
    const auto& q = handle.orientation;
    text += fmt::format("held at w, x, y, z = {:.4f}, {:.4f}, {:.4f}, {:.4f}\n", q[0], q[1], q[2],
                        q[3]);
  }
  if (info.gripper) text += fmt::format("gripper {:.4f}\n", handle.gripper);
  for (std::size_t i = 0; i < info.joints; ++i) {
    text += fmt::format("joint {} {:>10.5f}\n", i + 1, handle.joints[i]);
  }
  for (std::size_t i = 0; i < info.buttons.size(); ++i) {
    const bool pressed = (handle.buttons >> i & 1U) != 0;
    text += fmt::format("{}: {}\n", info.buttons[i], pressed ? "pressed" : "not pressed");
  }
  if (hand.fault != Fault::kNone) {
    text += fmt::format("fault: {}: {}\n", wordsFor(hand.fault), remedyFor(hand.fault));
  } else if (!hand.ready) {
    text += "not ready: " + not_ready + "\n";
  }
  return text;
}

/// What a plug-in's arm says; it is opened and made ready, with zero force.
int watchPlugin(const DevicesOptions& options) {
  Pictures pictures(options.seconds);
  ArmHost host;
  host.say = [](const std::string& words) { complain("devices: " + words); };
  host.stop = [] { return interrupted != 0; };
  const std::unique_ptr<Arm> arm = openAnyArm(options.watch, host).device;
  while (interrupted == 0) {
    const HandState hand = arm->read();
    arm->write(Vec3::Zero());
    const bool over = pictures.over();
    if (pictures.due() || over) {
      const std::string head =
          fmt::format("{:.1f} s, {}; zero force\n", pictures.since(), options.watch);
      if (!pictures.show(head + pictureOf(hand, arm->info().handle, arm->whyNotReady()))) {
        return kEndedEarly;
      }
    }
    if (over) return kDone;
    sleepUntil(nowNs() + kPeriod);
  }
  return kInterrupted;
}

/// What an arm says, again and again; nothing is sent, so that another program may drive it
/// meanwhile.
int watch(const DevicesOptions& options) {
  if (parsePluginName(options.watch)) return watchPlugin(options);
  Pictures pictures(options.seconds);
  const bool arm = parseArmName(options.watch).has_value();
  const ChosenArm chosen = findArm(arm ? options.watch : "hid:" + options.watch,
                                   [](const std::string& words) { complain("devices: " + words); });
  const auto wrong = chosen.arm.against(chosen.profile);
  const auto port = openHidToRead(chosen.arm.device.path);
  ArmWatch watch(chosen.profile);
  constexpr std::int64_t kLook = 5000000;  // [ns]: a few reports; the kernel keeps 63
  while (interrupted == 0) {
    const bool gone = watch.take(*port, nowNs()) == Got::kGone;
    const bool over = pictures.over();
    if (pictures.due() || gone || over) {
      std::string text = fmt::format("{:.1f} s, {} on {}; nothing is sent\n", pictures.since(),
                                     chosen.arm.nameAs(chosen.profile), chosen.arm.device.path);
      if (wrong) text += std::string(wrong->what()) + "\n";
      if (chosen.profile.home_at_open) {
        text += "its home pose is how it was first seen: " + chosen.profile.home_words + "\n";
      } else if (!chosen.profile.home.empty()) {
        text += "joints are true if it has been homed since it was switched on\n";
      }
      text += watch.picture(nowNs());
      if (!pictures.show(text)) return kEndedEarly;
    }
    if (gone) {
      complain("devices: it was unplugged: plug it in again, and watch it again");
      return kEndedEarly;
    }
    if (over) return kDone;
    sleepUntil(nowNs() + kLook);
  }
  return kInterrupted;
}

}  // namespace

void addDevices(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand(
      "devices", "What arms are plugged in, their limits and where those come from; tests one");
  auto options = std::make_shared<DevicesOptions>();
  verb->add_option("PROFILE", options->profile,
                   "What a profile's numbers come to: a name, or a file");
  verb->add_option("--test", options->test,
                   "Tests an arm, as hid:polhem: rates, steps, friction, motors' signs");
  CLI::Option* watched = verb->add_option(
      "--watch", options->watch,
      "Shows what an arm says, live: reports, fields, joints, tip, flags; sends nothing");
  verb->add_option("--seconds", options->seconds, "How long to watch [s] (default: till Ctrl-C)")
      ->check(CLI::PositiveNumber)
      ->needs(watched);
  verb->add_option("--force", options->force, "The most that a test may push [N] (default 0.5)");
  verb->add_option("--ruler", options->ruler,
                   "How far you move the tip along each axis so that the test knows its scale [m] "
                   "(default 0.1, of a small arm less; 0: leave it out, and the arm stays held)");
  verb->add_flag("-v,--verbose", options->verbose,
                 "With --test: say as well how a coupling's room is known");
  verb->add_flag("--json", options->json, "Print JSON");
  verb->footer(
      "Example:\n  palpate devices mine.json\n  palpate devices --watch hid:mine\n"
      "  palpate devices --test hid:polhem");
  verb->callback([=, &body] {
    body = [=] {
      if (!options->test.empty() && !options->profile.empty()) {
        throw Error(options->profile, "--test names its own arm", "leave one of them out");
      }
      if (!options->watch.empty()) {
        if (!options->test.empty() || !options->profile.empty() || options->json) {
          throw Error("--watch", "it names its own arm, and writes for eyes",
                      "leave --test, --json and the profile out");
        }
        return watch(*options);
      }
      if (!options->profile.empty()) return show(*options);
      return options->test.empty() ? list(*options) : test(*options);
    };
  });
}

}  // namespace palpate::cli
