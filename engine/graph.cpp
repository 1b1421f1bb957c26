#include "engine/graph.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "engine/error.h"

namespace palpate {
namespace {

/// What a name of the spec stands for once it is resolved.
struct Slot {
  bool vector = false;
  int index = -1;  ///< Into Properties::vectors or ::scalars.
};

/// Builds a Graph; each property is made when the first mode asks for it, and then shared.
class Compiler {
 public:
  Compiler(const GraphSpec& spec, const std::map<std::string, FieldPtr>& fields)
      : spec_(spec), fields_(fields) {}

  Graph compile() {
    for (const auto& [name, derived] : spec_.fields) {
      if (fields_.count(name) != 0) {
        throw SceneError("/fields/" + name, "a volume has the same name", "rename one of them");
      }
      std::set<std::string> open;
      checkDerived(name, derived, open);
    }
    if (spec_.modes.empty()) {
      throw SceneError("/modes", "there is no mode, so nothing can be felt", "add one");
    }
    if (spec_.modes.size() > kMaxModes) {
      throw SceneError("/modes", std::to_string(spec_.modes.size()) + " modes",
                       "use at most " + std::to_string(kMaxModes));
    }
    for (std::size_t i = 0; i < spec_.modes.size(); ++i) {
      addMode(spec_.modes[i], "/modes/" + std::to_string(i));
    }
    if (graph_.scalar_fields.size() + graph_.vector_fields.size() > kMaxFields) {
      throw SceneError("/volumes",
                       "the modes read more than " + std::to_string(kMaxFields) + " volumes",
                       "use fewer");
    }
    for (const auto& [name, field] : fields_) {
      if (read_.count(name) == 0) graph_.unused.push_back(name);
    }
    for (const auto& [name, derived] : spec_.fields) {
      if (used_.count(name) == 0) graph_.unused.push_back(name);
    }
    return std::move(graph_);
  }

 private:
  [[nodiscard]] std::vector<std::string> allNames() const {
    std::vector<std::string> names;
    for (const auto& [name, field] : fields_) names.push_back(name);
    for (const auto& [name, derived] : spec_.fields) names.push_back(name);
    return names;
  }

  [[noreturn]] void unknown(const std::string& path, const std::string& name) const {
    const std::vector<std::string> names = allNames();
    const std::string near = nearestName(name, names);
    std::string remedy = near.empty() ? "there are:" : "did you mean \"" + near + "\"?";
    if (near.empty()) {
      for (const std::string& n : names) remedy += " " + n;
    }
    throw SceneError(path, "there is no volume or field \"" + name + "\"", remedy);
  }

  /// True if `name` is, or derives to, a vector. Throws for unknown names and cycles.
  bool isVector(const std::string& path, const std::string& name, std::set<std::string>& open) {
    const auto field = fields_.find(name);
    if (field != fields_.end()) return field->second.index() == 1;
    const auto derived = spec_.fields.find(name);
    if (derived == spec_.fields.end()) unknown(path, name);
    return checkDerived(name, derived->second, open);
  }

  /// Checks one derived field's operand; true if the result is a vector.
  bool checkDerived(const std::string& name, const DerivedSpec& derived,
                    std::set<std::string>& open) {
    const std::string path = "/fields/" + name;
    if (!open.insert(name).second) {
      throw SceneError(path, "it is derived from itself", "break the circle");
    }
    const bool of_vector = isVector(path + "/" + wordFor(derived.derivation), derived.of, open);
    open.erase(name);
    const bool of_volume = fields_.count(derived.of) != 0;
    const std::string operand = "\"" + derived.of + "\"";
    const char* word = wordFor(derived.derivation);
    const DerivationKind kind = kindOf(derived.derivation);
    if (!kind.of_volume) {
      if (!of_vector) {
        throw SceneError(path, std::string(word) + " of " + operand + ", which is a scalar",
                         kind.vector ? "give a vector" : "give a vector, or use the scalar itself");
      }
      return kind.vector;
    }
    if (!of_volume) {
      throw SceneError(path, std::string(word) + " of " + operand + ", which is derived",
                       "give a volume; a derived field has no stored derivatives");
    }
    if (of_vector != kind.of_vector) {
      throw SceneError(path,
                       std::string(word) + " of " + operand + ", which is a " +
                           (of_vector ? "vector" : "scalar") + " volume",
                       std::string("give a ") + (kind.of_vector ? "vector" : "scalar") + " volume");
    }
    return kind.vector;
  }

