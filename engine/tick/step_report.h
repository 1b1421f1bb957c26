/// The report of a tick: its work, its force and its status.
#pragma once

#include <cstddef>
#include <cstdint>

#include "palpate/engine/balance/solver.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Status of a tick, in order of severity, the best first. The force is safe to send with each
/// status.
enum class StepStatus : std::uint8_t {
  kConverged,     ///< The tick ended without any of the conditions below.
  kHairpin,       ///< The curve of a stream bends about a centre nearer than the hand, so that its
                  ///< place nearest to the hand is not unique. The proxy may jump. The force then
                  ///< changes by at most the mode's strength, in addition to the stretch by the
                  ///< hand's own motion. Use a mode of less strength, or keep the hand nearer the
                  ///< stream.
  kSubstepLimit,  ///< The limit of readings, of 16 steps along a stream for each, or of iterations
                  ///< was reached before the proxy arrived. Causes: a fast hand, a stream that
                  ///< winds too much, walls or frictions that alternate. If something holds the
                  ///< proxy, the rest of its path waits. Otherwise the proxy is at the hand, and
                  ///< may have passed a surface beyond the range of the fields' firstFall without
                  ///< contact, as may the surface of a volume that moved too far. Raise
                  ///< max_substeps or the rate if it happens often.
  kIterationLimit,  ///< A balance stopped early; error_bound bounds its error.
  kDropped,         ///< More primitives than kMaxPrimitives: the tick left some out. Use fewer
                    ///< modes; 341 of the richest, a wall with friction and a drag, fit.
  kFault,           ///< A fault is latched (ProxyState::fault), or a value was not finite. The
                    ///< force is zero until ProxyState::clearFault(). See remedyFor.
};
inline constexpr std::size_t kStepStatuses = 6;  ///< Number of values of StepStatus.

/// Returns the word for a status in traces.
[[nodiscard]] const char* wordFor(StepStatus status) noexcept;

/// Results of one tick.
struct StepReport {
  Vec3 force = Vec3::Zero();    ///< Force for the device, after limitForce [N].
  Vec3 wanted = Vec3::Zero();   ///< Force before limitForce [N]: the spring's and that of remote
                                ///< hands, with the remainder of DataFade.
  Vec3 proxy = Vec3::Zero();    ///< Position of the proxy [m].
  double stiffness = 0.0;       ///< k of this tick's balance and force [N/m].
  double error_bound = 0.0;     ///< SolveResult::error_bound of the last balance [m].
  Vec3 waiting = Vec3::Zero();  ///< Negative of the pull that is left along a stream [m], at most
                                ///< the tolerance. With the probe displaced by this, the proxy is
                                ///< at the balance on the tangent.
  double injected = 0.0;        ///< Work that primitives did on the proxy [J]: the sum of
                          ///< max(0, -k (h - p_new).(p_new - p_old)) over its moves, h the hand in
                          ///< that move. Along a curve: the rise of the spring's energy. At least
                          ///< the bound on the work on the hand (docs/tick.md, Energy).
  int iterations = 0;   ///< Solver iterations (SolveResult) of all sub-steps.
  int substeps = 0;     ///< Readings of properties on the path, each followed by a balance.
  int samples = 0;      ///< Field reads of all sub-steps.
  bool coarse = false;  ///< Coarser data, or data of another moment, replaced missing data.
  int traced = 0;       ///< Vector reads along streams.
  int walked = 0;       ///< Cells searched for a surface on the path.
  int primitives = 0;   ///< Primitives balanced in the last sub-step.
  int parts = 0;        ///< Parts of the scene that were sampled: their data are near, or were near
                        ///< when the parts were chosen.
  int left_out = 0;     ///< Near parts left out for lack of room: the weakest.
  double missing = 0.0;  ///< Upper bound of the force error that left_out causes [N].
  SolverKind solver = SolverKind::kClosedForm;  ///< The solver's method in the last sub-step.
  StepStatus status = StepStatus::kConverged;   ///< The worst of what happened in the tick.
  bool limited = false;                         ///< limitForce changed the force.
  bool fresh = true;    ///< The hand's position was read since the last tick (NewReadings).
  double moving = 1.0;  ///< Share of the force that StillFade leaves while the arm does not move.
  double share = 1.0;   ///< Share of the force that the energy tank can pay for (passivity.h).
  double energy = 0.0;  ///< Energy in the tank [J].
  double left = 0.0;    ///< `force` as a share of the spring's and of remote hands' force together;
                        ///< 0 if it has another direction.
};

/// Sets the status, unless the report already has a worse one.
inline void worsen(StepReport& report, StepStatus status) noexcept {
  if (status > report.status) report.status = status;
}

}  // namespace palpate
