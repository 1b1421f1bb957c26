/// The primitive graph: the properties of each mode, by name for the loader, by index for the tick.
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

#include "palpate/engine/field/field.h"
#include "palpate/engine/field/placement.h"
#include "palpate/engine/field/properties.h"
#include "palpate/engine/modes/mode.h"

namespace palpate {

/// How an entry of the scene file's "fields" is computed from its operand.
enum class Derivation : std::uint8_t {
  kMagnitude,   ///< |v| of any vector.
  kGradient,    ///< Gradient of a scalar volume.
  kCurl,        ///< Curl of a vector volume.
  kDivergence,  ///< Divergence of a vector volume.
  kUnit,        ///< v / |v| of any vector v; zero where v has no direction (flow.h).
  kQ,           ///< The Q criterion of a vector volume: > 0 in a vortex.
  kLambda2,     ///< Lambda 2 of a vector volume: < 0 in a vortex.
};

/// All derivations, in the order of the enumerators.
inline constexpr std::array kDerivations{
    Derivation::kMagnitude, Derivation::kGradient, Derivation::kCurl,   Derivation::kDivergence,
    Derivation::kUnit,      Derivation::kQ,        Derivation::kLambda2};

/// Types of the operand and of the result of a derivation.
struct DerivationKind {
  bool of_vector = true;  ///< True if the operand is a vector; false for a scalar.
  bool vector = false;    ///< True if the result is a vector; false for a scalar.
  bool of_volume = true;  ///< True if the operand must be a volume, because derivatives are needed.
};
/// Returns the types of a derivation.
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

/// One entry of the scene file's "fields": a derivation and its operand.
struct DerivedSpec {
  Derivation derivation = Derivation::kMagnitude;  ///< Kind of the derivation.
  std::string of;  ///< Name of a volume or of another derived field.
};

/// Kind of a mode: the Mode of mode.h that a ModeSpec becomes.
enum class ModeKind : std::uint8_t {
  kForce,       ///< ForceMode: a push along a vector (eq. 8).
  kViscosity,   ///< ViscosityMode: a drag of constant size (eq. 9).
  kSurface,     ///< SurfaceMode: a plane through the proxy, perpendicular to the gradient (eq. 13).
  kIsosurface,  ///< IsosurfaceMode: a plane on V = V0 (eq. 13).
  kFollow,      ///< FollowMode: a line along a vector (eq. 11).
  kTransverseDamping,  ///< Like kFollow, with a name for weak lines.
  kFrontShape,         ///< FrontShapeMode: a plane perpendicular to a vector (eq. 13).
  kVortexTube,  ///< VortexTubeMode: holds the proxy at its radius around the core of a vortex.
  kGuide,       ///< GuideMode: a point, line or plane that the scene places.
  kUser,        ///< UserMode: a user-defined mode, from C++ only.
};

/// States whether values above or below an isovalue are solid.
enum class Solid : std::uint8_t { kAbove, kBelow };

/// Sign of a force: along its field (attract) or against it (repel).
enum class Sense : std::uint8_t { kAttract, kRepel };

/// A material property: one transfer function, or a product of several.
struct TransferSpec {
  /// One curve of the product, and its input.
  struct Factor {
    TransferFunction curve = 1.0;  ///< Outputs >= 0; their product is in the unit of the property.
    std::string by;  ///< Name of the scalar input; if empty, ModeSpec::by, else the mode's scalar.
  };
  std::vector<Factor> factors;  ///< Factors of the product; at least one.

  /// Makes a single curve. Its input is ModeSpec::by, else the mode's scalar.
  TransferSpec(TransferFunction curve) {  // NOLINT(google-explicit-constructor): the usual case
    factors.push_back({std::move(curve), ""});
  }
  /// Makes a constant >= 0. Throws SceneError if it is negative or not finite.
  TransferSpec(double number = 0.0)  // NOLINT(google-explicit-constructor): a number is one
      : TransferSpec(TransferFunction(number)) {}
  /// Makes a product. compileGraph rejects a product without factors.
  explicit TransferSpec(std::vector<Factor> product) : factors(std::move(product)) {}

