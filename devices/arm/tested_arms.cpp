#include "palpate/devices/arm/tested_arms.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <ctime>
#include <fstream>
#include <system_error>
#include <unistd.h>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "palpate/devices/arm/user_folder.h"
#include "palpate/engine/error.h"

namespace palpate {
namespace {

using Json = nlohmann::json;

/// Returns the content of testedArmsFile(); an empty object if the file cannot be read or parsed.
Json tested() {
  std::ifstream in(testedArmsFile());
  constexpr int kDeepest = 8;
  Json json = Json::parse(
      in, [](int depth, Json::parse_event_t, const Json&) { return depth <= kDeepest; }, false);
  if (!json.is_object()) json = Json::object();
  return json;
}

std::string keyFor(const ArmIdentity& arm) {
  return arm.name + "@" + arm.own;
}

std::string printOf(const ArmIdentity& arm) {
  return fmt::format("{:016x}", arm.fingerprint);
}

/// Returns the arm's record; null if it has not passed its test with the present description.
Json recordOf(const ArmIdentity& arm) {
  if (arm.own.empty()) return nullptr;
  const Json json = tested();
  const auto record = json.find(keyFor(arm));
  if (record == json.end() || !record->is_object()) return nullptr;
  const auto print = record->find("profile");
  const bool same = print != record->end() && *print == printOf(arm);
  // Earlier versions stored `scale` as one number, for one axis only. These records do not count.
  const auto scale = record->find("scale");
  return same && scale != record->end() && scale->is_array() ? *record : Json();
}

constexpr double kMostDelay = 0.02;  // [s], largest delay that the test finds at 1 kHz
// Standard errors on each side of a measured delay, and subtracted from a measured friction.
constexpr double kSure = 3.0;

/// Replaces testedArmsFile(). On failure leaves it unchanged and throws DeviceError.
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
      throw DeviceError(file.string(), "the file cannot be written",
                        "make its folder writable, or free disk space");
    }
  }
  std::filesystem::rename(partial, file, error);
  if (error) {
    const std::string why = error.message();
    std::filesystem::remove(partial, error);
    throw DeviceError(file.string(), "the file cannot be replaced (" + why + ")",
                      "remove what is at this path, or change its owner to you (chown)");
  }
}

}  // namespace

std::filesystem::path testedArmsFile() {
  return userFolder("XDG_STATE_HOME", ".local/state") / "palpate/arms.json";
}

bool isTested(const ArmIdentity& arm) {
  return !recordOf(arm).is_null();
}

std::vector<std::string> testedArms(const ArmIdentity& like) {
  std::vector<std::string> arms;
  ArmIdentity arm = like;
  arm.own.clear();
  const std::string prefix = keyFor(arm);
  const Json json = tested();
  for (const auto& [key, record] : json.items()) {
    if (key.rfind(prefix, 0) != 0) continue;
    arm.own = key.substr(prefix.size());
    if (isTested(arm)) arms.push_back(arm.own);
  }
  return arms;
}

MeasuredArm measuredArm(const ArmIdentity& identity) {
  const Json arm = recordOf(identity);
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
  // [s]: error of the delay from effects that the fit does not model: friction other than b and c,
  // the amplifiers' lag, and the times of reading and writing in a tick.
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

void rememberTest(const ArmIdentity& identity, const SelfTestResult& result) {
  Json json = tested();
  Json& arm = json[keyFor(identity)];
  arm = Json::object();
  arm["profile"] = printOf(identity);
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

void forgetTest(const ArmIdentity& arm) {
  Json json = tested();
  if (json.erase(keyFor(arm)) > 0) write(json);
}

}  // namespace palpate
