#include "engine/step.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>

namespace palpate {

/// The parts of one hapticStep that share its arguments.
class Tick {
 public:
  Tick(const Scene& scene, Reader& reader, const Vec3& probe, ProxyState& state) noexcept
      : scene_(scene),
        reader_(reader),
        probe_(probe),
        state_(state),
        bodies_(state.bodies_.data(), scene.graph.motions.size()) {}

  void meetScene() noexcept {
    reader_.bind(scene_);
    const bool swapped = state_.scene_id_ != scene_.id;
    if (swapped) {
      state_.scene_id_ = scene_.id;
      state_.time_ = 0.0;
    }
    if (swapped || !state_.placed_) {
      state_.posed_at_ = state_.time_;
      for (std::size_t i = 0; i < bodies_.size(); ++i) {
        bodies_[i].pose = scene_.graph.motions[i]->poseAt(state_.time_);
      }
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
    const int parts = bodies_.empty() ? 1 : planMotion(report);
    while (!arrived && held < scene_.step.max_substeps && report.substeps < kMostSubsteps) {
      ++report.substeps;
      if (!bodies_.empty()) moveBodies(report.substeps, parts);
      report.samples += reader_.sample(scene_, proxy, state_.properties_, bodies_);
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
      const bool there = length <= reach;
      if (!there && (bodies_.empty() || !followBody(solved.proxy))) proxy += (reach / length) * way;
      if (there) proxy = solved.proxy;
      arrived = there && report.substeps >= parts;
      offset = there ? solved.offset : Vec3(proxy - probe_);
      report.injected +=
          std::max(0.0, 0.5 * state_.stiffness_.value * (offset.squaredNorm() - before));
      if (arrived) settleModes(proxy);
    }
    if (!arrived) worsen(report, StepStatus::kSubstepLimit);
    state_.posed_at_ = state_.time_;
    return offset;
  }

  /// After the proxy has moved: the stiffness of the next tick.
  void stiffen(const Vec3& offset, double dissipated, double dt) noexcept {
    const Transfer& stiffness = scene_.graph.stiffness;
    if (stiffness.factors.empty()) return;
    const double wanted = stiffness.anywhere(state_.properties_);
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
      const Body* body = bodyOf(scene_.graph.mode_motions[i]);
      const Vec3& p = body == nullptr ? state_.proxy_ : body->carried;
      const Pose* pose = body == nullptr ? nullptr : &body->pose;
      if (body != nullptr && body->moved) carry(body->carry, state_.memories_[i]);
      if (!addPrimitives(modes[i], state_.properties_, p, probe_, state_.memories_[i],
                         state_.primitives_, pose)) {
        worsen(report, StepStatus::kDropped);
      }
    }
    report.primitives = static_cast<int>(state_.primitives_.size());
  }

  void settleModes(const Vec3& proxy) noexcept {
    const auto& modes = scene_.graph.modes;
    for (std::size_t i = 0; i < modes.size(); ++i) settle(modes[i], proxy, state_.memories_[i]);
  }

  [[nodiscard]] const Body* bodyOf(int motion) const noexcept {
    return motion < 0 ? nullptr : &bodies_[static_cast<std::size_t>(motion)];
  }

  /// Calls back with the frame and the motion of every field.
  template <class Do>
  void eachField(Do&& look) const noexcept {
    const Graph& graph = scene_.graph;
    for (std::size_t i = 0; i < graph.scalar_frames.size(); ++i) {
      look(graph.scalar_frames[i], graph.scalar_motions[i]);
    }
    for (std::size_t i = 0; i < graph.vector_frames.size(); ++i) {
      look(graph.vector_frames[i], graph.vector_motions[i]);
    }
  }

  /// True if a box of a field's own frame comes near its data.
  [[nodiscard]] static bool meets(const Box& way, const FieldFrame& frame) noexcept {
    const double margin = 2.0 * frame.voxel;
    const bool apart = (way.lower.array() > frame.bounds.upper.array() + margin).any() ||
                       (way.upper.array() < frame.bounds.lower.array() - margin).any();
    return !apart;
  }

  /// The way to b as a field sees it: from where it was read.
  [[nodiscard]] static bool meets(const Body& body, const Vec3& b,
                                  const FieldFrame& frame) noexcept {
    const Vec3 end = body.pose.toRest(b);
    return meets({body.seen.cwiseMin(end), body.seen.cwiseMax(end)}, frame);
  }

