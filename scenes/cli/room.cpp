#include "palpate/scenes/cli/room.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "palpate/devices/stability.h"

namespace palpate::cli {
namespace {

/// A hand that holds the arm as one holds a pen.
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
  json["passive"] = room.passive;
  json["stable"] = finite(room.stable);
  json["hand"] = {{"stiffness", kRelaxed.stiffness}, {"damping", kRelaxed.damping}};
  json["quiet"] = finite(quietStiffness(arm, rate, coupling.damping));
  json["holds"] = finite(room.amplitude);
  json["passive_rate"] = room.rate > 0.0 ? OrderedJson(room.rate) : OrderedJson();
  json["passive_viscous"] = room.viscous;
  return json;
}

std::string roomWords(const OrderedJson& room) {
  std::string words = fmt::format(
      "{} N/m of coupling on {} at {} Hz: passive with any hand to {}, stable with a relaxed one "
      "({} N/m, {} N s/m) to {}, let go of it friction holds swings of {} mm",
      rounded(room["stiffness"].get<double>()), room["device"].get<std::string>(),
      rounded(room["rate"].get<double>()), rounded(room["passive"].get<double>()),
      rounded(room["hand"]["stiffness"].get<double>()),
      rounded(room["hand"]["damping"].get<double>()),
      room["stable"].is_null() ? "any" : rounded(room["stable"].get<double>()),
      room["holds"].is_null() ? "any" : rounded(1e3 * room["holds"].get<double>()));
  if (room["stiffness"].get<double>() > room["passive"].get<double>()) {
    words += fmt::format("; passive at {} or with {} N s/m of friction",
                         room["passive_rate"].is_null()
                             ? "no rate"
                             : rounded(room["passive_rate"].get<double>()) + " Hz",
                         rounded(room["passive_viscous"].get<double>()));
  }
  return words;
}

std::string roomWarning(const OrderedJson& room) {
  if (room["stable"].is_null()) return {};
  if (room["stiffness"].get<double>() <= room["stable"].get<double>()) return {};
  return fmt::format("the coupling swings up even in a relaxed hand: use less than {} N/m: {}",
                     rounded(room["stable"].get<double>()), roomWords(room));
}

}  // namespace palpate::cli
