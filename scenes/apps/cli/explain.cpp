#include "palpate/scenes/apps/cli/explain.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <string>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/cli/feel.h"
#include "palpate/scenes/apps/cli/feel_options.h"
#include "palpate/scenes/apps/cli/slow_rate.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/apps/common/explain_tick.h"
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

/// Formats a transfer function, for example "2 (1.5 where speed is 0.3, times 1.33)".
std::string transferText(const OrderedJson& transfer) {
  std::string factors;
  for (const OrderedJson& factor : transfer["factors"]) {
    if (!factors.empty()) factors += ", times ";
    factors += text(factor["output"]);
    if (!factor.contains("reads")) continue;
    const std::string reads = text(factor["reads"]);
    factors += factor["input"].is_null() ? " because " + reads + " has no data"
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

bool told(const OrderedJson& force) {
  constexpr double kLeast = 1e-9;
  return std::any_of(force.begin(), force.end(),
                     [](const OrderedJson& x) { return std::abs(x.get<double>()) > kLeast; });
}

void printBalance(const OrderedJson& json) {
  const OrderedJson& balance = json["balance"];
  say("balance   {}, {} iterations, {} sub-steps, error at most {} m; {}\n",
      text(balance["solver"]), balance["iterations"].get<int>(), balance["substeps"].get<int>(),
      rounded(balance["error_bound"].get<double>()), text(balance["status"]));
  std::string stiffness = text(balance["stiffness"]);
  if (balance.contains("stiffness_by")) {
    stiffness += " now, target " + text(balance["stiffness_by"]["value"]);
  }
  say("stiffness {} N/m\n", stiffness);
  say("proxy     {} m; hand {} m\n", text(balance["proxy"]), text(json["hand"]));
  say("spring    {} N; sum of the loads {} N, residual {} N\n", text(balance["spring"]),
      text(balance["loads"]), text(balance["left_over"]));
  if (told(balance["waiting"])) {
    say("waiting   {} N: part of the spring's force along a streamline that the loads do not "
        "balance "
        "yet: the next tick continues\n",
        text(balance["waiting"]));
  }
  const OrderedJson& force = json["force"];
  const OrderedJson& limiter = force["limiter"];
  say("damper    {} N\n", text(force["damper"]));
  say("limiter   {} (limits: peak {} N, growth {} N a tick)\n",
      limiter["slewed"].get<bool>()    ? "limited the growth"
      : limiter["peaked"].get<bool>()  ? "reduced the force to the peak"
      : limiter["heated"].get<bool>()  ? "reduced the force because the motors are hot"
      : limiter["ramped"].get<bool>()  ? "reduced the force by an engagement"
      : limiter["drained"].get<bool>() ? "reduced the force by the energy tank"
                                       : "inactive",
      text(limiter["peak"]), text(limiter["growth"]));
  say("energy    {} J added by the proxy's own motion\n", text(balance["injected_energy"]));
  say("force     {} N, magnitude {} N", text(force["sent"]), text(force["size"]));
  if (told(force["damper"]) || limiter["slewed"].get<bool>()) {
    const OrderedJson& spring = balance["spring"];
    const double size =
        std::hypot(spring[0].get<double>(), spring[1].get<double>(), spring[2].get<double>());
    say(" in this tick; {} N by the spring alone", shown(size));
  }
  say("\n");
}

void printSteps(const OrderedJson& steps) {
  for (const OrderedJson& step : steps) {
    const std::string end = text(step["end"]);
    std::string yields;
    for (const OrderedJson& name : step["yields"]) yields += ", " + text(name) + " yields";
    say("step      {} {}: balance {}{}; {} {}\n",
        step["foreseen"].get<bool>() ? "no reading, at" : "read at", text(step["at"]),
        text(step["balance"]), sentence(yields),
        end == "free"      ? "moved to"
        : end == "voxel"   ? "stopped where the reading's valid range ends,"
        : end == "trusted" ? "shortened, because the previous step turned back, to"
        : end == "surface" ? "met a surface at"
                           : "reached other parts of the scene at",
        text(step["went"]));
  }
}

void printTick(const OrderedJson& json) {
  say("scene     {}\n", text(json["scene"]));
  for (const OrderedJson& line : json["because"]) say("because   {}\n", sentence(text(line)));
  const OrderedJson& rest = json["rest"];
  if (json["time"].is_null()) {
    say("rest      proxy at {} m, {} m from --at; force {} N\n", text(rest["proxy"]),
        text(rest["moved"]), text(rest["force"]));
  } else {
    say("time      {} s\n", number(json["time"].get<double>()));
    say("before    proxy at {} m, hand at {} m; force {} N\n", text(rest["proxy"]),
        text(json["at"]), text(rest["force"]));
  }
  say("read at   {} m\n", text(json["read_at"].empty() ? json["at"] : json["read_at"].back()));
  if (json["steps"].size() > 1) printSteps(json["steps"]);
  for (const OrderedJson& field : json["fields"]) {
    say("field     {}: {}, {}; used by {}\n", text(field["field"]),
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
    say("mode      {}: skipped, its strength is zero everywhere\n", text(name));
  }
  printBalance(json);
}

struct ExplainOptions {
  FeelOptions run;  ///< The scene, the rate and `json`, and with --until the run.
  std::optional<std::string> at;
  std::optional<std::string> push;
};

int explain(const ExplainOptions& options) {
  const FeelOptions& run = options.run;
  if (run.until && (options.at || options.push)) {
    throw Error("--until", "it explains a tick of a run, and --at and --push a single tick",
                "give either --until, or --at and --push");
  }
  if (run.until) {
    if (!(*run.until >= 0.0 && *run.until <= kMostFeelSeconds)) {
      throw Error("--until", fmt::format("{} s is not in 0 to 1000000 s", *run.until), "use 1");
    }
    return feel(run);
  }
  if (!options.at || !options.push) {
    throw Error(!options.at ? "--at" : "--push", "it is required without --until",
                "give --at x,y,z and --push x,y,z, or --until SECONDS");
  }
  if (run.seconds || run.passive || run.refill > 0.0 || run.devices != FeelOptions().devices) {
    throw Error("--until", "only a run has a --device, --seconds, --passive and --refill",
                "add --until SECONDS instead of --at and --push");
  }
  checkRate("--rate", run.rate);
  noteSlowRate("explain", run.rate);
  const Vec3 at = readVector("--at", *options.at);
  const Vec3 push = readVector("--push", *options.push);
  checkReach("--push", at + push);
  return sayExplained(explainTick(openScene(run.scene, showProgress("loading")), at, push, run.rate,
                                  showProgress("loading"), complainOf),
                      run.json);
}

}  // namespace

int sayExplained(const Explained& told, bool json) {
  if (json) {
    sayJson(told.json);
  } else {
    printTick(told.json);
  }
  if (!told.fault) return kDone;
  complain(
      told.json["time"].is_null()
          ? "explain: the force was cut: a sample or a force was not finite: correct the volume"
          : "explain: the force is cut in this tick");
  return kEndedEarly;
}

void addExplain(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand(
      "explain", "Explains the force of one tick: of a run (--until), or of a single push");
  auto options = std::make_shared<ExplainOptions>();
  FeelOptions& run = options->run;
  verb->add_option("SCENE", run.scene, "A scene file, a .vdb, or a folder of .vdb or bricks")
      ->required();
  verb->add_option("--at", options->at,
                   "x,y,z: position at which the hand rests before the push [m]");
  verb->add_option("--push", options->push,
                   "x,y,z: the hand's move from --at in the explained tick [m]");
  verb->add_option("--until", run.until,
                   "Repeat a run of palpate feel, and explain the tick at this time [s]. Give the "
                   "run's other options too");
  verb->add_option("--device", run.devices,
                   "With --until: simulated (default), path:FILE.csv or replay:FILE; if repeated, "
                   "the first hand is explained")
      ->take_all()
      ->type_name("D");
  verb->add_option("--seconds", run.seconds, "With --until: length of the whole run [s]");
  verb->add_flag("--passive", run.passive, "With --until: as in palpate feel");
  verb->add_option("--refill", run.refill, "With --until: as in palpate feel [W]");
  addRate(*verb, run);
  verb->add_flag("--json", run.json, "Print JSON");
  verb->footer(
      "Examples:\n  palpate explain head.json --until 2.5\n  palpate explain head.json --at "
      "0,0,0.05 --push 0,0.001,-0.002");
  verb->callback([=, &body] { body = [=] { return explain(*options); }; });
}

}  // namespace palpate::cli
