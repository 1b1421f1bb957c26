/// palpate check: validates a scene and prints what a tick will do, and why.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <variant>

#include <fmt/format.h>

#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/samplers/grid/ghosts.h"
#include "palpate/samplers/grid/thickness.h"
#include "palpate/scenes/apps/cli/room.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/apps/common/touch.h"
#include "palpate/scenes/library/frames.h"
#include "palpate/scenes/library/scene_file.h"

namespace palpate::cli {
namespace {

constexpr double kFeelRate = 1000.0;  // [Hz]

std::string describe(const TransferSpec& transfer, const std::string& unit, const std::string& by,
                     bool is_strength = false) {
  std::string text;
  // A constant strength acts where the mode's `by` has data.
  const bool mask = is_strength && transfer.factors.size() == 1 && !by.empty();
  for (const TransferSpec::Factor& factor : transfer.factors) {
    if (!text.empty()) text += " times ";
    if (factor.curve.isConstant()) {
      text += rounded(factor.curve.knots().front().second);
      if (mask) text += " where " + by + " has data";
      continue;
    }
    std::string curve;
    for (const auto& [input, output] : factor.curve.knots()) {
      curve += (curve.empty() ? "" : ", ") + rounded(input) + " -> " + rounded(output);
    }
    text += "(" + curve + ")";
    const std::string& reads = factor.by.empty() ? by : factor.by;
    if (!reads.empty()) text += " by " + reads;
  }
  return unit.empty() ? text : text + " " + unit;
}

std::string describe(const GuideSpec& guide, const std::string& in) {
  const auto vector = [](const Vec3& v) {
    return fmt::format("{}, {}, {}", rounded(v.x()), rounded(v.y()), rounded(v.z()));
  };
  std::string text = fmt::format("{} at {}", wordFor(guide.shape), vector(guide.position));
  if (guide.shape != PrimitiveKind::kPoint) text += " along " + vector(guide.direction);
  if (std::isfinite(guide.snap)) text += ", within " + rounded(guide.snap);
  return text + (in.empty() ? " (metres)" : " (in the units of " + in + ")");
}

/// `in`: the volume that defines a guide's units.
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
    text += " (along a vector, down a scalar's gradient)";
  }
  if (mode.kind == ModeKind::kFrontShape && !mode.two_sided) text += " (one-sided)";
  if (mode.snap_voxels > 0.0)
    text += fmt::format(", snaps at {} voxels", rounded(mode.snap_voxels));
  text += ", strength " + describe(mode.strength, "N", mode.by, true);
  if (mode.friction.highest() > 0.0) text += ", friction " + describe(mode.friction, "", mode.by);
  if (mode.viscosity.highest() > 0.0) {
    text += ", viscosity " + describe(mode.viscosity, "N", mode.by);
  }
  return text;
}

/// Returns the properties that the compiled graph reads from each field, as text.
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

/// This share of a surface may lie where the other frame has no data: edges of the scan.
constexpr double kLeft = 0.01;

/// Result of blending a surface between two frames.
struct Blended {
  std::size_t mode = 0;
  int pairs = 0;        ///< Frame steps with ghosts,
  int pieces = 0;       ///< the number of their pieces,
  Ghosts worst;         ///< the worst of them,
  std::size_t at = 0;   ///< after this frame.
  int left = 0;         ///< Steps in which it lies where the other frame has no data,
  double beyond = 0.0;  ///< with at most this share of it.

  void add(const Volume& last, const Volume& next, const ModeSpec& of, std::size_t after) {
    const Ghosts found =
        ghostsBetween(last, next, of.value, of.solid == Solid::kAbove ? -1.0 : 1.0);
    pairs += found.pieces > 0 ? 1 : 0;
    pieces += found.pieces;
    const double out = surfaceBeyondData(last, next, of.value);
    left += out > kLeft ? 1 : 0;
    beyond = std::max(beyond, out);
    if (found.share <= worst.share) return;
    worst = found;
    at = after;
  }
};