  /// Returns an upper bound: the product of the curves' highest outputs.
  [[nodiscard]] double highest() const noexcept;
  /// Returns a lower bound where there are data: the product of the curves' lowest outputs.
  [[nodiscard]] double lowest() const noexcept;
  /// Returns true if all curves are constant.
  [[nodiscard]] bool isConstant() const noexcept;
};

/// The shape and the place of a guide.
struct GuideSpec {
  PrimitiveKind shape = PrimitiveKind::kPoint;  ///< Point, line or plane.
  Vec3 position = Vec3::Zero();                 ///< The point, or a point on the line or plane [m].
  Vec3 direction = Vec3::UnitX();  ///< Direction of a line, or outward normal of a plane; != 0.
  double snap = std::numeric_limits<double>::infinity();  ///< Range of the guide [m], > 0.
  double metres_per_unit = 1.0;  ///< Metres per unit of the strength's input.
};

/// The spec of a user-defined mode; see mode.h.
struct UserSpec {
  PlacePrimitives place = nullptr;  ///< Called before every balance. compileGraph rejects null.
  std::shared_ptr<void> state;      ///< Passed to `place`. May be null. All proxies share it.
  std::vector<std::string> reads;  ///< Names of the volumes and derived fields to read for `place`.
};

/// The spec of one mode, as the scene file gives it.
struct ModeSpec {
  std::string name;                    ///< Name for messages; may be empty.
  ModeKind kind = ModeKind::kSurface;  ///< Kind of the mode.
  std::string of;          ///< Name of the volume or derived field; unused for guide and user.
  TransferSpec strength;   ///< Strength of the primitives [N]; unused for user.
  TransferSpec friction;   ///< surface and isosurface: Coulomb's mu, at most kMostFriction.
  TransferSpec viscosity;  ///< surface and isosurface: strength of the drag [N].
  std::string by;  ///< Name of the scalar input of strength, friction and viscosity; if empty, the
                   ///< mode's scalar.
  double value = 0.0;           ///< isosurface: V0, in the data's unit.
  Solid solid = Solid::kAbove;  ///< surface and isosurface: the solid side.
  double depth_voxels =
      3.0;  ///< isosurface: below this depth, a yielded surface fades over a voxel [voxels].
  std::optional<Sense> sense;  ///< force: default kAttract for a vector, kRepel for a scalar.
  bool two_sided = true;       ///< front shape: holds in both directions along its normal.
  double snap_voxels = 0.0;    ///< front shape: distance of snap-drag [voxels]; 0 disables it.
  GuideSpec guide;             ///< guide: its shape and its place.
  std::string in;  ///< guide: the volume that it moves with; empty if it stands still. The guide is
                   ///< placed relative to that volume at rest.
  UserSpec user;   ///< user: its function and its inputs.
};

/// The spec of a graph, by names as in the scene file.
struct GraphSpec {
  /// Derived fields by name. No derived field has the name of a volume.
  std::map<std::string, DerivedSpec> fields;
  std::vector<ModeSpec> modes;  ///< At most kMaxModes, in the order of their primitives.
  /// Motions by the name of the volume. Volumes that share a pointer move together.
  std::map<std::string, MotionPtr> motions;
  std::optional<TransferSpec> stiffness;  ///< Coupling stiffness that depends on properties [N/m];
                                          ///< if not set, that of CouplingParams.
  /// Number of each mode in messages (/modes/5); if empty, the index of the mode.
  std::vector<std::size_t> mode_numbers;
};

/// A set of fields of a graph.
struct FieldSet {
  std::uint64_t scalars = 0;  ///< Bit i: Graph::scalar_fields[i].
  std::uint64_t vectors = 0;  ///< Bit i: Graph::vector_fields[i].

