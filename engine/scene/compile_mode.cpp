#include "palpate/engine/scene/compile_mode.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <sstream>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

constexpr double kMostStrength = 1e9;   // [N]
constexpr double kMostStiffness = 1e9;  // [N/m]

std::string shortNumber(double value) {
  std::ostringstream out;
  out << value;
  return out.str();
}

int scalarInput(GraphReads& reads, const std::string& path, const std::string& name) {
  reads.names().checkScalar(path, name);
  return reads.resolve(path, name).index;
}

/// Compiles one material property of a mode. The input of a factor is the factor's `by`, else the
/// mode's `by`, else the scalar with the index own(). own() is called only in this case.
template <class OwnInput>
Transfer transfer(const TransferSpec& spec, const ModeSpec& mode, const std::string& path,
                  const std::string& key, double most, GraphReads& reads, OwnInput own) {
  const std::vector<TransferSpec::Factor>& factors = spec.factors;
  const std::string at = path + "/" + key;
  if (factors.empty())
    throw SceneError(at, "the product has no factors", "give at least one factor");
  Transfer out;
  const bool zero = spec.highest() == 0.0;
  // With `by` and a single constant strength, a mode acts only where `by` has data.
  const bool mask = key == "strength" && factors.size() == 1 && !mode.by.empty();
  for (std::size_t i = 0; i < factors.size(); ++i) {
    const TransferSpec::Factor& factor = factors[i];
    const std::string here = factors.size() > 1 ? at + "/product/" + std::to_string(i) : at;
    int scalar = -1;
    if (!factor.by.empty()) reads.names().checkScalar(here + "/by", factor.by);
    if (zero) continue;
    if (!factor.by.empty()) {
      scalar = scalarInput(reads, here + "/by", factor.by);
    } else if (!factor.curve.isConstant() || mask) {
      scalar = mode.by.empty() ? own() : scalarInput(reads, path + "/by", mode.by);
    }
    if (scalar >= 0 && !factor.curve.isConstant()) reads.followSlope(scalar);
    out.factors.push_back({factor.curve, scalar});
  }
  // A product of factors has the same limit as a single number.
  if (!(spec.highest() <= most)) {
    const char* const unit = key == "stiffness" ? " N/m" : key == "friction" ? "" : " N";
    throw SceneError(at,
                     "the highest value, " + shortNumber(spec.highest()) + unit + ", exceeds " +
                         shortNumber(most) + unit,
                     "reduce the value or its factors");
  }
  return out;
}

/// Throws if the spec has a key without effect in this kind of mode.
void checkKeys(const ModeSpec& mode, const std::string& path, const GraphNames& names) {
  const bool surface = mode.kind == ModeKind::kSurface || mode.kind == ModeKind::kIsosurface;
  if (!surface && (mode.friction.highest() > 0.0 || mode.viscosity.highest() > 0.0)) {
    throw SceneError(
        path,
        std::string("mode ") + wordFor(mode.kind) + " does not use \"friction\" or \"viscosity\"",
        "remove these keys, or use mode surface or isosurface");
  }
  if (mode.by.empty()) return;
  names.checkScalar(path + "/by", mode.by);
  const auto reads = [](const TransferSpec& spec) {
    return std::any_of(spec.factors.begin(), spec.factors.end(), [](const auto& factor) {
      return factor.by.empty() && !factor.curve.isConstant();
    });
  };
  const bool mask = mode.strength.factors.size() == 1 && mode.strength.factors[0].by.empty();
  if (!mask && !reads(mode.strength) && !reads(mode.friction) && !reads(mode.viscosity)) {
    throw SceneError(path + "/by", "no curve of the mode reads this scalar", "remove \"by\"");
  }
}

/// Compiles one mode: first the property of its `of` and its support, then its material properties.
class ModeCompiler {
 public:
  ModeCompiler(const ModeSpec& mode, const std::string& path, GraphReads& reads)
      : mode_(mode), path_(path), reads_(reads) {}

