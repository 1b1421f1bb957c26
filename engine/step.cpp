#include "engine/step.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <limits>
#include <span>

#include "engine/turning.h"

namespace palpate {

/// The parts of one hapticStep that share its arguments.
class Tick {
 public:
  Tick(const Scene& scene, Reader& reader, const Vec3& probe, ProxyState& state) noexcept
      : scene_(scene), reader_(reader), probe_(probe), state_(state), bodies_(state.bodies_) {
    state_.felt_[0] = {reader.bind(scene), &state.properties_, state.memories_.data()};
  }

  void meetScene() noexcept {
    const bool swapped = state_.scene_id_ != scene_.id;
    if (swapped) {
      state_.meet(scene_.shape);
      state_.scene_id_ = scene_.id;
      state_.time_ = 0.0;
    }
    if (swapped || !state_.placed_ || state_.lost_) {
      state_.lost_ = false;
      bodies_.place(scene_.graph, state_.time_);
      std::fill(state_.memories_.begin(), state_.memories_.end(), ModeMemory{});
      state_.near_.forget();
      state_.known_ = false;
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
      state_.length_rate_.forget();
    }
  }

  /// Steps 1 and 2: properties, primitives, balance, until the proxy has arrived. Returns
  /// proxy - probe [m]; false in `good` where a sample spoilt the balance.
  Vec3 moveProxy(StepReport& report, bool& good) noexcept {
    const int moves = bodies_.empty() ? 1
                                      : bodies_.plan(felt(), state_.time_, state_.proxy_, probe_,
                                                     scene_.step.max_substeps, report);
    if (!state_.known_) lookRound(report);
    if (!scene_.parts.empty()) meetParts(report);
    const int parts = std::max(moves, handParts());
    const Vec3 hand = probe_;
    const Vec3 came = (hand - handBefore()) / parts;
    for (int part = 1; part <= parts && good; ++part) {
      if (!bodies_.empty()) moveBodies(part, parts);
      probe_ = hand - (parts - part) * came;
      offset_ = state_.proxy_ - probe_;
      good = follow(parts - part, report);
    }
    settleModes();
    bodies_.arrive();
    return offset_;
  }

  /// After the proxy has moved: the stiffness of the next tick.
  void stiffen(const Vec3& offset, double dissipated, double dt) noexcept {
    const Transfer& stiffness = scene_.graph.stiffness;
    if (stiffness.factors.empty()) return;
    const double wanted = stiffness.anywhere(state_.properties_);
    state_.stiffness_ = nextStiffness(state_.stiffness_, wanted, offset, dissipated, dt);
  }

 private:
  /// A way that the proxy may go.
  struct Way {
    Vec3 end;
    bool clear = true;         ///< It leads to the balance.
    bool cut = false;          ///< Else: only as far as the data can be trusted,
    bool close = false;        ///< or as Newton's step is. Or it met a surface.
    bool near = true;          ///< To where properties were read last.
    Vec3 lift = Vec3::Zero();  ///< What met a surface went so far above the proxy's own way [m].
    bool swept = true;         ///< All of it, for the surfaces on it.
  };
  /// A line that holds the proxy while it goes along the curve that the line is a tangent of.
  struct Rail {
    bool laid = false;               ///< For the way from this proxy.
    const ModeMemory* of = nullptr;  ///< The mode's; null: no line holds.
    Primitive line;                  ///< The tangent where the curve led.
    /// How much farther on the probe would have to be for that to be the balance [m]: the curve led
    /// aside of the tangent, and what the tangent held is not all across the new one.
    Vec3 waiting = Vec3::Zero();
  };

  /// A proxy that is new here: properties where it is.
  void lookRound(StepReport& report) noexcept {
    bodies_.readAt(state_.proxy_);
    bodies_.stand(state_.proxy_);
    report.samples +=
        state_.felt_[0].bound.sample(state_.proxy_, state_.properties_, bodies_.items());
    read_at_ = state_.proxy_;
    placePrimitives(false, report);  // for what modes remember
    state_.known_ = true;
  }

