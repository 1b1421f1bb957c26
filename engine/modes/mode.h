/// Haptic modes: from properties at the proxy to primitives (compiled form, indices only).
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

/// Largest friction coefficient. Rubber on rubber is 1.2.
inline constexpr double kMostFriction = 10.0;

/// A material property of the paper's section 2 (strength, friction, viscosity, stiffness): a
/// transfer function of one scalar property, or a product of several.
struct Transfer {
  /// One transfer function, and the scalar property that it reads.
  struct Factor {
    TransferFunction curve;  ///< Outputs >= 0.
    int scalar = -1;         ///< Index into Properties::scalars; -1: the value that the mode itself
                             ///< measures.
  };
  std::vector<Factor> factors;  ///< If empty, the property is zero.

  /// Returns the product, >= 0; 0 if a factor's property has no data. `own` is the input of factors
  /// with scalar -1. RT: no allocation.
  [[nodiscard]] double operator()(const Properties& properties, double own = 0.0) const noexcept;
  /// Returns the gradient of the product at the place where its factors were read [its unit / m];
  /// zero if a factor has no data. At a knot, a curve's slope is that beyond the knot. The value
  /// that the mode itself measures counts as constant. RT: no allocation.
  [[nodiscard]] Vec3 slope(const Properties& properties) const noexcept PALPATE_NONBLOCKING;
  /// Returns the product with `value` for scalars `index` and -1; 0 if the property of another
  /// factor has no data. RT: no allocation.
  [[nodiscard]] double at(const Properties& properties, int index, double value) const noexcept;
  /// Returns the product with or without data: without data a scalar is its background, a magnitude
  /// zero. For the coupling, which has a stiffness everywhere. RT: no allocation.
  [[nodiscard]] double anywhere(const Properties& properties) const noexcept;
};

// Memory of the modes below between ticks.

/// Memory of a SurfaceMode: its plane, and the surface on which the plane stays.
struct SurfaceMemory {
  Contact contact;        ///< The plane and its last load.
  bool holds = false;     ///< The last balance lies on the contact's plane.
  bool captured = false;  ///< The plane is on V = level.
  double level = 0.0;     ///< Va, in the data's unit.
};

/// Side of an isosurface on which a proxy is.
enum class Side : std::uint8_t {
  kUnknown,  ///< No reading yet: the proxy takes the side that it finds, without force.
  kOutside,  ///< On the free side: the surface holds.
  kYielded,  ///< Pushed through: the plane pulls back until `depth` or until the hand returns.
  kInside,   ///< On the solid side: free to move and to leave.
};
/// Memory of an IsosurfaceMode: its plane, and the side on which the proxy is.
struct IsosurfaceMemory {
  Contact contact;             ///< The plane on V = level and its last load.
  Side side = Side::kUnknown;  ///< Set by the last reading and by the last settle().
  double share = 1.0;  ///< Share of the strength that is left while a yielded surface fades.
};

/// Memory of a curve that holds the proxy.
struct OnCurve {
  bool holds = false;        ///< The last balance lies on the mode's line.
  double stride = 0.5;       ///< First step of the next trace [voxels].
  Vec3 bend = Vec3::Zero();  ///< Second derivative of the curve in its volume's resting frame
                             ///< [1/voxel].
};
/// Memory of a FollowMode: the direction of its stream, and whether its line holds.
struct FollowMemory {
  Vec3 before = Vec3::Zero();  ///< Direction of the field at the proxy; zero: not known.
  OnCurve on;                  ///< The curve along which the proxy goes.
};

/// Memory of a FrontShapeMode: the direction of its field, and its front.
struct FrontShapeMemory {
  Vec3 before = Vec3::Zero();   ///< Direction of the field at the proxy; zero: not known.
  Vec3 anchor = Vec3::Zero();   ///< A point of the front [m].
  Vec3 normal = Vec3::UnitX();  ///< Unit normal of the front.
  bool placed = false;          ///< There is a front.
  bool let_go = false;          ///< Snapped off the front; ends when the proxy rests.
};