  struct Kind {
    ModeKind kind;
    const char* word;
    Mode (ModeCompiler::*compile)();
  };
  static const std::array<Kind, static_cast<std::size_t>(ModeKind::kUser) + 1> kKinds;

  CompiledMode compile() {
    const Kind& kind = kKinds[static_cast<std::size_t>(mode_.kind)];
    Mode mode = (this->*kind.compile)();
    return {std::move(mode), support_};
  }

 private:
  Slot resolveVector() {
    const Slot slot = reads_.resolve(path_ + "/of", mode_.of);
    if (!slot.vector) {
      throw SceneError(path_ + "/of",
                       "mode " + std::string(wordFor(mode_.kind)) + " needs a vector and \"" +
                           mode_.of + "\" is a scalar",
                       "give a vector volume, or the gradient of this scalar");
    }
    return slot;
  }

  /// Returns the mode's scalar volume, for kinds that need its gradient and its voxel size.
  const ScalarField& scalarVolume() {
    const FieldPtr* field = reads_.names().volume(mode_.of);
    if (field == nullptr) {
      (void)reads_.names().isVector(path_ + "/of", mode_.of);  // throws if the name is unknown
      throw SceneError(path_ + "/of",
                       "mode " + std::string(wordFor(mode_.kind)) + " needs a volume and \"" +
                           mode_.of + "\" is a derived field",
                       "give a scalar volume");
    }
    if (field->index() != 0) {
      throw SceneError(path_ + "/of",
                       "mode " + std::string(wordFor(mode_.kind)) +
                           " needs a scalar volume and \"" + mode_.of + "\" is a vector",
                       "use mode follow or force for a vector, or give a scalar volume");
    }
    return *std::get<0>(*field);
  }

  template <class OwnInput>
  Transfer strength(OwnInput own) {
    return transfer(mode_.strength, mode_, path_, "strength", kMostStrength, reads_, own);
  }
  template <class OwnInput>
  Transfer friction(OwnInput own) {
    return transfer(mode_.friction, mode_, path_, "friction", kMostFriction, reads_, own);
  }
  template <class OwnInput>
  Transfer viscosity(OwnInput own) {
    return transfer(mode_.viscosity, mode_, path_, "viscosity", kMostStrength, reads_, own);
  }

  SurfaceSource skinOf() {
    const FieldFrame& frame = scalarVolume().frame();
    SurfaceSource skin;
    skin.field = reads_.scalarField(mode_.of);
    skin.value = reads_.valueOf(mode_.of);
    skin.gradient = reads_.gradientOf(mode_.of);
    skin.cell_gradient = reads_.cellGradientOf(mode_.of);
    skin.sign = outwardSign(mode_.solid);
    skin.voxel = frame.voxel;
    skin.metres_per_unit = frame.metres_per_unit;
    return skin;
  }

  /// Returns the index of the volume whose streams follow the named vector; -1 for other vectors.
  int streamOf(const std::string& name) {
    if (reads_.names().volume(name) != nullptr) return reads_.vectorField(name);
    const DerivedSpec& derived = reads_.names().derived(path_ + "/of", name);
    const bool same = derived.derivation == Derivation::kUnit;
    return same ? streamOf(derived.of) : -1;
  }

  static double outwardSign(Solid solid) noexcept { return solid == Solid::kAbove ? -1.0 : 1.0; }

  /// Returns the index of the mode's vector, and adds its field to the support.
  int vectorOf() {
    const Slot slot = resolveVector();
    support_ = reads_.current;
    return slot.index;
  }

  Mode viscosityMode() {
    Slot slot = reads_.resolve(path_ + "/of", mode_.of);
    if (slot.vector) slot = {false, reads_.magnitudeOf(slot.index)};
    support_ = reads_.current;
    return ViscosityMode{slot.index, strength([&] { return slot.index; })};
  }

  Mode surface() {
    SurfaceMode surface;
    surface.skin = skinOf();
    support_ = reads_.current;
    const auto own = [&] { return reads_.valueOf(mode_.of); };
    surface.strength = strength(own);
    surface.friction = friction(own);
    surface.viscosity = viscosity(own);
    return surface;
  }