  /// The parts that the proxy can come to on its way to the hand are felt from now on; stayNear()
  /// sees to it that it comes to no others.
  void meetParts(StepReport& report) noexcept {
    state_.near_.meet(scene_, reader_, state_.proxy_, probe_, state_.primitives_, report);
    felt_count_ = 1 + state_.near_.bind(scene_, reader_, std::span(state_.felt_).subspan(1));
  }

  /// Cuts a way where it would come to parts that were not chosen: primitives that push, and
  /// volumes that move, take the proxy farther than to the hand.
  void stayNear(Way& way, const Vec3& from) noexcept {
    const double share = state_.near_.knownShare(from, way.end);
    strays_ = share < 1.0;
    if (!strays_) return;
    constexpr double kShort = 0.99;
    way.end = from + kShort * share * (way.end - from);
    way.clear = false;
    way.cut = true;
    way.near = false;
    ++strayed_;
  }

  [[nodiscard]] std::span<const Felt> felt() const noexcept {
    return {state_.felt_.data(), felt_count_};
  }

  /// The volumes stand; the proxy goes where the balance puts it. First by the primitives of the
  /// last reading; then properties are read where that led, planes placed anew, and the balance
  /// found again, until Newton's step on it is within the tolerance. False where a sample spoilt
  /// the balance. At least `later` readings are left over.
  bool follow(int later, StepReport& report) noexcept {
    sampled_ = onward_ = arrived_ = false;
    rail_ = {};
    read_at_ = state_.proxy_;
    trust_ = std::numeric_limits<double>::infinity();
    least_ = std::numeric_limits<double>::infinity();
    Vec3 from = standsFor();  // of the last reading
    bool cut = false;
    bool met_free = false;
    if (!balance(true, from, report)) return false;
    for (;;) {
      Way way = advance(false, report);
      const bool known = sampled_ && (way.near || !cut);
      const bool arrived = known && way.clear && steady();
      const bool spent = sampled_ && (held_ + later >= scene_.step.max_substeps ||
                                      report.substeps + later >= kMostSubsteps ||
                                      (strays_ && strayed_ > kMostStrays));
      // A proxy that nothing holds is at the hand, however much of its way is left to be read: that
      // is only swept, and what the sweep meets is read.
      const bool free = spent && !arrived && state_.primitives_.size() == 0;
      if (free) way = advance(true, report);
      const bool meets = free && !way.clear && (strays_ ? strayed_ <= kMostStrays : !met_free);
      met_free = met_free || (meets && !strays_);
      if (arrived || (spent && !meets)) {
        if (!arrived && (later == 0 || free)) worsen(report, StepStatus::kSubstepLimit);
        if (free) {
          state_.lost_ = state_.lost_ || !way.clear || !way.swept;
          arrived_ = true;
          moveTo({target_}, report);
          return true;
        }
        if (arrived && certified()) {
          target_ = way.end = balance_;
          offset_of_target_ = offset_of_balance_;
        }
        if (!arrived && least_ < step_.norm()) {
          read_at_ = least_at_;
          target_ = least_target_;
          offset_of_target_ = target_ - probe_;
          way = advance(false, report);
        }
        way.end -= way.lift;
        if (!arrived) pressThrough(way, report);
        arrived_ = arrived;
        moveTo(way, report);
        return true;
      }
      cut = way.cut;
      read(way.end, report);
      const Vec3 went = read_at_ - from;
      from = read_at_;
      if (cut) {
        moveTo(way, report);
        least_ = std::numeric_limits<double>::infinity();
        rail_ = {};
        if (strays_) meetParts(report);
      }
      if (!balance(false, from, report)) return false;
      trust(went);
      const bool met = !way.clear && !way.cut && !way.close;
      if (met || offset_of_balance_.norm() > kFree) ++held_;
    }
  }

  /// Where the proxy stands for the planes that are remembered: carried along by the volume whose
  /// surface holds it.
  [[nodiscard]] Vec3 standsFor() const noexcept {
    Vec3 at = state_.proxy_;
    (void)anyMode(
        felt(), [&](const Mode& mode, const ModeMemory& memory, const Felt& felt, std::size_t i) {
          const Body* body = bodies_.of(felt.graph().mode_motions[i]);
          if (skinOf(mode) == nullptr || !memory.placed || body == nullptr || !body->moved)
            return false;
          at = body->carried;
          return true;
        });
    return at;
  }

