#include "engine/step.h"

#include <algorithm>
#include <limits>

namespace palpate {

/// The parts of one hapticStep that share its arguments.
class Tick {
 public:
  Tick(const Scene& scene, Reader& reader, const Vec3& probe, ProxyState& state) noexcept
      : scene_(scene), reader_(reader), probe_(probe), state_(state) {}

  void meetScene() noexcept {
    reader_.bind(scene_);
    if (state_.scene_id_ != scene_.id) {
      state_.scene_id_ = scene_.id;
      std::fill(state_.memories_.begin(), state_.memories_.end(), ModeMemory{});
      state_.warm_.forget();
      state_.friction_.forget();
      // A stiffness that a swapped scene does not vary is that scene's; one that it does goes on.
      const bool varies = !scene_.graph.stiffness.factors.empty();
      if (!varies || !state_.placed_) state_.stiffness_ = {scene_.coupling.stiffness, 0.0};
    }
    if (!state_.placed_) {
      state_.placed_ = true;
      state_.proxy_ = probe_;
      state_.offset_.setZero();
    }
  }

  /// Steps 1 and 2: properties, primitives, balance, until the proxy has arrived. Returns
  /// proxy - probe [m]; false in `good` where a sample spoilt the balance.
  Vec3 moveProxy(StepReport& report, bool& good) noexcept {
    Vec3& proxy = state_.proxy_;
    bool arrived = false;
    int held = 0;
    Vec3 offset = proxy - probe_;
    while (!arrived && held < scene_.step.max_substeps && report.substeps < kMostSubsteps) {
      ++report.substeps;
      report.samples += reader_.sample(scene_, proxy, state_.properties_);
      placePrimitives(report);
      const SolveResult solved =
          solveWithFriction(probe_, state_.stiffness_.value, state_.primitives_, proxy,
                            scene_.solver, state_.warm_, state_.friction_, state_.forces_);
      good = solved.status != SolveStatus::kBadInput;
      if (!good) return offset;
      if (solved.status == SolveStatus::kIterationLimit) {
        worsen(report, StepStatus::kIterationLimit);
      }
      report.iterations += solved.iterations;
      report.error_bound = solved.error_bound;
      report.solver = solved.solver;

      constexpr double kFree = 1e-9;  // [m] from the probe: nothing holds the proxy
      if (solved.offset.norm() > kFree) ++held;

      // At most as far as the data of this place can be trusted.
      const double before = offset.squaredNorm();
      const Vec3 way = solved.proxy - proxy;
      const double reach = reachFrom(proxy, solved.proxy);
      const double length = way.norm();
      arrived = length <= reach;
      proxy = arrived ? solved.proxy : Vec3(proxy + (reach / length) * way);
      offset = arrived ? solved.offset : Vec3(proxy - probe_);
      report.injected +=
          std::max(0.0, 0.5 * state_.stiffness_.value * (offset.squaredNorm() - before));
      if (arrived) settleModes(proxy);
    }
    if (!arrived) worsen(report, StepStatus::kSubstepLimit);
    return offset;
  }

  /// After the proxy has moved: the stiffness of the next tick.
  void stiffen(const Vec3& offset, double dissipated, double dt) noexcept {
    const Transfer& stiffness = scene_.graph.stiffness;
    if (stiffness.factors.empty()) return;
    const double wanted = stiffness(state_.properties_);  // 0 without data: stays
    state_.stiffness_ = nextStiffness(state_.stiffness_, wanted, offset, dissipated, dt);
  }

  static void worsen(StepReport& report, StepStatus status) noexcept {
    report.status = std::max(report.status, status);
  }

 private:
  void placePrimitives(StepReport& report) noexcept {
    state_.primitives_.clear();
    const auto& modes = scene_.graph.modes;
    for (std::size_t i = 0; i < modes.size(); ++i) {
      if (!addPrimitives(modes[i], state_.properties_, state_.proxy_, probe_, state_.memories_[i],
                         state_.primitives_)) {
        worsen(report, StepStatus::kDropped);
      }
    }
    report.primitives = static_cast<int>(state_.primitives_.size());
  }

  void settleModes(const Vec3& proxy) noexcept {
    const auto& modes = scene_.graph.modes;
    for (std::size_t i = 0; i < modes.size(); ++i) settle(modes[i], proxy, state_.memories_[i]);
  }

  /// How far the proxy may go from a before properties are read again: a voxel of the finest volume
  /// that the way to b can meet, any distance where there is none.
  [[nodiscard]] double reachFrom(const Vec3& a, const Vec3& b) const noexcept {
    const Box way{a.cwiseMin(b), a.cwiseMax(b)};
    double reach = std::numeric_limits<double>::infinity();
    const auto meet = [&](const std::vector<FieldFrame>& frames) {
      for (const FieldFrame& frame : frames) {
        const double margin = 2.0 * frame.voxel;
        const bool apart = (way.lower.array() > frame.bounds.upper.array() + margin).any() ||
                           (way.upper.array() < frame.bounds.lower.array() - margin).any();
        if (!apart) reach = std::min(reach, frame.voxel);
      }
    };
    meet(scene_.graph.scalar_frames);
    meet(scene_.graph.vector_frames);
    return reach;
  }

  const Scene& scene_;
  Reader& reader_;
  const Vec3 probe_;
  ProxyState& state_;
};

StepReport hapticStep(const Scene& scene, Reader& reader, const HandState& hand, ProxyState& state,
                      double dt) noexcept {
  StepReport report;
  constexpr double kFarthest = 1e6;  // [m]: no hand is there; false for NaN as well
  bool good = hand.position.cwiseAbs().maxCoeff() < kFarthest && hand.position.allFinite() &&
              !state.faulted_;
  if (good) {
    Tick tick(scene, reader, hand.position, state);
    tick.meetScene();
    const Vec3 before = state.proxy_ - hand.position;
    const Vec3 offset = tick.moveProxy(report, good);

    // Step 3, eq. (3). The proxy's motion may not add energy to the spring; what it adds is
    // counted.
    const double k = state.stiffness_.value;
    report.stiffness = k;
    const Vec3 rate = dt > 0.0 ? Vec3((offset - state.offset_) / dt) : Vec3::Zero();
    state.offset_ = offset;
    if (good) {
      report.wanted = couplingForce({k, scene.coupling.damping}, offset, rate);
      tick.stiffen(offset, k * offset.dot(before - offset), dt);
    }
  }
  report.proxy = state.proxy_;
  if (!good) report.wanted.setConstant(std::numeric_limits<double>::quiet_NaN());

  // The last gate. Nothing below changes the force.
  const LimitedForce out = limitForce(report.wanted, state.sent_, dt, state.limits_);
  if (!out.finite) {
    state.faulted_ = true;
    report.status = StepStatus::kFault;
    report.wanted.setZero();
  }
  report.limited = out.limited();
  report.force = out.force;
  state.sent_ = out.force;
  return report;
}

const char* wordFor(StepStatus status) noexcept {
  switch (status) {
    case StepStatus::kConverged:
      return "converged";
    case StepStatus::kSubstepLimit:
      return "substep-limit";
    case StepStatus::kIterationLimit:
      return "iteration-limit";
    case StepStatus::kDropped:
      return "dropped";
    case StepStatus::kFault:
      return "fault";
  }
  return "";
}

}  // namespace palpate
