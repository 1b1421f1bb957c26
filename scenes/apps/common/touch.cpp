#include "palpate/scenes/apps/common/touch.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include "palpate/devices/simulated/path_device.h"
#include "palpate/engine/error.h"
#include "palpate/scenes/library/frames.h"
#include "palpate/scenes/library/nearby.h"

namespace palpate::cli {
namespace {

constexpr double kFarthest = 1e6;  // [m]: hapticStep() rejects larger coordinates

DeviceInfo pathDevice() {
  return PathDevice({PathPoint{}}, 1000.0).info();
}

/// Returns the state of a primitive. A primitive that carries its full strength still holds while
/// the proxy is on the primitive; otherwise the primitive yields.
Hold holdOf(const Load& load, const StepReport& report) {
  if (load.primitive.kind == PrimitiveKind::kForce) return Hold::kPushes;
  const double carried = load.force.norm();
  if (carried <= load.known) return Hold::kIdle;
  if (carried < load.primitive.strength - load.known) return Hold::kHolds;
  constexpr double kRounding = 1e-12;  // [m]: rounding error of a position
  const bool arrived = report.status != StepStatus::kSubstepLimit;
  const double off = distanceTo(load.primitive, report.proxy);
  return arrived && off <= kRounding + report.error_bound ? Hold::kHolds : Hold::kYields;
}

}  // namespace

std::optional<Vec3> numbersOf(const std::string& text) {
  Vec3 v = Vec3::Zero();
  const char* at = text.data();
  const char* end = at + text.size();
  bool good = true;
  for (int i = 0; i < 3 && good; ++i) {
    if (i > 0) good = at != end && *at++ == ',';
    if (!good) break;
    const auto [rest, error] = std::from_chars(at, end, v[i]);
    good = error == std::errc() && std::isfinite(v[i]);
    at = rest;
  }
  return good && at == end ? std::optional<Vec3>(v) : std::nullopt;
}

Vec3 readVector(const std::string& option, const std::string& text) {
  const std::optional<Vec3> v = numbersOf(text);
  if (!v) {
    throw Error(option, "\"" + text + "\" is not x,y,z",
                "give three numbers in metres, such as 0,0,0.05");
  }
  checkReach(option, *v);
  return *v;
}

bool holds(const Box& box, const Vec3& p) {
  return (p.array() >= box.lower.array()).all() && (p.array() <= box.upper.array()).all();
}

std::vector<std::filesystem::path> inputsOf(const std::string& scene, const SceneSpec& spec) {
  std::vector<std::filesystem::path> inputs{scene};
  for (const auto& [name, volume] : spec.volumes) {
    const std::vector<std::filesystem::path> files = filesOf(volume);
    inputs.insert(inputs.end(), files.begin(), files.end());
  }
  return inputs;
}

void checkReach(const std::string& name, const Vec3& p) {
  if ((p.array().abs() < kFarthest).all()) return;  // the condition is false for NaN
  throw Error(name, "a coordinate is 1,000 km or more from 0, or not a number",
              "give coordinates in metres");
}

void checkRate(const std::string& name, double rate) {
  if (rate >= 10.0 && rate <= 100000.0) return;
  throw Error(name, fmt::format("{} Hz is not in the range 10 to 100000 Hz", rate), "use 1000 Hz");
}

void complainOf(const std::string& line) {
  complain(line);
}

Opened openFor(const std::string& scene, const TrialRun& trial) {
  return openFor(openScene(scene, showProgress("loading")), trial, showProgress("loading"),
                 complainOf);
}

void narrow(Opened& opened, const Near& near, SceneCache& cache, const Say& say) {
  const std::string& scene = opened.spec.source;
  const std::size_t all = opened.built.scene->parts.size();
  const std::vector<std::string> notes = opened.built.notes;
  if (near.parts.size() > kMaxFields) {
    throw Error(
        scene,
        fmt::format("the hand comes near {} of the scene's {} parts; a report covers at most {}",
                    near.parts.size(), all, kMaxFields),
        "make a scene with fewer parts, or, for explain and press, shorten the path");
  }
  opened.told = nearby(opened.told, opened.built, near.parts);
  if (opened.told.graph.modes.empty()) {
    throw Error(scene, "the hand comes near no part of the scene",
                "run palpate check to see the bounds");
  }
  try {
    opened.built = buildScene(opened.told, nullptr, &cache);
  } catch (const SceneError&) {
    // The scene is valid, so the parts near the hand are too many for one graph.
    throw Error(scene,
                fmt::format("the hand comes near {} of the scene's {} parts; a report covers at "
                            "most {} volumes, {} properties and {} modes",
                            near.parts.size(), all, kMaxFields, kMaxProperties, kMaxModes),
                "make a scene with fewer parts, or, for explain and press, shorten the path");
  }
  opened.built.notes = notes;
  std::string words = fmt::format("{}: the hand comes near {} of the scene's {} parts", scene,
                                  near.parts.size(), all);
  if (near.parts.size() < all) words += "; the report skips the others";
  if (near.missing > 0.0) {
    words += fmt::format(
        "; more parts are near than a tick evaluates, so the force is off by at most {} N",
        rounded(near.missing));
  }
  say(words);
}

Opened openFor(SceneSpec spec, const TrialRun& trial, const Progress& progress, const Say& say) {
  Opened opened;
  opened.spec = std::move(spec);
  opened.spec.waits = true;
  for (const std::string& note : opened.spec.notes) say(note);
  checkDevice(opened.spec, pathDevice());
  opened.told = opened.spec;
  SceneCache cache;
  opened.built = buildScene(opened.told, progress, &cache);
  if (!opened.built.scene->parts.empty()) narrow(opened, trial(opened.built), cache, say);
  for (const std::string& note : opened.built.notes) say(note);
  return opened;
}

void Near::add(const ProxyState& state, const StepReport& report) {
  for (const std::uint8_t slot : state.near().order()) parts.insert(state.near()[slot].part);
  missing = std::max(missing, report.missing);
}

std::vector<std::string> readersOf(const Graph& graph, const FieldSet& field) {
  std::vector<std::string> names;
  for (std::size_t i = 0; i < graph.modes.size(); ++i) {
    if (graph.mode_fields[i].reads.holds(field)) names.push_back(graph.mode_names[i]);
  }
  if (graph.stiffness_reads.holds(field)) names.emplace_back("the coupling's stiffness");
  return names;
}

ForceLimits pathLimits() {
  return pathDevice().limits;
}

Rest restAt(const Scene& scene, Reader& reader, ProxyState& state, const Vec3& at, double dt) {
  constexpr double kLongest = 2.0;  // [s]: longest wait for a varying stiffness
  const bool varies = !scene.graph.stiffness.factors.empty();
  Rest rest;
  double last = 0.0;
  do {
    last = rest.report.stiffness;
    rest.report = hapticStep(scene, reader, {at}, state, dt);
    ++rest.ticks;
  } while (varies && rest.report.stiffness != last && rest.ticks * dt < kLongest);
  return rest;
}

Load loadOf(const Primitive& primitive, const Vec3& force, const StepReport& report) {
  Load load;
  load.primitive = primitive;
  load.force = force;
  // Uncertainty that follows from the error bound of the balance.
  load.known = 1e-9 * primitive.strength + report.stiffness * report.error_bound;
  load.hold = holdOf(load, report);
  return load;
}

std::vector<Load> loadsOf(const ProxyState& state, const StepReport& report, std::size_t i) {
  std::size_t first = 0;
  for (std::size_t j = 0; j < i; ++j) first += static_cast<std::size_t>(state.memory(j).emitted);
  const auto count = static_cast<std::size_t>(state.memory(i).emitted);
  const auto items = state.primitives().items();
  const auto forces = state.forces();
  std::vector<Load> loads;
  if (report.status == StepStatus::kFault || first + count > items.size()) return loads;
  for (std::size_t j = first; j < first + count; ++j) {
    Load load = loadOf(items[j], forces[j], report);
    for (const FrictionLink& link : state.primitives().links()) {
      if (link.line != j) continue;
      load.friction = true;
      load.coefficient = link.coefficient;
      load.plane = link.plane - first;
    }
    loads.push_back(load);
  }
  return loads;
}

Vec3 totalOf(const std::vector<Load>& loads) {
  Vec3 total = Vec3::Zero();
  for (const Load& load : loads) total += load.force;
  return total;
}

std::vector<Load> bearersOf(const std::vector<Load>& loads) {
  std::vector<Load> planes;
  std::vector<Load> others;
  for (const Load& load : loads) {
    const bool plane = load.primitive.kind == PrimitiveKind::kPlane;
    if (!load.friction) (plane ? planes : others).push_back(load);
  }
  return planes.empty() ? others : planes;
}

Hold holdOf(const std::vector<Load>& loads) {
  Hold hold = Hold::kIdle;
  double known = 0.0;
  const std::vector<Load> bearers = bearersOf(loads);
  for (const Load& load : bearers) {
    hold = std::max(hold, load.hold);
    known += load.known;
  }
  return totalOf(bearers).norm() > known ? hold : Hold::kIdle;
}

const char* wordFor(Hold hold, bool friction) {
  switch (hold) {
    case Hold::kIdle:
      break;
    case Hold::kHolds:
      return friction ? "sticks" : "holds";
    case Hold::kYields:
      return friction ? "slips" : "yields";
    case Hold::kPushes:
      return "pushes";
  }
  return "idle";
}

const char* wordFor(Side side) {
  switch (side) {
    case Side::kUnknown:
      break;
    case Side::kOutside:
      return "outside";
    case Side::kYielded:
      return "yielded";
    case Side::kInside:
      return "inside";
  }
  return "unknown";
}

const char* wordFor(SolverKind kind) {
  switch (kind) {
    case SolverKind::kClosedForm:
      return "closed-form";
    case SolverKind::kPair:
      return "pair";
    case SolverKind::kGeneral:
      break;
  }
  return "general";
}

std::string shown(double value) {
  constexpr double kNoise = 1e-12;
  return rounded(std::abs(value) < kNoise ? 0.0 : value);
}

}  // namespace palpate::cli