  /// The trust region of Newton's step, after a way: a step that turns back on it halves it.
  void trust(const Vec3& went) noexcept {
    const double step = step_.norm();
    if (turning_count_ == 0) least_ = std::numeric_limits<double>::infinity();
    if (turning_count_ > 0 && step < least_) {
      least_ = step;
      least_at_ = read_at_;
      least_target_ = target_;
    }
    if (step_.dot(went) < -0.25 * went.squaredNorm()) {
      trust_ = 0.5 * std::min(went.norm(), step);
    } else {
      trust_ *= 2.0;
    }
    went_ = went.norm();
  }

  /// As far off the hand as all that was placed can hold the proxy [m].
  [[nodiscard]] double reachOfStrengths() const noexcept {
    double most = 0.0;
    for (const Primitive& primitive : state_.primitives_.items()) most += primitive.strength;
    return most / state_.stiffness_.value;
  }

  /// Nothing holds more than its strength: what waits and is pulled by more than all that was
  /// placed can hold goes on, as far as it was read. One plane that could hold what presses on it
  /// stays, and the hand is followed along it; what else holds is come through.
  void pressThrough(Way& way, StepReport& report) noexcept {
    if (turning_count_ == 0 || rail_.of != nullptr) return;
    const double held = reachOfStrengths();
    const double enough = (1.0 + 1e-9) * held;
    const auto pulled = [&] { return (way.end - probe_).norm() > enough; };
    const auto go = [&](const Vec3& offset) {
      read_at_ = way.end;
      offset_of_target_ = offset;
      target_ = probe_ + offset;
      trust_ = std::numeric_limits<double>::infinity();
      way = advance(false, report);
      way.end -= way.lift;
    };
    if (!pulled()) return;
    if (turning_count_ == 1) {
      const Primitive& plane = state_.primitives_.items()[turning()[0].index];
      const Vec3 offset = way.end - probe_;
      const Vec3 pressed = std::max(offset.dot(plane.direction), 0.0) * plane.direction;
      if (pressed.norm() * state_.stiffness_.value < plane.strength) {
        const Vec3 along = offset - pressed;
        const double left = std::sqrt(held * held - pressed.squaredNorm());
        go(pressed + std::min(1.0, left / along.norm()) * along);
      }
    }
    if (!pulled()) return;
    eachMode(felt(), [](const Mode&, ModeMemory& memory, const Felt&, std::size_t) {
      if (memory.plane >= 0) memory.load = Load::kYielding;
    });
    const Vec3 offset = way.end - probe_;
    go(held / offset.norm() * offset);
  }

  /// What is left after Newton's step is within the tolerance: the step itself is; or, where planes
  /// alone hold, it is so much shorter than the way that led to it that what follows would be, and
  /// the slopes that it leads over differ so little that it stays on them.
  [[nodiscard]] bool steady() const noexcept {
    if (turning_count_ == 0) return true;
    const double tolerance = scene_.step.tolerance_voxels * voxel_;
    const double step = step_.norm();
    const double beyond = offset_of_target_.norm() - reachOfStrengths() - rail_.waiting.norm();
    if (beyond > tolerance) return false;
    if (step <= tolerance) return true;
    if (turning_count_ != state_.primitives_.size() || step > kFalls * went_) return false;
    double bend = 0.0;
    for (const TurningPlane& plane : turning()) {
      bend =
          std::max(bend, (state_.primitives_.items()[plane.index].direction - plane.across).norm());
    }
    return std::max(step * step / went_, bend * step) <= kRest * tolerance;
  }
  /// The balance itself is where it was read, to the tolerance.
  [[nodiscard]] bool certified() const noexcept {
    return turning_count_ > 0 &&
           (balance_ - read_at_).norm() <= scene_.step.tolerance_voxels * voxel_;
  }

  [[nodiscard]] static int motionOf(const IsosurfaceMode& mode, const Felt& felt) noexcept {
    return felt.graph().scalar_motions[static_cast<std::size_t>(mode.skin.field)];
  }

