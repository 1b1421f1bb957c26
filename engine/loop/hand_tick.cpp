#include "palpate/engine/loop/hand_tick.h"

#include "palpate/engine/scoped_float_mode.h"

namespace palpate {

StepReport HandTick::step(const Scene* scene, const TickInput& in, StepTrace* trace) noexcept {
  if (in.cleared) state_.clearFault();
  if (in.wrong != Fault::kNone) state_.cut(in.wrong);
  if (in.hand.ready && !ready_) state_.engage();
  ready_ = in.hand.ready;
  state_.playAt(in.play, in.play_rate);
  state_.pullBy(in.pull);
  if (scene != nullptr) return hapticStep(*scene, reader_, in.hand, state_, in.dt, trace);
  state_.release();
  return {};
}

void HandTick::withhold(const TickInput& in, StepReport& report) noexcept {
  if (in.order == Fault::kNone) return;
  state_.cut(in.order);
  state_.release();
  report.force.setZero();
  report.left = 0.0;
  report.status = StepStatus::kFault;
}

void HandTick::sent(const TickInput& in) noexcept {
  const ScopedFloatMode plain;
  state_.weaken(in.given);
  if (in.unsent != Fault::kNone) state_.cut(in.unsent);
}

}  // namespace palpate