/// Reports the matter of a sequence's isosurfaces that a blend of two frames cannot move. Loads
/// each frame.
OrderedJson ghostsOf(const std::string& name, const SceneSpec& spec, const BuiltScene& built) {
  const Placement& place = built.placements.at(name);
  const std::vector<ModeSpec>& modes = spec.graph.modes;
  std::vector<VolumeRequest> frames = framesOf(spec.volumes.at(name));
  if (built.sequences.at(name)->times().repeat) frames.push_back(frames.front());
  std::vector<Blended> surfaces;
  for (std::size_t i = 0; i < modes.size(); ++i) {
    if (modes[i].kind == ModeKind::kIsosurface && modes[i].of == name)
      surfaces.emplace_back().mode = i;
  }
  OrderedJson all = OrderedJson::array();
  if (surfaces.empty()) return all;
  std::shared_ptr<const Volume> last;
  for (std::size_t frame = 0; frame < frames.size(); ++frame) {
    const VolumeRequest& of = frames[frame];
    const auto next = loadVolume(of.file, of.grid, {of.non_finite, of.smooth, nullptr});
    if (last != nullptr) {
      for (Blended& one : surfaces) one.add(*last, *next, modes[one.mode], frame - 1);
    }
    last = next;
  }
  for (const Blended& one : surfaces) {
    if (one.pairs == 0 && one.left == 0) continue;
    const std::string& mode = modes[one.mode].name;
    all.push_back({{"of", mode.empty() ? fmt::format("/modes/{}", one.mode) : mode},
                   {"pairs", one.pairs},
                   {"beyond_pairs", one.left},
                   {"beyond", one.beyond},
                   {"of_pairs", frames.size() - 1},
                   {"pieces", one.pieces},
                   {"share", one.worst.share},
                   {"after", one.at},
                   {"at", toJson(place(one.worst.where))},
                   {"size", place.scale * one.worst.size}});
  }
  return all;
}

/// Returns the thickness of an isosurface's solid; null if it cannot be determined.
OrderedJson thicknessOf(const ModeSpec& mode, const SceneSpec& spec, const BuiltScene& built) {
  const auto volume = built.volumes.find(mode.of);
  if (volume == built.volumes.end() || built.windows.count(mode.of) != 0) return nullptr;
  // A computed volume is sampled as its source.
  const auto computed = built.computed.find(mode.of);
  const std::string& source = computed == built.computed.end() ? mode.of : computed->second.from;
  const auto found =
      measureThickness(volume->second, spec.volumes.at(source).sampling, mode.value, mode.solid);
  if (!found) return nullptr;
  const Placement& place = built.placements.at(mode.of);
  OrderedJson json = {{"surface_cells", found->surface_cells}, {"thin_cells", found->thin_cells},
                      {"below_one", found->below_one},         {"crowd", found->crowd},
                      {"open_cells", found->open_cells},       {"open_at", nullptr}};
  if (found->open_cells > 0) json["open_at"] = toJson(place(found->open_F));
  for (const char* key :
       {"tenth", "least", "thinnest", "thinnest_file", "crowd_at", "crowd_at_file", "remedy"}) {
    json[key] = nullptr;
  }
  if (found->thin_cells > 0) {
    json["tenth"] = found->tenth;
    json["least"] = found->least;
    json["thinnest"] = toJson(place(found->thinnest_F));
    json["thinnest_file"] = toJson(found->thinnest_F);
    json["crowd_at"] = toJson(place(found->crowd_F));
    json["crowd_at_file"] = toJson(found->crowd_F);
    json["remedy"] = fmt::format("take a {} value, or import it with a smaller --voxel",
                                 mode.solid == Solid::kAbove ? "lower" : "higher");
  }
  return json;
}

/// Returns the longest edge of a voxel, or twice that if slopes reach a voxel [m].
double longestEdge(const FieldFrame& frame) {
  const double edge = 2.0 * frame.reach.colwise().norm().maxCoeff();
  return std::max(frame.voxel, edge);
}

