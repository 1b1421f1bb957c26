/// The primitive graph: which property feeds which mode. Names at load, indices in the tick.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "palpate/engine/field.h"
#include "palpate/engine/mode.h"
#include "palpate/engine/placement.h"
#include "palpate/engine/properties.h"

namespace palpate {

/// A property computed from another, as the scene file's "fields" say.
enum class Derivation : std::uint8_t {
  kMagnitude,   ///< |v| of any vector.
  kGradient,    ///< Of a scalar volume.
  kCurl,        ///< Of a vector volume.
  kDivergence,  ///< Of a vector volume.
  kUnit,        ///< v / |v| of any vector; zero where it has no direction, see flow.h.
  kQ,           ///< The Q criterion of a vector volume: > 0 in a vortex.
  kLambda2,     ///< Of a vector volume: < 0 in a vortex.
};

/// All of them, in the order of the enumerators.
inline constexpr std::array kDerivations{
    Derivation::kMagnitude, Derivation::kGradient, Derivation::kCurl,   Derivation::kDivergence,
    Derivation::kUnit,      Derivation::kQ,        Derivation::kLambda2};

/// What a derivation is made of, and what it gives.
struct DerivationKind {
  bool of_vector = true;  ///< Else of a scalar.
  bool vector = false;    ///< What it gives; else a scalar.
  bool of_volume = true;  ///< Needs its operand's derivatives, hence a volume.
};
[[nodiscard]] constexpr DerivationKind kindOf(Derivation derivation) noexcept {
  switch (derivation) {
    case Derivation::kMagnitude:
      return {true, false, false};
    case Derivation::kUnit:
      return {true, true, false};
    case Derivation::kGradient:
      return {false, true, true};
    case Derivation::kCurl:
      return {true, true, true};
    case Derivation::kDivergence:
    case Derivation::kQ:
    case Derivation::kLambda2:
      break;
  }
  return {true, false, true};
}

struct DerivedSpec {
  Derivation derivation = Derivation::kMagnitude;
  std::string of;  ///< A volume or another derived field.
};

enum class ModeKind : std::uint8_t {
  kForce,
  kViscosity,
  kSurface,
  kIsosurface,
  kFollow,
  kTransverseDamping,  ///< As follow, and by its name meant weak.
  kFrontShape,
  kVortexTube,
  kGuide,
  kUser,  ///< From C++ only.
};

/// Which side of a value is solid.
enum class Solid : std::uint8_t { kAbove, kBelow };

/// Whether a force pulls along its field or pushes against it.
enum class Sense : std::uint8_t { kAttract, kRepel };

/// A material property: one transfer function, or several multiplied.
struct TransferSpec {
  struct Factor {
    TransferFunction curve = 1.0;
    std::string by;  ///< The scalar that it reads; empty: the mode's `by`, else the mode's own.
  };
  std::vector<Factor> factors;

  TransferSpec(TransferFunction curve) {  // NOLINT(google-explicit-constructor): the usual case
    factors.push_back({std::move(curve), ""});
  }
  TransferSpec(double number = 0.0)  // NOLINT(google-explicit-constructor): a number is one
      : TransferSpec(TransferFunction(number)) {}
  explicit TransferSpec(std::vector<Factor> product) : factors(std::move(product)) {}

  /// The most and the least that it can be where there are data.
  [[nodiscard]] double highest() const noexcept;
  [[nodiscard]] double lowest() const noexcept;
  /// True if it reads nothing.
  [[nodiscard]] bool isConstant() const noexcept;
};

/// Where a guide is.
struct GuideSpec {
  PrimitiveKind shape = PrimitiveKind::kPoint;  ///< Point, line or plane.
  Vec3 position = Vec3::Zero();                 ///< [m]
  Vec3 direction = Vec3::UnitX();               ///< Of a line; a plane's outward normal. Not zero.
  double snap = std::numeric_limits<double>::infinity();  ///< [m], > 0.
  double metres_per_unit = 1.0;                           ///< Of the distance that its curves read.
};

/// A mode of the user's own; see mode.h.
struct UserSpec {
  PlacePrimitives place = nullptr;
  std::shared_ptr<void> state;
  std::vector<std::string> reads;  ///< Volumes and derived fields.
};

/// One mode, as the scene file says it.
struct ModeSpec {
  std::string name;  ///< For people; may be empty.
  ModeKind kind = ModeKind::kSurface;
  std::string of;               ///< The volume or derived field it is made of; not of guide, user.
  TransferSpec strength;        ///< [N]; not of user.
  TransferSpec friction;        ///< surface and isosurface: Coulomb's mu, at most kMostFriction.
  TransferSpec viscosity;       ///< surface and isosurface: [N].
  std::string by;               ///< The scalar that these read; empty: the mode's own.
  double value = 0.0;           ///< isosurface: V0.
  Solid solid = Solid::kAbove;  ///< surface and isosurface.
  double depth_voxels = 3.0;    ///< isosurface: pushes back until so deep after yielding.
  std::optional<Sense> sense;   ///< force; default: along a vector, down a scalar's gradient.
  bool two_sided = true;        ///< front shape.
  double snap_voxels = 0.0;     ///< front shape: snap-drag, see mode.h; 0: none.
  GuideSpec guide;
  std::string in;  ///< guide: the volume that it moves with, given as that rests; empty: none.
  UserSpec user;
};

/// Largest friction coefficient. Rubber on rubber is 1.2.
inline constexpr double kMostFriction = 10.0;

/// Names and edges, as the scene file says.
struct GraphSpec {
  std::map<std::string, DerivedSpec> fields;
  std::vector<ModeSpec> modes;
  std::map<std::string, MotionPtr> motions;  ///< By volume; the others stand still. Volumes of one
                                             ///< pointer move together.
  std::optional<TransferSpec> stiffness;     ///< Coupling stiffness by a property [N/m]; none: as
                                             ///< CouplingParams says.
  std::vector<std::size_t> mode_numbers;     ///< What each mode is called, as /modes/5, where these
                                             ///< are some of another spec's; empty: its index.
};

/// A set of a graph's fields.
struct FieldSet {
  std::uint64_t scalars = 0;  ///< Bit i: Graph::scalar_fields[i].
  std::uint64_t vectors = 0;