/// Memory of a VortexTubeMode.
struct VortexTubeMemory {
  Vec3 before = Vec3::Zero();  ///< Direction of the radius at the proxy; zero: not known.
};

/// A directed force (eq. 8) along a vector. It injects energy, as the user requested.
struct ForceMode {
  using Memory = std::monostate;  ///< No memory.
  int vector = -1;                ///< Index into Properties::vectors.
  double sign = 1.0;              ///< +1 along the vector, -1 against it.
  Transfer strength;              ///< Strength of the force [N].
};

/// A point (eq. 9) at the proxy: a drag of constant size, not -b v.
struct ViscosityMode {
  using Memory = std::monostate;  ///< No memory.
  int scalar = -1;                ///< Index into Properties::scalars; without data there is no
                                  ///< drag.
  Transfer strength;              ///< Strength of the drag [N].
};

/// A plane (eq. 13) through the proxy across the gradient. While the plane holds, it stays on the
/// surface V = Va of the place where it began to hold; else the proxy would drift along the normal
/// as the surface curves. A plane that is left or yields is at the proxy. Friction adds a line (eq.
/// 11) along the normal, viscosity a point (eq. 9): the paper's surface, friction and viscosity.
struct SurfaceMode {
  using Memory = SurfaceMemory;  ///< Kept in ModeMemory::of.
  SurfaceSource skin;            ///< Properties read from the volume, its solid side and its scale.
  Transfer strength;             ///< Strength of the plane [N].
  Transfer friction;             ///< Coulomb's mu.
  Transfer viscosity;            ///< Strength of the drag [N], wherever the surface acts.
};

/// A plane (eq. 13) on the surface V = level, once the proxy has reached it; the mode remembers on
/// which side the proxy is. Friction adds a line (eq. 11).
struct IsosurfaceMode {
  using Memory = IsosurfaceMemory;  ///< Kept in ModeMemory::of.
  SurfaceSource skin;               ///< Properties read from the volume, its solid side and its
                                    ///< scale.
  double level = 0.0;               ///< V0, in the data's unit.
  double depth = 3e-3;              ///< After yielding, the plane pushes until the proxy is this
                                    ///< far past the surface [m].
  Transfer strength;   ///< Strength of the plane [N]; until it yields, that at V = level.
  Transfer friction;   ///< Coulomb's mu.
  Transfer viscosity;  ///< Drag by a point (eq. 9) on the solid side [N]: the body's material.
};

/// A line (eq. 11) through the proxy along a vector: the hand slides along the stream. A weak line
/// is the paper's transverse damping. If the line holds, the proxy goes along the stream's curve
/// (VectorField::trace), as far as the balance took it along the line.
struct FollowMode {
  using Memory = FollowMemory;  ///< Kept in ModeMemory::of.
  int vector = -1;              ///< Index into Properties::vectors.
  int field = -1;       ///< Index into Graph::vector_fields; -1: derived, followed by its tangents.
  double voxel = 1e-3;  ///< [m]
  Transfer strength;    ///< Strength of the line [N].
};

/// A plane (eq. 13) through the proxy across a vector: the front to which the vectors are normal,
/// such as that of a wave. A two-sided front is two opposed planes.
struct FrontShapeMode {
  using Memory = FrontShapeMemory;  ///< Kept in ModeMemory::of.
  int vector = -1;                  ///< Index into Properties::vectors.
  bool two_sided = true;  ///< False: held only against the vector; along it the hand is free.
  double snap = 0.0;      ///< Snap-drag [m]: a proxy pushed off its front is pulled back until it
                          ///< is this far off. Then the front is given up, and the next one is
                          ///< placed where the proxy rests. 0: the front moves along.
  Transfer strength;      ///< Strength of each plane [N].
};

