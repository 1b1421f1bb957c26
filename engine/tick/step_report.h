/// The report of a tick: its status, its force and the work that it took.
#pragma once

#include <cstddef>
#include <cstdint>

#include "palpate/engine/balance/solver.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Status of a tick, from the best to the worst. The force is safe to send with each status.
enum class StepStatus : std::uint8_t {
  kConverged,  ///< None of the conditions below occurred.
  /// The centre of curvature of a stream is nearer than the hand: several points may be nearest to
  /// the hand. The proxy may jump; the force then changes by at most twice the mode's strength,
  /// plus the change by the hand's motion. Remedy: less strength, or a hand nearer to the stream.
  kHairpin,
  kSubstepLimit,  ///< The proxy did not arrive before a limit was reached: of readings, of
                  ///< iterations, of slices, or of 16 steps along a stream for each reading. Causes
                  ///< are a fast hand or volume, a stream with many windings, or walls and
                  ///< frictions that alternate. If a primitive holds the proxy, the rest of its
                  ///< path waits for the next tick. Otherwise the proxy is at the hand, and may
                  ///< have passed a surface without contact, beyond the range of firstFall or of a
                  ///< volume that moved too far. Remedy if frequent: raise max_substeps or the
                  ///< rate.
  kIterationLimit,  ///< A balance after a reading ended before it converged. If it is the last
                    ///< balance, error_bound bounds its error.
  kDropped,         ///< The tick left out primitives beyond kMaxPrimitives. Remedy: fewer modes.
  kFault,  ///< A fault is latched (ProxyState::fault), or a value was not finite. The force is
           ///< zero until ProxyState::clearFault(). Remedy: see remedyFor.
};
inline constexpr std::size_t kStepStatuses = 6;  ///< Number of values of StepStatus.

/// Returns the word for a status, as in traces.
[[nodiscard]] const char* wordFor(StepStatus status) noexcept;

/// Results of a tick.
struct StepReport {
  Vec3 force = Vec3::Zero();  ///< Force for the device, after limitForce [N].
  /// Force before limitForce [N]: spring and remote hands, after DataFade, StillFade and brake().
  /// Zero if the hand is not ready, or after a fault.
  Vec3 wanted = Vec3::Zero();
  Vec3 proxy = Vec3::Zero();    ///< Position of the proxy [m].
  double stiffness = 0.0;       ///< Coupling stiffness k in this tick [N/m].
  double error_bound = 0.0;     ///< SolveResult::error_bound of the last balance [m].
  Vec3 waiting = Vec3::Zero();  ///< Negative of the pull that is left along a stream [m], at most
                                ///< the tolerance. A probe displaced by this would have its balance
                                ///< at the proxy, on the tangent.
  double injected =
      0.0;  ///< Work that primitives did on the proxy [J]: the sum of max(0, -k (h - p_new).(p_new
            ///< - p_old)) over its moves, h the hand in that move. Along a curve: the rise of the
            ///< spring's energy. If k o.dp - k/2 |dp - dh|^2 is larger, `injected` has that value
            ///< (symbols and reason: docs/tick.md, Energy).
  int iterations = 0;  ///< Solver iterations (SolveResult::iterations) of all sub-steps.
  int substeps = 0;  ///< Number of readings of properties on the path; a balance follows each. May
                     ///< be 0 if the hand is free and meets no surface, or rests on surfaces.
  int samples = 0;   ///< Number of readings of fields and warps, without those of seams (seams.h),
                     ///< of streams (`traced`) and of searches for a surface (`walked`).
  bool coarse = false;  ///< True if coarser data, or data of another time, replaced missing data.
  int traced = 0;       ///< Number of vector reads along streams.
  int walked = 0;       ///< Sum of Crossing::cells of the searches for a surface on the path.
  int primitives = 0;   ///< Number of primitives in the balance of the last sub-step.
  int parts = 0;        ///< Number of sampled parts, as chosen in this tick or an earlier tick.
  int left_out = 0;  ///< Number of near parts left out: the weakest, and those that NearBoxes could
                     ///< not return.
  double missing = 0.0;  ///< Bound of the force error that left_out causes [N], from Part::most.
  SolverKind solver = SolverKind::kClosedForm;  ///< The solver's method in the last sub-step.
  StepStatus status = StepStatus::kConverged;   ///< The worst status that occurred in the tick.
  bool limited = false;                         ///< True if limitForce changed the force.
  bool fresh = true;    ///< False if the hand's position repeats the last reading (NewReadings).
  double moving = 1.0;  ///< Share of the force that StillFade leaves while the arm does not move.
  double share = 1.0;   ///< Share of the force that the energy tank can pay for (passivity.h).
  double energy = 0.0;  ///< Energy in the tank [J].
  /// Share, 0 to 1, that `force` is of the force before StillFade, brake() and limitForce; 0 if the
  /// directions differ.
  double left = 0.0;
};

/// Sets the status, unless the present status is worse.
inline void worsen(StepReport& report, StepStatus status) noexcept {
  if (status > report.status) report.status = status;
}

}  // namespace palpate