  int newScalar(const std::string& name) { return newProperty(name, graph_.scalar_properties); }
  int newVector(const std::string& name) { return newProperty(name, graph_.vector_properties); }
  static int newProperty(const std::string& name, std::vector<std::string>& names) {
    if (names.size() == static_cast<std::size_t>(kMaxProperties)) {
      throw SceneError("/modes",
                       "the modes read more than " + std::to_string(kMaxProperties) + " properties",
                       "use fewer modes");
    }
    names.push_back(name);
    return static_cast<int>(names.size()) - 1;
  }

  /// The read of a volume, made at the first call.
  ScalarRead& scalarRead(const std::string& name) {
    read_.insert(name);
    const auto& field = std::get<0>(fields_.at(name));
    const auto at = std::find(graph_.scalar_names.begin(), graph_.scalar_names.end(), name);
    if (at != graph_.scalar_names.end()) {
      return graph_.scalar_reads[static_cast<std::size_t>(at - graph_.scalar_names.begin())];
    }
    graph_.scalar_names.push_back(name);
    graph_.scalar_fields.push_back(field);
    graph_.scalar_reads.push_back({static_cast<int>(graph_.scalar_fields.size()) - 1});
    return graph_.scalar_reads.back();
  }
  VectorRead& vectorRead(const std::string& name) {
    read_.insert(name);
    const auto& field = std::get<1>(fields_.at(name));
    const auto at = std::find(graph_.vector_names.begin(), graph_.vector_names.end(), name);
    if (at != graph_.vector_names.end()) {
      return graph_.vector_reads[static_cast<std::size_t>(at - graph_.vector_names.begin())];
    }
    graph_.vector_names.push_back(name);
    graph_.vector_fields.push_back(field);
    graph_.vector_reads.push_back({static_cast<int>(graph_.vector_fields.size()) - 1});
    return graph_.vector_reads.back();
  }

  int once(int& slot, bool vector, const std::string& name) {
    if (slot < 0) slot = vector ? newVector(name) : newScalar(name);
    return slot;
  }
  int valueOf(const std::string& name) { return once(scalarRead(name).value, false, name); }
  int gradientOf(const std::string& name) {
    return once(scalarRead(name).gradient, true, "gradient of " + name);
  }
  int cellGradientOf(const std::string& name) {
    return once(scalarRead(name).cell_gradient, true, "cell gradient of " + name);
  }

  /// |vectors[from]|.
  int magnitudeOf(int from) {
    for (const MagnitudeStep& step : graph_.magnitudes) {
      if (step.from == from) return step.to;
    }
    const std::string name =
        "magnitude of " + graph_.vector_properties[static_cast<std::size_t>(from)];
    graph_.magnitudes.push_back({from, newScalar(name)});
    return graph_.magnitudes.back().to;
  }

  /// Of vectors[from].
  int unitOf(int from) {
    for (const UnitStep& step : graph_.units) {
      if (step.from == from) return step.to;
    }
    const std::string name = "unit of " + graph_.vector_properties[static_cast<std::size_t>(from)];
    graph_.units.push_back({from, newVector(name)});
    return graph_.units.back().to;
  }