/// Two opposed planes (eq. 13) through the proxy across the radius of a vortex: the hand stays on
/// the tube, free round it and along it. Within a voxel of the core the radius is not defined, and
/// a line (eq. 11) along the core holds. Up to two voxels the line passes into the planes. The
/// radius is that of rigid rotation, r = 2 |v x w| / |curl v|, w the core's direction curl v /
/// |curl v|; v x w points outwards.
struct VortexTubeMode {
  using Memory = VortexTubeMemory;  ///< Kept in ModeMemory::of.
  int vector = -1;                  ///< Index into Properties::vectors.
  int curl = -1;                    ///< Index into Properties::vectors.
  double voxel = 1e-3;              ///< [m]
  double metres_per_unit = 1.0;     ///< Metres per unit of the field's own space.
  Transfer strength;  ///< Strength of each plane, and of the line on the core [N]; zero in a flow
                      ///< without turn.
};

/// A point, line or plane that the scene places. It acts while the proxy is within `snap` of it. It
/// draws the hand in, and releases the hand once it has pulled the proxy farther away. The energy
/// of drawing in counts as injected.
struct GuideMode {
  using Memory = std::monostate;                ///< No memory.
  PrimitiveKind shape = PrimitiveKind::kPoint;  ///< Not kForce.
  Vec3 position = Vec3::Zero();                 ///< Place [m]; of a moving guide, in the resting
                                                ///< frame.
  Vec3 direction = Vec3::UnitX();               ///< Unit vector along a line, or a plane's outward
                                                ///< normal.
  double snap = 0.0;                            ///< Range [m], > 0; infinite: it always acts.
  double metres_per_unit = 1.0;                 ///< Metres per unit of the strength's input.
  Transfer strength;                            ///< Strength [N], by the probe's distance to the
                                                ///< guide.
};

/// Input of a user-defined mode.
struct ModeInput {
  const Properties& properties;  ///< The last reading.
  std::span<const int> reads;    ///< For each name in UserSpec::reads its index in
                                 ///< properties.scalars or properties.vectors, by its kind.
  const Vec3& proxy;  ///< Proxy before it moves [m], where primitives belong; carried along if all
                      ///< that the mode reads moves as one.
  const Vec3& probe;  ///< Probe [m]; in a tick of several slices, that of this slice.
  const Vec3& read;   ///< Place where properties were read [m]: the previous balance led there, at
                      ///< most a voxel or so from the proxy.
  bool foreseen;      ///< No new reading yet: the properties are those read last.
};

/// Adds primitives; returns false if the set was full. Called in the tick, once a balance. The
/// first balance of a tick, and of each slice of a tick, is foreseen; one more follows each
/// reading. No allocation, no lock, no exception. The primitives should be anchored at the proxy,
/// else they can make energy (counted as injected).
using PlacePrimitives = bool (*)(void* state, const ModeInput& input, PrimitiveSet& set) noexcept;

/// A user-defined mode.
struct UserMode {
  using Memory = std::monostate;    ///< No memory.
  PlacePrimitives place = nullptr;  ///< Called with `state`; not null in a graph.
  std::shared_ptr<void> state;      ///< Of all proxies, whose threads may call at once.
  std::vector<int> reads;           ///< Indices, as in ModeInput::reads.
};

/// One mode as the tick runs it; compileGraph makes it from a ModeSpec.
using Mode = std::variant<ForceMode, ViscosityMode, SurfaceMode, IsosurfaceMode, FollowMode,
                          FrontShapeMode, VortexTubeMode, GuideMode, UserMode>;

/// Memory of a mode, of the type `Memory` of its kind.
struct ModeMemory {
  int emitted = 0;  ///< Primitives of this mode in the last balance.
  std::variant<std::monostate, SurfaceMemory, IsosurfaceMemory, FollowMemory, FrontShapeMemory,
               VortexTubeMemory>
      of;  ///< Memory of the mode's kind; see memoryFor() and memoryOf().
};