  Mode follow() {
    FollowMode follow;
    follow.vector = vectorOf();
    follow.field = streamOf(mode_.of);
    follow.voxel = reads_.frameOf(support_).voxel;
    follow.strength = strength([&] { return reads_.magnitudeOf(follow.vector); });
    return follow;
  }

  Mode force() {
    const Slot slot = reads_.resolve(path_ + "/of", mode_.of);
    ForceMode force;
    if (slot.vector) {
      force.vector = slot.index;
      reads_.followTurn(force.vector);
      force.sign = mode_.sense.value_or(Sense::kAttract) == Sense::kAttract ? 1.0 : -1.0;
      support_ = reads_.current;
      force.strength = strength([&] { return reads_.magnitudeOf(slot.index); });
    } else {
      scalarVolume();
      force.vector = reads_.gradientOf(mode_.of);
      reads_.followTurn(force.vector);
      force.sign = mode_.sense.value_or(Sense::kRepel) == Sense::kAttract ? 1.0 : -1.0;
      support_ = reads_.current;
      force.strength = strength([&] { return slot.index; });
    }
    return force;
  }

  Mode isosurface() {
    IsosurfaceMode iso;
    iso.skin = skinOf();
    if (!(mode_.depth_voxels > 0.0) || !std::isfinite(mode_.depth_voxels)) {
      throw SceneError(path_ + "/depth", "the depth must be > 0",
                       "give a depth in voxels, such as 3");
    }
    if (!std::isfinite(mode_.value)) {
      throw SceneError(path_ + "/value", "the value is not a finite number",
                       "give the volume's value on the surface");
    }
    iso.level = mode_.value;
    iso.depth = mode_.depth_voxels * iso.skin.voxel;
    support_ = reads_.current;
    const auto own = [&] { return iso.skin.value; };
    iso.strength = strength(own);
    iso.friction = friction(own);
    iso.skin.grooves = scalarVolume().frame().distance && mode_.friction.highest() > 0.0;
    iso.viscosity = viscosity(own);
    return iso;
  }

  Mode frontShape() {
    if (!(mode_.snap_voxels >= 0.0) || !std::isfinite(mode_.snap_voxels)) {
      throw SceneError(path_ + "/snap_drag", "the distance must be >= 0",
                       "give a distance in voxels, such as 4");
    }
    FrontShapeMode front;
    front.vector = vectorOf();
    reads_.followTurn(front.vector);
    front.two_sided = mode_.two_sided;
    front.snap = mode_.snap_voxels * reads_.frameOf(support_).voxel;
    front.strength = strength([&] { return reads_.magnitudeOf(front.vector); });
    return front;
  }

  Mode vortexTube() {
    const FieldPtr* field = reads_.names().volume(mode_.of);
    if (field == nullptr || field->index() != 1) {
      (void)reads_.names().isVector(path_ + "/of", mode_.of);  // throws if the name is unknown
      throw SceneError(path_ + "/of",
                       "mode vortex_tube needs a vector volume and \"" + mode_.of + "\" is not one",
                       "give a velocity; the mode computes its curl");
    }
    VortexTubeMode tube;
    tube.vector = vectorOf();
    tube.curl = reads_.curlOf(mode_.of);
    tube.voxel = reads_.frameOf(support_).voxel;
    tube.metres_per_unit = reads_.frameOf(support_).metres_per_unit;
    tube.strength = strength([&] { return reads_.magnitudeOf(tube.curl); });
    return tube;
  }

