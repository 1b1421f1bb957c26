#include "palpate/scenes/apps/cli/devices.h"

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <optional>
#include <poll.h>
#include <termios.h>
#include <unistd.h>

#include <fmt/format.h>

#include "palpate/devices/arm/guardian.h"
#include "palpate/devices/arm/self_test.h"
#include "palpate/devices/arm/tested_arms.h"
#include "palpate/devices/hid/arm_watch.h"
#include "palpate/devices/hid/open_arm.h"
#include "palpate/devices/hid/profile_facts.h"
#include "palpate/devices/open_device.h"
#include "palpate/devices/plugins/plugin_process.h"
#include "palpate/engine/error.h"
#include "palpate/engine/loop/haptic_loop.h"
#include "palpate/engine/loop/realtime.h"
#include "palpate/engine/safety/limit_force.h"
#include "palpate/scenes/apps/cli/test_arm.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {
namespace {

constexpr std::int64_t kPeriod = 1000000;  // [ns]
// USB numbers of a Teensy board that runs its bootloader instead of a firmware.
constexpr std::uint16_t kTeensyMaker = 0x16C0;
constexpr std::uint16_t kTeensyBoot = 0x0478;

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

/// Returns why the arm cannot be used, and a remedy; empty if the arm can be used.
std::string trouble(const FoundArm& arm) {
  if (!arm.may_open) {
    return fmt::format(
        "you have no permission to open the arm: put SUBSYSTEM==\"hidraw\", KERNEL==\"hidraw*\", "
        "ATTRS{{idVendor}}==\"{:04x}\", ATTRS{{idProduct}}==\"{:04x}\", TAG+=\"uaccess\" in "
        "/etc/udev/rules.d/70-palpate-arms.rules, run udevadm control --reload as root, and plug "
        "the arm in again",
        arm.device.vendor, arm.device.product);
  }
  if (const auto others = whoHas(arm.device.path); !others.empty()) {
    return "another program uses the arm: " + others[0] + ": end that program";
  }
  if (arm.profiles.size() > 1) {
    std::string names;
    for (const HidProfile& p : arm.profiles) names += (names.empty() ? "" : ", ") + p.name;
    return "the arm's USB numbers match several profiles: use hid:PROFILE with one of " + names;
  }
  return {};
}

OrderedJson factsIn(const HidProfile& profile) {
  const ProfileFacts facts = factsOf(profile);
  OrderedJson json;
  json["home"] = {facts.home_W.x(), facts.home_W.y(), facts.home_W.z()};
  json["step"] = facts.step;
  json["joint_step"] = facts.joint_step;
  json["carries"] = toJson(facts.carried_W);
  json["moves"] = axisNames(axesWithin(facts.moves));
  json["drives"] = axisNames(axesWithin(facts.drives));
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

int show(const DevicesOptions& options) {
  const std::optional<ArmName> parsed = parseArmName(options.profile);
  if (parsed && parsed->profile.empty()) {
    throw Error(options.profile, "it does not name a profile",
                "run palpate devices to list the profiles");
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
  say("  tip at the home position: ({}, {}, {}) m in the hand's world\n", rounded(facts.home_W.x()),
      rounded(facts.home_W.y()), rounded(facts.home_W.z()));
  if (facts.step > 0.0 && profile.rate_control == 0.0) {
    say("  at the centre, one count of a joint moves the tip by at most {} mm, one of every joint "
        "by at most {} mm\n",
        rounded(1e3 * facts.joint_step), rounded(1e3 * facts.step));
  }
  const ArmAxes moves = axesWithin(facts.moves);
  const ArmAxes drives = axesWithin(facts.drives);
  for (int a = 0; a < 3 && profile.output; ++a) {
    if (!moves.has[static_cast<std::size_t>(a)]) {
      say("  {}: no movement along this axis, and no force\n", moves.name(a));
    } else if (!drives.has[static_cast<std::size_t>(a)]) {
      say("  {}: {}\n", drives.name(a), kNoMotor);
    }
  }
  for (const MotorFact& motor : facts.motors) {
    const Legible ever = motor.continuous < motor.room
                             ? words(", {} continuously", rounded(motor.continuous))
                             : words("");
    say("  a force of {} N at the centre needs up to {} in field {}, whose limit is {}{} (in the "
        "field's unit){}\n",
        rounded(profile.limits.force), rounded(motor.asked), motor.field, rounded(motor.room), ever,
        motor.asked > motor.room         ? ": the force is reduced there"
        : motor.asked > motor.continuous ? ": the force is reduced when the motor is hot"
                                         : "");
  }
  if (!profile.masses.empty()) {
    say("  at the centre the motors carry {} N of the arm's weight at the tip, ({}, {}, {}) N",
        rounded(facts.carried_W.norm()), rounded(facts.carried_W.x()), rounded(facts.carried_W.y()),
        rounded(facts.carried_W.z()));
    for (const MotorFact& motor : facts.motors) {
      say(", {} in field {}", rounded(motor.carries), motor.field);
    }
    say("\n");
  }
  if (profile.output) {
    say("  {} N, {} N/m, {} N s/m, workspace radius {} m\n", rounded(profile.limits.force),
        rounded(profile.limits.stiffness), rounded(profile.limits.damping),
        rounded(profile.limits.workspace_radius));
    say("  firmware: {}\n", sentence(profile.firmware));
  }
  return kDone;
}

/// Name and limits of a plug-in's arm, as openAnyArm would report them.
struct NamedPluginArm {
  std::string name;
  /// Description with the limits; unset if the arm cannot be used.
  std::optional<DeviceInfo> info;
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

struct Listing {
  std::vector<std::string> notes;  ///< Errors in the user's own profiles.
  std::vector<HidProfile> profiles;
  std::vector<FoundArm> arms;
  std::vector<FoundPlugin> plugins;
  std::vector<std::string> others;  ///< Devices that may be arms without firmware.
};

Listing findAll() {
  Listing all;
  all.profiles = hidProfiles(hidProfileFolder(), all.notes);
  for (const std::string& note : all.notes) complain(note);
  all.arms = findArms(all.profiles);
  all.plugins = findPlugins();
  for (const HidDeviceName& device : listHid()) {
    if (device.vendor != kTeensyMaker || device.product != kTeensyBoot) continue;
    all.others.push_back(device.path +
                         ": a Teensy in its bootloader: load its firmware, or plug it in again");
  }
  return all;
}

OrderedJson textOrNull(const std::string& text) {
  return text.empty() ? OrderedJson() : OrderedJson(text);
}

OrderedJson armInJson(const FoundArm& arm, const HidProfile& profile) {
  OrderedJson json;
  json["device"] = arm.nameAs(profile);
  json["path"] = arm.device.path;
  json["description"] = profile.description;
  json["firmware"] = profile.firmware;
  json["tested"] = isTested(identityOf(profile, arm.identity()));
  const auto wrong = arm.against(profile);
  json["trouble"] = textOrNull(wrong ? wrong->what() : trouble(arm));
  json["limits"] = limitsOf(profile);
  json["sources"] = profile.sources;
  return json;
}

OrderedJson profileInJson(const HidProfile& profile) {
  return {{"name", profile.name},      {"description", profile.description},
          {"file", profile.source},    {"limits", limitsOf(profile)},
          {"facts", factsIn(profile)}, {"sources", profile.sources}};
}

OrderedJson pluginArmInJson(const FoundPlugin& plugin, const FoundPluginArm& arm) {
  const NamedPluginArm named = namedOf(plugin, arm);
  OrderedJson json;
  json["device"] = named.name;
  json["model"] = arm.model;
  json["tested"] = named.tested;
  json["trouble"] = textOrNull(named.trouble);
  if (!named.info) return json;
  const DeviceInfo& info = *named.info;
  json["limits"] = {{"force", info.limits.peak},
                    {"stiffness", info.max_stiffness},
                    {"damping", info.max_damping},
                    {"slew", info.limits.slew},
                    {"workspace_radius", info.workspace_radius},
                    {"input_rate", arm.facts->rate},
                    {"output_rate", info.output_rate}};
  json["buttons"] = info.handle.buttons;
  json["orientation"] = info.handle.orientation;
  json["gripper"] = info.handle.gripper;
  json["source"] = info.source;
  return json;
}

OrderedJson pluginInJson(const FoundPlugin& plugin) {
  OrderedJson json;
  json["name"] = plugin.name;
  json["file"] = plugin.file.string();
  json["description"] = plugin.what;
  json["version"] = plugin.version;
  json["licence"] = plugin.licence;
  json["trouble"] = textOrNull(plugin.trouble);
  json["arms"] = OrderedJson::array();
  for (const FoundPluginArm& arm : plugin.arms)
    json["arms"].push_back(pluginArmInJson(plugin, arm));
  return json;
}

OrderedJson knownArmInJson(const KnownArm& arm) {
  return {{"name", arm.name},
          {"force", arm.force},
          {"stiffness", arm.stiffness},
          {"damping", arm.damping},
          {"workspace_radius", arm.workspace_radius},
          {"transport", arm.transport},
          {"source", arm.source}};
}

OrderedJson listingInJson(const Listing& all) {
  OrderedJson out;
  out["arms"] = OrderedJson::array();
  for (const FoundArm& arm : all.arms) {
    for (const HidProfile& profile : arm.profiles) out["arms"].push_back(armInJson(arm, profile));
  }
  out["profiles"] = OrderedJson::array();
  for (const HidProfile& profile : all.profiles) out["profiles"].push_back(profileInJson(profile));
  out["plugins"] = OrderedJson::array();
  for (const FoundPlugin& plugin : all.plugins) out["plugins"].push_back(pluginInJson(plugin));
  out["notes"] = all.notes;
  out["known"] = OrderedJson::array();
  for (const KnownArm& arm : knownArms()) out["known"].push_back(knownArmInJson(arm));
  return out;
}

/// Limits and rates of an arm with motors [N, N/m, N s/m, Hz, Hz, m], in the order of the members.
struct ShownLimits {
  double force, stiffness, damping, input_rate, output_rate, workspace_radius;
};

void sayLimits(const ShownLimits& limits) {
  say("  {} N, {} N/m, {} N s/m, {} Hz in, {} Hz out, workspace radius {} m\n",
      rounded(limits.force), rounded(limits.stiffness), rounded(limits.damping),
      rounded(limits.input_rate), rounded(limits.output_rate), rounded(limits.workspace_radius));
}

void sayUntested(const std::string& device) {
  say("  untested: limited to at most {} N and {} N/m: run palpate devices --test {}\n",
      kUntestedForce, kUntestedStiffness, device);
}

void sayPluginArm(const FoundPlugin& plugin, const FoundPluginArm& arm) {
  const NamedPluginArm named = namedOf(plugin, arm);
  say("{}\n  {}, by {} {}\n", named.name, sentence(arm.model), sentence(plugin.what),
      plugin.version);
  if (named.info && named.info->hand) {
    const DeviceInfo& info = *named.info;
    sayLimits({info.limits.peak, info.max_stiffness, info.max_damping, arm.facts->rate,
               info.output_rate, info.workspace_radius});
    say("    {}\n", sentence(info.source));
    if (!named.tested) sayUntested(named.name);
  } else if (named.info) {
    say("  reports the hand's position, gives no force\n");
  }
  if (!named.trouble.empty()) say("  {}\n", sentence(named.trouble));
}

void sayHidArm(const FoundArm& arm, const HidProfile& profile) {
  say("{}\n  {}, {} ({})\n", arm.nameAs(profile), sentence(profile.description), arm.device.path,
      arm.device.product_name);
  if (profile.output) {
    const HidLimits& limits = profile.limits;
    sayLimits({limits.force, limits.stiffness, limits.damping, profile.input_rate,
               profile.output_rate, limits.workspace_radius});
    say("  firmware: {}\n", sentence(profile.firmware));
    if (!isTested(identityOf(profile, arm.identity()))) sayUntested(arm.nameAs(profile));
  } else {
    say("  reports the hand's position, gives no force\n");
  }
  for (const auto& [pointer, source] : profile.sources) {
    say("    {}: {}\n", pointer, sentence(source));
  }
  if (const auto wrong = arm.against(profile)) say("  {}\n", sentence(wrong->what()));
}

void sayArms(const Listing& all) {
  const bool none = std::all_of(all.plugins.begin(), all.plugins.end(),
                                [](const FoundPlugin& plugin) { return plugin.arms.empty(); });
  if (all.arms.empty()) {
    say("no connected arm matches a profile{}\n", none ? " or plug-in" : "");
  }
  for (const FoundPlugin& plugin : all.plugins) {
    if (!plugin.trouble.empty()) say("{}\n", sentence(plugin.trouble));
    for (const FoundPluginArm& arm : plugin.arms) sayPluginArm(plugin, arm);
  }
  for (const FoundArm& arm : all.arms) {
    for (const HidProfile& profile : arm.profiles) sayHidArm(arm, profile);
    if (const std::string what = trouble(arm); !what.empty()) say("  {}\n", sentence(what));
  }
  for (const std::string& other : all.others) say("{}\n", sentence(other));
}

void sayCatalogue(const Listing& all) {
  say("\nprofiles: ");
  for (const HidProfile& p : all.profiles) say("{}{}", &p == &all.profiles[0] ? "" : ", ", p.name);
  say("; your own profiles are in {}\nplug-ins: ", hidProfileFolder().string());
  for (const FoundPlugin& p : all.plugins) say("{}{}", &p == &all.plugins[0] ? "" : ", ", p.name);
  say("{} (docs/plugins.md)\n\nlimits of known arms, with sources:\n",
      all.plugins.empty() ? "none" : "");
  for (const KnownArm& arm : knownArms()) {
    say("  {:24} {:>4} N {:>5} N/m {:>3} N s/m {:>6} m  {} ({})\n", arm.name, rounded(arm.force),
        rounded(arm.stiffness), rounded(arm.damping), rounded(arm.workspace_radius), arm.transport,
        sentence(arm.source));
  }
}

int list(const DevicesOptions& options) {
  const Listing all = findAll();
  if (options.json) {
    sayJson(listingInJson(all));
    return kDone;
  }
  sayArms(all);
  sayCatalogue(all);
  return kDone;
}

/// Prints an arm's readings repeatedly. On a terminal, each reading replaces the previous one.
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
  [[nodiscard]] bool due() {
    const bool is = since() >= next_;
    if (is) next_ += often();
    return is;
  }
  /// Returns false if the output fails.
  [[nodiscard]] bool show(const std::string& text) const {
    if (terminal_) sayRaw("\x1b[H\x1b[J");
    std::istringstream lines(text + "\n");
    for (std::string line; std::getline(lines, line);) say("{}\n", sentence(line));
    return std::fflush(stdout) == 0;
  }

 private:
  /// Interval between two printed readings [s].
  [[nodiscard]] double often() const { return terminal_ ? 0.25 : 0.5; }
  bool terminal_ = isatty(STDOUT_FILENO) == 1;
  double seconds_;
  std::int64_t begin_;
  double next_;
};

std::string pictureOf(const HandState& hand, const HandleInfo& info, const std::string& not_ready) {
  const Vec3& p = hand.position;
  std::string text =
      fmt::format("tip at ({:.5f}, {:.5f}, {:.5f}) m in the hand's world, {:.3f} s ago\n", p.x(),
                  p.y(), p.z(), hand.age);
  const Handle& handle = hand.handle;
  if (info.velocity) {
    text += fmt::format("speed {:.3f} m/s\n", Vec3(handle.velocity.data()).norm());
  }
  if (info.orientation) {
    const auto& q = handle.orientation;
    text += fmt::format("orientation w, x, y, z = {:.4f}, {:.4f}, {:.4f}, {:.4f}\n", q[0], q[1],
                        q[2], q[3]);
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

/// Prints the readings of a plug-in's arm. The arm is opened as for a run, and gets zero force.
int watchPlugin(const DevicesOptions& options) {
  Pictures pictures(options.seconds);
  ArmHost host;
  host.say = [](const std::string& words) { complain("devices: " + words); };
  host.stop = [] { return interrupted != 0; };
  host.stuck = [] { endWithoutFiles(kEndedEarly); };
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

/// Prints the readings of an arm. An arm over HID is only read, so another program can drive it at
/// the same time.
int watch(const DevicesOptions& options) {
  if (parsePluginName(options.watch)) return watchPlugin(options);
  Pictures pictures(options.seconds);
  const bool arm = parseArmName(options.watch).has_value();
  const ChosenArm chosen = findArm(arm ? options.watch : "hid:" + options.watch,
                                   [](const std::string& words) { complain("devices: " + words); });
  const auto wrong = chosen.arm.against(chosen.profile);
  const auto port = openHidToRead(chosen.arm.device.path);
  ArmWatch watch(chosen.profile);
  // [ns]: time between two reads; the kernel stores at most 63 reports
  constexpr std::int64_t kLook = 5000000;
  while (interrupted == 0) {
    const bool gone = watch.take(*port, nowNs()) == ReadStatus::kGone;
    const bool over = pictures.over();
    if (pictures.due() || gone || over) {
      std::string text = fmt::format("{:.1f} s, {} on {}; read only\n", pictures.since(),
                                     chosen.arm.nameAs(chosen.profile), chosen.arm.device.path);
      if (wrong) text += std::string(wrong->what()) + "\n";
      if (chosen.profile.home_at_open) {
        text +=
            "the home pose is the pose of the first report: " + chosen.profile.home_words + "\n";
      } else if (!chosen.profile.home.empty()) {
        text += "joint values are valid if the arm has been homed since it was switched on\n";
      }
      text += watch.picture(nowNs());
      if (!pictures.show(text)) return kEndedEarly;
    }
    if (gone) {
      complain("devices: the arm was unplugged: plug it in, and run the command again");
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
      "devices", "Lists arms, their limits and the sources of these limits; tests an arm");
  auto options = std::make_shared<DevicesOptions>();
  verb->add_option("PROFILE", options->profile,
                   "Name or file of a profile; prints its limits and derived quantities");
  verb->add_option(
      "--test", options->test,
      "Tests an arm, for example hid:polhem: rates, encoder steps, friction, motor signs");
  verb->add_flag("--virtual", options->virtual_arm,
                 "Runs the test on a simulated arm, to see a test that passes; saves nothing");
  CLI::Option* watched =
      verb->add_option("--watch", options->watch,
                       "Shows an arm's reports live: fields, joints, tip, flags; sends no force");
  verb->add_option("--seconds", options->seconds, "Time to watch [s] (default: until Ctrl-C)")
      ->check(CLI::PositiveNumber)
      ->needs(watched);
  verb->add_option("--force", options->force, "Largest force of a test [N] (default 0.5)");
  verb->add_option(
      "--ruler", options->ruler,
      "Length by which you move the tip along a ruler on each axis, to measure the scale [m] "
      "(default 0.1, less for a small arm; 0: skip this, and an untested arm stays limited to "
      "at most 1 N and 100 N/m)");
  verb->add_flag("-v,--verbose", options->verbose,
                 "With --test: also print the numbers behind the stability margin");
  verb->add_flag("--json", options->json, "Print JSON");
  verb->footer(
      "Example:\n  palpate devices mine\n  palpate devices --watch hid:mine\n"
      "  palpate devices --virtual\n  palpate devices --test hid:polhem");
  verb->callback([=, &body] {
    body = [=] {
      if (!options->test.empty() && !options->profile.empty()) {
        throw Error(options->profile, "--test already names an arm",
                    "leave out the profile or --test");
      }
      if (options->virtual_arm && (!options->test.empty() || !options->watch.empty() ||
                                   !options->profile.empty() || options->ruler)) {
        throw Error("--virtual",
                    "it tests the simulated arm, which has no profile and no user who moves it",
                    "leave out --test, --watch, --ruler and the profile");
      }
      if (!options->watch.empty()) {
        if (!options->test.empty() || !options->profile.empty() || options->json) {
          throw Error("--watch", "it already names an arm, and prints only text",
                      "leave out --test, --json and the profile");
        }
        return watch(*options);
      }
      if (!options->profile.empty()) return show(*options);
      if (options->virtual_arm || !options->test.empty()) return testArm(*options);
      return list(*options);
    };
  });
}

}  // namespace palpate::cli
