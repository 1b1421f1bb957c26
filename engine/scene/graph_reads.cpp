#include "palpate/engine/scene/graph_reads.h"

#include <algorithm>
#include <limits>
#include <vector>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

/// Adds a property. Throws SceneError with these texts if kMaxProperties of its type exist already.
int newProperty(const std::string& name, std::vector<std::string>& names, const char* examples,
                const std::string& remedy) {
  if (names.size() == static_cast<std::size_t>(kMaxProperties)) {
    throw SceneError("/modes",
                     "the modes and the stiffness read more than " +
                         std::to_string(kMaxProperties) + " " + examples,
                     remedy);
  }
  names.push_back(name);
  return static_cast<int>(names.size()) - 1;
}

void checkRoom(const Graph& graph) {
  if (graph.scalar_fields.size() + graph.vector_fields.size() < kMaxFields) return;
  throw SceneError(
      "/volumes",
      "the modes and the stiffness read more than " + std::to_string(kMaxFields) + " volumes",
      "use fewer volumes, or groups of up to 8 still volumes, which can become parts "
      "(docs/scene.md)");
}

}  // namespace

int GraphReads::newScalar(const std::string& name) {
  return newProperty(name, graph.scalar_properties,
                     "scalars (values, magnitudes, divergences, q and lambda2)",
                     "use fewer volumes, or fewer derived fields");
}
int GraphReads::newVector(const std::string& name) {
  return newProperty(name, graph.vector_properties,
                     "vectors (each volume with the mode surface or isosurface takes two, its "
                     "gradient and its cell gradient)",
                     "use surface and isosurface on at most " + std::to_string(kMaxProperties / 2) +
                         " volumes, or use fewer gradients, curls and unit vectors");
}

ScalarRead& GraphReads::scalarRead(const std::string& name) {
  read_.insert(name);
  const auto& field = std::get<0>(*names_->volume(name));
  const auto at = std::find(graph.scalar_names.begin(), graph.scalar_names.end(), name);
  const auto i = static_cast<std::size_t>(at - graph.scalar_names.begin());
  if (at == graph.scalar_names.end()) {
    checkRoom(graph);
    graph.scalar_names.push_back(name);
    graph.scalar_fields.push_back(field);
    graph.scalar_frames.push_back(field->frame());
    graph.scalar_motions.push_back(motionOf(name));
    graph.scalar_reads.push_back({static_cast<int>(i)});
  }
  current.scalars |= std::uint64_t{1} << i;
  return graph.scalar_reads[i];
}

VectorRead& GraphReads::vectorRead(const std::string& name) {
  read_.insert(name);
  const auto& field = std::get<1>(*names_->volume(name));
  const auto at = std::find(graph.vector_names.begin(), graph.vector_names.end(), name);
  const auto i = static_cast<std::size_t>(at - graph.vector_names.begin());
  if (at == graph.vector_names.end()) {
    checkRoom(graph);
    graph.vector_names.push_back(name);
    graph.vector_fields.push_back(field);
    graph.vector_frames.push_back(field->frame());
    graph.vector_motions.push_back(motionOf(name));
    graph.vector_reads.push_back({static_cast<int>(i)});
  }
  current.vectors |= std::uint64_t{1} << i;
  return graph.vector_reads[i];
}

int GraphReads::motionOf(const std::string& name) {
  const auto motion = spec_->motions.find(name);
  if (motion == spec_->motions.end()) return -1;
  auto& motions = graph.motions;
  const auto known = std::find(motions.begin(), motions.end(), motion->second);
  if (known != motions.end()) return static_cast<int>(known - motions.begin());
  if (motions.size() == kMaxMotions) {
    throw SceneError("/volumes",
                     "the modes need more than " + std::to_string(kMaxMotions) + " motions",
                     "use fewer motions, or let volumes share one");
  }
  motions.push_back(motion->second);
  return static_cast<int>(motions.size()) - 1;
}