  /// Where a way first falls through a surface, both in the resting frame of its volume.
  [[nodiscard]] static Crossing sweep(const IsosurfaceMode& mode, const Felt& felt,
                                      const Vec3& from, const Vec3& to,
                                      StepReport& report) noexcept {
    const Graph& graph = felt.graph();
    const auto field = static_cast<std::size_t>(mode.skin.field);
    if (!meets({from.cwiseMin(to), from.cwiseMax(to)}, graph.scalar_frames[field])) return {};
    const double length = (to - from).norm();
    if (length > mode.skin.voxel && graph.scalar_fields[field]->freeWithin(from) > length) {
      return {};
    }
    // Where it has no strength there is nothing to meet.
    if (!(mode.strength.at(*felt.properties, mode.skin.value, mode.level) > 0.0)) return {};
    const Crossing crossing = felt.bound.firstFall(mode.skin, mode.level, from, to);
    report.walked += crossing.cells;
    return crossing;
  }

  /// Properties at a place.
  void read(const Vec3& at, StepReport& report) noexcept {
    ++report.substeps;
    bodies_.readAt(at);
    for (const Felt& felt : this->felt()) {
      report.samples += felt.bound.sample(at, *felt.properties, bodies_.items());
    }
    read_at_ = at;
    sampled_ = onward_ = true;
  }

  /// Places the primitives, finds their balance, and by Newton's step from where they were read,
  /// `from`, target_.
  bool balance(bool foreseen, const Vec3& from, StepReport& report) noexcept {
    placePrimitives(foreseen, report);
    // What the curve led aside of the tangent waits for the next tick.
    const bool on_rail = rail_.of != nullptr;
    const double k = state_.stiffness_.value;
    const Vec3 probe = on_rail ? Vec3(probe_ + rail_.waiting) : probe_;
    const SolveResult solved =
        solveWithFriction(probe, k, state_.primitives_, state_.proxy_, scene_.solver, state_.warm_,
                          state_.friction_, state_.forces_);
    if (solved.status == SolveStatus::kBadInput) return false;
    if (solved.status == SolveStatus::kIterationLimit && !foreseen) {
      worsen(report, StepStatus::kIterationLimit);
    }
    report.iterations += solved.iterations;
    if (!foreseen) {
      report.error_bound = solved.error_bound;
      report.solver = solved.solver;
    }
    balance_ = solved.proxy;
    offset_of_balance_ = on_rail ? Vec3(solved.proxy - probe_) : solved.offset;
    eachMode(felt(), [&](const Mode& mode, ModeMemory& memory, const Felt&, std::size_t) {
      weigh(mode, state_.primitives_.items(), state_.forces_, memory);
    });
    const Vec3 residual = balance_ - from;
    step_ = newtonStep(balance_, from, k, state_.primitives_.items(), state_.forces_, turning());
    const Vec3 beyond = step_ - residual;
    target_ = balance_ + beyond;
    offset_of_target_ = offset_of_balance_ + beyond;
    return true;
  }

  [[nodiscard]] std::span<const TurningPlane> turning() const noexcept {
    return {state_.turning_.data(), turning_count_};
  }

  /// How far the proxy may go towards the balance; `unread`: nothing is to be read on the way.
  Way advance(bool unread, StepReport& report) noexcept {
    Way way{target_};
    const Vec3& from = onward_ ? read_at_ : state_.proxy_;
    const Vec3 line = target_ - from;
    const double length = line.norm();
    const double reach =
        unread ? std::numeric_limits<double>::infinity() : reachFrom(from, target_);
    way.near = length <= kNear * reach;
    if (length > trust_ && trust_ < reach && !steady()) {
      way.clear = false;
      way.close = true;
      way.end = from + (trust_ / length) * line;
    } else if (!(length <= reach)) {
      way.clear = false;
      way.cut = true;
      if (bodies_.empty() || onward_ || !bodies_.follow(felt(), state_.proxy_, target_, way.end)) {
        way.end = from + (reach / length) * line;
      }
    }
    if (!rail_.laid) layRail(way, report);
    if (!scene_.parts.empty()) stayNear(way, from);
    meetSurfaces(way, report);
    return way;
  }

  /// The first line that holds the proxy: along the curve instead of its tangent.
  void layRail(Way& way, StepReport& report) noexcept {
    rail_.laid = true;
    std::size_t first = 0;
    (void)anyMode(felt(),
                  [&](const Mode& any, ModeMemory& memory, const Felt& felt, std::size_t i) {
                    const std::size_t index = first;
                    first += static_cast<std::size_t>(memory.emitted);
                    const auto* mode = std::get_if<FollowMode>(&any);
                    if (mode == nullptr || mode->field < 0 || memory.emitted == 0) return false;
                    return layAlong(*mode, memory, felt, i, index, way, report);
                  });
  }

