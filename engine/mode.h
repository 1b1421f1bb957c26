/// Haptic modes: from properties at the proxy to primitives (compiled form, indices only).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <variant>
#include <vector>

#include "engine/newton.h"
#include "engine/placement.h"
#include "engine/primitive.h"
#include "engine/properties.h"
#include "engine/transfer.h"
#include "engine/types.h"

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
  /// The product if scalar `index` were `value`, where there are data. RT: no allocation.
  [[nodiscard]] double at(const Properties& properties, int index, double value) const noexcept;
  /// The product whether or not there are data: without, a scalar is its background, a magnitude
  /// zero. For the coupling, which has a stiffness everywhere. RT: no allocation.
  [[nodiscard]] double anywhere(const Properties& properties) const noexcept;
};

/// A directed force (eq. 8) along a vector: injects energy, as its user asked.
struct ForceMode {
  int vector = -1;    ///< Index into Properties::vectors.
  double sign = 1.0;  ///< +1 along it, -1 against it.
  Transfer strength;  ///< [N]
};

/// A point (eq. 9) at the proxy: a drag of constant size, not -b v.
struct ViscosityMode {
  int scalar = -1;  ///< Where this property has no data there is no drag.
  Transfer strength;
};

/// What the two surfaces below read of their scalar volume.
struct Skin {
  int field = -1;  ///< Index into Graph::scalar_fields.
  int value = -1;  ///< -> Properties::scalars
  int gradient = -1;
  int cell_gradient = -1;        ///< The slope that the value really has.
  double sign = -1.0;            ///< Outward normal = sign * gradient: -1 where high is solid.
  double voxel = 1e-3;           ///< [m]
  double metres_per_unit = 1.0;  ///< Of the field's own space.
};

/// A plane (eq. 13) through the proxy across the gradient. While it holds, it stays on the surface
/// V = Va of where it began to: else the proxy drifts along the normal as the surface curves. Left
/// or yielding, it is at the proxy. With friction a line (eq. 11) along the normal, with viscosity
/// a point (eq. 9): the paper's surface, friction and viscosity.
struct SurfaceMode {
  Skin skin;
  Transfer strength;
  Transfer friction;   ///< Coulomb's mu.
  Transfer viscosity;  ///< [N], wherever the surface acts.
};

/// A plane (eq. 13) on the surface V = level, once the proxy has come to it; remembers on which
/// side it is. With friction it has a line (eq. 11).
struct IsosurfaceMode {
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
  int vector = -1;
  int field = -1;  ///< Index into Graph::vector_fields; -1: derived, and followed by its tangents.
  double voxel = 1e-3;  ///< [m]
  Transfer strength;
};

/// A plane (eq. 13) through the proxy across a vector: the front that the vectors are normal to, as
/// of a wave. Two-sided, two opposed planes.
struct FrontShapeMode {
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
  PlacePrimitives place = nullptr;
  std::shared_ptr<void> state;  ///< One for all proxies that feel the scene.
  std::vector<int> reads;
};

using Mode = std::variant<ForceMode, ViscosityMode, SurfaceMode, IsosurfaceMode, FollowMode,
                          FrontShapeMode, VortexTubeMode, GuideMode, UserMode>;

/// A plane that a mode remembers.
struct Wall {
  Vec3 anchor = Vec3::Zero();   ///< [m]
  Vec3 normal = Vec3::UnitX();  ///< Outward.
  Mat3 turn = Mat3::Zero();     ///< How that turns with the place [1/m],
  Vec3 across = Vec3::UnitX();  ///< the surface's own slope where it was read, outwards,
  double height = 0.0;          ///< and how far above it that is [m].
};

/// What a mode remembers between ticks. `contact` is isosurface's.
struct ModeMemory {
  enum class Contact : std::uint8_t {
    kUnknown,  ///< Nothing seen yet: takes the side it finds, without force.
    kOutside,  ///< On the free side: the surface holds.
    kYielded,  ///< Pushed through: the plane pulls back until `depth` or until the hand returns.
    kInside,   ///< On the solid side: free to move and to leave.
  };
  Contact contact = Contact::kUnknown;
  int emitted = 0;          ///< Primitives of this mode in the last balance.
  Wall wall;                ///< A surface's plane; snap-drag's as well.
  bool placed = false;      ///< There is one,
  bool seen = false;        ///< put on the surface by the last reading,
  int plane = -1;           ///< the primitive of the last balance that it is; -1: none,
  Load load = Load::kNone;  ///< and what that did there.
  bool touched = false;   ///< The way of the proxy met the surface where properties are read next.
  bool let_go = false;    ///< Snapped off its front, until the proxy has come to rest.
  bool holds = false;     ///< The last balance lies on a surface's plane or a stream's line,
  bool captured = false;  ///< and the plane on V = level.
  double level = 0.0;
  double share = 1.0;          ///< Of its strength, where a yielded surface fades.
  Vec3 before = Vec3::Zero();  ///< Direction of the field at the proxy; zero: not known.
  double stride = 0.5;         ///< Of the next trace [voxels].
};

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

/// The surface that a mode is, if it is one; else null.
[[nodiscard]] const Skin* skinOf(const Mode& mode) noexcept;

/// Tells a mode what the last balance has of it: `primitives`, and the `forces` of each.
/// RT: no allocation.
void weigh(const Mode& mode, std::span<const Primitive> primitives, std::span<const Vec3> forces,
           ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// Tells a mode where the proxy has come to, and whether that is the balance: a surface that bears
/// no load is left, one that gave all its strength and has the proxy behind it is pushed through,
/// and nothing else ends a contact but missing data. RT: no allocation.
void settle(const Mode& mode, const Vec3& proxy, bool arrived,
            ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// Off its surface by a fraction of a way so long [m], on the free side: whence that is swept. The
/// chord of a surface that bends by a radius of half the way or more is free so. Zero where there
/// is none. RT: no allocation.
[[nodiscard]] Vec3 liftOff(const IsosurfaceMode& mode, double way,
                           const ModeMemory& memory) noexcept;

}  // namespace palpate