/// Returns the side of an isosurface on which the proxy is; kUnknown for other modes.
[[nodiscard]] Side sideOf(const ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// Returns the initial memory of a mode.
[[nodiscard]] ModeMemory memoryFor(const Mode& mode) noexcept PALPATE_NONBLOCKING;

/// Returns the mode's own memory. @pre memoryFor() made it.
template <class M>
[[nodiscard]] typename M::Memory& memoryOf(const M& /*mode*/, ModeMemory& memory) noexcept {
  auto* own = std::get_if<typename M::Memory>(&memory.of);
  assert(own != nullptr);
  return *own;
}

/// Places that the primitives of a mode refer to.
struct EvaluationPoint {
  const Vec3& proxy;      ///< Proxy before it moves [m]: anchor of primitives without memory.
  const Vec3& read;       ///< Place where properties were read [m].
  const Vec3& probe;      ///< The hand [m].
  const Pose* pose;       ///< Pose of the volume with which a guide moves; null: it stands still.
  bool foreseen = false;  ///< No new reading: planes stay where they are remembered.
  const Seam* seam = nullptr;  ///< Terms of other solids and walls at the last reading, if any.
};

/// Adds the primitives of one mode at the proxy: step 2 of the paper's figure 1.
///
/// @return  False if the set was full and a primitive was dropped.
/// RT: no allocation.
[[nodiscard]] bool addPrimitives(const Mode& mode, const Properties& properties,
                                 const EvaluationPoint& stand, ModeMemory& memory,
                                 PrimitiveSet& set) noexcept PALPATE_NONBLOCKING;

/// Moves a mode's memory along with its volume. RT: no allocation.
void carry(const Pose& by, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// The contact of a mode with its surface.
struct ContactReference {
  const SurfaceSource* skin = nullptr;  ///< Null: the mode is not a surface.
  Contact* contact = nullptr;           ///< In the mode's memory; null if skin is null.
  const double* level = nullptr;  ///< V of the surface, in the data's unit; null: not known yet.
};
/// Returns the contact of a surface or isosurface mode; for other modes an empty one. RT: no
/// allocation.
[[nodiscard]] ContactReference touchOf(const Mode& mode,
                                       ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// The surface for which paths are swept: V = level, which a proxy on its free side can touch.
struct SurfaceAhead {
  const SurfaceSource* skin = nullptr;  ///< Null: no path can touch a surface of this mode.
  Contact* contact = nullptr;           ///< In the mode's memory; null if skin is null.
  double level = 0.0;                   ///< V0, in the data's unit.
  const Transfer* strength = nullptr;   ///< Strength [N]; zero at V = level: it stops no path. Null
                                        ///< if skin is null.
};
/// Returns the surface of an isosurface mode, if the proxy is outside and the surface did not yield
/// in the last balance; else an empty one. RT: no allocation.
[[nodiscard]] SurfaceAhead surfaceAhead(const Mode& mode,
                                        ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// The curve of a stream to which a mode holds the proxy.
struct Curve {
  OnCurve* on = nullptr;  ///< Null: the mode does not hold the proxy to a curve.
  int field = -1;      ///< Index into Graph::vector_fields; -1: derived, followed by its tangents.
  double voxel = 0.0;  ///< Finest voxel that the mode reads [m].
};
/// Returns the curve of a follow mode; for other modes an empty one. RT: no allocation.
[[nodiscard]] Curve curveOf(const Mode& mode, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// Returns the longest move of the hand in one slice [m]: a voxel if the proxy is held to a curve,
/// else infinite. RT: no allocation.
[[nodiscard]] double sliceOf(const Mode& mode, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// Returns true if a force of this mode depends on a value, so that a reading at one place need not
/// hold at another. Returns false for surfaces and streams, which have means of their own for that.
[[nodiscard]] bool followsValue(const Mode& mode) noexcept;

/// Updates a mode's memory from the last balance: all `primitives`, and the `forces` of each on the
/// proxy [N]. RT: no allocation.
void readLoads(const Mode& mode, std::span<const Primitive> primitives,
               std::span<const Vec3> forces, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// Makes a mode's surface yield, as if it could not hold. RT: no allocation.
void followYielding(const Mode& mode, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// Updates a mode's memory from the place that the proxy has reached; `arrived`: that place is the
/// balance. A surface that bears no load is left. A surface that gave all its strength and has the
/// proxy behind it is pushed through. A front that was let go may be placed again once the proxy
/// rests. RT: no allocation.
void settle(const Mode& mode, const Vec3& proxy, bool arrived,
            ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
