#include <array>
#include <cmath>
#include <cstdint>
#include <variant>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/samplers/grid/open_cells.h"
#include "palpate/scenes/apps/cli/room.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/apps/common/touch.h"
#include "palpate/scenes/library/scene_file.h"

namespace palpate::cli {
namespace {

constexpr double kFeelRate = 1000.0;  // [Hz]: default rate of `palpate feel`

std::string describe(const TransferSpec& transfer, const std::string& unit, const std::string& by,
                     bool is_strength = false) {
  std::string text;
  // A constant strength acts only at points where the field named by the key `by` has data.
  const bool mask = is_strength && transfer.factors.size() == 1 && !by.empty();
  for (const TransferSpec::Factor& factor : transfer.factors) {
    // Only the first factor has a unit.
    const std::string in = text.empty() && !unit.empty() ? " " + unit : "";
    if (!text.empty()) text += " times ";
    if (factor.curve.isConstant()) {
      text += rounded(factor.curve.knots().front().second) + in;
      if (mask) text += " where " + by + " has data";
      continue;
    }
    std::string curve;
    for (const auto& [input, output] : factor.curve.knots()) {
      curve += (curve.empty() ? "" : ", ") + rounded(input) + " -> " + rounded(output);
    }
    text += "(";
    text += curve;
    text += ")";
    text += in;
    const std::string& reads = factor.by.empty() ? by : factor.by;
    if (!reads.empty()) text += " by " + reads;
  }
  return text;
}

/// Returns the three numbers of a vector, and 0 for -0.
std::string vectorText(const OrderedJson& v) {
  return fmt::format("{}, {}, {}", rounded(v[0].get<double>() + 0.0),
                     rounded(v[1].get<double>() + 0.0), rounded(v[2].get<double>() + 0.0));
}

std::string describe(const GuideSpec& guide, const std::string& in) {
  std::string text =
      fmt::format("{} at {}", wordFor(guide.shape), vectorText(toJson(guide.position)));
  if (guide.shape != PrimitiveKind::kPoint) {
    text += " along " + vectorText(toJson(guide.direction));
  }
  if (std::isfinite(guide.snap)) text += ", snaps within " + rounded(guide.snap);
  return text + (in.empty() ? " (metres)" : " (in the units of " + in + ")");
}

/// Describes a mode in one line. `in` names the volume whose units a guide uses; empty: metres.
std::string describe(const ModeSpec& mode, const std::string& in) {
  std::string text = wordFor(mode.kind);
  text += mode.kind == ModeKind::kGuide ? ": " + describe(mode.guide, in) : " of " + mode.of;
  if (mode.kind == ModeKind::kIsosurface) {
    text += fmt::format(" at {}, {} is solid", rounded(mode.value),
                        mode.solid == Solid::kAbove ? "above" : "below");
  }
  if (mode.kind == ModeKind::kForce && mode.sense) {
    text += *mode.sense == Sense::kAttract ? " (attract)" : " (repel)";
  } else if (mode.kind == ModeKind::kForce) {
    text += " (along a vector field, or down the gradient of a scalar field)";
  }
  if (mode.kind == ModeKind::kFrontShape && !mode.two_sided) text += " (one-sided)";
  if (mode.snap_voxels > 0.0)
    text += fmt::format(", snaps within {} voxels", rounded(mode.snap_voxels));
  text += ", strength " + describe(mode.strength, "N", mode.by, true);
  if (mode.friction.highest() > 0.0) text += ", friction " + describe(mode.friction, "", mode.by);
  if (mode.viscosity.highest() > 0.0) {
    text += ", viscosity " + describe(mode.viscosity, "N", mode.by);
  }
  return text;
}

/// Returns the names of the properties that a graph reads from one field.
std::vector<std::string> wanted(const Graph& graph, const ScalarRead& read) {
  std::vector<std::string> out;
  if (read.value >= 0) out.emplace_back("value");
  for (const int i : {read.gradient, read.cell_gradient}) {
    if (i >= 0) out.push_back(graph.vector_properties[static_cast<std::size_t>(i)]);
  }
  return out;
}
std::vector<std::string> wanted(const Graph& graph, const VectorRead& read) {
  std::vector<std::string> out;
  if (read.value >= 0) out.emplace_back("value");
  if (read.curl >= 0) out.push_back(graph.vector_properties[static_cast<std::size_t>(read.curl)]);
  for (const int i : {read.divergence, read.q, read.lambda2}) {
    if (i >= 0) out.push_back(graph.scalar_properties[static_cast<std::size_t>(i)]);
  }
  return out;
}

/// Returns the numbers of cells in which an isosurface meets missing data; null if the volume was
/// not examined.
OrderedJson edgeOf(const ModeSpec& mode, const BuiltScene& built) {
  const auto volume = built.volumes.find(mode.of);
  if (volume == built.volumes.end() || built.windows.count(mode.of) != 0) return nullptr;
  const auto found =
      findOpenCells(*volume->second, built.samplings.at(mode.of), mode.value, mode.solid);
  if (!found) return nullptr;
  OrderedJson json = {
      {"open_cells", found->count}, {"surface_cells", found->surface}, {"open_at", nullptr}};
  if (found->count > 0) json["open_at"] = toJson(built.placements.at(mode.of)(found->first_F));
  return json;
}

std::size_t instancesOf(const SceneSpec& spec, const std::string& name) {
  const auto volume = spec.volumes.find(name);
  return volume == spec.volumes.end() ? 0 : volume->second.instances.size();
}

/// Adds the reads, modes and unused fields of a graph that has `places` instances.
void addGraph(const Graph& graph, std::size_t places, const SceneSpec& spec,
              const BuiltScene& built, OrderedJson& json) {
  const auto add = [&](const char* list, OrderedJson entry) {
    if (places != 1) entry["places"] = places;
    json[list].push_back(std::move(entry));
  };
  for (std::size_t i = 0; i < graph.scalar_reads.size(); ++i) {
    add("sampled", {{"field", graph.scalar_names[i]},
                    {"properties", wanted(graph, graph.scalar_reads[i])},
                    {"for", readersOf(graph, {std::uint64_t{1} << i, 0})}});
  }
  for (std::size_t i = 0; i < graph.vector_reads.size(); ++i) {
    add("sampled", {{"field", graph.vector_names[i]},
                    {"properties", wanted(graph, graph.vector_reads[i])},
                    {"for", readersOf(graph, {0, std::uint64_t{1} << i})}});
  }
  for (const UnitStep& step : graph.units) {
    json["derived"].push_back(graph.vector_properties[static_cast<std::size_t>(step.to)]);
  }
  for (const MagnitudeStep& step : graph.magnitudes) {
    json["derived"].push_back(graph.scalar_properties[static_cast<std::size_t>(step.to)]);
  }
  for (std::size_t i = 0; i < graph.modes.size(); ++i) {
    const std::size_t source = graph.mode_sources[i];
    const auto in = spec.guide_volumes.find(source);
    const ModeSpec& mode = spec.graph.modes[source];
    OrderedJson entry = {
        {"name", graph.mode_names[i]},
        {"does", describe(mode, in == spec.guide_volumes.end() ? "" : in->second)}};
    if (mode.kind == ModeKind::kIsosurface) entry["edge"] = edgeOf(mode, built);
    add("modes", entry);
  }
  for (const std::string& name : graph.silent) json["silent"].push_back(name);
  for (const std::string& name : graph.unused) json["left_out"].push_back(name);
}

OrderedJson couplingOf(const SceneSpec& spec, const BuiltScene& built) {
  OrderedJson json = {{"stiffness", built.scene->coupling.stiffness},
                      {"damping", spec.coupling.damping}};
  if (spec.graph.stiffness) {
    json["stiffness_most"] = spec.graph.stiffness->highest();
    json["stiffness_by"] = describe(*spec.graph.stiffness, "N/m", "");
  }
  // `palpate feel` uses this arm by default.
  const SimulatedDevice arm({}, {}, {[](double) { return Vec3(0, 0, 0); }, 0.0}, kFeelRate);
  json["room"] = roomFor(arm.info(), kFeelRate, stiffestCoupling(spec));
  return json;
}

void addContents(const std::string& name, const std::shared_ptr<const Volume>& grid,
                 const SceneSpec& spec, const BuiltScene& built, OrderedJson& volume) {
  const auto window = built.windows.find(name);
  const bool in_bricks = window != built.windows.end();
  const GridInfo& info = in_bricks ? window->second->manifest().info() : grid->info();
  const auto computed = built.computed.find(name);
  if (computed == built.computed.end()) {
    volume["file"] = spec.volumes.at(name).file.string();
    volume["grid"] = info.name;
  } else {
    volume["computed"] = computed->second.as;
    volume["from"] = computed->second.from;
    volume["because"] = computed->second.why;
  }
  volume["type"] = info.type;
  volume["active_voxels"] = info.active_voxels;
  volume["memory_bytes"] = in_bricks ? window->second->state().bytes : grid->memory();
  if (in_bricks) {
    volume["bricks"] = {{"levels", window->second->manifest().levels().size()},
                        {"stored_bytes", window->second->manifest().storedBytes()},
                        {"slots", window->second->state().slots}};
  }
  if (const auto played = built.sequences.find(name); played != built.sequences.end()) {
    const FrameTimes& when = played->second->times();
    const SequenceState state = played->second->state();
    volume["frames"] = {{"count", state.frames},
                        {"from", when.times.front()},
                        {"to", when.times.back()},
                        {"repeat", when.repeat},
                        {"in_memory", state.resident}};
    volume["memory_bytes"] = state.bytes;
  }
}

OrderedJson volumeOf(const std::string& name, const FieldPtr& field, const SceneSpec& spec,
                     const BuiltScene& built) {
  const FieldFrame& frame =
      std::visit([](const auto& f) -> const FieldFrame& { return f->frame(); }, field);
  OrderedJson volume;
  const auto grid = built.volumes.find(name);
  if (grid != built.volumes.end()) addContents(name, grid->second, spec, built, volume);
  const auto places = instancesOf(spec, name);
  if (places > 0) volume["instances"] = places;
  volume["metres_per_unit"] = frame.metres_per_unit;
  if (const auto placed = built.placements.find(name); placed != built.placements.end()) {
    const Placement& place = placed->second;
    const Vec3 centre = place.rotation.transpose() * place.translate / -place.scale;
    volume["at_hand_origin"] = toJson(centre);
    const Eigen::Quaterniond turn(place.rotation);
    volume["rotation_wxyz"] = {turn.w(), turn.x(), turn.y(), turn.z()};
  }
  volume["voxel"] = frame.voxel;
  volume["bounds"] = {toJson(frame.bounds.lower), toJson(frame.bounds.upper)};
  const auto motion = built.motions.find(name);
  if (motion != built.motions.end()) {
    const Motion& moves = *motion->second;
    const Box swept = moves.sweep(frame.bounds);
    volume["motion"] = {{"keyframes", moves.size()},
                        {"from", moves.from()},
                        {"to", moves.to()},
                        {"repeat", moves.repeats()},
                        {"deforms", moves.warp() != nullptr},
                        {"top_speed", moves.topSpeed(frame.bounds)},
                        {"bounds", {toJson(swept.lower), toJson(swept.upper)}}};
  }
  return volume;
}

OrderedJson report(const SceneSpec& spec, const BuiltScene& built) {
  OrderedJson json;
  json["scene"] = spec.source;
  json["status"] = "valid";
  json["coupling"] = couplingOf(spec, built);
  json["max_substeps"] = spec.step.max_substeps;
  json["tolerance_voxels"] = spec.step.tolerance_voxels;
  json["slope_reach"] = spec.slope_reach;
  json["volumes"] = OrderedJson::object();
  for (const auto& [name, field] : built.fields) {
    json["volumes"][name] = volumeOf(name, field, spec, built);
  }
  for (const char* list : {"sampled", "derived", "modes", "silent", "left_out"}) {
    json[list] = OrderedJson::array();
  }
  if (!built.sequences.empty()) {
    const PlayParams& play = built.play;
    const auto time = [](double t) { return std::isfinite(t) ? OrderedJson(t) : OrderedJson(); };
    json["play"] = {{"begin", play.begin}, {"from", time(play.from)}, {"to", time(play.to)},
                    {"speed", play.speed}, {"repeat", play.repeat},   {"paused", play.paused}};
  }
  json["parts"] = built.scene->parts.size();
  json["bounds"] = {toJson(built.bounds.lower), toJson(built.bounds.upper)};
  addGraph(built.scene->graph, 1, spec, built, json);
  for (const PartGroup& group : built.parts) {
    addGraph(built.scene->parts[group.first].graph, group.count, spec, built, json);
  }
  return json;
}

std::string placeText(const OrderedJson& at) {
  return "(" + vectorText(at) + ")";
}

std::string edgeRemark(const OrderedJson& edge) {
  if (edge.is_null() || edge["open_cells"] == 0) return "";
  const auto open = edge["open_cells"].get<std::uint64_t>();
  const double share = static_cast<double>(open) / edge["surface_cells"].get<double>();
  return fmt::format(
      "in {} cells the surface reaches the edge of its data ({:.2g} % of the surface is not felt), "
      "first at {} m: there the force drops to zero within one tick: use a wider band or a larger "
      "volume",
      open, 100.0 * share, placeText(edge["open_at"]));
}

void saySceneLines(const OrderedJson& json, bool verbose) {
  say("scene     {}: valid\n", json["scene"].get<std::string>());
  const OrderedJson& bounds = json["bounds"];
  const auto corner = [&](std::size_t i) {
    return fmt::format("{}, {}, {}", rounded(bounds[i][0].get<double>()),
                       rounded(bounds[i][1].get<double>()), rounded(bounds[i][2].get<double>()));
  };
  say("bounds    {} to {} m", corner(0), corner(1));
  if (const auto parts = json["parts"].get<std::size_t>(); parts > 0) say(", {} parts", parts);
  say("\n");
  const OrderedJson& coupling = json["coupling"];
  say("coupling  {}, {} N s/m; tolerance {} voxel, at most {} sub-steps a tick\n",
      coupling.contains("stiffness_by")
          ? sentence(coupling["stiffness_by"].get<std::string>())
          : sentence(number(coupling["stiffness"].get<double>()) + " N/m"),
      number(json["coupling"]["damping"].get<double>()),
      number(json["tolerance_voxels"].get<double>()), json["max_substeps"].get<int>());
  sayRoom(coupling["room"], 10, verbose);
}

/// Returns ", turned by 90 degrees about 0, 0, 1" for such a rotation, and "" for none.
std::string rotationText(const std::array<double, 4>& wxyz) {
  const Eigen::AngleAxisd turn(Eigen::Quaterniond(wxyz[0], wxyz[1], wxyz[2], wxyz[3]));
  if (turn.angle() < 1e-9) return "";
  return fmt::format(", turned by {} degrees about {}", rounded(turn.angle() * 180.0 / M_PI),
                     vectorText(toJson(turn.axis())));
}

void sayPlay(const OrderedJson& play) {
  const auto end = [&](const char* word) {
    return play[word].is_null() ? ""
                                : fmt::format(", {} {} s", word, rounded(play[word].get<double>()));
  };
  say("play      begins at {} s{}{}, {} s/s{}{}\n", rounded(play["begin"].get<double>()),
      end("from"), end("to"), rounded(play["speed"].get<double>()),
      play["repeat"].get<bool>() ? ", repeated" : "", play["paused"].get<bool>() ? ", paused" : "");
}

void sayVolume(const std::string& name, const OrderedJson& volume) {
  say("volume    {}: ", name);
  if (volume.contains("file")) {
    say("grid \"{}\" of {}", volume["grid"].get<std::string>(), volume["file"].get<std::string>());
  } else if (volume.contains("computed")) {
    say("{}, computed once at load because {}", volume["computed"].get<std::string>(),
        sentence(volume["because"].get<std::string>()));
  }
  if (volume.contains("type")) {
    say(", {}, {} active voxels, {} MB; ", volume["type"].get<std::string>(),
        volume["active_voxels"].get<std::uint64_t>(),
        rounded(volume["memory_bytes"].get<double>() / 1e6));
  }
  if (volume.contains("bricks")) {
    const OrderedJson& bricks = volume["bricks"];
    say("in bricks, {} MB stored in {} levels, at most {} bricks in memory; ",
        rounded(bricks["stored_bytes"].get<double>() / 1e6), bricks["levels"].get<std::size_t>(),
        bricks["slots"].get<std::uint64_t>());
  }
  if (volume.contains("frames")) {
    const OrderedJson& frames = volume["frames"];
    say("{} frames, {} to {} s{}, {} of them in memory; ", frames["count"].get<std::uint64_t>(),
        rounded(frames["from"].get<double>()), rounded(frames["to"].get<double>()),
        frames["repeat"].get<bool>() ? ", repeated" : "", frames["in_memory"].get<std::uint64_t>());
  }
  say("voxel edge {} mm (the smallest), {} mm per unit of the file",
      rounded(1e3 * volume["voxel"].get<double>()),
      rounded(1e3 * volume["metres_per_unit"].get<double>()));
  if (volume.contains("at_hand_origin")) {
    say("; 0, 0, 0 of the hand is {} of the file", vectorText(volume["at_hand_origin"]));
    say("{}", rotationText(volume["rotation_wxyz"].get<std::array<double, 4>>()));
  }
  if (volume.contains("instances")) {
    say(" (of the first of {} instances)", volume["instances"].get<std::size_t>());
  }
  say("\n");
}

void sayMotion(const std::string& name, const OrderedJson& motion) {
  std::string how = motion["deforms"].get<bool>() ? "deforms" : "";
  if (how.empty() || motion["keyframes"].get<std::size_t>() > 1) {
    how += fmt::format("{}{} keyframes, {} to {} s{}", how.empty() ? "" : ", ",
                       motion["keyframes"].get<std::size_t>(),
                       rounded(motion["from"].get<double>()), rounded(motion["to"].get<double>()),
                       motion["repeat"].get<bool>() ? ", repeated" : "");
  }
  say("moves     {}: {}, at most {} m/s\n", name, how, rounded(motion["top_speed"].get<double>()));
}

void saySampled(const OrderedJson& sampled) {
  const auto list = [](const OrderedJson& names) {
    std::string text;
    for (const auto& name : names) text += (text.empty() ? "" : ", ") + name.get<std::string>();
    return sentence(text);
  };
  say("samples   {}: {}; used by {}\n", sampled["field"].get<std::string>(),
      list(sampled["properties"]), list(sampled["for"]));
}

void sayMode(const OrderedJson& mode) {
  say("mode      {}: {}", mode["name"].get<std::string>(),
      sentence(mode["does"].get<std::string>()));
  if (mode.contains("places")) {
    say("; {} instances, active near the hand", mode["places"].get<std::size_t>());
  }
  say("\n");
  if (!mode.contains("edge")) return;
  const std::string edge = edgeRemark(mode["edge"]);
  if (!edge.empty()) say("edge      {}: {}\n", mode["name"].get<std::string>(), sentence(edge));
}

void sayLeftOut(const OrderedJson& json) {
  for (const auto& silent : json["silent"]) {
    say("skipped   mode {}: its strength is zero everywhere\n", silent.get<std::string>());
  }
  for (const auto& left_out : json["left_out"]) {
    const std::string unused = left_out.get<std::string>();
    std::string uses;
    for (const auto& [name, volume] : json["volumes"].items()) {
      if (volume.value("from", "") == unused) uses += (uses.empty() ? "" : ", ") + name;
    }
    say("skipped   {}: no mode reads it{}\n", unused,
        sentence(uses.empty() ? "" : "; at load it was the source of " + uses));
  }
}

void printCheck(const OrderedJson& json, bool verbose) {
  saySceneLines(json, verbose);
  for (const auto& [name, volume] : json["volumes"].items()) {
    sayVolume(name, volume);
    if (volume.contains("motion")) sayMotion(name, volume["motion"]);
  }
  if (json.contains("play")) sayPlay(json["play"]);
  for (const auto& sampled : json["sampled"]) saySampled(sampled);
  for (const auto& derived : json["derived"]) {
    say("derives   {}\n", derived.get<std::string>());
  }
  for (const auto& mode : json["modes"]) sayMode(mode);
  sayLeftOut(json);
}

}  // namespace

void addCheck(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb =
      app.add_subcommand("check", "Validates a scene; prints its volumes, properties and modes");
  auto scene = std::make_shared<std::string>();
  auto json = std::make_shared<bool>(false);
  auto verbose = std::make_shared<bool>(false);
  verb->add_option("SCENE", *scene, "A scene file, a .vdb, or a folder of .vdb or bricks")
      ->required();
  verb->add_flag("-v,--verbose", *verbose, "Also print the numbers behind the stability margin");
  verb->add_flag("--json", *json, "Print JSON");
  verb->footer("Example:\n  palpate check head.json");
  verb->callback([=, &body] {
    body = [=] {
      SceneSpec spec = openScene(*scene, showProgress("loading"));
      spec.waits = true;
      for (const std::string& note : spec.notes) complain(note);
      const BuiltScene built = buildScene(spec, showProgress("loading"));
      for (const std::string& note : built.notes) complain(note);
      std::function<void(double)> progress = showProgress("measuring");
      const OrderedJson out = report(spec, built);
      progress = nullptr;
      if (const OrderedJson& room = out["coupling"]["room"];
          !room.is_null() && (swingsUp(room) || exceedsDevice(room))) {
        complain("check: " + roomWords(room));
      }
      if (*json) {
        sayJson(out);
      } else {
        printCheck(out, *verbose);
      }
      return kDone;
    };
  });
}

}  // namespace palpate::cli
