/// Haptic modes, compiled: they turn properties at the proxy into primitives.
#pragma once

#include <cassert>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <variant>
#include <vector>

#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/field/placement.h"
#include "palpate/engine/field/properties.h"
#include "palpate/engine/modes/contact.h"
#include "palpate/engine/modes/transfer.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Largest friction coefficient. Rubber on rubber has 1.2.
inline constexpr double kMostFriction = 10.0;
/// Largest factor by which the walls of a groove increase friction (Seam::walls).
inline constexpr double kMostWalls = 3.0;

/// A material property of the paper's section 2 (strength, friction, viscosity, stiffness): a
/// transfer function of one scalar property, or a product of several.
struct Transfer {
  /// One transfer function, and the scalar property that it reads.
  struct Factor {
    TransferFunction curve;  ///< The curve; its outputs are >= 0.
    /// Index into Properties::scalars. -1 for a constant, and for the value that the mode itself
    /// measures.
    int scalar = -1;
  };
  /// Factors of the product. Without factors the material property is zero.
  std::vector<Factor> factors;

  /// Returns the product, >= 0, with `own` as the input of factors with scalar -1; 0 if the
  /// property of a factor has no data. RT: no allocation.
  [[nodiscard]] double operator()(const Properties& properties, double own = 0.0) const noexcept;
  /// Returns the gradient of the product at the place of the reading [its unit / m]; zero if the
  /// property of a factor has no data. At a knot, this is the slope just above the knot. `own` is
  /// the input of factors with scalar -1, and does not depend on the place. RT: no allocation.
  [[nodiscard]] Vec3 slope(const Properties& properties,
                           double own = 0.0) const noexcept PALPATE_NONBLOCKING;
  /// Returns the product, with `value` as the input of factors with scalar `index` or -1; 0 if the
  /// property of another factor has no data. RT: no allocation.
  [[nodiscard]] double at(const Properties& properties, int index, double value) const noexcept;
  /// Returns the product even without data: a scalar volume then has its background value, and
  /// other scalars are zero. The coupling's stiffness needs this. RT: no allocation.
  [[nodiscard]] double anywhere(const Properties& properties) const noexcept;
};

/// Memory of a SurfaceMode: its plane, and the surface that the plane follows.
struct SurfaceMemory {
  Contact contact;        ///< The plane and its last load.
  bool holds = false;     ///< True if the last balance lies on the contact's plane.
  bool captured = false;  ///< True once the plane follows the surface V = level.
  double level = 0.0;     ///< Va, in the data's unit.
};

/// The side of an isosurface on which the proxy is.
enum class Side : std::uint8_t {
  kUnknown,  ///< No reading yet.
  kOutside,  ///< The proxy is on the free side, or the surface holds it.
  kYielded,  ///< The surface has yielded. The plane pulls the proxy back, until the proxy returns
             ///< or is a voxel deeper than IsosurfaceMode::depth.
  kInside,   ///< The proxy is on the solid side, moves freely and may leave.
};
/// Memory of an IsosurfaceMode: its plane, and the side of the proxy.
struct IsosurfaceMemory {
  Contact contact;             ///< The plane on V = level and its last load.
  Side side = Side::kUnknown;  ///< Side of the proxy after the last reading and the last settle().
  double share = 1.0;          ///< Factor on the strength, < 1 while a yielded surface fades.
};

/// Memory of a curve that holds the proxy.
struct OnCurve {
  bool holds = false;   ///< True if the last balance lies on the line of the mode.
  double stride = 0.5;  ///< First step of the next trace to try [voxels].
  Vec3 bend =
      Vec3::Zero();  ///< Second derivative of the curve in its volume's resting frame [1/voxel].
};
/// Memory of a FollowMode: the direction of its stream, and its curve.
struct FollowMemory {
  Vec3 before = Vec3::Zero();  ///< Direction of the field at the proxy; zero if unknown.
  OnCurve on;                  ///< The curve that the proxy follows.
};

/// Memory of a FrontShapeMode: the direction of its field, and its front.
struct FrontShapeMemory {
  Vec3 before = Vec3::Zero();   ///< Direction of the field at the proxy; zero if unknown.
  Vec3 anchor = Vec3::Zero();   ///< A point of the front [m].
  Vec3 normal = Vec3::UnitX();  ///< Unit normal of the front.
  bool placed = false;          ///< True if there is a front.
  bool let_go = false;          ///< True from the release of the proxy until the proxy rests.
};