  [[nodiscard]] constexpr bool holds(const FieldSet& other) const noexcept {
    return (other.scalars & ~scalars) == 0 && (other.vectors & ~vectors) == 0;
  }
  constexpr FieldSet& operator|=(const FieldSet& other) noexcept {
    scalars |= other.scalars;
    vectors |= other.vectors;
    return *this;
  }
  [[nodiscard]] constexpr FieldSet operator&(const FieldSet& other) const noexcept {
    return {scalars & other.scalars, vectors & other.vectors};
  }
};

/// Which fields a mode needs.
struct ModeFields {
  FieldSet
      support;     ///< Outside the bounds of one of these it is silent, and nothing is read for it.
  FieldSet reads;  ///< All that it reads.
};

/// One scalar field read once; an index below zero is wanted by nobody and not written.
struct ScalarRead {
  int field = 0;           ///< Index into Graph::scalar_fields.
  int value = -1;          ///< -> Properties::scalars
  int gradient = -1;       ///< -> Properties::vectors
  int cell_gradient = -1;  ///< -> Properties::vectors
  bool slope = false;      ///< A strength follows the value: its slope is wanted,
  bool turn = false;       ///< and how the gradient turns.
};

/// One vector field read once.
struct VectorRead {
  int field = 0;        ///< Index into Graph::vector_fields.
  int value = -1;       ///< -> Properties::vectors
  int curl = -1;        ///< -> Properties::vectors
  int divergence = -1;  ///< -> Properties::scalars
  int q = -1;           ///< -> Properties::scalars
  int lambda2 = -1;     ///< -> Properties::scalars
};

/// The direction of vectors[from] -> vectors[to].
struct UnitStep {
  int from = 0;
  int to = 0;
};

/// |vectors[from]| -> scalars[to].
struct MagnitudeStep {
  int from = 0;
  int to = 0;
};

/// What the tick runs: a flat list, nothing sampled twice and nothing in vain.
struct Graph {
  std::vector<std::shared_ptr<const ScalarField>> scalar_fields;  ///< Only those read.
  std::vector<std::shared_ptr<const VectorField>> vector_fields;
  std::vector<FieldFrame> scalar_frames;  ///< How they lie.
  std::vector<FieldFrame> vector_frames;
  std::vector<MotionPtr> motions;   ///< Each once; none: nothing moves.
  std::vector<int> scalar_motions;  ///< Of each field its index there; -1: it stands still.
  std::vector<int> vector_motions;
  std::vector<std::string> scalar_names;  ///< Of the fields, and what each property is: for people.
  std::vector<std::string> vector_names;
  std::vector<std::string> scalar_properties;
  std::vector<std::string> vector_properties;
  std::vector<ScalarRead> scalar_reads;
  std::vector<VectorRead> vector_reads;
  std::vector<UnitStep> units;  ///< Each after the one that it is made of.
  std::vector<MagnitudeStep> magnitudes;
  std::vector<Mode> modes;
  std::vector<ModeFields> mode_fields;    ///< One a mode.
  std::vector<double> mode_voxels;        ///< The finest that each reads [m],
  std::vector<char> mode_follows;         ///< and whether it followsValue().
  std::vector<int> mode_motions;          ///< Of what the mode is made of; -1: it stands still.
  std::vector<std::size_t> mode_sources;  ///< Each mode's number in GraphSpec.
  std::vector<std::string> mode_names;
  Transfer stiffness;        ///< [N/m]; no factors: constant.
  FieldSet stiffness_reads;  ///< Where they have data about the proxy; else the background counts.
  std::vector<std::string> unused;  ///< Fields and derived fields that no mode reads: not sampled.
  std::vector<std::string> silent;  ///< Modes left out: their strength is zero everywhere.
};

/// Most modes of one scene, and most fields that one scene reads.
inline constexpr std::size_t kMaxModes = 256;
inline constexpr std::size_t kMaxFields = 64;
/// Most motions: of the fields and of guides.
inline constexpr std::size_t kMaxMotions = 64;

/// Checks the names, types and edges and flattens them. Throws SceneError whose text begins with
/// the JSON path of what is wrong, as /modes/0/of.
[[nodiscard]] Graph compileGraph(const GraphSpec& spec,
                                 const std::map<std::string, FieldPtr>& fields);

/// The words of the scene file.
[[nodiscard]] const char* wordFor(ModeKind kind) noexcept;
[[nodiscard]] const char* wordFor(Derivation derivation) noexcept;

}  // namespace palpate