  /// Primitive `index` of mode i of what is felt. True if it holds.
  bool layAlong(const FollowMode& mode, ModeMemory& memory, const Felt& felt, std::size_t i,
                std::size_t index, Way& way, StepReport& report) noexcept {
    const Primitive& line = state_.primitives_.items()[index];
    const Vec3 go = way.end - line.position;
    const Vec3 aside = balance_ - line.position;
    constexpr double kOn = 1e-3;     // [voxels] off the line: it gives way
    constexpr double kStays = 1e-5;  // [voxels] along it: the proxy rests
    memory.holds = (aside - line.direction.dot(aside) * line.direction).norm() <= kOn * mode.voxel;
    if (!memory.holds) return false;
    if (std::abs(line.direction.dot(go)) < kStays * mode.voxel) return false;
    const Body* body = bodies_.of(felt.graph().mode_motions[i]);
    TraceOrder order;
    order.length = line.direction.dot(go);
    order.along = line.direction;
    // What the line holds against: the hand, or what other primitives leave of it.
    order.hand = line.direction.dot(aside) * line.direction -
                 state_.forces_[index] / state_.stiffness_.value;
    const Vec3 hand = order.hand;
    if (body != nullptr) {
      order.along = body->pose.rotation.transpose() * order.along;
      order.hand = body->pose.rotation.transpose() * order.hand;
    }
    order.tolerance = kTraceStep * scene_.step.tolerance_voxels;
    order.stride = memory.stride;
    const Trace trace = felt.bound.trace(
        mode.field, body == nullptr ? line.position : body->pose.toRest(line.position), order);
    memory.stride = trace.stride;
    report.traced += trace.samples;
    const Vec3 curve = body == nullptr ? trace.position : body->pose(trace.position);
    const Vec3 ahead =
        body == nullptr ? trace.direction : Vec3(body->pose.rotation * trace.direction);
    // Where the stream or its data end the rest is gone straight on.
    const double rest = trace.capped || trace.shortened ? 0.0 : order.length - trace.length;
    const Vec3 on = line.direction.dot(go) * line.direction;
    const Vec3 shift = curve + rest * line.direction - (line.position + on);
    // A curve that leads farther off its tangent than the line's strength reaches cannot be held,
    // nor a place on it that the hand is farther from.
    const double k = state_.stiffness_.value;
    const Vec3 left = hand - (curve - line.position);
    if (trace.shortened && !(left.norm() <= line.strength / k)) return true;
    const Vec3 waiting = shift + ahead.dot(state_.forces_[index]) / k * ahead;
    if (!(waiting.norm() <= line.strength / k)) return true;
    rail_.of = &memory;
    rail_.line = {PrimitiveKind::kLine, curve + rest * line.direction, ahead, line.strength};
    rail_.waiting = waiting;
    way.end += shift;
    way.clear = false;  // but to where properties are to be read
    if (trace.hairpin) worsen(report, StepStatus::kHairpin);
    if (trace.capped) worsen(report, StepStatus::kSubstepLimit);
    return true;
  }