/// Memory of a VortexTubeMode.
struct VortexTubeMemory {
  Vec3 before = Vec3::Zero();  ///< Direction of the radius at the proxy; zero if unknown.
};

/// A directed force (eq. 8) along a vector. This force may add energy.
struct ForceMode {
  using Memory = std::monostate;  ///< The mode has no memory.
  int vector = -1;                ///< Index into Properties::vectors.
  double sign = 1.0;              ///< +1 along the vector, -1 against it.
  Transfer strength;              ///< Strength of the force [N].
};

/// A point (eq. 9) at the proxy: a drag of constant magnitude, in contrast to -b v.
struct ViscosityMode {
  using Memory = std::monostate;  ///< The mode has no memory.
  /// Index into Properties::scalars. Without data the drag is zero.
  int scalar = -1;
  Transfer strength;  ///< Strength of the drag [N].
};

/// The paper's surface, friction and viscosity: a plane (eq. 13) through the proxy, perpendicular
/// to the gradient. While the plane holds the proxy, the plane stays on V = Va, the value at which
/// it began to hold. Otherwise the proxy would drift along the normal of a curved surface. Friction
/// adds a line (eq. 11) along the normal, and viscosity adds a point (eq. 9).
struct SurfaceMode {
  using Memory = SurfaceMemory;  ///< The memory that is kept from tick to tick.
  SurfaceSource skin;            ///< Properties read from the volume, its solid side and its scale.
  Transfer strength;             ///< Strength of the plane [N].
  Transfer friction;             ///< Coulomb's mu.
  Transfer viscosity;            ///< Strength of the drag [N]; no drag where there is no gradient.
};

/// A plane (eq. 13) on V = level, once the proxy reaches it. Friction adds a line (eq. 11).
struct IsosurfaceMode {
  using Memory = IsosurfaceMemory;  ///< The memory that is kept from tick to tick.
  SurfaceSource skin;   ///< Properties read from the volume, its solid side and its scale.
  double level = 0.0;   ///< V0, in the data's unit.
  double depth = 3e-3;  ///< If the proxy is farther behind a yielded plane, the strength fades over
                        ///< a voxel [m].
  Transfer strength;    ///< Strength of the plane [N]: its value at V = level until the surface
                        ///< yields, then its value at the reading.
  Transfer friction;    ///< Coulomb's mu, which a groove can increase (SurfaceSource::grooves).
  Transfer viscosity;   ///< Strength of the drag in the solid [N], a point (eq. 9).
};

/// A line (eq. 11) through the proxy along a vector: the hand slides along the stream. A weak line
/// is the paper's transverse damping. If the line holds the proxy, the proxy follows the stream's
/// curve (VectorField::trace).
struct FollowMode {
  using Memory = FollowMemory;  ///< The memory that is kept from tick to tick.
  int vector = -1;              ///< Index into Properties::vectors.
  /// Index into Graph::vector_fields of the field with the vector's streams. -1 for a gradient, a
  /// curl or their unit vectors: the proxy follows these by tangents.
  int field = -1;
  double voxel = 1e-3;  ///< Shortest edge of a voxel [m].
  Transfer strength;    ///< Strength of the line [N].
};

/// A plane (eq. 13) through the proxy, perpendicular to a vector: a front, such as that of a wave.
/// A two-sided front consists of two opposed planes.
struct FrontShapeMode {
  using Memory = FrontShapeMemory;  ///< The memory that is kept from tick to tick.
  int vector = -1;                  ///< Index into Properties::vectors.
  bool two_sided = true;            ///< If false, the front stops only motion against the vector.
  double snap = 0.0;  ///< Distance of snap-drag [m]. Up to this distance the front pulls back a
                      ///< proxy that was pushed off it. Beyond, the front releases the proxy, and
                      ///< the next front is placed where the proxy rests. If 0, the front moves
                      ///< with the proxy.
  Transfer strength;  ///< Strength of each plane [N].
};

