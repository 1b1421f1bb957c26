#include "palpate/scenes/apps/cli/explain_words.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "palpate/scenes/apps/common/say.h"
#include "palpate/scenes/apps/common/touch.h"

namespace palpate::cli {
namespace {

std::string text(const OrderedJson& value) {
  if (value.is_null()) return "none";
  if (value.is_number()) return shown(value.get<double>());
  if (value.is_string()) return value.get<std::string>();
  std::string list;
  for (const OrderedJson& item : value) list += (list.empty() ? "" : ", ") + text(item);
  return list;
}

/// Formats, for example, "2 (1.5 where speed is 0.3, times 1.33)".
std::string transferText(const OrderedJson& transfer) {
  std::string factors;
  for (const OrderedJson& factor : transfer["factors"]) {
    if (!factors.empty()) factors += ", times ";
    factors += text(factor["output"]);
    if (!factor.contains("reads")) continue;
    const std::string reads = text(factor["reads"]);
    factors += factor["input"].is_null() ? " as " + reads + " has no data"
                                         : " where " + reads + " is " + text(factor["input"]);
  }
  const bool plain = transfer["factors"].size() == 1 && !transfer["factors"][0].contains("reads");
  return text(transfer["value"]) + (plain || factors.empty() ? "" : " (" + factors + ")");
}

void printMode(const OrderedJson& mode) {
  say("mode      {}: {}{}: {}\n", text(mode["name"]), text(mode["mode"]),
      mode["of"].is_null() ? "" : " of " + text(mode["of"]), sentence(text(mode["because"])));
  std::string properties;
  for (const char* key : {"strength", "friction", "viscosity"}) {
    if (!mode.contains(key)) continue;
    const std::string unit = key == std::string("friction") ? "" : " N";
    properties +=
        (properties.empty() ? "" : "; ") + std::string(key) + " " + transferText(mode[key]) + unit;
  }
  if (!mode["contact"].is_null()) properties += "; contact " + text(mode["contact"]);
  if (!properties.empty()) say("          {}\n", sentence(properties));
  for (const OrderedJson& primitive : mode["primitives"]) {
    std::string where;
    if (primitive.contains("position")) where += " at " + text(primitive["position"]);
    if (primitive.contains("direction")) where += " along " + text(primitive["direction"]);
    say("primitive {}, a {}{}, strength {} N: {}, load {} ({} N)\n", text(primitive["role"]),
        text(primitive["kind"]), where, text(primitive["strength"]), text(primitive["state"]),
        text(primitive["load"]), text(primitive["size"]));
  }
}

/// Returns true if a vector is large enough to print [N].
bool told(const OrderedJson& force) {
  constexpr double kLeast = 1e-9;
  return std::any_of(force.begin(), force.end(),
                     [](const OrderedJson& x) { return std::abs(x.get<double>()) > kLeast; });
}

void printBalance(const OrderedJson& json) {
  const OrderedJson& balance = json["balance"];
  say("balance   {}, {} iterations, {} sub-steps, within {} m of the exact one; {}\n",
      text(balance["solver"]), balance["iterations"].get<int>(), balance["substeps"].get<int>(),
      rounded(balance["error_bound"].get<double>()), text(balance["status"]));
  std::string stiffness = text(balance["stiffness"]);
  if (balance.contains("stiffness_by")) {
    stiffness += " now, wanted " + text(balance["stiffness_by"]["value"]);
  }
  say("stiffness {} N/m\n", stiffness);
  say("proxy     {}; hand {}\n", text(balance["proxy"]), text(json["hand"]));
  say("spring    {} N; the loads add up to {} N, {} N left over\n", text(balance["spring"]),
      text(balance["loads"]), text(balance["left_over"]));
  if (told(balance["waiting"])) {
    say("waiting   {} N: minus the pull that is left along a stream\n", text(balance["waiting"]));
  }
  const OrderedJson& force = json["force"];
  const OrderedJson& limiter = force["limiter"];
  say("damper    {} N\n", text(force["damper"]));
  say("limiter   {} (peak {} N, growth {} N a tick)\n",
      limiter["slewed"].get<bool>()   ? "held the growth back"
      : limiter["peaked"].get<bool>() ? "cut to the peak"
                                      : "did nothing",
      text(limiter["peak"]), text(limiter["growth"]));
  say("energy    {} J added by the proxy's own motion\n", text(balance["injected_energy"]));
  say("force     {} N, {} N\n", text(force["sent"]), text(force["size"]));
}

/// Prints how far the proxy got towards each balance; a free step is printed without further
/// details.
void printSteps(const OrderedJson& steps) {
  for (const OrderedJson& step : steps) {
    const std::string end = text(step["end"]);
    std::string yields;
    for (const OrderedJson& name : step["yields"]) yields += ", " + text(name) + " yields";
    say("step      {} {}: balance {}{}; {} {}\n",
        step["foreseen"].get<bool>() ? "remembered of" : "read at", text(step["at"]),
        text(step["balance"]), sentence(yields),
        end == "free"      ? "went to"
        : end == "voxel"   ? "as far as what was read can be trusted,"
        : end == "trusted" ? "turned back, went half as far,"
        : end == "surface" ? "a surface was met at"
                           : "other parts of the scene begin at",
        text(step["went"]));
  }
}

}  // namespace

void printTick(const OrderedJson& json) {
  say("scene     {}\n", text(json["scene"]));
  say("rest      proxy {}, {} m from --at; force {} N\n", text(json["rest"]["proxy"]),
      text(json["rest"]["moved"]), text(json["rest"]["force"]));
  say("read at   {}\n", text(json["read_at"].empty() ? json["at"] : json["read_at"].back()));
  if (json["steps"].size() > 1) printSteps(json["steps"]);
  for (const OrderedJson& field : json["fields"]) {
    say("field     {}: {}, {}; for {}\n", text(field["field"]),
        field["sampled"].get<bool>() ? "sampled" : "not sampled", sentence(text(field["because"])),
        cli::sentence(text(field["for"])));
  }
  for (const OrderedJson& name : json["left_out"]) {
    say("field     {}: not sampled, no mode reads it\n", text(name));
  }
  for (const OrderedJson& property : json["properties"]) {
    say("property  {}: {}\n", text(property["property"]),
        property["inside"].get<bool>() ? text(property["value"]) : "no data");
  }
  for (const OrderedJson& mode : json["modes"]) printMode(mode);
  for (const OrderedJson& name : json["silent"]) {
    say("mode      {}: left out, its strength is zero everywhere\n", text(name));
  }
  printBalance(json);
  for (const OrderedJson& line : json["because"]) say("because   {}\n", sentence(text(line)));
}

}  // namespace palpate::cli
