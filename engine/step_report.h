/// The report of a tick: what it did, and how it ended.
#pragma once

#include <cstddef>
#include <cstdint>

#include "palpate/engine/solver.h"
#include "palpate/engine/types.h"

namespace palpate {

/// How a tick ended, in the order of severity, the best first. Each is safe to send.
enum class StepStatus : std::uint8_t {
  kConverged,     ///< All is well.
  kHairpin,       ///< A stream turns about a place that is nearer than the hand: its place nearest
                  ///< to the hand is not unique, and the proxy may jump, by no more force than the
                  ///< mode's strength beside what the hand's own move stretches. Use a mode of less
                  ///< strength or a hand nearer the stream.
  kSubstepLimit,  ///< The readings, 16 steps along a stream for each, or the iterations were used
                  ///< up before the proxy had arrived: a hand too fast, a stream that winds too
                  ///< much, walls or frictions that take turns. The rest waits where something
                  ///< holds the proxy; where nothing does the proxy is at the hand, and a surface
                  ///< farther off than the fields' firstFall looks can have been passed unfelt, as
                  ///< by a volume that moved so far. Raise max_substeps or the rate if it happens
                  ///< often.
  kIterationLimit,  ///< A balance stopped early; error_bound says how far off it can be.
  kDropped,         ///< More primitives than kMaxPrimitives: some were left out. Use fewer modes;
                    ///< 341 of the richest, a wall with friction and a drag, fit.
  kFault,           ///< A fault is latched (ProxyState::fault), or something was not finite: the
                    ///< force is zero until ProxyState::clearFault(). See remedyFor.
};
inline constexpr std::size_t kStepStatuses = 6;  ///< Number of values of StepStatus.

/// The word for a status in traces.
[[nodiscard]] const char* wordFor(StepStatus status) noexcept;

/// What one tick did.
struct StepReport {
  Vec3 force = Vec3::Zero();    ///< Force for the device, after limitForce [N].
  Vec3 wanted = Vec3::Zero();   ///< Force before limitForce [N]: the spring's, and what is left of
                                ///< DataFade's.
  Vec3 proxy = Vec3::Zero();    ///< Position of the proxy [m].
  double stiffness = 0.0;       ///< k of this tick's balance and force [N/m].
  double error_bound = 0.0;     ///< SolveResult::error_bound of the last balance [m].
  Vec3 waiting = Vec3::Zero();  ///< What the balance leaves for the next tick [m]: a proxy that
                                ///< went along a curved stream is off the balance on its tangent by
                                ///< this; with the probe this much farther on it is at the balance.
  double injected = 0.0;  ///< Work that primitives did on the proxy [J], the sum over its moves
                          ///< of max(0, -k (h - p_new).(p_new - p_old)), h the hand in that
                          ///< move: at least what bounds the work on the hand (docs/tick.md,
                          ///< Energy).
  int iterations = 0;     ///< Iterations of the solver (SolveResult), all sub-steps.
  int substeps = 0;       ///< Readings of properties on the path, each followed by a balance.
  int samples = 0;        ///< Field reads, all sub-steps.
  bool coarse = false;    ///< Data coarser than a volume's, or of another moment's, were read,
                          ///< for want of these.
  int traced = 0;         ///< Reads of vectors along streams.
  int walked = 0;         ///< Cells searched for a surface on the path.
  int primitives = 0;     ///< Primitives balanced in the last sub-step.
  int parts = 0;     ///< Parts of the scene that were sampled: their data are near, or were when
                     ///< the parts were chosen.
  int left_out = 0;  ///< Near parts for which there was no room: the weakest.
  double missing = 0.0;  ///< Upper bound of the force error that left_out causes [N].
  SolverKind solver = SolverKind::kClosedForm;  ///< The solver's method in the last sub-step.
  StepStatus status = StepStatus::kConverged;   ///< The worst of what happened in the tick.
  bool limited = false;                         ///< limitForce changed the force.
  bool fresh = true;    ///< The hand's position was read since the last tick (NewReadings).
  double moving = 1.0;  ///< Share of the force that StillFade leaves, since the arm does not move.
  double share = 1.0;   ///< Share of the force that the energy tank can pay for (passivity.h).
  double energy = 0.0;  ///< Energy in the tank [J].
  double left = 0.0;    ///< Share of the spring's and of other hands' force together that `force`
                        ///< is; 0 where that has another direction.
};

/// Reports the status, unless a worse one is reported already.
inline void worsen(StepReport& report, StepStatus status) noexcept {
  if (status > report.status) report.status = status;
}

}  // namespace palpate
