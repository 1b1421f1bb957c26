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
  struct Factor {
    TransferFunction curve;
    int scalar = -1;  ///< Index into Properties::scalars; -1: what the mode itself measures.
  };
  std::vector<Factor> factors;  ///< None: the property is zero.

  /// The product, >= 0; 0 where a factor's property has no data. `own` is what factors of scalar
  /// -1 read; a constant reads nothing. RT: no allocation.
  [[nodiscard]] double operator()(const Properties& properties, double own = 0.0) const noexcept;
  /// How the product changes with the place where its factors were read [its unit / m]; zero where
  /// one of them has no data. At a knot a curve's slope is that beyond it; what the mode itself
  /// measures counts as constant. RT: no allocation.
  [[nodiscard]] Vec3 slope(const Properties& properties) const noexcept PALPATE_NONBLOCKING;
  /// The product if scalar `index` were `value`, where there are data. RT: no allocation.
  [[nodiscard]] double at(const Properties& properties, int index, double value) const noexcept;
  /// The product whether or not there are data: without, a scalar is its background, a magnitude
  /// zero. For the coupling, which has a stiffness everywhere. RT: no allocation.
  [[nodiscard]] double anywhere(const Properties& properties) const noexcept;
};

// What the modes below remember between ticks.

struct SurfaceMemory {
  Contact contact;
  bool holds = false;     ///< The last balance lies on its plane,
  bool captured = false;  ///< and that on V = level.
  double level = 0.0;
};

/// Where a proxy is of an isosurface.
enum class Side : std::uint8_t {
  kUnknown,  ///< Nothing seen yet: takes the side it finds, without force.
  kOutside,  ///< On the free side: the surface holds.
  kYielded,  ///< Pushed through: the plane pulls back until `depth` or until the hand returns.
  kInside,   ///< On the solid side: free to move and to leave.
};
struct IsosurfaceMemory {
  Contact contact;
  Side side = Side::kUnknown;
  double share = 1.0;  ///< Of its strength, where a yielded surface fades.
};

/// Of a mode that holds the proxy to a curve.
struct OnCurve {
  bool holds = false;   ///< The last balance lies on its line.
  double stride = 0.5;  ///< Of the next trace [voxels].
};
struct FollowMemory {
  Vec3 before = Vec3::Zero();  ///< Direction of the field at the proxy; zero: not known.
  OnCurve on;
};

struct FrontShapeMemory {
  Vec3 before = Vec3::Zero();   ///< As above.
  Vec3 anchor = Vec3::Zero();   ///< Of the front [m],
  Vec3 normal = Vec3::UnitX();  ///< unit;
  bool placed = false;          ///< there is one.
  bool let_go = false;          ///< Snapped off it, until the proxy has come to rest.
};

struct VortexTubeMemory {
  Vec3 before = Vec3::Zero();  ///< As above, of the radius.
};

/// A directed force (eq. 8) along a vector: injects energy, as its user asked.
struct ForceMode {
  using Memory = std::monostate;
  int vector = -1;    ///< Index into Properties::vectors.
  double sign = 1.0;  ///< +1 along it, -1 against it.
  Transfer strength;  ///< [N]
};

/// A point (eq. 9) at the proxy: a drag of constant size, not -b v.
struct ViscosityMode {
  using Memory = std::monostate;
  int scalar = -1;  ///< Where this property has no data there is no drag.
  Transfer strength;
};

/// A plane (eq. 13) through the proxy across the gradient. While it holds, it stays on the surface
/// V = Va of where it began to: else the proxy drifts along the normal as the surface curves. Left
/// or yielding, it is at the proxy. With friction a line (eq. 11) along the normal, with viscosity
/// a point (eq. 9): the paper's surface, friction and viscosity.
struct SurfaceMode {
  using Memory = SurfaceMemory;
  Skin skin;
  Transfer strength;
  Transfer friction;   ///< Coulomb's mu.
  Transfer viscosity;  ///< [N], wherever the surface acts.
};