/// Returns the gaps between isosurfaces of different volumes, if both rest or share one motion. A
/// gap counts if at least kFacing of the smaller surface has one.
OrderedJson gapsOf(const SceneSpec& spec, const BuiltScene& built) {
  constexpr double kFacing = 0.05;
  constexpr int kMostPairs = 256;  // a pair of heads takes a second
  OrderedJson gaps = OrderedJson::array();
  const auto motion_of = [&](const std::string& name) {
    const auto found = built.motions.find(name);
    return found == built.motions.end() ? nullptr : found->second.get();
  };
  const auto is_solid = [&](const ModeSpec& mode) {
    return mode.kind == ModeKind::kIsosurface && mode.strength.highest() > 0.0 &&
           built.volumes.count(mode.of) != 0 && built.windows.count(mode.of) == 0 &&
           built.sequences.count(mode.of) == 0 && spec.volumes.count(mode.of) != 0 &&
           spec.volumes.at(mode.of).instances.empty();
  };
  const auto across = [&](const ModeSpec& from, const ModeSpec& to) {
    const auto& other = *std::get<0>(built.fields.at(to.of));
    return measureGap(built.volumes.at(from.of), built.samplings.at(from.of), from.value,
                      from.solid, built.placements.at(from.of), other, to.value, to.solid);
  };
  const std::vector<ModeSpec>& modes = spec.graph.modes;
  int pairs = 0;
  for (std::size_t i = 0; i < modes.size(); ++i) {
    for (std::size_t j = i + 1; j < modes.size(); ++j) {
      const ModeSpec& one = modes[i];
      const ModeSpec& two = modes[j];
      if (one.of == two.of || !is_solid(one) || !is_solid(two)) continue;
      if (motion_of(one.of) != motion_of(two.of)) continue;
      const FieldFrame& frame = std::get<0>(built.fields.at(one.of))->frame();
      const FieldFrame& facing = std::get<0>(built.fields.at(two.of))->frame();
      const Vec3 beyond = Vec3::Constant(kGap * std::max(longestEdge(frame), longestEdge(facing)));
      const bool near =
          ((frame.bounds.lower - beyond).array() <= facing.bounds.upper.array()).all() &&
          ((frame.bounds.upper + beyond).array() >= facing.bounds.lower.array()).all();
      if (!near || ++pairs > kMostPairs) continue;
      const std::optional<Gap> out = across(one, two);
      const std::optional<Gap> back = across(two, one);
      if (!out || !back) continue;
      const auto area = [](const Gap& gap, const FieldFrame& of) {
        return static_cast<double>(gap.surface_cells) * longestEdge(of) * longestEdge(of);
      };
      const bool first = area(*out, frame) <= area(*back, facing);
      const Gap& gap = first ? *out : *back;
      const ModeSpec& of = first ? one : two;
      if (!(static_cast<double>(gap.facing_cells) >
            kFacing * static_cast<double>(gap.surface_cells))) {
        continue;
      }
      const auto name = [&](const ModeSpec& mode, std::size_t index) {
        return mode.name.empty() ? fmt::format("/modes/{}", index) : mode.name;
      };
      gaps.push_back({{"between", {name(one, i), name(two, j)}},
                      {"surface_cells", gap.surface_cells},
                      {"facing_cells", gap.facing_cells},
                      {"median", gap.median},
                      {"widest", gap.widest},
                      {"widest_metres", built.placements.at(of.of).scale * gap.length_F},
                      {"widest_at", toJson(built.placements.at(of.of)(gap.widest_F))}});
    }
  }
  return gaps;
}

/// Returns the number of instances of a volume that has its own; 0: no instances.
std::size_t instancesOf(const SceneSpec& spec, const std::string& name) {
  const auto volume = spec.volumes.find(name);
  return volume == spec.volumes.end() ? 0 : volume->second.instances.size();
}

/// Adds a graph's reads and actions; `places` is the number of its instances.
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
    if (mode.kind == ModeKind::kIsosurface) entry["thickness"] = thicknessOf(mode, spec, built);
    add("modes", entry);
  }
  for (const std::string& name : graph.silent) json["silent"].push_back(name);
  for (const std::string& name : graph.unused) json["left_out"].push_back(name);
}

