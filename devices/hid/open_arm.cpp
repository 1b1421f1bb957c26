#include "palpate/devices/hid/open_arm.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string_view>
#include <unistd.h>
#include <utility>

#include <fmt/format.h>

#include "palpate/devices/arm/tested_arms.h"
#include "palpate/devices/hid/hid_descriptor.h"
#include "palpate/devices/hid/pid_descriptor.h"
#include "palpate/devices/hid/pid_device.h"

namespace palpate {
namespace {

constexpr std::string_view kEnding = ".json";

// A larger torque constant is probably in mN m/A: arms have motors of at most about 0.3 N m/A.
constexpr double kLargestConstant = 1.0;

bool matches(const HidMatch& match, const HidDeviceName& device) {
  return match.vendor == device.vendor && match.product == device.product &&
         (!match.usage_page || *match.usage_page == device.usage_page) &&
         (!match.usage || *match.usage == device.usage);
}

/// Adds the fields of the device's own descriptor to a profile of a PID device.
HidProfile asDescribed(const HidProfile& profile, const HidDeviceName& device) {
  const auto described = parseHidDescriptor(device.descriptor);
  if (profile.pid.empty() || !described) return profile;
  try {
    return describedBy(readPidMap(*described, profile.source), profile);
  } catch (const DeviceError&) {
    return profile;  // FoundArm::against reports the problem
  }
}

/// Returns true for a joint that moves the tip along a fixed direction, by 1 m per unit of the
/// joint.
bool isSliding(const HidProfile& profile, std::size_t joint) {
  Joints at{};
  for (std::size_t i = 0; i < profile.joints.size(); ++i) at[i] = profile.joints[i].home;
  const Vec3 before = profile.kinematics->at(at).jacobian[joint];
  at[joint] += 0.5;
  const Vec3 after = profile.kinematics->at(at).jacobian[joint];
  constexpr double kRounding = 1e-9;
  return std::abs(before.norm() - 1.0) < kRounding && (after - before).norm() < kRounding;
}

/// Reports the first torque constant that seems to be in mN m/A. `say` may be empty.
void noteTorqueConstant(const HidProfile& profile,
                        const std::function<void(const std::string&)>& say) {
  if (!say || !profile.output) return;
  for (std::size_t i = 0; i < profile.joints.size(); ++i) {
    const HidJoint& joint = profile.joints[i];
    if (!joint.to || !(joint.torque_constant > kLargestConstant) || isSliding(profile, i)) continue;
    say(fmt::format(
        "{}: /kinematics/joints/{}/torque_constant: {:g} N m per unit of {} is above {:g}, more "
        "than the motor of an arm usually has: if the number is in mN m, divide it by 1000",
        profile.source, i, joint.torque_constant, profile.output->fields[*joint.to].name,
        kLargestConstant));
    return;
  }
}

/// Returns a name like FoundArm::nameAs(). If `given` names a file, the name contains this file
/// instead of the profile's name, because palpate finds profiles by name only in the user's folder.
std::string nameLike(const ArmName& given, const FoundArm& arm, const HidProfile& profile) {
  if (!given.isFile()) return arm.nameAs(profile);
  const std::string own = arm.identity();
  return "hid:" + given.profile + (own.empty() ? "" : "@" + own);
}

const HidProfile& oneNamed(const std::string& name, const std::vector<HidProfile>& profiles,
                           const std::vector<std::string>& notes) {
  std::vector<std::string> names;
  for (const HidProfile& profile : profiles) {
    if (profile.name == name) return profile;
    names.push_back(profile.name);
  }
  for (const HidProfile& profile : profiles) {
    if (!profile.source.ends_with("/" + name + ".json")) continue;
    throw DeviceError("hid:" + name,
                      "the profile in " + profile.source + " has the name " + profile.name,
                      "use hid:" + profile.name + ", or change \"name\" in this file");
  }
  const bool refused = std::any_of(notes.begin(), notes.end(), [&](const std::string& note) {
    return note.find("/" + name + ".json: ") != std::string::npos;
  });
  if (refused) {
    throw DeviceError("hid:" + name, "the profile's file is invalid",
                      "correct the error reported above");
  }
  std::string editions;
  for (const std::string& one : names) {
    if (one.rfind(name + "-", 0) == 0) editions += (editions.empty() ? "" : " or ") + one;
  }
  if (!editions.empty()) {
    throw DeviceError("hid:" + name, "this name is incomplete, and fits " + editions,
                      "use the whole name of your edition; palpate devices NAME describes one");
  }
  const std::string near = nearestName(name, names);
  throw DeviceError("hid:" + name, "no profile has the name \"" + name + "\"",
                    near.empty()
                        ? "run palpate devices for a list; the name of a file ends in .json"
                        : "did you mean \"" + near + "\"?");
}

}  // namespace

std::string FoundArm::serial() const {
  return device.serial == "0123456789" ? "" : device.serial;
}

std::string FoundArm::identity() const {
  const std::string own = serial();
  return own.empty() ? device.port : own;
}

std::optional<DeviceError> FoundArm::against(const HidProfile& profile) const {
  const auto described = parseHidDescriptor(device.descriptor);
  if (!profile.pid.empty()) {
    try {
      if (described) (void)describedBy(readPidMap(*described, profile.source), profile);
    } catch (const DeviceError& error) {
      return error;
    }
    return std::nullopt;
  }
  const auto complaint = described ? complaintAbout(profile, *described) : std::nullopt;
  if (!complaint) return std::nullopt;
  return DeviceError(profile.source + ": " + complaint->path, complaint->what, complaint->remedy);
}

std::string FoundArm::nameAs(const HidProfile& profile) const {
  const std::string own = identity();
  return "hid:" + profile.name + (own.empty() ? "" : "@" + own);
}

bool ArmName::isFile() const {
  return profile.size() > kEnding.size() &&
         profile.compare(profile.size() - kEnding.size(), kEnding.size(), kEnding) == 0;
}

std::optional<ArmName> parseArmName(const std::string& name) {
  if (name == "hid") return ArmName{};
  if (name.rfind("hid:", 0) != 0) return std::nullopt;
  const std::string text = name.substr(4);
  // A path or a serial number may contain any character; a profile's name contains no @.
  std::size_t end = text.find('@');
  for (std::size_t at = text.find(kEnding); at != std::string::npos;
       at = text.find(kEnding, at + 1)) {
    const std::size_t after = at + kEnding.size();
    if (after != text.size() && text[after] != '@') continue;
    end = after;
    break;
  }
  ArmName parsed;
  parsed.profile = text.substr(0, end);
  if (end < text.size()) parsed.serial = text.substr(end + 1);
  return parsed;
}

std::vector<FoundArm> findArms(const std::vector<HidProfile>& profiles) {
  std::vector<FoundArm> arms;
  for (const HidDeviceName& device : listHid()) {
    // hidapi lists a device once for each of its top-level usages.
    const auto same = std::find_if(arms.begin(), arms.end(), [&](const FoundArm& arm) {
      return arm.device.path == device.path;
    });
    FoundArm found;
    found.device = device;
    FoundArm& arm = same != arms.end() ? *same : found;
    for (const HidProfile& profile : profiles) {
      const bool known = std::any_of(arm.profiles.begin(), arm.profiles.end(),
                                     [&](const HidProfile& p) { return p.name == profile.name; });
      if (!known && std::any_of(profile.match.begin(), profile.match.end(),
                                [&](const HidMatch& m) { return matches(m, device); })) {
        arm.profiles.push_back(asDescribed(profile, device));
      }
    }
    if (same != arms.end() || arm.profiles.empty()) continue;
    arm.may_open = access(device.path.c_str(), R_OK | W_OK) == 0;
    arms.push_back(std::move(found));
  }
  return arms;
}

HidProfile namedProfile(const ArmName& name, const std::function<void(const std::string&)>& say) {
  if (name.isFile()) {
    HidProfile profile = readHidProfile(name.profile);
    noteTorqueConstant(profile, say);
    return profile;
  }
  std::vector<std::string> notes;
  const std::vector<HidProfile> profiles = hidProfiles(hidProfileFolder(), notes);
  if (say) {
    for (const std::string& note : notes) say(note);
  }
  const HidProfile& profile = oneNamed(name.profile, profiles, notes);
  noteTorqueConstant(profile, say);
  return profile;
}

ChosenArm findArm(const std::string& name, const std::function<void(const std::string&)>& say) {
  const std::optional<ArmName> parsed = parseArmName(name);
  if (!parsed) {
    throw DeviceError(name, "it is not the name of an arm",
                      "write hid, hid:PROFILE, hid:PROFILE@SERIAL or plugin:NAME");
  }
  std::string wanted = parsed->profile;
  const std::string& serial = parsed->serial;
  std::vector<HidProfile> profiles;
  if (parsed->isFile()) {
    profiles.push_back(readHidProfile(wanted));
    wanted = profiles.back().name;
  } else {
    std::vector<std::string> notes;
    profiles = hidProfiles(hidProfileFolder(), notes);
    if (say) {
      for (const std::string& note : notes) say(note);
    }
    if (!wanted.empty()) (void)oneNamed(wanted, profiles, notes);
  }

  std::vector<std::pair<const FoundArm*, const HidProfile*>> choices;
  const auto fits = [&](const FoundArm& arm, const HidProfile& profile) {
    return (serial.empty() || arm.identity() == serial) &&
           (wanted.empty() || profile.name == wanted);
  };
  std::vector<FoundArm> arms = findArms(profiles);
  const auto ours = std::partition(
      arms.begin(), arms.end(), [](const FoundArm& arm) { return !isOpenHere(arm.device.path); });
  const bool used = std::any_of(ours, arms.end(), [&](const FoundArm& arm) {
    return std::any_of(arm.profiles.begin(), arm.profiles.end(),
                       [&](const HidProfile& profile) { return fits(arm, profile); });
  });
  arms.erase(ours, arms.end());
  for (const FoundArm& arm : arms) {
    for (const HidProfile& profile : arm.profiles) {
      if (fits(arm, profile)) choices.emplace_back(&arm, &profile);
    }
  }
  if (choices.empty() && used) {
    throw DeviceError(name, "other hands use all plugged-in arms of this name",
                      "plug in another arm");
  }
  if (choices.empty()) {
    std::string there;
    for (const FoundArm& arm : arms)
      there += (there.empty() ? "" : ", ") + nameLike(*parsed, arm, arm.profiles[0]);
    throw DeviceError(
        name, "no plugged-in arm fits this name",
        std::string("plug the arm in") +
            (wanted.empty() ? "" : " or correct \"match\" of its profile") +
            (there.empty() ? "; run palpate devices for a list of arms" : ", or use " + there));
  }
  if (choices.size() > 1) {
    std::string which;
    for (const auto& [arm, profile] : choices)
      which += (which.empty() ? "" : ", ") + nameLike(*parsed, *arm, *profile);
    throw DeviceError(name, "several arms match", "name one of " + which);
  }
  noteTorqueConstant(*choices[0].second, say);
  return {*choices[0].first, *choices[0].second};
}

ArmIdentity identityOf(const HidProfile& profile, const std::string& own, bool numbered) {
  return {profile.name, own, profile.fingerprint, numbered};
}

OpenedArm openArm(const std::string& name, const ArmHost& asked) {
  const ChosenArm chosen = findArm(name, asked.say);
  const HidProfile& profile = chosen.profile;
  if (const auto wrong = chosen.arm.against(profile)) throw *wrong;
  const HidDeviceName device = chosen.arm.device;
  const std::string own = chosen.arm.identity();
  const ArmIdentity identity = identityOf(profile, own, !chosen.arm.serial().empty());
  if (const auto others = whoHas(device.path); !others.empty() && asked.say) {
    asked.say(fmt::format(
        "{} is also open in {}: end one of the programs, because both would drive the arm",
        device.path, others[0]));
  }
  HidHost host{asked};
  // The path may change with each plugging in. Without a serial number, the port identifies the
  // arm.
  host.find = [device, profile, own]() -> std::unique_ptr<ReportPort> {
    for (const FoundArm& arm : findArms({profile})) {
      const bool same = arm.device.vendor == device.vendor &&
                        arm.device.product == device.product && arm.identity() == own;
      const bool another = !profile.pid.empty() && arm.device.descriptor != device.descriptor;
      if (same && !another && !isOpenHere(arm.device.path) && !arm.against(profile)) {
        return openHid(arm.device.path);
      }
    }
    return nullptr;
  };
  const bool good = isTested(identity);
  host.measured = measuredArm(identity);
  if (!profile.pid.empty()) refuseEffects(device.path, effectNodes(device.path));
  auto port = openHid(device.path, host.say);
  OpenedArm arm;
  arm.identity = identity;
  if (profile.pid.empty()) {
    arm.device = std::make_unique<HidDevice>(profile, std::move(port), good, host);
  } else {
    arm.device =
        std::make_unique<PidDevice>(profile, device.descriptor, std::move(port), good, host);
  }
  // The limits of a PID device follow from the time that its reports take.
  if (asked.say && !profile.pid.empty()) {
    asked.say(fmt::format("{}: {}", arm.device->info().name, arm.device->info().source));
  }
  if (asked.say && !good && profile.output) {
    const std::string test =
        asked.tests ? ""
        : own.empty()
            ? ": palpate cannot store the test of an arm without a serial number and a port"
            : ": run palpate devices --test " +
                  nameLike(parseArmName(name).value_or(ArmName{}), chosen.arm, profile);
    asked.say(fmt::format("{}: limited to at most {} N and {} N/m, because it is untested{}",
                          arm.device->info().name, kUntestedForce, kUntestedStiffness, test));
  }
  if (asked.say && good && !identity.numbered) {
    asked.say(fmt::format(
        "{}: the arm has no serial number: palpate takes it for the arm that was tested at port "
        "{}; if it is another arm, test it again",
        arm.device->info().name, own));
  }
  return arm;
}

}  // namespace palpate
