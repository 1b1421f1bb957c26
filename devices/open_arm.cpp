#include "palpate/devices/open_arm.h"

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <fstream>
#include <string_view>
#include <system_error>
#include <unistd.h>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "palpate/devices/hid_descriptor.h"

namespace palpate {
namespace {

using Json = nlohmann::json;

bool matches(const HidMatch& match, const HidDeviceName& device) {
  return match.vendor == device.vendor && match.product == device.product &&
         (!match.usage_page || *match.usage_page == device.usage_page) &&
         (!match.usage || *match.usage == device.usage);
}

/// What has been tested, as the file has it; empty where there is none, or none that can be read:
/// then nothing has been.
Json tested() {
  std::ifstream in(testedArmsFile());
  constexpr int kDeepest = 8;
  Json json = Json::parse(
      in, [](int depth, Json::parse_event_t, const Json&) { return depth <= kDeepest; }, false);
  if (!json.is_object()) json = Json::object();
  return json;
}

std::string keyFor(const HidProfile& profile, const std::string& identity) {
  return profile.name + "@" + identity;
}

/// What is remembered of an arm that has passed with this very profile; null: nothing.
Json recordOf(const HidProfile& profile, const std::string& identity) {
  if (identity.empty()) return nullptr;
  const Json json = tested();
  const auto arm = json.find(keyFor(profile, identity));
  if (arm == json.end() || !arm->is_object()) return nullptr;
  const auto print = arm->find("profile");
  const bool same = print != arm->end() && *print == fmt::format("{:016x}", profile.fingerprint);
  // Tests that measured one way had a number here.
  const auto scale = arm->find("scale");
  return same && scale != arm->end() && scale->is_array() ? *arm : Json();
}

constexpr double kMostDelay = 0.02;  // [s]
constexpr double kSure = 3.0;        // standard errors
constexpr std::string_view kEnding = ".json";

/// Whole or not at all.
void write(const Json& json) {
  const std::filesystem::path file = testedArmsFile();
  std::error_code error;
  std::filesystem::create_directories(file.parent_path(), error);
  const std::filesystem::path partial = file.string() + fmt::format(".{}", getpid());
  {
    std::ofstream out(partial);
    out << json.dump(2) << "\n";
    out.flush();
    if (!out) {
      std::filesystem::remove(partial, error);
      throw DeviceError(file.string(), "it cannot be written", "make its folder writable");
    }
  }
  std::filesystem::rename(partial, file, error);
  if (error) {
    const std::string why = error.message();
    std::filesystem::remove(partial, error);
    throw DeviceError(file.string(), why, "make its folder writable");
  }
}

/// The profile of a name; throws where there is none.
const HidProfile& oneNamed(const std::string& name, const std::vector<HidProfile>& profiles,
                           const std::vector<std::string>& notes) {
  std::vector<std::string> names;
  for (const HidProfile& profile : profiles) {
    if (profile.name == name) return profile;
    names.push_back(profile.name);
  }
  const bool refused = std::any_of(notes.begin(), notes.end(), [&](const std::string& note) {
    return note.find("/" + name + ".json: ") != std::string::npos;
  });
  if (refused) {
    throw DeviceError("hid:" + name, "its file cannot be used as that", "mend what was said of it");
  }
  std::string editions;
  for (const std::string& one : names) {
    if (one.rfind(name + "-", 0) == 0) editions += (editions.empty() ? "" : " or ") + one;
  }
  if (!editions.empty()) {
    throw DeviceError("hid:" + name, "it may be " + editions + ", whose numbers differ",
                      "name the one that is yours; palpate devices NAME says what it is");
  }
  const std::string near = nearestName(name, names);
  throw DeviceError("hid:" + name, "there is no profile \"" + name + "\"",
                    near.empty() ? "palpate devices lists them; a file ends in .json"
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
  // A path may have any character, and so may a serial number; a profile's name has no @.
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
        arm.profiles.push_back(profile);
      }
    }
    if (same != arms.end() || arm.profiles.empty()) continue;
    arm.may_open = access(device.path.c_str(), R_OK | W_OK) == 0;
    arms.push_back(std::move(found));
  }
  return arms;
}