  /// The property that a checked name stands for.
  Slot resolve(const std::string& path, const std::string& name) {
    const auto field = fields_.find(name);
    if (field != fields_.end()) {
      if (field->second.index() == 0) return {false, valueOf(name)};
      return {true, once(vectorRead(name).value, true, name)};
    }
    const auto derived = spec_.fields.find(name);
    if (derived == spec_.fields.end()) unknown(path, name);
    used_.insert(name);
    const std::string& of = derived->second.of;
    switch (derived->second.derivation) {
      case Derivation::kMagnitude:
        return {false, magnitudeOf(resolve(path, of).index)};
      case Derivation::kGradient:
        return {true, gradientOf(of)};
      case Derivation::kCurl:
        return {true, once(vectorRead(of).curl, true, "curl of " + of)};
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

  Slot resolveVector(const ModeSpec& mode, const std::string& path) {
    const Slot slot = resolve(path + "/of", mode.of);
    if (!slot.vector) {
      throw SceneError(path + "/of",
                       "mode " + std::string(wordFor(mode.kind)) + " needs a vector and \"" +
                           mode.of + "\" is a scalar",
                       "give a vector volume, or the gradient of this one");
    }
    return slot;
  }

  /// A scalar volume, for the modes that need its gradient and its voxel size.
  const ScalarField& scalarVolume(const ModeSpec& mode, const std::string& path) {
    const auto field = fields_.find(mode.of);
    if (field == fields_.end()) {
      std::set<std::string> open;
      isVector(path + "/of", mode.of, open);  // throws where the name is unknown
      throw SceneError(path + "/of",
                       "mode " + std::string(wordFor(mode.kind)) + " needs a volume and \"" +
                           mode.of + "\" is derived",
                       "give a scalar volume");
    }
    if (field->second.index() != 0) {
      throw SceneError(path + "/of",
                       "mode " + std::string(wordFor(mode.kind)) + " needs a scalar volume and \"" +
                           mode.of + "\" is a vector",
                       "use mode follow or force for a vector");
    }
    return *std::get<0>(field->second);
  }

  /// The strength's input: `by`, else the mode's own.
  template <class OwnInput>
  Strength strength(const ModeSpec& mode, const std::string& path, OwnInput own) {
    Strength out{mode.strength, -1};
    if (!mode.by.empty()) {
      const Slot slot = resolve(path + "/by", mode.by);
      if (slot.vector) {
        throw SceneError(path + "/by", "\"" + mode.by + "\" is a vector",
                         "give a scalar, as the magnitude of it");
      }
      out.scalar = slot.index;
    } else if (!mode.strength.isConstant()) {
      out.scalar = own();
    }
    return out;
  }

  void addMode(const ModeSpec& mode, const std::string& path) {
    switch (mode.kind) {
      case ModeKind::kForce:
        addForce(mode, path);
        break;
      case ModeKind::kViscosity: {
        Slot slot = resolve(path + "/of", mode.of);
        if (slot.vector) slot = {false, magnitudeOf(slot.index)};
        graph_.modes.emplace_back(
            ViscosityMode{slot.index, strength(mode, path, [&] { return slot.index; })});
        break;
      }
      case ModeKind::kSurface: {
        scalarVolume(mode, path);
        const int gradient = gradientOf(mode.of);
        graph_.modes.emplace_back(
            SurfaceMode{gradient, outwardSign(mode.solid),
                        strength(mode, path, [&] { return valueOf(mode.of); })});
        break;
      }
      case ModeKind::kIsosurface:
        addIsosurface(mode, path);
        break;
      case ModeKind::kFollow: {
        const Slot slot = resolveVector(mode, path);
        graph_.modes.emplace_back(
            FollowMode{slot.index, strength(mode, path, [&] { return magnitudeOf(slot.index); })});
        break;
      }
    }
    graph_.mode_names.push_back(mode.name.empty() ? path : mode.name);
  }

  static double outwardSign(Solid solid) noexcept { return solid == Solid::kAbove ? -1.0 : 1.0; }

  void addForce(const ModeSpec& mode, const std::string& path) {
    Slot slot = resolve(path + "/of", mode.of);
    ForceMode force;
    if (slot.vector) {
      force.vector = slot.index;
      force.sign = mode.sense.value_or(Sense::kAttract) == Sense::kAttract ? 1.0 : -1.0;
      force.strength = strength(mode, path, [&] { return magnitudeOf(slot.index); });
    } else {
      scalarVolume(mode, path);
      force.vector = gradientOf(mode.of);
      force.sign = mode.sense.value_or(Sense::kRepel) == Sense::kAttract ? 1.0 : -1.0;
      force.strength = strength(mode, path, [&] { return slot.index; });
    }
    graph_.modes.emplace_back(force);
  }

  void addIsosurface(const ModeSpec& mode, const std::string& path) {
    const FieldFrame& frame = scalarVolume(mode, path).frame();
    if (!(mode.depth_voxels > 0.0) || !std::isfinite(mode.depth_voxels)) {
      throw SceneError(path + "/depth", "it must be > 0", "give a depth in voxels, as 3");
    }
    if (!std::isfinite(mode.value)) {
      throw SceneError(path + "/value", "it is not a finite number", "give the value to be felt");
    }
    IsosurfaceMode iso;
    iso.value = valueOf(mode.of);
    iso.gradient = gradientOf(mode.of);
    iso.cell_gradient = cellGradientOf(mode.of);
    iso.level = mode.value;
    iso.sign = outwardSign(mode.solid);
    iso.voxel = frame.voxel;
    iso.metres_per_unit = frame.metres_per_unit;
    iso.depth = mode.depth_voxels * frame.voxel;
    iso.strength = strength(mode, path, [&] { return iso.value; });
    graph_.modes.emplace_back(iso);
  }

  const GraphSpec& spec_;
  const std::map<std::string, FieldPtr>& fields_;
  Graph graph_;
  std::set<std::string> read_;  ///< Volumes that are sampled.
  std::set<std::string> used_;  ///< Derived fields that are.
};

}  // namespace

Graph compileGraph(const GraphSpec& spec, const std::map<std::string, FieldPtr>& fields) {
  return Compiler(spec, fields).compile();
}

const char* wordFor(ModeKind kind) noexcept {
  switch (kind) {
    case ModeKind::kForce:
      return "force";
    case ModeKind::kViscosity:
      return "viscosity";
    case ModeKind::kSurface:
      return "surface";
    case ModeKind::kIsosurface:
      return "isosurface";
    case ModeKind::kFollow:
      return "follow";
  }
  return "";
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