  Mode guide() {
    const GuideSpec& spec = mode_.guide;
    const double length = spec.direction.stableNorm();
    if (spec.shape == PrimitiveKind::kForce) {
      throw SceneError(path_ + "/shape", "a guide is a point, a line or a plane",
                       "choose one of them");
    }
    if (!spec.position.allFinite() || !(spec.position.norm() < 1e6)) {
      throw SceneError(path_ + "/at", "the position is not within 1,000 km of the origin",
                       "give metres");
    }
    const bool directed = spec.shape != PrimitiveKind::kPoint;
    if (directed && (!(length > 1e-100) || !std::isfinite(length))) {
      throw SceneError(path_ + "/along", "the vector is zero or not finite",
                       "give a direction, such as [0, 0, 1]");
    }
    if (!(spec.snap > 0.0)) {
      throw SceneError(path_ + "/snap", "the distance must be > 0", "give metres, such as 0.005");
    }
    if (!mode_.in.empty() && reads_.names().volume(mode_.in) == nullptr) {
      reads_.names().throwUnknown(path_ + "/in", mode_.in);
    }
    GuideMode guide;
    guide.shape = spec.shape;
    guide.position = spec.position;
    if (directed) guide.direction = spec.direction / length;
    guide.snap = spec.snap;
    guide.metres_per_unit = spec.metres_per_unit;
    guide.strength = strength([] { return -1; });
    return guide;
  }

  Mode userMode() {
    if (mode_.user.place == nullptr) {
      throw SceneError(path_, "a user-defined mode has no function", "set ModeSpec::user.place");
    }
    UserMode user;
    user.place = mode_.user.place;
    user.state = mode_.user.state;
    for (const std::string& name : mode_.user.reads) {
      user.reads.push_back(reads_.resolve(path_ + "/user/reads", name).index);
    }
    return user;
  }

  const ModeSpec& mode_;
  const std::string& path_;
  GraphReads& reads_;
  FieldSet support_;  ///< Fields that must have data for the mode to act.
};

constexpr std::array<ModeCompiler::Kind, static_cast<std::size_t>(ModeKind::kUser) + 1>
    ModeCompiler::kKinds{{
        {ModeKind::kForce, "force", &ModeCompiler::force},
        {ModeKind::kViscosity, "viscosity", &ModeCompiler::viscosityMode},
        {ModeKind::kSurface, "surface", &ModeCompiler::surface},
        {ModeKind::kIsosurface, "isosurface", &ModeCompiler::isosurface},
        {ModeKind::kFollow, "follow", &ModeCompiler::follow},
        {ModeKind::kTransverseDamping, "transverse_damping", &ModeCompiler::follow},
        {ModeKind::kFrontShape, "front_shape", &ModeCompiler::frontShape},
        {ModeKind::kVortexTube, "vortex_tube", &ModeCompiler::vortexTube},
        {ModeKind::kGuide, "guide", &ModeCompiler::guide},
        {ModeKind::kUser, "user", &ModeCompiler::userMode},  // kUser is the last ModeKind
    }};
static_assert([] {  // kKinds has the order of ModeKind
  for (std::size_t i = 0; i < ModeCompiler::kKinds.size(); ++i) {
    if (ModeCompiler::kKinds[i].kind != static_cast<ModeKind>(i)) return false;
  }
  return true;
}());

}  // namespace

const char* wordFor(ModeKind kind) noexcept {
  return ModeCompiler::kKinds[static_cast<std::size_t>(kind)].word;
}

CompiledMode compileMode(const ModeSpec& spec, const std::string& path, GraphReads& reads) {
  checkKeys(spec, path, reads.names());
  return ModeCompiler(spec, path, reads).compile();
}

Transfer compileStiffness(const TransferSpec& spec, GraphReads& reads) {
  const std::string path = "/coupling";
  for (std::size_t i = 0; i < spec.factors.size(); ++i) {
    const TransferSpec::Factor& factor = spec.factors[i];
    if (factor.by.empty() && !factor.curve.isConstant()) {
      std::string at = path + "/stiffness";
      if (spec.factors.size() > 1) at += "/product/" + std::to_string(i);
      throw SceneError(at, "the curve has no input", "add \"by\" with the name of a scalar");
    }
  }
  Transfer stiffness =
      transfer(spec, ModeSpec{}, path, "stiffness", kMostStiffness, reads, [] { return -1; });
  if (!(spec.lowest() > 0.0)) {
    throw SceneError(path + "/stiffness", "its lowest value is zero", "give outputs > 0, in N/m");
  }
  return stiffness;
}

}  // namespace palpate