HidProfile namedProfile(const ArmName& name, const std::function<void(const std::string&)>& say) {
  if (name.isFile()) return readHidProfile(name.profile);
  std::vector<std::string> notes;
  const std::vector<HidProfile> profiles = hidProfiles(hidProfileFolder(), notes);
  if (say) {
    for (const std::string& note : notes) say(note);
  }
  return oneNamed(name.profile, profiles, notes);
}

ChosenArm findArm(const std::string& name, const std::function<void(const std::string&)>& say) {
  const std::optional<ArmName> parsed = parseArmName(name);
  if (!parsed) {
    throw DeviceError(name, "it is no arm", "write hid, hid:PROFILE or hid:PROFILE@SERIAL");
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
  std::vector<FoundArm> arms = findArms(profiles);
  const auto ours = std::partition(
      arms.begin(), arms.end(), [](const FoundArm& arm) { return !isOpenHere(arm.device.path); });
  const bool all_ours = ours == arms.begin() && !arms.empty();
  arms.erase(ours, arms.end());
  if (all_ours) {
    throw DeviceError(name, "every arm that is plugged in is another hand's", "plug in another");
  }
  for (const FoundArm& arm : arms) {
    if (!serial.empty() && arm.identity() != serial) continue;
    for (const HidProfile& profile : arm.profiles) {
      if (wanted.empty() || profile.name == wanted) choices.emplace_back(&arm, &profile);
    }
  }
  if (choices.empty()) {
    std::string there;
    for (const FoundArm& arm : arms)
      there += (there.empty() ? "" : ", ") + arm.nameAs(arm.profiles[0]);
    throw DeviceError(
        name, "no such arm is plugged in",
        there.empty() ? "plug it in; palpate devices shows what is there" : "there is " + there);
  }
  if (choices.size() > 1) {
    std::string which;
    for (const auto& [arm, profile] : choices)
      which += (which.empty() ? "" : ", ") + arm->nameAs(*profile);
    throw DeviceError(name, "that may be several", "name one of " + which);
  }
  return {*choices[0].first, *choices[0].second};
}

OpenedArm openArm(const std::string& name, HidHost host) {
  const ChosenArm chosen = findArm(name, host.say);
  const HidProfile& profile = chosen.profile;
  if (const auto wrong = chosen.arm.against(profile)) throw *wrong;
  const HidDeviceName device = chosen.arm.device;
  const std::string own = chosen.arm.identity();
  const bool numbered = !chosen.arm.serial().empty();
  if (const auto others = whoHas(device.path); !others.empty() && host.say) {
    host.say(fmt::format("{} is open in {} as well: both would drive it", device.path, others[0]));
  }
  // Its path is another one when it comes back.
  // Without a serial number of its own it is what is plugged in where it was.
  host.find = [device, profile, own]() -> std::unique_ptr<ReportPort> {
    for (const FoundArm& arm : findArms({profile})) {
      const bool same = arm.device.vendor == device.vendor &&
                        arm.device.product == device.product && arm.identity() == own;
      if (same && !isOpenHere(arm.device.path) && !arm.against(profile)) {
        return openHid(arm.device.path);
      }
    }
    return nullptr;
  };
  const bool good = isTested(profile, own);
  host.measured = measuredArm(profile, own);
  OpenedArm arm{std::make_unique<HidDevice>(profile, openHid(device.path, host.say), good, host),
                own, numbered};
  if (host.say && !good && profile.output) {
    host.say(fmt::format("{}: held to {} N and {} N/m: run palpate devices --test {}",
                         arm.device->info().name, kUntestedForce, kUntestedStiffness,
                         chosen.arm.nameAs(profile)));
  }
  if (host.say && good && !numbered) {
    host.say(
        fmt::format("{}: it has no serial number: it is taken for the arm that was tested at {}",
                    arm.device->info().name, own));
  }
  return arm;
}

std::filesystem::path testedArmsFile() {
  const char* state = std::getenv("XDG_STATE_HOME");
  const char* home = std::getenv("HOME");
  // A relative one is to be ignored (XDG Base Directory Specification).
  if (state != nullptr && *state == '/') return std::filesystem::path(state) / "palpate/arms.json";
  return std::filesystem::path(home != nullptr ? home : "/") / ".local/state/palpate/arms.json";
}

bool isTested(const HidProfile& profile, const std::string& identity) {
  return !recordOf(profile, identity).is_null();
}

std::vector<std::string> testedArms(const HidProfile& profile) {
  std::vector<std::string> arms;
  const std::string prefix = keyFor(profile, "");
  const Json json = tested();
  for (const auto& [key, record] : json.items()) {
    if (key.rfind(prefix, 0) != 0) continue;
    const std::string identity = key.substr(prefix.size());
    if (isTested(profile, identity)) arms.push_back(identity);
  }
  return arms;
}

MeasuredArm measuredArm(const HidProfile& profile, const std::string& identity) {
  const Json arm = recordOf(profile, identity);
  const auto numbers = [&](const char* key) {
    std::vector<double> all;
    const auto list = arm.is_object() ? arm.find(key) : arm.end();
    if (!arm.is_object() || list == arm.end() || !list->is_array()) return all;
    for (const Json& number : *list) {
      if (number.is_number()) all.push_back(number.get<double>());
    }
    return all;
  };
  MeasuredArm measured;
  const auto viscous = numbers("viscous_least");
  const auto coulomb = numbers("coulomb_least");
  const auto delay = numbers("delay");
  const auto delay_error = numbers("delay_error");
  const auto mass = numbers("mass");
  for (const auto* list : {&viscous, &coulomb, &delay, &delay_error, &mass}) {
    if (list->empty() || list->size() != mass.size()) return measured;
  }
  measured.viscous = std::max(0.0, *std::min_element(viscous.begin(), viscous.end()));
  measured.coulomb = std::max(0.0, *std::min_element(coulomb.begin(), coulomb.end()));
  measured.mass = std::max(0.0, *std::min_element(mass.begin(), mass.end()));
  // Half a millisecond for what no fit knows: friction that is no b and c, amplifiers' lag, when
  // within a tick an arm reads and gives.
  constexpr double kUnknown = 0.5e-3;
  double early = kMostDelay;
  double late = 0.0;
  for (std::size_t i = 0; i < delay.size(); ++i) {
    const double about = kSure * std::abs(delay_error[i]) + kUnknown;
    early = std::min(early, std::max(0.0, delay[i] - about));
    late = std::max(late, std::min(kMostDelay, delay[i] + about));
  }
  measured.delay = 0.5 * (early + late);
  measured.doubt = 0.5 * (late - early);
  return measured;
}

void rememberTest(const HidProfile& profile, const std::string& identity,
                  const SelfTestResult& result) {
  Json json = tested();
  Json& arm = json[keyFor(profile, identity)];
  arm = Json::object();
  arm["profile"] = fmt::format("{:016x}", profile.fingerprint);
  const auto now = std::chrono::system_clock::to_time_t(std::chrono::system_clock::now());
  std::array<char, 32> date{};
  std::tm utc{};
  gmtime_r(&now, &utc);
  (void)std::strftime(date.data(), date.size(), "%Y-%m-%d", &utc);
  arm["date"] = date.data();
  arm["scale"] = result.scale;
  for (const char* key :
       {"viscous", "viscous_least", "coulomb", "coulomb_least", "mass", "delay", "delay_error"}) {
    arm[key] = Json::array();
  }
  // Along what it has no motor for nothing was measured.
  for (const AxisResult& axis : result.axes) {
    if (!axis.driven) continue;
    arm["viscous"].push_back(axis.viscous);
    arm["coulomb"].push_back(axis.coulomb);
    arm["viscous_least"].push_back(axis.viscous - kSure * axis.viscous_error);
    arm["coulomb_least"].push_back(axis.coulomb - kSure * axis.coulomb_error);
    arm["mass"].push_back(axis.mass);
    arm["delay"].push_back(axis.delay);
    arm["delay_error"].push_back(axis.delay_error);
  }
  write(json);
}

void forgetTest(const HidProfile& profile, const std::string& identity) {
  Json json = tested();
  if (json.erase(keyFor(profile, identity)) > 0) write(json);
}

}  // namespace palpate