  /// How far the proxy may go from a before properties are read again: a voxel of the finest volume
  /// that the way to b can meet, any distance where there is none. A volume that has carried the
  /// place of its reading away from a counts from there.
  [[nodiscard]] double reachFrom(const Vec3& a, const Vec3& b) const noexcept {
    const Box way{a.cwiseMin(b), a.cwiseMax(b)};
    double reach = std::numeric_limits<double>::infinity();
    if (bodies_.empty()) {
      const auto meet = [&](const std::vector<FieldFrame>& frames) {
        for (const FieldFrame& frame : frames) {
          if (meets(way, frame)) reach = std::min(reach, frame.voxel);
        }
      };
      meet(scene_.graph.scalar_frames);
      meet(scene_.graph.vector_frames);
      return reach;
    }
    eachField([&](const FieldFrame& frame, int motion) {
      const Body* body = bodyOf(motion);
      if (body == nullptr) {
        if (meets(way, frame)) reach = std::min(reach, frame.voxel);
      } else if ((b - body->carried).norm() > frame.voxel && meets(*body, b, frame)) {
        const double carried = (body->carried - a).norm();
        reach = std::min(reach, std::max(frame.voxel - carried, 0.5 * frame.voxel));
      }
    });
    return reach;
  }

  /// Part of the way to b, for a proxy that one moving volume holds back: a voxel of it from where
  /// that volume was read, as if it stood still. False, and nothing done, where another volume
  /// could not follow that.
  [[nodiscard]] bool followBody(const Vec3& b) noexcept {
    const Body* holder = nullptr;
    double share = 1.0;
    eachField([&](const FieldFrame& frame, int motion) {
      const Body* body = bodyOf(motion);
      if (body == nullptr || !body->moved || !meets(*body, b, frame)) return;
      const double part = frame.voxel / (b - body->carried).norm();
      if (part >= share) return;
      share = part;
      holder = body;
    });
    if (holder == nullptr) return false;
    const Vec3 to = holder->carried + share * (b - holder->carried);
    bool trusted = true;
    eachField([&](const FieldFrame& frame, int motion) {
      const Body* body = bodyOf(motion);
      if (body == holder) return;
      const Vec3& from = body == nullptr ? state_.proxy_ : body->carried;
      if ((to - from).norm() <= frame.voxel) return;
      const Box way{from.cwiseMin(to), from.cwiseMax(to)};
      trusted = trusted && !(body == nullptr ? meets(way, frame) : meets(*body, to, frame));
    });
    if (trusted) state_.proxy_ = to;
    return trusted;
  }

  /// In how many parts the volumes move on to this tick's time: each at most half a voxel where the
  /// proxy is or can come to.
  [[nodiscard]] int planMotion(StepReport& report) noexcept {
    const Vec3& p = state_.proxy_;
    for (std::size_t i = 0; i < bodies_.size(); ++i) {
      bodies_[i].target = scene_.graph.motions[i]->poseAt(state_.time_);
    }
    double parts = 1.0;
    eachField([&](const FieldFrame& frame, int motion) {
      if (motion < 0) return;
      const Body& body = bodies_[static_cast<std::size_t>(motion)];
      const Vec3 seen = body.pose.toRest(p);
      const double way = (body.target(seen) - p).norm();
      if (!(way > 0.5 * frame.voxel)) return;
      Box near;
      for (const Vec3& x : {p, probe_}) {
        near.extend(body.pose.toRest(x));
        near.extend(body.target.toRest(x));
      }
      if (meets(near, frame)) parts = std::max(parts, std::ceil(way / (0.5 * frame.voxel)));
    });
    if (parts > scene_.step.max_substeps) worsen(report, StepStatus::kSubstepLimit);
    return static_cast<int>(std::min<double>(parts, scene_.step.max_substeps));
  }

  /// Moves the volumes to their place in a sub-step, and finds where each sees the proxy.
  void moveBodies(int substep, int parts) noexcept {
    const Vec3& p = state_.proxy_;
    for (std::size_t i = 0; i < bodies_.size(); ++i) {
      Body& body = bodies_[i];
      const Pose last = body.pose;
      if (substep < parts) {
        const double share = static_cast<double>(substep) / parts;
        const double time = state_.posed_at_ + share * (state_.time_ - state_.posed_at_);
        body.pose = scene_.graph.motions[i]->poseAt(time);
      } else {
        body.pose = body.target;
      }
      body.seen = last.toRest(p);
      body.moved = !(body.pose == last);
      body.carried = body.moved ? body.pose(body.seen) : p;
      if (!body.moved) continue;
      body.carry.rotation = body.pose.rotation * last.rotation.transpose();
      body.carry.translate = body.pose.translate - body.carry.rotation * last.translate;
    }
  }

  const Scene& scene_;
  Reader& reader_;
  const Vec3 probe_;
  ProxyState& state_;
  const std::span<Body> bodies_;  ///< One for each of the scene's motions.
};

StepReport hapticStep(const Scene& scene, Reader& reader, const HandState& hand, ProxyState& state,
                      double dt) noexcept {
  StepReport report;
  if (dt > 0.0 && std::isfinite(dt)) state.time_ += dt;
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