  /// Returns true if every field of `other` is in this set.
  [[nodiscard]] constexpr bool holds(const FieldSet& other) const noexcept {
    return (other.scalars & ~scalars) == 0 && (other.vectors & ~vectors) == 0;
  }
  /// Adds the fields of `other` to this set.
  constexpr FieldSet& operator|=(const FieldSet& other) noexcept {
    scalars |= other.scalars;
    vectors |= other.vectors;
    return *this;
  }
  /// Returns the fields that are in both sets.
  [[nodiscard]] constexpr FieldSet operator&(const FieldSet& other) const noexcept {
    return {scalars & other.scalars, vectors & other.vectors};
  }
};

/// The fields that a mode needs.
struct ModeFields {
  /// A tick reads fields for the mode only at places inside the bounds of all these fields.
  FieldSet support;
  FieldSet reads;  ///< All fields that the mode reads.
};

/// The reading of a scalar field. An index below zero means that the property is not used.
struct ScalarRead {
  int field = 0;           ///< Index into Graph::scalar_fields.
  int value = -1;          ///< Index into Properties::scalars.
  int gradient = -1;       ///< Index into Properties::vectors.
  int cell_gradient = -1;  ///< Index into Properties::vectors.
  bool slope = false;      ///< True if a transfer function reads the value: its slope is needed.
  bool turn = false;       ///< True if a primitive follows the gradient: its Jacobian is needed.
};

/// The reading of a vector field. An index below zero means that the property is not used.
struct VectorRead {
  int field = 0;        ///< Index into Graph::vector_fields.
  int value = -1;       ///< Index into Properties::vectors.
  int curl = -1;        ///< Index into Properties::vectors.
  int divergence = -1;  ///< Index into Properties::scalars.
  int q = -1;           ///< Index into Properties::scalars.
  int lambda2 = -1;     ///< Index into Properties::scalars.
};

/// Writes the direction of vectors[from] to vectors[to].
struct UnitStep {
  int from = 0;  ///< Index into Properties::vectors.
  int to = 0;    ///< Index into Properties::vectors.
};

/// Writes |vectors[from]| to scalars[to].
struct MagnitudeStep {
  int from = 0;  ///< Index into Properties::vectors.
  int to = 0;    ///< Index into Properties::scalars.
};

/// The graph that the tick runs, as flat lists. Each field is sampled at most once in a reading.
struct Graph {
  std::vector<std::shared_ptr<const ScalarField>> scalar_fields;  ///< Scalar fields to read.
  std::vector<std::shared_ptr<const VectorField>> vector_fields;  ///< Vector fields to read.
  std::vector<FieldFrame> scalar_frames;  ///< Placement of each scalar field in W, at rest.
  std::vector<FieldFrame> vector_frames;  ///< Placement of each vector field in W, at rest.
  std::vector<MotionPtr> motions;         ///< No duplicates; empty if all fields and guides rest.
  std::vector<int> scalar_motions;  ///< Index into motions for each scalar field; -1: at rest.
  std::vector<int> vector_motions;  ///< Index into motions for each vector field; -1: at rest.
  std::vector<std::string> scalar_names;       ///< Names of scalar_fields, for messages.
  std::vector<std::string> vector_names;       ///< Names of vector_fields, for messages.
  std::vector<std::string> scalar_properties;  ///< Names of Properties::scalars, as "q of flow".
  std::vector<std::string> vector_properties;  ///< Names of Properties::vectors, as "curl of flow".
  std::vector<ScalarRead> scalar_reads;        ///< One for each of scalar_fields, in their order.
  std::vector<VectorRead> vector_reads;        ///< One for each of vector_fields, in their order.
  std::vector<UnitStep> units;                 ///< Each step comes after those that it depends on.
  std::vector<MagnitudeStep> magnitudes;       ///< Run after all `units`.
  std::vector<Mode> modes;  ///< The modes in the spec's order, without those in `silent`.
  std::vector<ModeFields> mode_fields;  ///< The fields of each mode.
  std::vector<double> mode_voxels;    ///< Finest voxel of each mode [m]; infinite without a field.
  std::vector<char> mode_follows;     ///< followsValue() of each mode.
  std::vector<int> mode_motions;      ///< Index of the motion that carries each mode, or -1.
  std::vector<std::size_t> surfaces;  ///< Indices of the modes that have a contact.
  std::vector<std::size_t> curves;    ///< Indices of the modes that hold the proxy to a streamline.
  std::vector<std::size_t> mode_sources;  ///< Number of each mode, by GraphSpec::mode_numbers.
  std::vector<std::string>
      mode_names;  ///< Names of modes in messages; without a name the path, such as /modes/5.
  /// Finest voxel of all fields [m]; infinite without a field.
  double finest = std::numeric_limits<double>::infinity();
  Transfer stiffness;        ///< Coupling stiffness [N/m]. Without factors it is constant.
  FieldSet stiffness_reads;  ///< Fields that the stiffness reads, even without data
                             ///< (Transfer::anywhere).
  /// Fields that matter only in contact (bit i: scalar_fields[i]). These fields need no attend(),
  /// and only two kinds of modes read them. The first kind is an isosurface with the same strength
  /// everywhere on V = level, and with the background on its free side. The second kind is a drag
  /// that is zero on the free side of such an isosurface. If the proxy is in front of all these
  /// surfaces, the modes of both kinds add no primitive.
  std::uint64_t contact_only = 0;
  /// True if primitives depend only on the last reading, on contacts, and on the proxy by their
  /// position: all modes are isosurfaces and drags (viscosity). Says nothing of parts and motions.
  bool by_reading = false;
  /// Numbers of the fields that need attend(). The numbers of vector_fields continue those of
  /// scalar_fields.
  std::vector<std::size_t> attentive;
  std::vector<std::string> unused;  ///< Fields and derived fields that neither a mode nor the
                                    ///< stiffness reads: not sampled.
  std::vector<std::string> silent;  ///< Modes left out, because strength and viscosity are zero.
};

/// Largest number of modes of one graph.
inline constexpr std::size_t kMaxModes = 256;
/// Largest number of fields that one graph reads, scalars and vectors together.
inline constexpr std::size_t kMaxFields = 64;
/// Largest number of motions of one scene, for fields and guides together.
inline constexpr std::size_t kMaxMotions = 64;

/// Checks the names, types and references of a spec and compiles it to flat lists. Throws
/// SceneError, with the JSON path of the error (such as /modes/0/of) as its subject.
[[nodiscard]] Graph compileGraph(const GraphSpec& spec,
                                 const std::map<std::string, FieldPtr>& fields);

/// Returns the word for a kind of mode in scene files, such as "front_shape".
[[nodiscard]] const char* wordFor(ModeKind kind) noexcept;
/// Returns the key of a derivation in the scene file's "fields", such as "lambda2".
[[nodiscard]] const char* wordFor(Derivation derivation) noexcept;

}  // namespace palpate