int GraphReads::motionOf(const FieldSet& set) const {
  std::set<int> found;
  const auto look = [&](const std::vector<int>& motions, std::uint64_t bits) {
    for (std::size_t i = 0; i < motions.size(); ++i) {
      if ((bits >> i & 1U) != 0) found.insert(motions[i]);
    }
  };
  look(graph.scalar_motions, set.scalars);
  look(graph.vector_motions, set.vectors);
  return found.size() == 1 ? *found.begin() : -1;
}

int GraphReads::once(int& slot, bool vector, const std::string& name) {
  if (slot < 0) slot = vector ? newVector(name) : newScalar(name);
  return slot;
}

int GraphReads::valueOf(const std::string& name) {
  return once(scalarRead(name).value, false, name);
}
int GraphReads::gradientOf(const std::string& name) {
  return once(scalarRead(name).gradient, true, "gradient of " + name);
}
int GraphReads::cellGradientOf(const std::string& name) {
  return once(scalarRead(name).cell_gradient, true, "cell gradient of " + name);
}
int GraphReads::curlOf(const std::string& name) {
  return once(vectorRead(name).curl, true, "curl of " + name);
}

int GraphReads::magnitudeOf(int from) {
  for (const MagnitudeStep& step : graph.magnitudes) {
    if (step.from == from) return step.to;
  }
  const std::string name =
      "magnitude of " + graph.vector_properties[static_cast<std::size_t>(from)];
  graph.magnitudes.push_back({from, newScalar(name)});
  return graph.magnitudes.back().to;
}

int GraphReads::unitOf(int from) {
  for (const UnitStep& step : graph.units) {
    if (step.from == from) return step.to;
  }
  const std::string name = "unit of " + graph.vector_properties[static_cast<std::size_t>(from)];
  graph.units.push_back({from, newVector(name)});
  return graph.units.back().to;
}

void GraphReads::followSlope(int scalar) {
  for (ScalarRead& read : graph.scalar_reads) {
    if (read.value == scalar) read.slope = true;
  }
  for (const MagnitudeStep& step : graph.magnitudes) {
    if (step.to == scalar) followTurn(step.from);
  }
}

void GraphReads::followTurn(int vector) {
  for (ScalarRead& read : graph.scalar_reads) {
    if (read.gradient == vector) read.turn = true;
  }
  for (const UnitStep& step : graph.units) {
    if (step.to == vector) followTurn(step.from);
  }
}

Slot GraphReads::resolve(const std::string& path, const std::string& name) {
  if (const FieldPtr* field = names_->volume(name)) {
    if (field->index() == 0) return {false, valueOf(name)};
    return {true, once(vectorRead(name).value, true, name)};
  }
  const DerivedSpec& derived = names_->derived(path, name);
  used_.insert(name);
  const std::string& of = derived.of;
  switch (derived.derivation) {
    case Derivation::kMagnitude:
      return {false, magnitudeOf(resolve(path, of).index)};
    case Derivation::kGradient:
      return {true, gradientOf(of)};
    case Derivation::kCurl:
      return {true, curlOf(of)};
    case Derivation::kDivergence:
      return {false, once(vectorRead(of).divergence, false, "divergence of " + of)};
    case Derivation::kUnit:
      return {true, unitOf(resolve(path, of).index)};
    case Derivation::kQ:
      return {false, once(vectorRead(of).q, false, "q of " + of)};
    case Derivation::kLambda2:
      return {false, once(vectorRead(of).lambda2, false, "lambda2 of " + of)};
  }
  return {};
}

FieldFrame GraphReads::frameOf(const FieldSet& set) const {
  FieldFrame frame;
  frame.voxel = std::numeric_limits<double>::infinity();
  const auto look = [&](const std::vector<FieldFrame>& frames, std::uint64_t bits) {
    for (std::size_t i = 0; i < frames.size(); ++i) {
      if ((bits >> i & 1U) != 0 && frames[i].voxel < frame.voxel) frame = frames[i];
    }
  };
  look(graph.scalar_frames, set.scalars);
  look(graph.vector_frames, set.vectors);
  return frame;
}

}  // namespace palpate