OrderedJson report(const SceneSpec& spec, const BuiltScene& built) {
  OrderedJson json;
  json["scene"] = spec.source;
  json["status"] = "valid";
  json["coupling"] = {{"stiffness", built.scene->coupling.stiffness},
                      {"damping", spec.coupling.damping}};
  if (spec.graph.stiffness) {
    json["coupling"]["stiffness_most"] = spec.graph.stiffness->highest();
    json["coupling"]["stiffness_by"] = describe(*spec.graph.stiffness, "N/m", "");
  }
  // The arm on which feel tries a scene.
  const SimulatedDevice arm({}, {}, {[](double) { return Vec3(0, 0, 0); }, 0.0}, kFeelRate);
  json["coupling"]["room"] = roomFor(arm.info(), kFeelRate, stiffestCoupling(spec));
  json["max_substeps"] = spec.step.max_substeps;
  json["tolerance_voxels"] = spec.step.tolerance_voxels;
  json["slope_reach"] = spec.slope_reach;
  json["volumes"] = OrderedJson::object();
  for (const auto& [name, field] : built.fields) {
    const FieldFrame& frame =
        std::visit([](const auto& f) -> const FieldFrame& { return f->frame(); }, field);
    OrderedJson volume;
    const auto grid = built.volumes.find(name);
    if (grid != built.volumes.end()) {
      const auto window = built.windows.find(name);
      const bool in_bricks = window != built.windows.end();
      const GridInfo& info = in_bricks ? window->second->manifest().info() : grid->second->info();
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
      volume["memory_bytes"] = in_bricks ? window->second->state().bytes : grid->second->memory();
      if (in_bricks) {
        volume["bricks"] = {{"levels", window->second->manifest().levels().size()},
                            {"stored_bytes", window->second->manifest().storedBytes()},
                            {"slots", window->second->state().slots}};
      }
      if (const auto played = built.sequences.find(name); played != built.sequences.end()) {
        const FrameTimes& when = played->second->times();
        const SequenceState state = played->second->state();
        volume["frames"] = {{"count", state.frames},       {"from", when.times.front()},
                            {"to", when.times.back()},     {"repeat", when.repeat},
                            {"in_memory", state.resident}, {"ghosts", ghostsOf(name, spec, built)}};
        volume["memory_bytes"] = state.bytes;
      }
    }
    const auto places = instancesOf(spec, name);
    if (places > 0) volume["instances"] = places;
    volume["metres_per_unit"] = frame.metres_per_unit;
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
    json["volumes"][name] = volume;
  }
  for (const char* list : {"sampled", "derived", "modes", "silent", "left_out"}) {
    json[list] = OrderedJson::array();
  }
  json["parts"] = built.scene->parts.size();
  json["bounds"] = {toJson(built.bounds.lower), toJson(built.bounds.upper)};
  addGraph(built.scene->graph, 1, spec, built, json);
  for (const PartGroup& group : built.parts) {
    addGraph(built.scene->parts[group.first].graph, group.count, spec, built, json);
  }
  json["gaps"] = gapsOf(spec, built);
  return json;
}

/// Returns a place [m] of the report as text.
std::string placeText(const OrderedJson& at) {
  return fmt::format("({}, {}, {})", rounded(at[0].get<double>()), rounded(at[1].get<double>()),
                     rounded(at[2].get<double>()));
}

/// Returns a warning about a surface that leaves its data; empty if it does not.
std::string edgeRemark(const OrderedJson& thickness) {
  if (thickness.is_null() || thickness["open_cells"] == 0) return "";
  return fmt::format(
      "the surface leaves its data in {} cells, first at {}: the force ends there in one tick: "
      "give a wider band or larger data",
      thickness["open_cells"].get<std::uint64_t>(), placeText(thickness["open_at"]));
}

