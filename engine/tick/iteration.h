/// The iteration of one slice: Newton's method on the balance. A tick divides the motion of the
/// volumes and of the hand into slices. In each slice the volumes and the hand move first, and then
/// the proxy moves to the balance.
#pragma once

#include <limits>

#include "palpate/engine/tick/rail.h"
#include "palpate/engine/tick/tick.h"
#include "palpate/engine/types.h"

namespace palpate {

/// A balance, and Newton's step on it.
struct Balanced {
  Vec3 proxy = Vec3::Zero();          ///< The balance G(x), for primitives read at x [m].
  Vec3 offset = Vec3::Zero();         ///< G(x) minus the probe [m].
  Vec3 step = Vec3::Zero();           ///< Newton's step from x [m].
  Vec3 target = Vec3::Zero();         ///< End of Newton's step [m].
  Vec3 target_offset = Vec3::Zero();  ///< The target minus the probe [m].
  bool found = true;                  ///< False after SolveStatus::kIterationLimit.
};

/// Limits the length of Newton's step, in addition to the validity of a reading (one voxel). If a
/// step turns back on the previous step, the radius becomes half of the shorter step, else it
/// doubles. Without surfaces, the balance lies between two readings whose steps turn back. The
/// radius is then half of their distance (bisection).
struct TrustRegion {
  double radius = std::numeric_limits<double>::infinity();  ///< The trust radius [m].
  /// Upper bound of the distance to the balance [m]; infinite if unknown.
  double ahead = std::numeric_limits<double>::infinity();
  bool closed = false;  ///< True if half of `ahead` is within the tolerance, although Newton's step
                        ///< is longer.
  double reach =
      0.0;  ///< Distance from the hand to which the last reading's primitives can hold [m].
  double went = 0.0;  ///< Distance between the last two readings [m].
  /// Shortest Newton's step since the proxy last moved [m].
  double least = std::numeric_limits<double>::infinity();
  Vec3 least_at = Vec3::Zero();      ///< Start of the shortest step [m].
  Vec3 least_target = Vec3::Zero();  ///< Target of the shortest step [m].

  /// Forgets the shortest step so far.
  void forgetLeast() noexcept { least = std::numeric_limits<double>::infinity(); }
};

/// The iteration of one slice of a tick, in which the volumes and the hand stay in place.
struct Iteration {
  Vec3 last_read = Vec3::Zero();  ///< Place of the last reading [m].
  Vec3 read_at = Vec3::Zero();    ///< Start of the next trial step, if `read` is true [m].
  /// True if properties were read in this slice; else trial steps start at the proxy.
  bool read = false;
  Balanced to;        ///< The last balance, and the target of the next trial step.
  TrustRegion trust;  ///< Limit of Newton's step.
  /// Finest voxel of all primitives that vary [m].
  double voxel = std::numeric_limits<double>::infinity();
  /// True if primitives other than surfaces vary; without surfaces, also if such primitives varied
  /// earlier in this slice. A reading is then valid only at its place.
  bool follows = false;
  /// Finest voxel of the varying primitives that are not surfaces [m].
  double followed = std::numeric_limits<double>::infinity();
  Rail rail;  ///< The streamline that holds the proxy; traced again when the proxy moves.
};

/// Returns true if primitives vary, and no varying primitive is a directed force or a plane on a
/// surface. Then all are anchored at the proxy, except a front in snap-drag and the lines of traced
/// streams (rail.h). The balance at the last reading then adds no energy; Newton's step might.
[[nodiscard]] bool anchored(const BalanceMemory& b) noexcept;

/// Reads properties at `at` [m]: step 1 of the paper's figure 1. RT: no allocation.
void read(Tick& tick, Iteration& now, const Vec3& at) noexcept PALPATE_NONBLOCKING;

/// Initialises the memories of the modes for a proxy that has no contacts yet. RT: no allocation.
void initContacts(Tick& tick) noexcept PALPATE_NONBLOCKING;

/// Places the primitives (step 2), finds their balance (eqs. 14, 15), and computes Newton's step
/// from the place of their reading, `from` [m]. If `foreseen`, uses the planes of the last reading,
/// carried along with their volumes. Returns false if solveProxy rejects the primitives, as after a
/// sample that is not finite. RT: no allocation.
[[nodiscard]] bool balance(Tick& tick, Iteration& now, bool foreseen,
                           const Vec3& from) noexcept PALPATE_NONBLOCKING;

/// Updates the trust region after a reading that is displaced by `way` [m] from the previous
/// reading. `compared` is true if both readings are of the same data; only then does a step that
/// turns back reduce the radius.
///
/// Some forces jump, such as a force towards an axis at that axis. Newton's step then does not lead
/// to a balance. The balance is where even a very short step turns back: a force between those on
/// both sides balances there (Filippov's solution). If that place is found to the tolerance, the
/// target is the place of the last reading, but at most the reach of the strengths from the hand.
/// If the primitives are `anchored`, the target is the balance at the last reading, which adds no
/// energy.
void trust(const Tick& tick, Iteration& now, const Vec3& way, bool compared) noexcept;

/// Returns true if no primitive varies, if TrustRegion::closed, or if the error that remains after
/// Newton's step is within the tolerance. The latter has two cases. (1) The step is within the
/// tolerance; if the primitives are `anchored`, the balance must also be within the tolerance of
/// the last reading. (2) All primitives are planes of surfaces, the target is on the surfaces, and
/// the step is much shorter than the previous step. The next step would then be within the
/// tolerance. In both cases the target must be within the reach of the strengths from the hand.
[[nodiscard]] bool steady(const Tick& tick, const Iteration& now) noexcept;
/// Returns true if p [m] is within `within` [m] of every surface that holds the proxy in the last
/// balance. Behind a surface without load, p may also be at most `within` away. Uses the values at
/// p, because slopes jump at the faces of trilinear cells. Cost: a value and a slope for each
/// surface.
[[nodiscard]] bool onSurfaces(const Tick& tick, const Vec3& p, double within) noexcept;
/// Returns the final place of the proxy [m], once steady() is true: Newton's target or the balance.
/// Prefers the target if no primitive varies, if TrustRegion::closed, if Newton's step exceeds the
/// tolerance, or if all primitives are planes of surfaces. Otherwise prefers the balance, if the
/// last reading is within the tolerance of it. The last digit of the balance matters, because
/// friction's threshold depends on it. If neither place is certain to be on the surfaces, returns
/// the place of the last reading.
[[nodiscard]] Vec3 answer(const Tick& tick, const Iteration& now) noexcept;

/// Returns the sum of the strengths of all placed primitives, divided by k [m]. No balance is
/// farther from the hand.
[[nodiscard]] double reachOfStrengths(const Tick& tick) noexcept;

}  // namespace palpate
