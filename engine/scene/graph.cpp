#include "palpate/engine/scene/graph.h"

#include <algorithm>
#include <utility>
#include <variant>

#include "palpate/engine/error.h"
#include "palpate/engine/scene/compile_mode.h"
#include "palpate/engine/scene/graph_names.h"
#include "palpate/engine/scene/graph_reads.h"

namespace palpate {
namespace {

void checkModes(const GraphSpec& spec) {
  if (spec.modes.empty()) {
    throw SceneError("/modes", "the scene has no modes", "add one");
  }
  if (spec.modes.size() > kMaxModes) {
    throw SceneError("/modes", "the scene has " + std::to_string(spec.modes.size()) + " modes",
                     "use at most " + std::to_string(kMaxModes));
  }
}

void checkMotions(const GraphSpec& spec, const GraphNames& names) {
  for (const auto& [name, motion] : spec.motions) {
    const std::string path = "/volumes/" + name + "/place/keyframes";
    if (names.volume(name) == nullptr) names.throwUnknown(path, name);
    if (motion == nullptr)
      throw SceneError(path, "the motion is null", "remove this entry of GraphSpec::motions");
  }
}

/// Rejects guides in volumes that deform, because a warp is not sampled at the guide's place.
void checkGuide(const GraphSpec& spec, const ModeSpec& mode, const std::string& path) {
  const auto in = spec.motions.find(mode.in);
  if (mode.kind != ModeKind::kGuide || in == spec.motions.end()) return;
  if (in->second->warp() == nullptr) return;
  throw SceneError(path + "/in", "\"" + mode.in + "\" deforms, but guides can only move rigidly",
                   "place the guide in the world, or in a volume that moves by keyframes");
}

bool isSilent(const ModeSpec& mode) {
  return mode.kind != ModeKind::kUser && mode.strength.highest() == 0.0 &&
         mode.viscosity.highest() == 0.0;
}

/// Returns the index of the motion that carries a mode's primitives: that of the mode's volume; -1
/// if it stands still. Returns -1 for a user-defined mode if the volumes that it reads do not share
/// a motion.
int motionOf(const ModeSpec& mode, const FieldSet& support, GraphReads& reads) {
  if (mode.kind == ModeKind::kGuide) return mode.in.empty() ? -1 : reads.motionOf(mode.in);
  return reads.motionOf(mode.kind == ModeKind::kUser ? reads.current : support);
}

void addMode(const GraphSpec& spec, std::size_t index, GraphReads& reads) {
  const ModeSpec& mode = spec.modes[index];
  const std::size_t number = spec.mode_numbers.empty() ? index : spec.mode_numbers.at(index);
  const std::string path = "/modes/" + std::to_string(number);
  const std::string name = mode.name.empty() ? path : mode.name;
  checkGuide(spec, mode, path);
  if (isSilent(mode)) {
    // Checks a silent mode like other modes, but leaves the mode and its readings out of the graph.
    GraphReads unused = reads;
    (void)compileMode(mode, path, unused);
    reads.graph.silent.push_back(name);
    return;
  }
  reads.current = {};
  CompiledMode compiled = compileMode(mode, path, reads);
  Graph& graph = reads.graph;
  graph.mode_follows.push_back(followsValue(compiled.mode) ? 1 : 0);
  graph.modes.push_back(std::move(compiled.mode));
  graph.mode_fields.push_back({compiled.support, reads.current});
  graph.mode_voxels.push_back(reads.frameOf(reads.current).voxel);
  graph.mode_motions.push_back(motionOf(mode, compiled.support, reads));
  graph.mode_sources.push_back(number);
  graph.mode_names.push_back(name);
}

/// Returns the mode's surface if it is an isosurface with the same strength everywhere on V =
/// level, and places without data are on its free side; else null.
const IsosurfaceMode* evenSurface(const Mode& mode, const Graph& graph) {
  const auto* surface = std::get_if<IsosurfaceMode>(&mode);
  if (surface == nullptr) return nullptr;
  const SurfaceSource& skin = surface->skin;
  const double outside = graph.scalar_frames[static_cast<std::size_t>(skin.field)].background;
  const auto& factors = surface->strength.factors;
  const bool even = std::all_of(factors.begin(), factors.end(), [&](const Transfer::Factor& by) {
    return by.scalar == -1 || by.scalar == skin.value;
  });
  return even && skin.sign * (outside - surface->level) >= 0.0 ? surface : nullptr;
}

/// Returns true if the mode adds no primitive to a proxy in front of the even surfaces: the mode is
/// an even surface, or a drag that is zero on the free side of an even surface.
bool isSilentInFront(const Mode& mode, const Graph& graph) {
  if (evenSurface(mode, graph) != nullptr) return true;
  const auto* drag = std::get_if<ViscosityMode>(&mode);
  if (drag == nullptr) return false;
  const auto is_zero = [&](const Transfer::Factor& by) {
    return std::any_of(graph.modes.begin(), graph.modes.end(), [&](const Mode& other) {
      const IsosurfaceMode* surface = evenSurface(other, graph);
      return surface != nullptr && by.scalar == surface->skin.value &&
             by.curve.isZeroFrom(surface->level, surface->skin.sign);
    });
  };
  return std::any_of(drag->strength.factors.begin(), drag->strength.factors.end(), is_zero);
}

/// Lists the modes with contacts and with streamlines, and finds the finest voxel, for all ticks.
void planTick(Graph& graph) {
  for (std::size_t i = 0; i < graph.modes.size(); ++i) {
    ModeMemory memory = memoryFor(graph.modes[i]);
    if (touchOf(graph.modes[i], memory).skin != nullptr) graph.surfaces.push_back(i);
    if (curveOf(graph.modes[i], memory).on != nullptr) graph.curves.push_back(i);
  }
  for (const auto* frames : {&graph.scalar_frames, &graph.vector_frames}) {
    for (const FieldFrame& frame : *frames) graph.finest = std::min(graph.finest, frame.voxel);
  }
}

/// Returns Graph::contact_only.
std::uint64_t contactOnly(const Graph& graph) {
  std::uint64_t others = graph.stiffness_reads.scalars;
  std::uint64_t surfaces = 0;
  for (std::size_t i = 0; i < graph.modes.size(); ++i) {
    const bool silent = isSilentInFront(graph.modes[i], graph);
    (silent ? surfaces : others) |= graph.mode_fields[i].reads.scalars;
  }
  for (const std::size_t i : graph.attentive) {
    if (i < graph.scalar_fields.size()) others |= std::uint64_t{1} << i;
  }
  return surfaces & ~others;
}

}  // namespace

double TransferSpec::highest() const noexcept {
  double product = 1.0;
  for (const Factor& factor : factors) product *= factor.curve.highest();
  return product;
}

double TransferSpec::lowest() const noexcept {
  double product = 1.0;
  for (const Factor& factor : factors) product *= factor.curve.lowest();
  return product;
}

bool TransferSpec::isConstant() const noexcept {
  return std::all_of(factors.begin(), factors.end(),
                     [](const Factor& factor) { return factor.curve.isConstant(); });
}

Graph compileGraph(const GraphSpec& spec, const std::map<std::string, FieldPtr>& fields) {
  const GraphNames names(spec, fields);
  names.checkDerived();
  checkModes(spec);
  checkMotions(spec, names);
  GraphReads reads(spec, names);
  for (std::size_t i = 0; i < spec.modes.size(); ++i) addMode(spec, i, reads);
  if (spec.stiffness) {
    reads.current = {};
    reads.graph.stiffness = compileStiffness(*spec.stiffness, reads);
    reads.graph.stiffness_reads = reads.current;
  }
  Graph& graph = reads.graph;
  for (std::size_t i = 0; i < graph.scalar_fields.size(); ++i) {
    if (graph.scalar_fields[i]->attends()) graph.attentive.push_back(i);
  }
  for (std::size_t i = 0; i < graph.vector_fields.size(); ++i) {
    if (graph.vector_fields[i]->attends())
      graph.attentive.push_back(graph.scalar_fields.size() + i);
  }
  graph.contact_only = contactOnly(graph);
  graph.by_reading = std::all_of(graph.modes.begin(), graph.modes.end(), [](const Mode& mode) {
    return std::holds_alternative<IsosurfaceMode>(mode) ||
           std::holds_alternative<ViscosityMode>(mode);
  });
  planTick(graph);
  for (const auto& [name, field] : fields) {
    if (!reads.isRead(name)) reads.graph.unused.push_back(name);
  }
  for (const auto& [name, derived] : spec.fields) {
    if (!reads.isUsed(name)) reads.graph.unused.push_back(name);
  }
  return std::move(reads.graph);
}

const char* wordFor(Derivation derivation) noexcept {
  switch (derivation) {
    case Derivation::kMagnitude:
      return "magnitude";
    case Derivation::kGradient:
      return "gradient";
    case Derivation::kCurl:
      return "curl";
    case Derivation::kDivergence:
      return "divergence";
    case Derivation::kUnit:
      return "unit";
    case Derivation::kQ:
      return "q";
    case Derivation::kLambda2:
      return "lambda2";
  }
  return "";
}

}  // namespace palpate
