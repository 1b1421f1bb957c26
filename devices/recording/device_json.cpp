#include "palpate/devices/recording/device_json.h"

#include <algorithm>
#include <cstddef>
#include <string>
#include <vector>

namespace palpate {

using OrderedJson = nlohmann::ordered_json;

namespace {

OrderedJson jsonOf(const ForceLimits& l) {
  const ArmDissipation& arm = l.tank.arm;
  return {{"peak", l.peak},
          {"slew", l.slew},
          {"continuous", l.continuous},
          {"heating", l.heating},
          {"friction", l.friction},
          {"engage", l.engage},
          {"tank",
           {{"use", static_cast<int>(l.tank.use)},
            {"soft", l.tank.soft},
            {"refill", l.tank.refill},
            {"viscous", arm.viscous},
            {"coulomb", arm.coulomb},
            {"step", arm.step},
            {"delay", arm.delay},
            {"doubt", arm.doubt},
            {"jitter", arm.jitter},
            {"lag", arm.lag},
            {"period", arm.period}}}};
}

ForceLimits limitsOf(const OrderedJson& json) {
  ForceLimits l;
  const auto read = [](const OrderedJson& from, const char* key, double& to) {
    to = from.at(key).get<double>();
  };
  read(json, "peak", l.peak);
  read(json, "slew", l.slew);
  read(json, "continuous", l.continuous);
  read(json, "heating", l.heating);
  read(json, "friction", l.friction);
  read(json, "engage", l.engage);
  const OrderedJson& tank = json.at("tank");
  l.tank.use = static_cast<TankUse>(std::clamp(tank.at("use").get<int>(), 0, 2));
  read(tank, "soft", l.tank.soft);
  read(tank, "refill", l.tank.refill);
  ArmDissipation& arm = l.tank.arm;
  read(tank, "viscous", arm.viscous);
  read(tank, "coulomb", arm.coulomb);
  read(tank, "step", arm.step);
  read(tank, "delay", arm.delay);
  read(tank, "doubt", arm.doubt);
  read(tank, "jitter", arm.jitter);
  read(tank, "lag", arm.lag);
  read(tank, "period", arm.period);
  return l;
}

}  // namespace

OrderedJson deviceToJson(const DeviceInfo& d) {
  return {{"name", d.name},
          {"source", d.source},
          {"hand", d.hand},
          {"max_stiffness", d.max_stiffness},
          {"max_damping", d.max_damping},
          {"workspace_radius", d.workspace_radius},
          {"mass", d.mass},
          {"output_rate", d.output_rate},
          {"stale", d.watch.stale},
          {"max_speed", d.watch.max_speed},
          {"late", d.watch.late},
          {"handle",
           {{"buttons", d.handle.buttons},
            {"orientation", d.handle.orientation},
            {"gripper", d.handle.gripper},
            {"joints", d.handle.joints},
            {"velocity", d.handle.velocity}}},
          {"limits", jsonOf(d.limits)}};
}

DeviceInfo deviceFromJson(const OrderedJson& json) {
  DeviceInfo d;
  d.name = json.at("name").get<std::string>();
  d.source = json.at("source").get<std::string>();
  d.hand = json.at("hand").get<bool>();
  d.max_stiffness = json.at("max_stiffness").get<double>();
  d.max_damping = json.at("max_damping").get<double>();
  d.workspace_radius = json.at("workspace_radius").get<double>();
  d.mass = json.at("mass").get<double>();
  d.output_rate = json.at("output_rate").get<double>();
  d.watch = {json.at("stale").get<double>(), json.at("max_speed").get<double>(),
             json.at("late").get<double>()};
  const OrderedJson& handle = json.at("handle");
  d.handle.buttons = handle.at("buttons").get<std::vector<std::string>>();
  d.handle.orientation = handle.at("orientation").get<bool>();
  d.handle.gripper = handle.at("gripper").get<bool>();
  d.handle.joints = std::min(handle.at("joints").get<std::size_t>(), kMostJoints);
  d.handle.velocity = handle.at("velocity").get<bool>();
  d.limits = limitsOf(json.at("limits"));
  return d;
}

}  // namespace palpate