  /// Cuts a way where it first meets a surface from the free side.
  void meetSurfaces(Way& way, StepReport& report) noexcept {
    double share = 1.0;
    Vec3 end = way.end;
    ModeMemory* met = nullptr;
    eachMode(felt(), [&](const Mode& any, ModeMemory& memory, const Felt& felt, std::size_t) {
      const auto* mode = std::get_if<IsosurfaceMode>(&any);
      if (mode == nullptr || memory.contact != ModeMemory::Contact::kOutside) return;
      if (memory.load == Load::kYielding) return;
      const Body* body = bodies_.of(motionOf(*mode, felt));
      const Vec3 lift =
          liftOff(*mode, (way.end - (onward_ ? read_at_ : state_.proxy_)).norm(), memory);
      // What led to the last reading is known to be free.
      Vec3 from = (onward_ ? read_at_ : state_.proxy_) + lift;
      Vec3 to = way.end + lift;
      if (memory.placed && (to - from).norm() < kSeen * mode->skin.voxel && onward_) return;
      if (body != nullptr) {
        from = onward_ ? body->pose.toRest(from)
                       : Vec3(body->from + body->pose.rotation.transpose() * lift);
        to = body->pose.toRest(to);
      }
      const Crossing crossing = sweep(*mode, felt, from, to, report);
      // A way that is all behind it begins behind another of its walls: that is met at once.
      if (!crossing.found && !crossing.behind) {
        way.swept = way.swept && crossing.share >= 1.0;
        return;
      }
      const double at_share = crossing.found ? crossing.share : 0.0;
      if (met != nullptr && at_share >= share) return;
      share = at_share;
      way.lift = lift;
      const Vec3 at = from + share * (to - from);
      end = body == nullptr ? at : body->pose(at);
      met = &memory;
    });
    if (met == nullptr) return;
    met->touched = true;
    // Where nothing of it held the proxy before, there it has come to.
    way = {end, false, !met->placed, false, way.near, way.lift};
  }

  /// The proxy goes there; what it adds to the spring's energy is counted.
  void moveTo(const Way& way, StepReport& report) noexcept {
    const Vec3 before = offset_;
    state_.proxy_ = way.end;
    offset_ = way.clear ? offset_of_target_ : Vec3(state_.proxy_ - probe_);
    report.waiting = rail_.waiting;
    report.injected += std::max(0.0, state_.stiffness_.value * offset_.dot(offset_ - before));
    bodies_.stand(state_.proxy_);
  }

  void placePrimitives(bool foreseen, StepReport& report) noexcept {
    state_.primitives_.clear();
    turning_count_ = 0;
    voxel_ = std::numeric_limits<double>::infinity();
    eachMode(felt(), [&](const Mode& mode, ModeMemory& memory, const Felt& felt, std::size_t i) {
      if (&memory == rail_.of) {
        memory.emitted = 1;
        if (!state_.primitives_.tryAdd(rail_.line)) {
          memory.emitted = 0;
          worsen(report, StepStatus::kDropped);
        }
        return;
      }
      const Body* body = bodies_.of(felt.graph().mode_motions[i]);
      const Vec3& p = body == nullptr ? state_.proxy_ : body->carried;
      const Pose* pose = body == nullptr ? nullptr : &body->pose;
      const Stand stand{p, foreseen ? p : read_at_, probe_, pose, foreseen};
      if (!addPrimitives(mode, *felt.properties, stand, memory, state_.primitives_)) {
        worsen(report, StepStatus::kDropped);
      }
      if (memory.plane >= 0) addTurn(mode, felt, foreseen ? p : read_at_, foreseen, memory);
    });
    if (!foreseen) report.primitives = static_cast<int>(state_.primitives_.size());
  }

  /// A surface's plane turns with the place where it is read.
  void addTurn(const Mode& mode, const Felt& felt, const Vec3& x, bool foreseen,
               ModeMemory& memory) noexcept {
    const Skin* skin = skinOf(mode);
    if (skin == nullptr) return;
    Wall& wall = memory.wall;
    if (!foreseen) {
      readTurn(mode, felt.bound, *felt.properties, read_at_, bodies_.items(), memory);
    }
    // A plane that the surface did not place is its own slope.
    const Vec3& across = memory.seen ? wall.across : wall.normal;
    const double over = across.dot(wall.normal) * wall.normal.dot(x - wall.anchor);
    const double most = 0.5 * skin->voxel;
    const double height = memory.seen && !foreseen ? wall.height : std::clamp(over, -most, most);
    voxel_ = std::min(voxel_, skin->voxel);
    if (turning_count_ == state_.turning_.size()) return;
    state_.turning_[turning_count_++] = {static_cast<std::size_t>(memory.plane), wall.turn, across,
                                         height};
  }

  void settleModes() noexcept {
    eachMode(felt(), [&](const Mode& mode, ModeMemory& memory, const Felt&, std::size_t) {
      settle(mode, state_.proxy_, arrived_, memory);
    });
  }