/// A plane (eq. 13) on the surface V = level, once the proxy has come to it; remembers on which
/// side it is. With friction it has a line (eq. 11).
struct IsosurfaceMode {
  using Memory = IsosurfaceMemory;
  Skin skin;
  double level = 0.0;   ///< V0, in the data's unit.
  double depth = 3e-3;  ///< After yielding, pushes until this far past the surface [m].
  Transfer strength;
  Transfer friction;   ///< Coulomb's mu.
  Transfer viscosity;  ///< [N], a point (eq. 9) on the solid side: what the body is made of.
};

/// A line (eq. 11) through the proxy along a vector: the hand slides along the stream. Weak, it is
/// the paper's transverse damping. Where the line holds, the proxy goes along the curve that the
/// stream is (VectorField::trace), as far as the balance took it along the line.
struct FollowMode {
  using Memory = FollowMemory;
  int vector = -1;
  int field = -1;  ///< Index into Graph::vector_fields; -1: derived, and followed by its tangents.
  double voxel = 1e-3;  ///< [m]
  Transfer strength;
};

/// A plane (eq. 13) through the proxy across a vector: the front that the vectors are normal to, as
/// of a wave. Two-sided, two opposed planes.
struct FrontShapeMode {
  using Memory = FrontShapeMemory;
  int vector = -1;
  bool two_sided = true;  ///< Else only against the vector: with it the hand is free.
  double snap = 0.0;      ///< Snap-drag: pushed off its front, the proxy is pulled back until it is
                          ///< this far; then it is let go, and where it comes to rest is the next
                          ///< front. 0: the front comes along [m].
  Transfer strength;
};

/// Two opposed planes (eq. 13) through the proxy across the radius of a vortex: the hand rides the
/// tube, free round it and along it. Nearer to the core than a voxel there is no radius, and a line
/// (eq. 11) along the core holds; to two voxels the one passes into the other. The radius is that
/// of rigid rotation, r = 2 |v x w| / |curl v|, w the core's direction curl v / |curl v|; v x w
/// points outwards.
struct VortexTubeMode {
  using Memory = VortexTubeMemory;
  int vector = -1;
  int curl = -1;
  double voxel = 1e-3;           ///< [m]
  double metres_per_unit = 1.0;  ///< Of the field's own space.
  Transfer strength;
};

/// A point, line or plane that the scene places. It acts while the proxy is within `snap` of it:
/// the hand is drawn in there, and let go once it has pulled the proxy farther off. Energy that
/// drawing in makes is counted as injected.
struct GuideMode {
  using Memory = std::monostate;
  PrimitiveKind shape = PrimitiveKind::kPoint;  ///< Not kForce.
  Vec3 position = Vec3::Zero();                 ///< [m], where it rests if it moves.
  Vec3 direction = Vec3::UnitX();               ///< Unit; a plane's outward normal.
  double snap = 0.0;                            ///< [m], > 0; infinite: it always acts.
  double metres_per_unit = 1.0;                 ///< Of the distance below.
  Transfer strength;                            ///< Of its own: the probe's distance to it.
};

/// What a mode of the user's own is given.
struct ModeInput {
  const Properties& properties;
  std::span<const int> reads;  ///< For each name in UserSpec::reads its index in
                               ///< properties.scalars or properties.vectors, whichever it is.
  const Vec3& proxy;           ///< Before it moves [m]: primitives belong there. Carried along
                               ///< where all that the mode reads moves as one.
  const Vec3& probe;           ///< [m]; where it goes on in parts, of this part of the tick.
  const Vec3& read;  ///< Where properties were read [m]: where the balance before this one
                     ///< led, at most a voxel or so from the proxy.
  bool foreseen;     ///< Of the tick before: nothing new was read yet.
};

/// Adds primitives; returns false if the set was full. Called in the tick, once a balance: the
/// first of a tick, and of each part of it, is foreseen, then one follows each reading. No
/// allocation, no lock, no exception. What it adds should stand at the proxy, else it can make
/// energy (counted as injected).
using PlacePrimitives = bool (*)(void* state, const ModeInput& input, PrimitiveSet& set) noexcept;

