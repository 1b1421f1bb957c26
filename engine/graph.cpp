#include "palpate/engine/graph.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <sstream>
#include <tuple>

#include "palpate/engine/error.h"

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
    for (const auto& [name, motion] : spec_.motions) {
      const std::string path = "/volumes/" + name + "/place/keyframes";
      if (fields_.count(name) == 0) unknown(path, name);
      if (motion == nullptr) throw SceneError(path, "there is no motion", "remove it");
    }
    for (std::size_t i = 0; i < spec_.modes.size(); ++i) addMode(i);
    addStiffness();
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

  void checkRoom() const {
    if (graph_.scalar_fields.size() + graph_.vector_fields.size() < kMaxFields) return;
    throw SceneError("/volumes",
                     "the modes read more than " + std::to_string(kMaxFields) + " volumes",
                     "use fewer");
  }

  /// The read of a volume, made at the first call.
  ScalarRead& scalarRead(const std::string& name) {
    read_.insert(name);
    const auto& field = std::get<0>(fields_.at(name));
    const auto at = std::find(graph_.scalar_names.begin(), graph_.scalar_names.end(), name);
    const auto i = static_cast<std::size_t>(at - graph_.scalar_names.begin());
    if (at == graph_.scalar_names.end()) {
      checkRoom();
      graph_.scalar_names.push_back(name);
      graph_.scalar_fields.push_back(field);
      graph_.scalar_frames.push_back(field->frame());
      graph_.scalar_motions.push_back(motionOf(name));
      graph_.scalar_reads.push_back({static_cast<int>(i)});
    }
    current_.scalars |= std::uint64_t{1} << i;
    return graph_.scalar_reads[i];
  }
  VectorRead& vectorRead(const std::string& name) {
    read_.insert(name);
    const auto& field = std::get<1>(fields_.at(name));
    const auto at = std::find(graph_.vector_names.begin(), graph_.vector_names.end(), name);
    const auto i = static_cast<std::size_t>(at - graph_.vector_names.begin());
    if (at == graph_.vector_names.end()) {
      checkRoom();
      graph_.vector_names.push_back(name);
      graph_.vector_fields.push_back(field);
      graph_.vector_frames.push_back(field->frame());
      graph_.vector_motions.push_back(motionOf(name));
      graph_.vector_reads.push_back({static_cast<int>(i)});
    }
    current_.vectors |= std::uint64_t{1} << i;
    return graph_.vector_reads[i];
  }

  /// The motion of a volume, -1 where it stands still.
  int motionOf(const std::string& name) {
    const auto motion = spec_.motions.find(name);
    if (motion == spec_.motions.end()) return -1;
    auto& motions = graph_.motions;
    const auto known = std::find(motions.begin(), motions.end(), motion->second);
    if (known != motions.end()) return static_cast<int>(known - motions.begin());
    if (motions.size() == kMaxMotions) {
      throw SceneError("/volumes",
                       "the modes need more than " + std::to_string(kMaxMotions) + " motions",
                       "use fewer, or place volumes like each other");
    }
    motions.push_back(motion->second);
    return static_cast<int>(motions.size()) - 1;
  }

  /// The motion that a mode's primitives are carried by: its own volume's. A user's mode is carried
  /// where all that it reads moves as one.
  int motionOf(const ModeSpec& mode) {
    if (mode.kind == ModeKind::kGuide) return mode.in.empty() ? -1 : motionOf(mode.in);
    const FieldSet set = mode.kind == ModeKind::kUser ? current_ : support_;
    std::set<int> found;
    const auto look = [&](const std::vector<int>& motions, std::uint64_t bits) {
      for (std::size_t i = 0; i < motions.size(); ++i) {
        if ((bits >> i & 1U) != 0) found.insert(motions[i]);
      }
    };
    look(graph_.scalar_motions, set.scalars);
    look(graph_.vector_motions, set.vectors);
    return found.size() == 1 ? *found.begin() : -1;
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

  /// How a scalar that a strength follows changes with the place is wanted as well, where it can
  /// be known: derivatives of derivatives are not stored.
  void followSlope(int scalar) {
    for (ScalarRead& read : graph_.scalar_reads) {
      if (read.value == scalar) read.slope = true;
    }
    for (const MagnitudeStep& step : graph_.magnitudes) {
      if (step.to == scalar) followTurn(step.from);
    }
  }
  /// And how a vector does that primitives are along.
  void followTurn(int vector) {
    for (ScalarRead& read : graph_.scalar_reads) {
      if (read.gradient == vector) read.turn = true;
    }
    for (const UnitStep& step : graph_.units) {
      if (step.to == vector) followTurn(step.from);
    }
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

  /// Compiles one material property of a mode. A factor reads its own `by`, else the mode's, else
  /// the mode's own property, which is asked for only where it matters.
  template <class OwnInput>
  Transfer transfer(const TransferSpec& spec, const ModeSpec& mode, const std::string& path,
                    const std::string& key, double most, OwnInput own) {
    const std::vector<TransferSpec::Factor>& factors = spec.factors;
    const std::string at = path + "/" + key;
    if (factors.empty()) throw SceneError(at, "it is a product of nothing", "give its factors");
    Transfer out;
    const bool zero = spec.highest() == 0.0;
    // A single constant with `by` acts only where that has data.
    const bool mask = key == "strength" && factors.size() == 1 && !mode.by.empty();
    for (std::size_t i = 0; i < factors.size(); ++i) {
      const TransferSpec::Factor& factor = factors[i];
      const std::string here = factors.size() > 1 ? at + "/product/" + std::to_string(i) : at;
      int scalar = -1;
      if (!factor.by.empty()) checkScalar(factor.by, here + "/by");
      if (zero) continue;
      if (!factor.by.empty()) {
        scalar = scalarInput(factor.by, here + "/by");
      } else if (!factor.curve.isConstant() || mask) {
        scalar = mode.by.empty() ? own() : scalarInput(mode.by, path + "/by");
      }
      if (scalar >= 0 && !factor.curve.isConstant()) followSlope(scalar);
      out.factors.push_back({factor.curve, scalar});
    }
    // What a product can reach is as bounded as a number.
    if (!(spec.highest() <= most)) {
      throw SceneError(at, "it can exceed " + shortNumber(most), "make it or its factors smaller");
    }
    return out;
  }

  template <class OwnInput>
  Transfer strength(const ModeSpec& mode, const std::string& path, OwnInput own) {
    return transfer(mode.strength, mode, path, "strength", kMostStrength, own);
  }
  template <class OwnInput>
  Transfer friction(const ModeSpec& mode, const std::string& path, OwnInput own) {
    return transfer(mode.friction, mode, path, "friction", kMostFriction, own);
  }
  template <class OwnInput>
  Transfer viscosity(const ModeSpec& mode, const std::string& path, OwnInput own) {
    return transfer(mode.viscosity, mode, path, "viscosity", kMostStrength, own);
  }

  static std::string shortNumber(double value) {
    std::ostringstream out;
    out << value;
    return out.str();
  }

  int scalarInput(const std::string& name, const std::string& path) {
    checkScalar(name, path);
    return resolve(path, name).index;
  }

  /// Throws where a key says something that the mode would not do.
  void checkKeys(const ModeSpec& mode, const std::string& path) {
    const bool surface = mode.kind == ModeKind::kSurface || mode.kind == ModeKind::kIsosurface;
    if (!surface && (mode.friction.highest() > 0.0 || mode.viscosity.highest() > 0.0)) {
      throw SceneError(
          path, std::string("mode ") + wordFor(mode.kind) + " has no friction and no viscosity",
          "use surface or isosurface for them");
    }
    if (mode.by.empty()) return;
    checkScalar(mode.by, path + "/by");
    const auto reads = [](const TransferSpec& spec) {
      return std::any_of(spec.factors.begin(), spec.factors.end(), [](const auto& factor) {
        return factor.by.empty() && !factor.curve.isConstant();
      });
    };
    const bool mask = mode.strength.factors.size() == 1 && mode.strength.factors[0].by.empty();
    if (!mask && !reads(mode.strength) && !reads(mode.friction) && !reads(mode.viscosity)) {
      throw SceneError(path + "/by", "no factor of the mode's curves reads it", "remove it");
    }
  }

  /// Throws where a name is unknown or no scalar, also if nobody comes to read it.
  void checkScalar(const std::string& name, const std::string& path) {
    std::set<std::string> open;
    if (!isVector(path, name, open)) return;
    throw SceneError(path, "\"" + name + "\" is a vector", "give a scalar, as the magnitude of it");
  }

  /// True where it can never act.
  static bool isSilent(const ModeSpec& mode) {
    return mode.kind != ModeKind::kUser && mode.strength.highest() == 0.0 &&
           mode.viscosity.highest() == 0.0;
  }

  void addMode(std::size_t index) {
    const ModeSpec& mode = spec_.modes[index];
    const std::size_t number = spec_.mode_numbers.empty() ? index : spec_.mode_numbers.at(index);
    const std::string path = "/modes/" + std::to_string(number);
    const std::string name = mode.name.empty() ? path : mode.name;
    checkKeys(mode, path);
    current_ = {};
    support_ = {};
    if (isSilent(mode)) {
      // Checked like any other, and then as if it were not there: nothing is read for it.
      const auto before = std::tuple(graph_, read_, used_);
      (void)compileMode(mode, path);
      std::tie(graph_, read_, used_) = before;
      graph_.silent.push_back(name);
      return;
    }
    graph_.modes.push_back(compileMode(mode, path));
    graph_.mode_fields.push_back({support_, current_});
    graph_.mode_voxels.push_back(finestOf(current_));
    graph_.mode_follows.push_back(followsValue(graph_.modes.back()) ? 1 : 0);
    graph_.mode_motions.push_back(motionOf(mode));
    graph_.mode_sources.push_back(number);
    graph_.mode_names.push_back(name);
  }

  [[nodiscard]] double finestOf(const FieldSet& set) const noexcept {
    double finest = std::numeric_limits<double>::infinity();
    const auto look = [&](const std::vector<FieldFrame>& frames, std::uint64_t bits) {
      for (std::size_t i = 0; i < frames.size(); ++i) {
        if ((bits >> i & 1U) != 0) finest = std::min(finest, frames[i].voxel);
      }
    };
    look(graph_.scalar_frames, set.scalars);
    look(graph_.vector_frames, set.vectors);
    return finest;
  }

  Mode compileMode(const ModeSpec& mode, const std::string& path) {
    switch (mode.kind) {
      case ModeKind::kForce:
        return force(mode, path);
      case ModeKind::kViscosity: {
        Slot slot = resolve(path + "/of", mode.of);
        if (slot.vector) slot = {false, magnitudeOf(slot.index)};
        support_ = current_;
        return ViscosityMode{slot.index, strength(mode, path, [&] { return slot.index; })};
      }
      case ModeKind::kSurface: {
        SurfaceMode surface;
        surface.skin = skinOf(mode, path);
        support_ = current_;
        const auto own = [&] { return valueOf(mode.of); };
        surface.strength = strength(mode, path, own);
        surface.friction = friction(mode, path, own);
        surface.viscosity = viscosity(mode, path, own);
        return surface;
      }
      case ModeKind::kIsosurface:
        return isosurface(mode, path);
      case ModeKind::kFollow:
      case ModeKind::kTransverseDamping: {
        FollowMode follow;
        follow.vector = vectorOf(mode, path);
        follow.field = streamOf(mode.of);
        follow.voxel = frameOf(support_).voxel;
        follow.strength = strength(mode, path, [&] { return magnitudeOf(follow.vector); });
        return follow;
      }
      case ModeKind::kFrontShape:
        return frontShape(mode, path);
      case ModeKind::kVortexTube:
        return vortexTube(mode, path);
      case ModeKind::kGuide:
        return guide(mode, path);
      case ModeKind::kUser:
        return userMode(mode, path);
    }
    return {};
  }

  Skin skinOf(const ModeSpec& mode, const std::string& path) {
    const FieldFrame& frame = scalarVolume(mode, path).frame();
    Skin skin;
    skin.field = scalarRead(mode.of).field;
    skin.value = valueOf(mode.of);
    skin.gradient = gradientOf(mode.of);
    skin.cell_gradient = cellGradientOf(mode.of);
    skin.sign = outwardSign(mode.solid);
    skin.voxel = frame.voxel;
    skin.metres_per_unit = frame.metres_per_unit;
    return skin;
  }

  /// The vector volume whose streams those of a name are; -1 where it is no volume's, nor its
  /// direction's.
  int streamOf(const std::string& name) {
    if (fields_.count(name) != 0) return vectorRead(name).field;
    const DerivedSpec& derived = spec_.fields.at(name);
    const bool same = derived.derivation == Derivation::kUnit;
    return same ? streamOf(derived.of) : -1;
  }

  static double outwardSign(Solid solid) noexcept { return solid == Solid::kAbove ? -1.0 : 1.0; }

  /// The vector that a mode is made of, which is also its support.
  int vectorOf(const ModeSpec& mode, const std::string& path) {
    const Slot slot = resolveVector(mode, path);
    support_ = current_;
    return slot.index;
  }

  Mode force(const ModeSpec& mode, const std::string& path) {
    const Slot slot = resolve(path + "/of", mode.of);
    ForceMode force;
    if (slot.vector) {
      force.vector = slot.index;
      followTurn(force.vector);
      force.sign = mode.sense.value_or(Sense::kAttract) == Sense::kAttract ? 1.0 : -1.0;
      support_ = current_;
      force.strength = strength(mode, path, [&] { return magnitudeOf(slot.index); });
    } else {
      scalarVolume(mode, path);
      force.vector = gradientOf(mode.of);
      followTurn(force.vector);
      force.sign = mode.sense.value_or(Sense::kRepel) == Sense::kAttract ? 1.0 : -1.0;
      support_ = current_;
      force.strength = strength(mode, path, [&] { return slot.index; });
    }
    return force;
  }

  Mode isosurface(const ModeSpec& mode, const std::string& path) {
    IsosurfaceMode iso;
    iso.skin = skinOf(mode, path);
    if (!(mode.depth_voxels > 0.0) || !std::isfinite(mode.depth_voxels)) {
      throw SceneError(path + "/depth", "it must be > 0", "give a depth in voxels, as 3");
    }
    if (!std::isfinite(mode.value)) {
      throw SceneError(path + "/value", "it is not a finite number", "give the value to be felt");
    }
    iso.level = mode.value;
    iso.depth = mode.depth_voxels * iso.skin.voxel;
    support_ = current_;
    const auto own = [&] { return iso.skin.value; };
    iso.strength = strength(mode, path, own);
    iso.friction = friction(mode, path, own);
    iso.viscosity = viscosity(mode, path, own);
    return iso;
  }

  Mode frontShape(const ModeSpec& mode, const std::string& path) {
    if (!(mode.snap_voxels >= 0.0) || !std::isfinite(mode.snap_voxels)) {
      throw SceneError(path + "/snap_drag", "it must be >= 0", "give a distance in voxels, as 4");
    }
    FrontShapeMode front;
    front.vector = vectorOf(mode, path);
    followTurn(front.vector);
    front.two_sided = mode.two_sided;
    front.snap = mode.snap_voxels * frameOf(support_).voxel;
    front.strength = strength(mode, path, [&] { return magnitudeOf(front.vector); });
    return front;
  }

  Mode vortexTube(const ModeSpec& mode, const std::string& path) {
    const auto field = fields_.find(mode.of);
    if (field == fields_.end() || field->second.index() != 1) {
      std::set<std::string> open;
      isVector(path + "/of", mode.of, open);  // throws where the name is unknown
      throw SceneError(path + "/of",
                       "mode vortex_tube needs a vector volume and \"" + mode.of + "\" is none",
                       "give a velocity; the curl is taken of it");
    }
    VortexTubeMode tube;
    tube.vector = vectorOf(mode, path);
    tube.curl = once(vectorRead(mode.of).curl, true, "curl of " + mode.of);
    tube.voxel = frameOf(support_).voxel;
    tube.metres_per_unit = frameOf(support_).metres_per_unit;
    tube.strength = strength(mode, path, [&] { return magnitudeOf(tube.curl); });
    return tube;
  }

  Mode guide(const ModeSpec& mode, const std::string& path) {
    const GuideSpec& spec = mode.guide;
    const double length = spec.direction.stableNorm();
    if (spec.shape == PrimitiveKind::kForce) {
      throw SceneError(path + "/shape", "a guide is a point, a line or a plane", "choose one");
    }
    if (!spec.position.allFinite() || !(spec.position.norm() < 1e6)) {
      throw SceneError(path + "/at", "it is not a place within 1,000 km", "give metres");
    }
    const bool directed = spec.shape != PrimitiveKind::kPoint;
    if (directed && (!(length > 1e-100) || !std::isfinite(length))) {
      throw SceneError(path + "/along", "it is no direction", "give a vector that is not zero");
    }
    if (!(spec.snap > 0.0)) {
      throw SceneError(path + "/snap", "it must be > 0", "give metres, as 0.005");
    }
    if (!mode.in.empty() && fields_.count(mode.in) == 0) unknown(path + "/in", mode.in);
    GuideMode guide;
    guide.shape = spec.shape;
    guide.position = spec.position;
    if (directed) guide.direction = spec.direction / length;
    guide.snap = spec.snap;
    guide.metres_per_unit = spec.metres_per_unit;
    guide.strength = strength(mode, path, [] { return -1; });
    return guide;
  }

  Mode userMode(const ModeSpec& mode, const std::string& path) {
    if (mode.user.place == nullptr) {
      throw SceneError(path, "a user's mode needs its function", "set ModeSpec::user.place");
    }
    UserMode user;
    user.place = mode.user.place;
    user.state = mode.user.state;
    for (const std::string& name : mode.user.reads) {
      user.reads.push_back(resolve(path + "/user/reads", name).index);
    }
    return user;
  }

  /// Of the one field of a set, the finest where there are several.
  [[nodiscard]] FieldFrame frameOf(const FieldSet& set) const {
    FieldFrame frame;
    frame.voxel = std::numeric_limits<double>::infinity();
    const auto look = [&](const std::vector<FieldFrame>& frames, std::uint64_t bits) {
      for (std::size_t i = 0; i < frames.size(); ++i) {
        if ((bits >> i & 1U) != 0 && frames[i].voxel < frame.voxel) frame = frames[i];
      }
    };
    look(graph_.scalar_frames, set.scalars);
    look(graph_.vector_frames, set.vectors);
    return frame;
  }

  void addStiffness() {
    if (!spec_.stiffness) return;
    const std::string path = "/coupling";
    const TransferSpec& stiffness = *spec_.stiffness;
    for (const TransferSpec::Factor& factor : stiffness.factors) {
      if (factor.by.empty() && !factor.curve.isConstant()) {
        throw SceneError(path + "/stiffness", "a curve does not say what it reads",
                         "add \"by\": the name of a scalar");
      }
    }
    current_ = {};
    graph_.stiffness =
        transfer(stiffness, ModeSpec{}, path, "stiffness", kMostStiffness, [] { return -1; });
    graph_.stiffness_reads = current_;
    if (!(stiffness.lowest() > 0.0)) {
      throw SceneError(path + "/stiffness", "it can be zero", "give outputs > 0, in N/m");
    }
  }

  static constexpr double kMostStrength = 1e9;   // [N]
  static constexpr double kMostStiffness = 1e9;  // [N/m]

  const GraphSpec& spec_;
  const std::map<std::string, FieldPtr>& fields_;
  Graph graph_;
  FieldSet current_;            ///< What the mode at hand has read so far.
  FieldSet support_;            ///< Of that, what it must have to act.
  std::set<std::string> read_;  ///< Volumes that are sampled.
  std::set<std::string> used_;  ///< Derived fields that are.
};

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
    case ModeKind::kTransverseDamping:
      return "transverse_damping";
    case ModeKind::kFrontShape:
      return "front_shape";
    case ModeKind::kVortexTube:
      return "vortex_tube";
    case ModeKind::kGuide:
      return "guide";
    case ModeKind::kUser:
      return "user";
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