/// Returns a warning about a thin solid; empty if it is thick everywhere.
std::string remark(const OrderedJson& thickness) {
  if (thickness.is_null()) return "not looked at: only trilinear volumes in memory are";
  const auto thin = thickness["thin_cells"].get<std::uint64_t>();
  if (thin == 0) return "";
  const auto cells = thickness["surface_cells"].get<std::uint64_t>();
  const auto place = [&](const char* key) { return placeText(thickness[key]); };
  return fmt::format(
      "{} surface cells; {} ({} %) thinner than {} voxels, {} of them than 1, most together at "
      "{}, the thinnest {:.2g} at {}: a fast hand can pass there: {}",
      cells, thin, rounded(100.0 * static_cast<double>(thin) / static_cast<double>(cells)), kThick,
      thickness["below_one"].get<std::uint64_t>(), place("crowd_at"),
      thickness["least"].get<double>(), place("thinnest"), thickness["remedy"].get<std::string>());
}

void sayGhosts(const OrderedJson& of) {
  const OrderedJson& at = of["at"];
  if (of["pairs"].get<int>() > 0) {
    say("ghosts    {}: {} pieces of matter, in {} of {} steps from frame to frame, move farther "
        "than their own width, most of all after frame {}, {} % of the matter, one of {} mm at "
        "({}, "
        "{}, {}): between frames they fade away and in again: give more frames, or a displacement "
        "field (\"warp\")\n",
        of["of"].get<std::string>(), of["pieces"].get<int>(), of["pairs"].get<int>(),
        of["of_pairs"].get<std::size_t>(), of["after"].get<std::size_t>(),
        rounded(100.0 * of["share"].get<double>()), rounded(1e3 * of["size"].get<double>()),
        rounded(at[0].get<double>()), rounded(at[1].get<double>()), rounded(at[2].get<double>()));
  }
  if (of["beyond_pairs"].get<int>() > 0) {
    say("ghosts    {}: in {} of {} steps from frame to frame the surface, up to {} % of it, comes "
        "to where the other frame has no data: there it gives way under a hand between them: give "
        "more frames, a wider band, or volumes with data all around\n",
        of["of"].get<std::string>(), of["beyond_pairs"].get<int>(),
        of["of_pairs"].get<std::size_t>(), rounded(100.0 * of["beyond"].get<double>()));
  }
}

void sayGap(const OrderedJson& gap) {
  say("gap       {} and {}: {} of {} surface cells face the other solid across a gap, median "
      "{:.2f} voxels, widest {:.2f} ({} mm) at {}: a hand catches or falls in there: where they "
      "are "
      "one body, give values at which they overlap by two voxels\n",
      gap["between"][0].get<std::string>(), gap["between"][1].get<std::string>(),
      gap["facing_cells"].get<std::uint64_t>(), gap["surface_cells"].get<std::uint64_t>(),
      gap["median"].get<double>(), gap["widest"].get<double>(),
      rounded(1e3 * gap["widest_metres"].get<double>()), placeText(gap["widest_at"]));
}