/// A mode of the user's own.
struct UserMode {
  using Memory = std::monostate;
  PlacePrimitives place = nullptr;
  std::shared_ptr<void> state;  ///< One for all proxies that feel the scene.
  std::vector<int> reads;
};

using Mode = std::variant<ForceMode, ViscosityMode, SurfaceMode, IsosurfaceMode, FollowMode,
                          FrontShapeMode, VortexTubeMode, GuideMode, UserMode>;

/// What a mode remembers: of the kind that its own `Memory` is.
struct ModeMemory {
  int emitted = 0;  ///< Primitives of this mode in the last balance.
  std::variant<std::monostate, SurfaceMemory, IsosurfaceMemory, FollowMemory, FrontShapeMemory,
               VortexTubeMemory>
      of;
};

/// Where the proxy is of a mode that is an isosurface; of others unknown.
[[nodiscard]] Side sideOf(const ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// That of a mode that nothing is remembered of yet.
[[nodiscard]] ModeMemory memoryFor(const Mode& mode) noexcept PALPATE_NONBLOCKING;

/// A mode's own memory. @pre memoryFor() made it.
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
  const Pose* pose;       ///< Of the volume that a guide moves with; none: it stands still.
  bool foreseen = false;  ///< Nothing new was read: planes stay where they are remembered.
};

/// Step 2 of the paper's figure 1: adds the primitives that one mode asks for at the proxy.
///
/// @return  False if the set was full and a primitive was dropped.
/// RT: no allocation.
[[nodiscard]] bool addPrimitives(const Mode& mode, const Properties& properties, const Stand& stand,
                                 ModeMemory& memory,
                                 PrimitiveSet& set) noexcept PALPATE_NONBLOCKING;

/// Moves what a mode remembers along with its volume. RT: no allocation.
void carry(const Pose& by, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// A mode's contact with the surface that it is. RT: no allocation.
struct Touch {
  const Skin* skin = nullptr;  ///< None: it is no surface.
  Contact* contact = nullptr;
};
[[nodiscard]] Touch touchOf(const Mode& mode, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// The surface that ways are swept for: V = level, where a proxy on its free side meets it.
struct SurfaceAhead {
  const Skin* skin = nullptr;  ///< None: nothing of this mode is met on a way.
  Contact* contact = nullptr;
  double level = 0.0;
  const Transfer* strength = nullptr;
};
/// RT: no allocation.
[[nodiscard]] SurfaceAhead surfaceAhead(const Mode& mode,
                                        ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// The stream that a mode holds the proxy to.
struct Curve {
  OnCurve* on = nullptr;  ///< None: it holds to none.
  int field = -1;      ///< Index into Graph::vector_fields; -1: derived, followed by its tangents.
  double voxel = 0.0;  ///< [m]
};
/// RT: no allocation.
[[nodiscard]] Curve curveOf(const Mode& mode, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// At most so far may the hand go on at once [m]: infinitely, but where the proxy is held to a
/// curve. RT: no allocation.
[[nodiscard]] double sliceOf(const Mode& mode, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// Does a force of this mode follow a value, so that what is read at one place need not hold at
/// another? Surfaces and streams have their own ways for that: none of theirs does.
[[nodiscard]] bool followsValue(const Mode& mode) noexcept;

/// Tells a mode what the last balance has of it: `primitives`, and the `forces` of each.
/// RT: no allocation.
void readLoads(const Mode& mode, std::span<const Primitive> primitives,
               std::span<const Vec3> forces, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// Gives a mode's surface up as one that cannot hold. RT: no allocation.
void giveWay(const Mode& mode, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// Tells a mode where the proxy has come to, and whether that is the balance: a surface that bears
/// no load is left, one that gave all its strength and has the proxy behind it is pushed through,
/// and nothing else ends a contact but missing data. RT: no allocation.
void settle(const Mode& mode, const Vec3& proxy, bool arrived,
            ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