  /// How far the proxy may go from a before properties are read again: a voxel of the finest volume
  /// that the way to b can meet, any distance where there is none or where it is empty. A volume
  /// that has carried the place of its reading away from a counts from there.
  [[nodiscard]] double reachFrom(const Vec3& a, const Vec3& b) const noexcept {
    if (!bodies_.empty()) return bodies_.reachFrom(felt(), a, b, onward_);
    const Box way{a.cwiseMin(b), a.cwiseMax(b)};
    double reach = std::numeric_limits<double>::infinity();
    const double length = (b - a).norm();
    const auto meet = [&](const std::vector<FieldFrame>& frames, const auto& fields) {
      for (std::size_t i = 0; i < frames.size(); ++i) {
        const FieldFrame& frame = frames[i];
        if (!meets(way, frame)) continue;
        const double free = length > frame.voxel ? fields[i]->freeWithin(a) : 0.0;
        reach = std::min(reach, std::max(frame.voxel, free));
      }
    };
    for (const Felt& felt : this->felt()) {
      meet(felt.graph().scalar_frames, felt.graph().scalar_fields);
      meet(felt.graph().vector_frames, felt.graph().vector_fields);
    }
    return reach;
  }

  /// Where the hand was in the last tick [m].
  [[nodiscard]] Vec3 handBefore() const noexcept { return state_.proxy_ - state_.offset_; }

  /// In how many parts the hand goes on where a stream holds the proxy: each a voxel at most, but
  /// so that each may take two readings. All at once a fast hand would be farther aside of the line
  /// at the proxy than of the curve.
  [[nodiscard]] int handParts() const noexcept {
    double voxel = std::numeric_limits<double>::infinity();
    eachMode(felt(), [&](const Mode& any, const ModeMemory& memory, const Felt&, std::size_t) {
      const auto* mode = std::get_if<FollowMode>(&any);
      if (mode != nullptr && memory.emitted > 0 && memory.holds) {
        voxel = std::min(voxel, mode->voxel);
      }
    });
    const double parts = std::ceil((probe_ - handBefore()).norm() / voxel);
    const int most = std::max(1, scene_.step.max_substeps / 2);
    return static_cast<int>(std::clamp<double>(parts, 1.0, most));
  }

  /// Moves the volumes to their place in a part, and what is remembered with them.
  void moveBodies(int part, int parts) noexcept {
    bodies_.move(scene_.graph, part, parts, state_.proxy_);
    state_.felt_[0].bound.turn(state_.properties_, bodies_.items());
    const auto& modes = scene_.graph.modes;
    for (std::size_t i = 0; i < modes.size(); ++i) {
      const Body* body = bodies_.of(scene_.graph.mode_motions[i]);
      if (body != nullptr && body->moved) carry(body->carry, state_.memories_[i]);
    }
  }

  const Scene& scene_;
  Reader& reader_;
  Vec3 probe_;  ///< The hand [m]; within a tick where it goes on in parts.
  ProxyState& state_;
  Bodies& bodies_;
  std::size_t felt_count_ = 1;  ///< Of ProxyState::felt_.
  bool strays_ = false;         ///< The last way led beyond the parts that were chosen,
  int strayed_ = 0;             ///< as so many ways of this tick did.
  Rail rail_;
  bool sampled_ = false;         ///< Since the volumes moved.
  bool onward_ = false;          ///< The next way begins there, not where the proxy stands.
  bool arrived_ = false;         ///< The proxy is at the balance.
  int held_ = 0;                 ///< Readings after which something held the proxy.
  Vec3 read_at_ = Vec3::Zero();  ///< Where properties were read last [m].
  Vec3 balance_ = Vec3::Zero();  ///< The last balance [m],
  Vec3 offset_of_balance_ = Vec3::Zero();  ///< and from the probe.
  Vec3 step_ = Vec3::Zero();               ///< Newton's, from where was read last [m],
  Vec3 target_ = Vec3::Zero();             ///< which leads here [m],
  Vec3 offset_of_target_ = Vec3::Zero();   ///< from the probe.
  std::size_t turning_count_ = 0;          ///< Of ProxyState::turning_.
  double voxel_ = 0.0;                     ///< The finest of those [m].
  double trust_ = 0.0;                     ///< Of that step, so much is gone [m].
  double went_ = 0.0;                      ///< Between the last two readings [m].
  double least_ = 0.0;                     ///< The shortest step of this move [m],
  Vec3 least_at_ = Vec3::Zero();           ///< from here,
  Vec3 least_target_ = Vec3::Zero();       ///< to there.
  Vec3 offset_ = Vec3::Zero();             ///< proxy - probe [m].