void printCheck(const OrderedJson& json, bool verbose) {
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
  say("coupling  {}, {} N s/m; motion to {} voxel, at most {} sub-steps a tick\n",
      coupling.contains("stiffness_by")
          ? sentence(coupling["stiffness_by"].get<std::string>())
          : sentence(number(coupling["stiffness"].get<double>()) + " N/m"),
      number(json["coupling"]["damping"].get<double>()),
      number(json["tolerance_voxels"].get<double>()), json["max_substeps"].get<int>());
  sayRoom(coupling["room"], 10, verbose);
  for (const auto& [name, volume] : json["volumes"].items()) {
    say("volume    {}: ", name);
    if (volume.contains("file")) {
      say("grid \"{}\" of {}", volume["grid"].get<std::string>(),
          volume["file"].get<std::string>());
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
      say("in bricks, {} MB stored in {} levels, {} bricks at a time; ",
          rounded(bricks["stored_bytes"].get<double>() / 1e6), bricks["levels"].get<std::size_t>(),
          bricks["slots"].get<std::uint64_t>());
    }
    if (volume.contains("frames")) {
      const OrderedJson& frames = volume["frames"];
      say("{} frames, {} to {} s{}, {} of them in memory; ", frames["count"].get<std::uint64_t>(),
          rounded(frames["from"].get<double>()), rounded(frames["to"].get<double>()),
          frames["repeat"].get<bool>() ? ", over and over" : "",
          frames["in_memory"].get<std::uint64_t>());
    }
    say("voxel {} mm, {} mm a unit", rounded(1e3 * volume["voxel"].get<double>()),
        rounded(1e3 * volume["metres_per_unit"].get<double>()));
    if (volume.contains("instances")) {
      say("; the first of {}", volume["instances"].get<std::size_t>());
    }
    say("\n");
    if (volume.contains("frames")) {
      for (const OrderedJson& ghosts : volume["frames"]["ghosts"]) sayGhosts(ghosts);
    }
    if (!volume.contains("motion")) continue;
    const OrderedJson& motion = volume["motion"];
    std::string how = motion["deforms"].get<bool>() ? "deforms" : "";
    if (how.empty() || motion["keyframes"].get<std::size_t>() > 1) {
      how += fmt::format("{}{} keyframes, {} to {} s{}", how.empty() ? "" : ", ",
                         motion["keyframes"].get<std::size_t>(),
                         rounded(motion["from"].get<double>()), rounded(motion["to"].get<double>()),
                         motion["repeat"].get<bool>() ? ", repeated" : "");
    }
    say("moves     {}: {}, at most {} m/s\n", name, how,
        rounded(motion["top_speed"].get<double>()));
  }
  for (const auto& sampled : json["sampled"]) {
    const auto list = [](const OrderedJson& names) {
      std::string text;
      for (const auto& name : names) text += (text.empty() ? "" : ", ") + name.get<std::string>();
      return sentence(text);
    };
    say("samples   {}: {}; for {}\n", sampled["field"].get<std::string>(),
        list(sampled["properties"]), list(sampled["for"]));
  }
  for (const auto& derived : json["derived"]) {
    say("derives   {}\n", derived.get<std::string>());
  }
  for (const auto& mode : json["modes"]) {
    say("mode      {}: {}", mode["name"].get<std::string>(),
        sentence(mode["does"].get<std::string>()));
    if (mode.contains("places")) {
      say("; in {} places, felt where the hand is", mode["places"].get<std::size_t>());
    }
    say("\n");
    if (!mode.contains("thickness")) continue;
    const std::string edge = edgeRemark(mode["thickness"]);
    if (!edge.empty()) say("edge      {}: {}\n", mode["name"].get<std::string>(), sentence(edge));
    const std::string thickness = remark(mode["thickness"]);
    if (thickness.empty()) continue;
    say("thickness {}: {}\n", mode["name"].get<std::string>(), sentence(thickness));
  }
  for (const auto& gap : json["gaps"]) sayGap(gap);
  for (const auto& silent : json["silent"]) {
    say("left out  mode {}: its strength is zero everywhere\n", silent.get<std::string>());
  }
  for (const auto& unused : json["left_out"]) {
    std::string uses;
    for (const auto& [name, volume] : json["volumes"].items()) {
      if (volume.value("from", "") == unused) uses += (uses.empty() ? "" : ", ") + name;
    }
    say("left out  {}: no mode reads it{}\n", unused.get<std::string>(),
        sentence(uses.empty() ? "" : "; at load it made " + uses));
  }
}

}  // namespace

void addCheck(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb =
      app.add_subcommand("check", "Validates a scene; prints what is sampled, derived and placed");
  auto scene = std::make_shared<std::string>();
  auto json = std::make_shared<bool>(false);
  auto verbose = std::make_shared<bool>(false);
  verb->add_option("SCENE", *scene, "A scene file, a .vdb, or a folder of .vdb or bricks")
      ->required();
  verb->add_flag("-v,--verbose", *verbose, "Say as well how the coupling's room is known");
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
      if (const OrderedJson& room = out["coupling"]["room"]; swingsUp(room)) {
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
