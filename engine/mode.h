/// Haptic modes: from properties at the proxy to primitives (compiled form, indices only).
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <variant>
#include <vector>

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

/// A plane (eq. 13) at the proxy across the gradient: memoryless, so the proxy can drift along the
/// normal as the surface curves; isosurface does not drift. With friction a line (eq. 11) along the
/// normal, with viscosity a point (eq. 9): the paper's surface, friction and viscosity.
struct SurfaceMode {
  int gradient = -1;
  double sign = -1.0;  ///< Outward normal = sign * gradient: -1 where high values are solid.
  Transfer strength;
  Transfer friction;   ///< Coulomb's mu.
  Transfer viscosity;  ///< [N], wherever the surface acts.
};

/// A plane (eq. 13) on the surface V = value near the proxy; remembers on which side it is. In a
/// concave edge both walls hold. With friction each wall has its line (eq. 11).
struct IsosurfaceMode {
  int value = -1;
  int gradient = -1;
  int cell_gradient = -1;
  double level = 0.0;            ///< V0, in the data's unit.
  double sign = -1.0;            ///< Outward normal = sign * gradient: -1 where high is solid.
  double voxel = 1e-3;           ///< [m]
  double metres_per_unit = 1.0;  ///< Of the field's own space.
  double depth = 3e-3;           ///< After yielding, pushes until this far past the surface [m].
  Transfer strength;
  Transfer friction;   ///< Coulomb's mu.
  Transfer viscosity;  ///< [N], a point (eq. 9) on the solid side: what the body is made of.
};

/// A line (eq. 11) through the proxy along a vector: the hand slides along the stream. Weak, it is
/// the paper's transverse damping.
struct FollowMode {
  int vector = -1;
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
  const Vec3& probe;           ///< [m]
};

/// Adds primitives; returns false if the set was full. Called in the tick, once a sub-step: no
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

/// What a mode remembers between ticks. `contact` and the edge are isosurface's; snap-drag has an
/// anchor and a normal as well.
struct ModeMemory {
  enum class Contact : std::uint8_t {
    kUnknown,  ///< Nothing seen yet: takes the side it finds, without force.
    kOutside,  ///< On the free side: the surface holds.
    kYielded,  ///< Pushed through: the plane pulls back until `depth` or until the hand returns.
    kInside,   ///< On the solid side: free to move and to leave.
  };
  Contact contact = Contact::kUnknown;
  int emitted = 0;              ///< Primitives of this mode in the last sub-step.
  Vec3 anchor = Vec3::Zero();   ///< The plane's position [m].
  Vec3 normal = Vec3::UnitX();  ///< Its outward normal.
  bool placed = false;          ///< Outside, with the plane above placed.
  bool let_go = false;          ///< Snapped off its front, until the proxy has come to rest.
  bool cornered = false;        ///< In a concave edge: the plane below is its other wall.
  Vec3 other_anchor = Vec3::Zero();
  Vec3 other_normal = Vec3::UnitX();
};

/// Step 2 of the paper's figure 1: adds the primitives that one mode asks for at the proxy.
///
/// @param properties  Sampled at p.
/// @param p           The proxy before it moves [m]: primitives are anchored there.
/// @param probe       The hand [m].
/// @param pose        Of the volume that a guide moves with; none: it stands still.
/// @return            False if the set was full and a primitive was dropped.
/// RT: no allocation.
[[nodiscard]] bool addPrimitives(const Mode& mode, const Properties& properties, const Vec3& p,
                                 const Vec3& probe, ModeMemory& memory, PrimitiveSet& set,
                                 const Pose* pose = nullptr) noexcept PALPATE_NONBLOCKING;

/// Moves what a mode remembers along with its volume. RT: no allocation.
void carry(const Pose& by, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

/// Tells a mode where the balance put the proxy, so that it can notice having been pushed through.
/// RT: no allocation.
void settle(const Mode& mode, const Vec3& proxy, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