  /// So often in a tick parts are chosen anew: each time the proxy comes 2 mm on, or farther.
  static constexpr int kMostStrays = 16;
  /// A shorter way along a surface is seen from where properties were read [voxels].
  static constexpr double kSeen = 0.1;
  /// What is read holds so far from there, as a share of how far the proxy may go.
  static constexpr double kNear = 0.25;
  /// A step so much shorter than the way before it falls fast enough to be believed.
  static constexpr double kFalls = 0.25;
  /// Share of the tolerance that may be left so.
  static constexpr double kRest = 0.5;
  static constexpr double kFree = 1e-9;  ///< [m] from the probe: nothing holds the proxy.
  /// Error of a trace's step, by the scene's tolerance. Measured: of 0.01 voxel less than 0.01
  /// comes together over 1,280 voxels of any stream tried (docs/motion_accuracy.md).
  static constexpr double kTraceStep = 2.25e-3;
};

StepReport hapticStep(const Scene& scene, Reader& reader, const HandState& hand, ProxyState& state,
                      double dt) noexcept {
  StepReport report;
  if (dt > 0.0 && std::isfinite(dt)) state.time_ += dt;
  constexpr double kFarthest = 1e6;  // [m]: no hand is there; false for NaN as well
  bool good = hand.position.cwiseAbs().maxCoeff() < kFarthest && hand.position.allFinite() &&
              !state.faulted();
  if (good) {
    Tick tick(scene, reader, hand.position, state);
    tick.meetScene();
    const Vec3 before = state.proxy_ - hand.position;
    const Vec3 offset = tick.moveProxy(report, good);

    // Step 3, eq. (3). The proxy's motion may not add energy to the spring; what it adds is
    // counted.
    const double k = state.stiffness_.value;
    report.stiffness = k;
    const double rate = state.length_rate_.next(offset.norm(), dt);
    // Several moves give less than all at once would: docs/tick.md, Energy.
    const double at_once =
        k * (offset.dot(offset - before) - 0.5 * (offset - state.offset_).squaredNorm());
    report.injected = std::max(report.injected, at_once);
    state.offset_ = offset;
    if (good) {
      report.wanted = hand.drives * couplingForce({k, scene.coupling.damping}, offset, rate);
      assert(report.primitives > 0 || report.wanted.isZero(0.0));  // nothing there, nothing felt
      if (!hand.ready) report.wanted.setZero();
      report.moving =
          state.still_.pass(state.limiter_.letsOut(report.wanted.norm(), state.limits_.peak),
                            hand.still, state.limits_.friction, dt);
      report.wanted *= report.moving;
      // Braked along what its motors can push along: what drives it is all in there.
      const Vec3 along = hand.drives * hand.velocity;
      if (hand.too_fast && hand.ready && along.norm() > 0.0) {
        const double share = hand.velocity.norm() / along.norm();
        report.wanted = brake(report.wanted, share * along, hand.max_speed);
      }
      tick.stiffen(offset, k * offset.dot(before - offset), dt);
    }
  }
  report.proxy = state.proxy_;
  if (!good) report.wanted.setConstant(std::numeric_limits<double>::quiet_NaN());

  // The last gate. Nothing below changes the force.
  if (dt > 0.0 && report.injected > 0.0) {
    state.limiter_.tank.refill(std::min(report.injected, state.limits_.tank.refill * dt));
  }
  // A position that is no hand's, or not yet the arm's, is none to count energy by.
  if (!good || !hand.ready) state.limiter_.tank.forget();
  const LimitedForce out =
      limitForce(report.wanted, hand.position, dt, state.limits_, state.limiter_, hand.fresh);
  if (!out.finite) {
    state.cut(Fault::kNotFinite);
    report.status = StepStatus::kFault;
    report.wanted.setZero();
  }
  report.limited = out.limited();
  report.force = out.force;
  report.share = out.share;
  report.energy = state.limiter_.tank.energy();
  return report;
}

}  // namespace palpate
