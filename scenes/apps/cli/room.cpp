#include "palpate/scenes/apps/cli/room.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "palpate/devices/simulated/stability.h"

namespace palpate::cli {
namespace {

/// Grip of a relaxed hand, as on a pen.
constexpr GripParams kRelaxed{};

}  // namespace

OrderedJson roomFor(const DeviceInfo& device, double rate, const CouplingParams& coupling) {
  const ArmDissipation& known = device.limits.tank.arm;
  if (!(device.mass > 0.0) || !(known.viscous > 0.0)) return nullptr;
  ArmParams arm;
  arm.mass = device.mass;
  arm.viscous = known.viscous;
  arm.coulomb = known.coulomb;
  arm.encoder = known.step / std::sqrt(3.0);
  arm.delay = known.delay + known.doubt;
  arm.lag = known.lag;
  if (device.output_rate > 0.0) rate = std::min(rate, device.output_rate);
  const CouplingRoom room =
      palpate::roomFor(arm, kRelaxed, rate, coupling.stiffness, coupling.damping);
  OrderedJson json;
  json["device"] = device.name;
  json["rate"] = rate;
  json["stiffness"] = coupling.stiffness;
  json["damping"] = coupling.damping;
  json["most"] = device.max_stiffness;
  json["passive"] = room.passive;
  json["stable"] = finite(room.stable);
  json["hand"] = {{"stiffness", kRelaxed.stiffness}, {"damping", kRelaxed.damping}};
  json["quiet"] = finite(quietStiffness(arm, rate, coupling.damping));
  json["holds"] = finite(room.amplitude);
  json["passive_rate"] = room.rate > 0.0 ? OrderedJson(room.rate) : OrderedJson();
  json["passive_viscous"] = room.viscous;
  return json;
}

bool swingsUp(const OrderedJson& room) {
  return !room["stable"].is_null() &&
         room["stiffness"].get<double>() > room["stable"].get<double>();
}

bool exceedsDevice(const OrderedJson& room) {
  return room["stiffness"].get<double>() > room["most"].get<double>();
}

std::string roomWords(const OrderedJson& room) {
  const auto newtons = [&](const char* key) { return rounded(room[key].get<double>()) + " N/m"; };
  const std::string asked = newtons("stiffness");
  const std::string name = room["device"].get<std::string>();
  // A recording names a simulated arm "mouse" or "igtl" if the mouse or 3D Slicer leads the arm.
  const bool simulated = name == "simulated" || name == "mouse" || name == "igtl";
  const std::string arm = simulated ? "the simulated arm" : name;
  const bool device_limits =
      room["stable"].is_null() || room["most"].get<double>() < room["stable"].get<double>();
  if (exceedsDevice(room) && device_limits) {
    return fmt::format("stiffness {}: above the limit of {}: use at most {}", asked, arm,
                       newtons("most"));
  }
  if (swingsUp(room)) {
    return fmt::format(
        "stiffness {}: unstable on {}, even while held: use {}", asked, arm,
        room["stable"].get<double>() > 0.0 ? "less than " + newtons("stable") : "less damping");
  }
  const auto passive = room["passive"].get<double>();
  if (room["stiffness"].get<double>() <= passive) {
    return fmt::format("stiffness {}: stable on {}, held or released", asked, arm);
  }
  std::string held = room["stable"].is_null() ? "no limit" : "limit " + newtons("stable");
  if (device_limits) held += "; palpate allows at most " + newtons("most");
  return fmt::format("stiffness {}: stable on {} while held ({}); may oscillate when released ({})",
                     asked, arm, held,
                     passive > 0.0 ? "limit " + newtons("passive") : "at any stiffness");
}

std::string roomNumbers(const OrderedJson& room) {
  const auto newtons = [&](const char* key) { return rounded(room[key].get<double>()) + " N/m"; };
  std::string words = fmt::format(
      "coupling of {} N/m and {} N s/m at {} Hz: passive with any hand up to {} N/m; stable with a "
      "relaxed hand ({} N/m, {} N s/m) up to {}; when released, friction stops oscillations of up "
      "to {}",
      rounded(room["stiffness"].get<double>()), rounded(room["damping"].get<double>()),
      rounded(room["rate"].get<double>()), rounded(room["passive"].get<double>()),
      rounded(room["hand"]["stiffness"].get<double>()),
      rounded(room["hand"]["damping"].get<double>()),
      room["stable"].is_null() ? "any stiffness" : newtons("stable"),
      room["holds"].is_null() ? "any size" : rounded(1e3 * room["holds"].get<double>()) + " mm");
  if (room["stiffness"].get<double>() > room["passive"].get<double>()) {
    words += fmt::format("; it would be passive {} with {} N s/m of viscous friction",
                         room["passive_rate"].is_null()
                             ? "only"
                             : "at " + rounded(room["passive_rate"].get<double>()) + " Hz or",
                         rounded(room["passive_viscous"].get<double>()));
  }
  return words;
}

void sayRoom(const OrderedJson& room, int column, bool verbose) {
  if (room.is_null()) return;
  say("{:<{}}{}\n", "stability", column, sentence(roomWords(room)));
  if (verbose) say("{:<{}}{}\n", "", column, sentence(roomNumbers(room)));
}

}  // namespace palpate::cli
