/// Newton's method on the balance: the result of one reading.
#pragma once

#include <limits>

#include "palpate/engine/tick/rail.h"
#include "palpate/engine/tick/tick.h"
#include "palpate/engine/types.h"

namespace palpate {

/// A balance, and Newton's step on it.
struct Balanced {
  Vec3 proxy = Vec3::Zero();          ///< The balance G(x) [m].
  Vec3 offset = Vec3::Zero();         ///< G(x) from the probe [m].
  Vec3 step = Vec3::Zero();           ///< Newton's step from x [m].
  Vec3 target = Vec3::Zero();         ///< End of Newton's step [m].
  Vec3 target_offset = Vec3::Zero();  ///< The target from the probe [m].
};

/// How far Newton's step is trusted: one voxel. If a step turns back on the last one, the radius is
/// half of the shorter of the two, else it doubles. Without surfaces, the balance lies between two
/// readings with steps that turn back: half of the distance between them, which is bisection.
struct TrustRegion {
  double radius = std::numeric_limits<double>::infinity();  ///< The trust radius [m].
  double ahead = std::numeric_limits<double>::infinity();   ///< The balance is this near [m].
  bool closed = false;                                      ///< `ahead` is within the tolerance.
  double reach = 0.0;  ///< The strengths last read hold the proxy this far from the hand [m].
  double went = 0.0;   ///< Distance between the last two readings [m].
  double least = std::numeric_limits<double>::infinity();  ///< Shortest step of this move [m].
  Vec3 least_at = Vec3::Zero();                            ///< Start of the shortest step [m].
  Vec3 least_target = Vec3::Zero();                        ///< Target of the shortest step [m].

  /// Forgets the shortest step so far.
  void forgetLeast() noexcept { least = std::numeric_limits<double>::infinity(); }
};

/// The iteration of one slice of a tick. Volumes and hand stand still in a slice.
struct Iteration {
  Vec3 last_read = Vec3::Zero();  ///< Place of the last reading [m].
  Vec3 read_at = Vec3::Zero();    ///< If `read`: start of the next trial step [m].
  bool read = false;              ///< Read in this slice; else trial steps start at the proxy.
  Balanced to;                    ///< The last balance, and the target of the next trial step.
  TrustRegion trust;              ///< How far that step may go.
  double voxel = std::numeric_limits<double>::infinity();  ///< Finest voxel of all that varies [m].
  bool follows = false;  ///< Something other than a surface varies, or has varied in this slice: a
                         ///< reading holds only at its own place.
  double followed = std::numeric_limits<double>::infinity();  ///< Finest voxel beside surfaces [m].
  Rail rail;  ///< The stream that holds the proxy; laid again when the proxy moves.
};

/// Returns true if primitives vary, but no varying primitive is a directed force or is put on a
/// surface: all stand at the proxy, except a front that is snapped off. The balance as it was read
/// then adds no energy; the rest of Newton's step might.
[[nodiscard]] bool anchored(const BalanceMemory& b) noexcept;

/// Reads properties at `at` [m]: step 1 of the paper's figure 1. RT: no allocation.
void read(Tick& tick, Iteration& now, const Vec3& at) noexcept PALPATE_NONBLOCKING;

/// Initialises the memories of the modes for a proxy that is new here, at its place. RT: no
/// allocation.
void initContacts(Tick& tick) noexcept PALPATE_NONBLOCKING;

/// Places the primitives (step 2), finds their balance (eqs. 14, 15), and computes Newton's step
/// from `from` [m], where they were read. If `foreseen`, the planes are the last reading's, carried
/// along. Returns false if a sample that is not finite spoilt the balance. RT: no allocation.
[[nodiscard]] bool balance(Tick& tick, Iteration& now, bool foreseen,
                           const Vec3& from) noexcept PALPATE_NONBLOCKING;

/// Updates the trust region after a reading displaced by `way` [m] from the last one. `compared`:
/// the last reading was of the same data, so that a step that turns back shows how far they can be
/// trusted.
///
/// Forces that jump (such as forces towards an axis, on that axis) have no balance where Newton's
/// step ends. They balance where the step turns back on itself however short it is: a force between
/// those on both sides balances there (Filippov's solution). If that place is found to the
/// tolerance, the target is the place of the last reading. If the primitives are `anchored`, the
/// target is the balance at the last reading, which adds no energy.
void trust(const Tick& tick, Iteration& now, const Vec3& way, bool compared) noexcept;

/// Returns true if the rest after Newton's step is within the tolerance. There are two cases. In
/// the first, the step itself is within the tolerance. If the primitives are `anchored`, the
/// balance must be so too: the proxy is then where they put it, and they add no energy. In the
/// second, planes of surfaces alone hold, and the step is so much shorter than the one before that
/// the next would be within the tolerance. The proxy must then stay on the planes.
[[nodiscard]] bool steady(const Tick& tick, const Iteration& now) noexcept;
/// Returns true if p [m] is within `within` [m] of every surface that holds the proxy in the last
/// balance. Nor may p be farther behind a surface that bears no load. It uses the values at p:
/// slopes jump at the faces of trilinear cells, so that a plane cannot predict them. Cost: a value
/// and a slope for each surface.
[[nodiscard]] bool onSurfaces(const Tick& tick, const Vec3& p, double within) noexcept;
/// Returns the place of the proxy once the rest is within the tolerance [m]. If planes of surfaces
/// alone hold the proxy, this is the target of Newton's step. Else, if the last reading is within
/// the tolerance of the balance, it is the balance to the last digit, on which friction's threshold
/// rests. Else it is Newton's target. If neither is certain to be on the surface, it is the last
/// reading.
[[nodiscard]] Vec3 answer(const Tick& tick, const Iteration& now) noexcept;

/// Returns the distance from the hand to which all placed primitives can hold the proxy [m].
[[nodiscard]] double reachOfStrengths(const Tick& tick) noexcept;

}  // namespace palpate