/// Two opposed planes (eq. 13) through the proxy, perpendicular to the radius of a vortex: the hand
/// moves freely on a tube. Within a voxel of the core, where the radius is not accurate, a line
/// (eq. 11) along the core holds the proxy. Between one and two voxels, both act. The radius is
/// that of a rigid rotation, r = 2 |v x w| / |curl v|. w = curl v / |curl v| is the direction of
/// the core, and v x w points outwards.
struct VortexTubeMode {
  using Memory = VortexTubeMemory;  ///< The memory that is kept from tick to tick.
  int vector = -1;                  ///< Index into Properties::vectors of v.
  int curl = -1;                    ///< Index into Properties::vectors of curl v.
  double voxel = 1e-3;              ///< Shortest edge of a voxel [m].
  double metres_per_unit = 1.0;     ///< Metres per unit of the data's space.
  Transfer strength;                ///< Strength of plane and line [N]; zero without rotation.
};

/// A point, line or plane that the scene places. While the proxy is within `snap` of the guide, or
/// in front of the plane, the guide acts. The energy of its pull counts as injected
/// (StepReport::injected).
struct GuideMode {
  using Memory = std::monostate;                ///< The mode has no memory.
  PrimitiveKind shape = PrimitiveKind::kPoint;  ///< Any kind except kForce.
  Vec3 position = Vec3::Zero();    ///< Position [m]; in the resting frame if the guide moves.
  Vec3 direction = Vec3::UnitX();  ///< Unit vector along a line, or outward unit normal of a plane.
  double snap = 0.0;               ///< Range of the guide [m], > 0; may be infinite.
  double metres_per_unit = 1.0;    ///< Metres per unit of the strength's input.
  Transfer strength;  ///< Strength [N], as a function of the distance from the probe to the guide.
};

/// Input of a user-defined mode.
struct ModeInput {
  const Properties& properties;  ///< Properties from the last reading.
  std::span<const int>
      reads;  ///< Index of each of UserSpec::reads in properties.scalars or properties.vectors.
  /// The proxy before it moves [m], where primitives should be placed. If all volumes that the mode
  /// reads share a motion, that motion carries this place along.
  const Vec3& proxy;
  const Vec3& probe;  ///< Position of the probe in this slice of the tick's motion [m].
  const Vec3& read;  ///< Place where properties were read [m]; usually within a voxel of the proxy.
  bool foreseen;     ///< True if the properties are those of an earlier reading.
};

/// Adds primitives. Returns false if the set was full. A tick calls this function before each
/// balance: in each slice first without a new reading (`foreseen`), then after each reading. A tick
/// also calls it once if the proxy is new in the scene. Do not allocate, lock or throw. Anchor
/// primitives at the proxy; other anchors can add energy, which counts as injected.
using PlacePrimitives = bool (*)(void* state, const ModeInput& input, PrimitiveSet& set) noexcept;

/// A user-defined mode.
struct UserMode {
  using Memory = std::monostate;    ///< The mode has no memory.
  PlacePrimitives place = nullptr;  ///< Called with `state`. Not null in a graph.
  /// State that all proxies share. Their threads may call `place` at the same time.
  std::shared_ptr<void> state;
  std::vector<int> reads;  ///< Indices, as in ModeInput::reads.
};

/// A mode as the tick runs it. compileGraph makes it from a ModeSpec.
using Mode = std::variant<ForceMode, ViscosityMode, SurfaceMode, IsosurfaceMode, FollowMode,
                          FrontShapeMode, VortexTubeMode, GuideMode, UserMode>;

/// Memory of a mode of any kind.
struct ModeMemory {
  int emitted = 0;  ///< Number of this mode's primitives in the last balance.
  std::variant<std::monostate, SurfaceMemory, IsosurfaceMemory, FollowMemory, FrontShapeMemory,
               VortexTubeMemory>
      of;  ///< Memory of the kind of mode; see memoryFor() and memoryOf().
};

