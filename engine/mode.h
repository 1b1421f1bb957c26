/// Haptic modes: from properties at the proxy to primitives (compiled form, indices only).
#pragma once

#include <cassert>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <variant>
#include <vector>

#include "palpate/engine/contact.h"
#include "palpate/engine/placement.h"
#include "palpate/engine/primitive.h"
#include "palpate/engine/properties.h"
#include "palpate/engine/transfer.h"
#include "palpate/engine/types.h"

namespace palpate {

/// A material property of the paper's section 2 (strength, friction, viscosity, stiffness): a
/// transfer function of one scalar property, or a product of several.
struct Transfer {
  /// One transfer function, and the scalar property that it reads.
  struct Factor {
    TransferFunction curve;  ///< Outputs >= 0.
    int scalar = -1;         ///< Index into Properties::scalars; -1: what the mode itself measures.
  };
  std::vector<Factor> factors;  ///< None: the property is zero.

  /// The product, >= 0; 0 where a factor's property has no data. `own` is what factors of scalar
  /// -1 read. RT: no allocation.
  [[nodiscard]] double operator()(const Properties& properties, double own = 0.0) const noexcept;
  /// The gradient of the product at the place where its factors were read [its unit / m]; zero
  /// where one of them has no data. At a knot a curve's slope is that beyond it; what the mode
  /// itself measures counts as constant. RT: no allocation.
  [[nodiscard]] Vec3 slope(const Properties& properties) const noexcept PALPATE_NONBLOCKING;
  /// The product with `value` for scalars `index` and -1, where there are data. RT: no allocation.
  [[nodiscard]] double at(const Properties& properties, int index, double value) const noexcept;
  /// The product whether or not there are data: without data a scalar is its background, a
  /// magnitude zero. For the coupling, which has a stiffness everywhere. RT: no allocation.
  [[nodiscard]] double anywhere(const Properties& properties) const noexcept;
};

// What the modes below remember between ticks.

/// What a SurfaceMode remembers: its plane, and on which surface the plane stays.
struct SurfaceMemory {
  Contact contact;        ///< The plane and its last load.
  bool holds = false;     ///< The last balance lies on the contact's plane.
  bool captured = false;  ///< The plane is on V = level.
  double level = 0.0;     ///< Va, in the data's unit.
};

/// Where a proxy is relative to an isosurface.
enum class Side : std::uint8_t {
  kUnknown,  ///< Nothing seen yet: takes the side it finds, without force.
  kOutside,  ///< On the free side: the surface holds.
  kYielded,  ///< Pushed through: the plane pulls back until `depth` or until the hand returns.
  kInside,   ///< On the solid side: free to move and to leave.
};
/// What an IsosurfaceMode remembers: its plane, and on which side of it the proxy is.
struct IsosurfaceMemory {
  Contact contact;             ///< The plane on V = level and its last load.
  Side side = Side::kUnknown;  ///< By the last reading, and by the last settle().
  double share = 1.0;  ///< Share of the strength that is left where a yielded surface fades.
};

/// What is remembered of a curve that holds the proxy.
struct OnCurve {
  bool holds = false;   ///< The last balance lies on the mode's line.
  double stride = 0.5;  ///< First step of the next trace [voxels].
};
/// What a FollowMode remembers: the direction of its stream, and whether its line holds.
struct FollowMemory {
  Vec3 before = Vec3::Zero();  ///< Direction of the field at the proxy; zero: not known.
  OnCurve on;                  ///< Of the curve along which the proxy goes.
};

/// What a FrontShapeMode remembers: the direction of its field, and its front.
struct FrontShapeMemory {
  Vec3 before = Vec3::Zero();   ///< Direction of the field at the proxy; zero: not known.
  Vec3 anchor = Vec3::Zero();   ///< A point of the front [m].
  Vec3 normal = Vec3::UnitX();  ///< Unit normal of the front.
  bool placed = false;          ///< There is a front.
  bool let_go = false;          ///< Snapped off the front, until the proxy has come to rest.
};

/// What a VortexTubeMode remembers.
struct VortexTubeMemory {
  Vec3 before = Vec3::Zero();  ///< Direction of the radius at the proxy; zero: not known.
};

/// A directed force (eq. 8) along a vector; it injects energy, as its user asked.
struct ForceMode {
  using Memory = std::monostate;  ///< Nothing is remembered.
  int vector = -1;                ///< Index into Properties::vectors.
  double sign = 1.0;              ///< +1 along the vector, -1 against it.
  Transfer strength;              ///< Strength of the force [N].
};

/// A point (eq. 9) at the proxy: a drag of constant size, not -b v.
struct ViscosityMode {
  using Memory = std::monostate;  ///< Nothing is remembered.
  int scalar = -1;                ///< Where this property has no data there is no drag.
  Transfer strength;              ///< Strength of the drag [N].
};

/// A plane (eq. 13) through the proxy across the gradient. While the plane holds, it stays on the
/// surface V = Va of the place where it began to: else the proxy would drift along the normal as
/// the surface curves. Left or yielding, the plane is at the proxy. Friction adds a line (eq. 11)
/// along the normal, viscosity a point (eq. 9): the paper's surface, friction and viscosity.
struct SurfaceMode {
  using Memory = SurfaceMemory;  ///< Kept in ModeMemory::of.
  Skin skin;                     ///< What is read of the volume, its solid side and its scale.
  Transfer strength;             ///< Strength of the plane [N].
  Transfer friction;             ///< Coulomb's mu.
  Transfer viscosity;            ///< Strength of the drag [N], wherever the surface acts.
};

/// A plane (eq. 13) on the surface V = level, once the proxy has reached it; the mode remembers on
/// which side the proxy is. Friction adds a line (eq. 11).
struct IsosurfaceMode {
  using Memory = IsosurfaceMemory;  ///< Kept in ModeMemory::of.
  Skin skin;                        ///< What is read of the volume, its solid side and its scale.
  double level = 0.0;               ///< V0, in the data's unit.
  double depth = 3e-3;              ///< After yielding, pushes until this far past the surface [m].
  Transfer strength;   ///< Strength of the plane [N]; until it yields, that at V = level.
  Transfer friction;   ///< Coulomb's mu.
  Transfer viscosity;  ///< Drag by a point (eq. 9) on the solid side [N]: what the body is made of.
};

/// A line (eq. 11) through the proxy along a vector: the hand slides along the stream. A weak line
/// is the paper's transverse damping. Where the line holds, the proxy goes along the curve that the
/// stream is (VectorField::trace), as far as the balance took it along the line.
struct FollowMode {
  using Memory = FollowMemory;  ///< Kept in ModeMemory::of.
  int vector = -1;              ///< Index into Properties::vectors.
  int field = -1;       ///< Index into Graph::vector_fields; -1: derived, followed by its tangents.
  double voxel = 1e-3;  ///< [m]
  Transfer strength;    ///< Strength of the line [N].
};

/// A plane (eq. 13) through the proxy across a vector: the front to which the vectors are normal,
/// as that of a wave. A two-sided front is two opposed planes.
struct FrontShapeMode {
  using Memory = FrontShapeMemory;  ///< Kept in ModeMemory::of.
  int vector = -1;                  ///< Index into Properties::vectors.
  bool two_sided = true;  ///< False: held only against the vector; along it the hand is free.
  double snap = 0.0;      ///< Snap-drag [m]: pushed off its front, the proxy is pulled back until
                          ///< it is this far off; then the front is given up, and the next one is
                          ///< where the proxy comes to rest. 0: the front comes along.
  Transfer strength;      ///< Strength of each plane [N].
};

/// Two opposed planes (eq. 13) through the proxy across the radius of a vortex: the hand rides the
/// tube, free round it and along it. Nearer to the core than a voxel there is no radius, and a line
/// (eq. 11) along the core holds; up to two voxels the line passes into the planes. The radius is
/// that of rigid rotation, r = 2 |v x w| / |curl v|, w the core's direction curl v / |curl v|; v x
/// w points outwards.
struct VortexTubeMode {
  using Memory = VortexTubeMemory;  ///< Kept in ModeMemory::of.
  int vector = -1;                  ///< Index into Properties::vectors.
  int curl = -1;                    ///< Index into Properties::vectors.
  double voxel = 1e-3;              ///< [m]
  double metres_per_unit = 1.0;     ///< Metres per unit of the field's own space.
  Transfer strength;  ///< Of each plane, on the core of the line [N]; zero in a flow without turn.
};

/// A point, line or plane that the scene places. It acts while the proxy is within `snap` of it:
/// the hand is drawn in there, and released once it has pulled the proxy farther away. The energy
/// that drawing in makes is counted as injected.
struct GuideMode {
  using Memory = std::monostate;                ///< Nothing is remembered.
  PrimitiveKind shape = PrimitiveKind::kPoint;  ///< Not kForce.
  Vec3 position = Vec3::Zero();                 ///< Its place [m]; of a moving one, at rest.
  Vec3 direction = Vec3::UnitX();               ///< Unit; along a line or a plane's outward normal.
  double snap = 0.0;                            ///< Range [m], > 0; infinite: it always acts.
  double metres_per_unit = 1.0;                 ///< Metres per unit of the strength's input.
  Transfer strength;                            ///< [N], by the probe's distance to the guide.
};

/// The input of a mode of the user's own.
struct ModeInput {
  const Properties& properties;  ///< What was read last.
  std::span<const int> reads;    ///< For each name in UserSpec::reads its index in
                                 ///< properties.scalars or properties.vectors, whichever it is.
  const Vec3& proxy;  ///< The proxy before it moves [m], where primitives belong; carried
                      ///< along where all that the mode reads moves as one.
  const Vec3& probe;  ///< The probe [m]; in a tick of several slices, that of this slice.
  const Vec3& read;   ///< Where properties were read [m]: where the balance before this one
                      ///< led, at most a voxel or so from the proxy.
  bool foreseen;      ///< Nothing new was read yet: the properties are those read last.
};

/// Adds primitives; returns false if the set was full. Called in the tick, once a balance: the
/// first of a tick, and of each slice of it, is foreseen, then one follows each reading. No
/// allocation, no lock, no exception. What it adds should stand at the proxy, else it can make
/// energy (counted as injected).
using PlacePrimitives = bool (*)(void* state, const ModeInput& input, PrimitiveSet& set) noexcept;

/// A mode of the user's own.
struct UserMode {
  using Memory = std::monostate;    ///< Nothing is remembered.
  PlacePrimitives place = nullptr;  ///< Called with `state`; not null in a graph.
  std::shared_ptr<void> state;      ///< One for all proxies that feel the scene.
  std::vector<int> reads;           ///< Indices, as ModeInput::reads.
};

/// One mode as the tick runs it; compileGraph makes it of a ModeSpec.
using Mode = std::variant<ForceMode, ViscosityMode, SurfaceMode, IsosurfaceMode, FollowMode,
                          FrontShapeMode, VortexTubeMode, GuideMode, UserMode>;

/// What a mode remembers: its `Memory`, which is of its own kind.
struct ModeMemory {
  int emitted = 0;  ///< Primitives of this mode in the last balance.
  std::variant<std::monostate, SurfaceMemory, IsosurfaceMemory, FollowMemory, FrontShapeMemory,
               VortexTubeMemory>
      of;  ///< Of the mode's kind; see memoryFor() and memoryOf().
};

/// The side of an isosurface on which the proxy is; kUnknown for other modes.
[[nodiscard]] Side sideOf(const ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// The memory of a mode of which nothing is remembered yet.
[[nodiscard]] ModeMemory memoryFor(const Mode& mode) noexcept PALPATE_NONBLOCKING;

/// The mode's own memory. @pre memoryFor() made it.
template <class M>
[[nodiscard]] typename M::Memory& memoryOf(const M& /*mode*/, ModeMemory& memory) noexcept {
  auto* own = std::get_if<typename M::Memory>(&memory.of);
  assert(own != nullptr);
  return *own;
}

/// Where the primitives of a mode belong.
struct Stand {
  const Vec3& proxy;      ///< Before it moves [m]: primitives without memory are anchored there.
  const Vec3& read;       ///< Where properties were read [m].
  const Vec3& probe;      ///< The hand [m].
  const Pose* pose;       ///< Pose of the volume with which a guide moves; null: it stands still.
  bool foreseen = false;  ///< Nothing new was read: planes stay where they are remembered.
};

/// Step 2 of the paper's figure 1: adds the primitives that one mode asks for at the proxy.
///
/// @return  False if the set was full and a primitive was dropped.
/// RT: no allocation.
[[nodiscard]] bool addPrimitives(const Mode& mode, const Properties& properties, const Stand& stand,
                                 ModeMemory& memory,
                                 PrimitiveSet& set) noexcept PALPATE_NONBLOCKING;

/// Moves a mode's memory along with its volume. RT: no allocation.
void carry(const Pose& by, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// The contact of a mode with its surface.
struct Touch {
  const Skin* skin = nullptr;     ///< Null: the mode is no surface.
  Contact* contact = nullptr;     ///< In the mode's memory; null where skin is.
  const double* level = nullptr;  ///< V of the surface, in the data's unit; null: none yet.
};
/// The contact of a surface or isosurface mode; of others none. RT: no allocation.
[[nodiscard]] Touch touchOf(const Mode& mode, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// The surface for which paths are swept: V = level, where a proxy on its free side touches it.
struct SurfaceAhead {
  const Skin* skin = nullptr;          ///< Null: no path can touch a surface of this mode.
  Contact* contact = nullptr;          ///< In the mode's memory; null where skin is.
  double level = 0.0;                  ///< V0, in the data's unit.
  const Transfer* strength = nullptr;  ///< [N]; zero at V = level: no path stops. Null as skin.
};
/// The surface of an isosurface mode, where the proxy is outside and the surface did not yield in
/// the last balance; else none. RT: no allocation.
[[nodiscard]] SurfaceAhead surfaceAhead(const Mode& mode,
                                        ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// The curve of a stream to which a mode holds the proxy.
struct Curve {
  OnCurve* on = nullptr;  ///< Null: the mode holds the proxy to no curve.
  int field = -1;      ///< Index into Graph::vector_fields; -1: derived, followed by its tangents.
  double voxel = 0.0;  ///< Finest voxel that the mode reads [m].
};
/// The curve of a follow mode; of others none. RT: no allocation.
[[nodiscard]] Curve curveOf(const Mode& mode, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// The longest move of the hand in one slice [m]: a voxel where the proxy is held to a curve, else
/// infinite. RT: no allocation.
[[nodiscard]] double sliceOf(const Mode& mode, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// True if a force of this mode depends on a value, so that a reading at one place need not hold at
/// another. False for surfaces and streams, which have means of their own for that.
[[nodiscard]] bool followsValue(const Mode& mode) noexcept;

/// Tells a mode the last balance: all `primitives`, and the `forces` of each on the proxy [N].
/// RT: no allocation.
void readLoads(const Mode& mode, std::span<const Primitive> primitives,
               std::span<const Vec3> forces, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// Makes a mode's surface yield, as one that cannot hold. RT: no allocation.
void giveWay(const Mode& mode, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// Tells a mode where the proxy has arrived, and whether that is the balance: a surface that bears
/// no load is left, one that gave all its strength and has the proxy behind it is pushed through.
/// A front that was let go may be placed again once the proxy rests. RT: no allocation.
void settle(const Mode& mode, const Vec3& proxy, bool arrived,
            ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