/// Returns the side of the proxy at an isosurface; kUnknown for other modes.
[[nodiscard]] Side sideOf(const ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// Returns the initial memory of a mode.
[[nodiscard]] ModeMemory memoryFor(const Mode& mode) noexcept PALPATE_NONBLOCKING;

/// Returns the memory of the kind of mode M. @pre memoryFor() made it.
template <class M>
[[nodiscard]] typename M::Memory& memoryOf(const M& /*mode*/, ModeMemory& memory) noexcept {
  auto* own = std::get_if<typename M::Memory>(&memory.of);
  assert(own != nullptr);
  return *own;
}

/// Places and states to which the primitives of a mode refer.
struct EvaluationPoint {
  /// The proxy before it moves [m]. Primitives without memory are anchored here.
  const Vec3& proxy;
  const Vec3& read;   ///< Place where properties were read [m].
  const Vec3& probe;  ///< Position of the hand [m].
  /// Pose of the volume with which a guide moves; null if the guide stands still.
  const Pose* pose;
  bool foreseen = false;  ///< True without a new reading: planes stay as remembered.
  /// Corrections for other solids and walls from the last reading; may be null.
  const Seam* seam = nullptr;
};

/// Adds the primitives of one mode, step 2 of the paper's figure 1. Returns false if the set was
/// full. RT: no allocation.
[[nodiscard]] bool addPrimitives(const Mode& mode, const Properties& properties,
                                 const EvaluationPoint& stand, ModeMemory& memory,
                                 PrimitiveSet& set) noexcept PALPATE_NONBLOCKING;

/// Moves a mode's memory along with its volume. RT: no allocation.
void carry(const Pose& by, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// A mode's contact with its surface.
struct ContactReference {
  const SurfaceSource* skin = nullptr;  ///< Null if the mode is not a surface.
  Contact* contact = nullptr;           ///< Contact in the mode's memory; null if skin is null.
  const double* level = nullptr;  ///< V of the surface, in the data's unit; null if not yet known.
};
/// Returns the contact of a surface or isosurface mode; else null pointers. RT: no allocation.
[[nodiscard]] ContactReference touchOf(const Mode& mode,
                                       ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// The surface V = level that a sweep searches for.
struct SurfaceAhead {
  const SurfaceSource* skin = nullptr;  ///< Null if the mode has no surface that a path can reach.
  Contact* contact = nullptr;           ///< Contact in the mode's memory; null if skin is null.
  double level = 0.0;                   ///< V0, in the data's unit.
  const Transfer* strength = nullptr;   ///< Strength [N]; null if skin is null. A surface with zero
                                        ///< strength at V = level does not stop a path.
};
/// Returns the surface of an isosurface mode if the proxy is outside and the surface did not yield
/// in the last balance. Otherwise all pointers are null. RT: no allocation.
[[nodiscard]] SurfaceAhead surfaceAhead(const Mode& mode,
                                        ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// The streamline to which a mode holds the proxy.
struct Curve {
  OnCurve* on = nullptr;  ///< Null if the mode is not a FollowMode.
  int field = -1;         ///< FollowMode::field.
  double voxel = 0.0;     ///< FollowMode::voxel [m].
};
/// Returns the curve of a follow mode. For other modes `on` is null. RT: no allocation.
[[nodiscard]] Curve curveOf(const Mode& mode, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// Returns the longest motion of the hand in one slice of a tick [m]: a voxel while a curve holds
/// the proxy, else infinity. RT: no allocation.
[[nodiscard]] double sliceOf(const Mode& mode, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// Returns true if the mode adds a directed force whose strength varies with a property. Such a
/// force is valid only near the reading. Returns false for all other modes.
[[nodiscard]] bool followsValue(const Mode& mode) noexcept;

/// Updates the load in the memory of a surface or isosurface mode from the last balance: its
/// `primitives` and their forces on the proxy [N]. RT: no allocation.
void readLoads(const Mode& mode, std::span<const Primitive> primitives,
               std::span<const Vec3> forces, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// Makes a mode's surface yield, as if the load exceeded its strength. RT: no allocation.
void followYielding(const Mode& mode, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// Updates a mode's memory from the place that the proxy has reached. `arrived` is true if that
/// place is the balance. Clears Contact::touched. Ends the contact with an isosurface that bears no
/// load, if the proxy is in front of it. Marks an isosurface as pushed through if it yields and the
/// proxy is behind it. Once the proxy has arrived, a released front may be placed again. RT: no
/// allocation.
void settle(const Mode& mode, const Vec3& proxy, bool arrived,
            ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
