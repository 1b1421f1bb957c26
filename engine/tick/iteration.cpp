#include "palpate/engine/tick/iteration.h"

#include <algorithm>
#include <limits>
#include <optional>

#include "palpate/engine/balance/newton.h"
#include "palpate/engine/tick/seams.h"

namespace palpate {
namespace {

constexpr double kUnknown = std::numeric_limits<double>::infinity();
/// A balance gets at least this number of iterations, even near the tick's limit, unless
/// SolverParams::max_iterations is smaller.
constexpr int kLeastIterations = 70;
/// A step up to this share of the distance between the last two readings shows fast convergence.
constexpr double kFalls = 0.25;
/// Share of the tolerance that may remain after a step that kFalls accepts.
constexpr double kRest = 0.5;
/// Share of the tolerance by which the final place may be off a surface without a reading there.
constexpr double kSure = 0.25;

/// Adds the line of a stream whose curve was traced.
void placeLine(Tick& tick, const RailLine& on, ModeMemory& memory) noexcept {
  memory.emitted = tick.balance.primitives.tryAdd(on.line()) ? 1 : 0;
  if (memory.emitted == 0) worsen(tick.report, StepStatus::kDropped);
}

/// Returns true if the primitives of the last balance are also those of this slice until its first
/// reading, except for the place of the proxy. This requires that only the hand has moved
/// (Proxy::arrived), and that no surface has yielded or lost its load.
bool primitivesStay(const Tick& tick) noexcept {
  if (!tick.proxy.arrived || !tick.scene.graph.by_reading) return false;
  return !anySurface(tick.felt(),
                     [](const Mode& mode, ModeMemory& memory, const Felt&, std::size_t) {
                       const Contact& contact = *touchOf(mode, memory).contact;
                       return contact.plane >= 0 && contact.load != Load::kHeld;
                     });
}

/// Places the primitives of the last balance at the present proxy.
void keepPrimitives(Tick& tick, Iteration& now) noexcept {
  PrimitiveSet& primitives = tick.balance.primitives;
  const Vec3& proxy = tick.proxy.position;
  for (std::size_t i = 0; i < primitives.size(); ++i) {
    if (primitives.items()[i].kind != PrimitiveKind::kPlane) primitives.setPosition(i, proxy);
  }
  eachSurface(tick.felt(), [&](const Mode& mode, ModeMemory& memory, const Felt&, std::size_t) {
    const ContactReference touch = touchOf(mode, memory);
    if (touch.contact->plane < 0) return;
    now.voxel = std::min(now.voxel, touch.skin->voxel);
    tellTurn(*touch.contact, *touch.skin, proxy, true,
             primitives.varying()[static_cast<std::size_t>(touch.contact->varies)]);
  });
  tick.report.primitives = static_cast<int>(primitives.size());
}

void placePrimitives(Tick& tick, Iteration& now, bool foreseen) noexcept {
  if (foreseen && primitivesStay(tick)) return keepPrimitives(tick, now);
  BalanceMemory& balance = tick.balance;
  balance.primitives.clear();
  balance.surfaces = 0;
  now.voxel = std::numeric_limits<double>::infinity();
  now.follows = false;
  eachMode(tick.felt(), [&](const Mode& mode, ModeMemory& memory, const Felt& felt, std::size_t i) {
    if (const RailLine* on = now.rail.lineOf(memory); on != nullptr) {
      placeLine(tick, *on, memory);
      now.followed = std::min(now.followed, felt.graph().mode_voxels[i]);
      return;
    }
    const Body* body = tick.around.bodies.of(felt.graph().mode_motions[i]);
    const Vec3& p = body == nullptr ? tick.proxy.position : body->carried;
    const Pose* pose = body == nullptr ? nullptr : &body->pose;
    const Vec3& x = foreseen ? p : now.read_at;
    const ContactReference touch = touchOf(mode, memory);
    std::optional<Seam> seam;
    if (!foreseen && touch.skin != nullptr) seam = seamOf(tick, mode, memory, felt, x);
    const EvaluationPoint stand{p, x, tick.probe, pose, foreseen, seam ? &*seam : nullptr};
    const std::size_t before = balance.primitives.varying().size();
    if (!placeMode(felt, i, stand, touch, tick.around.bodies.items(), balance.primitives)) {
      worsen(tick.report, StepStatus::kDropped);
    }
    const std::span<Varying> varying = balance.primitives.varying();
    const bool varies = varying.size() > before;
    if (touch.skin == nullptr) {
      const double voxel = felt.graph().mode_voxels[i];
      const bool follows = felt.graph().mode_follows[i] != 0 && memory.emitted > 0;
      if (follows || varies) now.followed = std::min(now.followed, voxel);
      if (!varies) return;
      now.follows = true;
      now.voxel = std::min(now.voxel, voxel);
      return;
    }
    if (!varies) return;
    now.voxel = std::min(now.voxel, touch.skin->voxel);
    if (touch.contact->plane < 0) return;
    tellTurn(*touch.contact, *touch.skin, x, foreseen,
             varying[static_cast<std::size_t>(touch.contact->varies)]);
    ++balance.surfaces;
  });
  if (balance.surfaces == 0 && now.followed < kUnknown) {
    now.follows = true;
    now.voxel = std::min(now.voxel, now.followed);
  }
  tick.report.primitives = static_cast<int>(balance.primitives.size());
}

bool varies(const Tick& tick, const Iteration& now) noexcept {
  return now.follows || tick.balance.surfaces > 0;
}

/// Records a balance in the trace; without yielding modes if the balance failed (`balanced` is
/// false).
void tell(Tick& tick, const Iteration& now, bool foreseen, const Vec3& at,
          bool balanced = true) noexcept {
  StepTrace& trace = *tick.trace;
  if (trace.count == trace.all.size()) return;
  StepTrace::Step& step = trace.all[trace.count++];
  step = {};
  step.foreseen = foreseen;
  step.at = at;
  step.proxy = tick.proxy.position;
  step.balance = now.to.proxy;
  step.newton = now.to.step;
  if (!balanced) return;
  const auto primitives = tick.balance.primitives.items();
  std::size_t next = 0;
  const Felt& own = tick.felt()[0];
  for (std::size_t i = 0; i < own.graph().modes.size(); ++i) {
    const std::size_t end = next + static_cast<std::size_t>(own.memories[i].emitted);
    for (; next < end; ++next) {
      const bool holds = primitives[next].kind != PrimitiveKind::kForce;
      const Load load = loadOf(primitives[next], tick.balance.forces[next]);
      if (holds && load == Load::kYielding) step.yields.set(i);
    }
  }
}

void balanceNothing(Tick& tick, Iteration& now, bool foreseen, const Vec3& from) noexcept {
  BalanceMemory& b = tick.balance;
  b.warm.forget();
  b.friction.forget();
  tick.report.error_bound = 0.0;
  tick.report.solver = SolverKind::kClosedForm;
  eachSurface(tick.felt(), [](const Mode& mode, ModeMemory& memory, const Felt&, std::size_t) {
    readLoads(mode, {}, {}, memory);
  });
  now.to = {tick.probe, Vec3::Zero(), tick.probe - from, tick.probe, Vec3::Zero()};
  if (tick.trace != nullptr) tell(tick, now, foreseen, from);
}

}  // namespace

bool anchored(const BalanceMemory& b) noexcept {
  const auto varying = b.primitives.varying();
  const auto pushes = [&](const Varying& one) {
    return b.primitives.items()[one.index].kind == PrimitiveKind::kForce;
  };
  return b.surfaces == 0 && !varying.empty() &&
         std::none_of(varying.begin(), varying.end(), pushes);
}

void read(Tick& tick, Iteration& now, const Vec3& at) noexcept {
  ++tick.report.substeps;
  Bodies& bodies = tick.around.bodies;
  tick.report.samples += bodies.readAt(tick.scene.graph, at);
  keepRail(tick, at, now.rail);
  for (const Felt& felt : tick.felt()) {
    tick.report.samples += felt.bound.sample(at, *felt.properties, bodies.items());
    tick.report.coarse = tick.report.coarse || felt.properties->coarse;
  }
  now.last_read = now.read_at = at;
  now.read = true;
}

void initContacts(Tick& tick) noexcept {
  const Felt& felt = tick.felt()[0];
  Bodies& bodies = tick.around.bodies;
  Iteration now;
  now.read_at = tick.proxy.position;
  tick.report.samples += bodies.readAt(tick.scene.graph, now.read_at);
  bodies.stand(now.read_at);
  tick.report.samples += felt.bound.sample(now.read_at, *felt.properties, bodies.items());
  placePrimitives(tick, now, false);
  tick.proxy.beyond.setZero();
  tick.proxy.known = true;
}

bool balance(Tick& tick, Iteration& now, bool foreseen, const Vec3& from) noexcept {
  placePrimitives(tick, now, foreseen);
  BalanceMemory& b = tick.balance;
  if (b.primitives.size() == 0) {
    balanceNothing(tick, now, foreseen, from);
    return true;
  }
  // On a rail, `waiting` removes the pull along the stream, which is within the tolerance.
  const bool on_rail = now.rail.count > 0;
  const Vec3 probe = on_rail ? Vec3(tick.probe + now.rail.waiting) : tick.probe;
  SolverParams params = tick.scene.solver;
  const int left = tick.scene.step.max_iterations - tick.report.iterations;
  params.max_iterations = std::min(params.max_iterations, std::max(left, kLeastIterations));
  const SolveResult solved = solveWithFriction(
      probe, b.stiffness, b.primitives, tick.proxy.position, params, b.warm, b.friction, b.forces);
  if (solved.status == SolveStatus::kBadInput) {
    now.to = {from, Vec3::Zero(), Vec3::Zero(), from, Vec3::Zero()};
    if (tick.trace != nullptr) tell(tick, now, foreseen, from, false);
    return false;
  }
  if (solved.status == SolveStatus::kIterationLimit && !foreseen) {
    worsen(tick.report, StepStatus::kIterationLimit);
  }
  tick.report.iterations += solved.iterations;
  tick.report.error_bound = solved.error_bound;
  tick.report.solver = solved.solver;
  Balanced& to = now.to;
  to.found = solved.status != SolveStatus::kIterationLimit;
  to.proxy = solved.proxy;
  to.offset = on_rail ? Vec3(solved.proxy - tick.probe) : solved.offset;
  eachSurface(tick.felt(), [&](const Mode& mode, ModeMemory& memory, const Felt&, std::size_t) {
    readLoads(mode, b.primitives.items(), b.forces, memory);
  });
  const Vec3 residual = to.proxy - from;
  to.step = newtonStep(to.proxy, from, foreseen ? Vec3(from - tick.proxy.beyond) : from,
                       b.stiffness, b.primitives.items(), b.forces, b.primitives.varying());
  const Vec3 beyond = to.step - residual;
  to.target = to.proxy + beyond;
  to.target_offset = to.offset + beyond;
  if (tick.trace != nullptr) tell(tick, now, foreseen, from);
  return true;
}

void trust(const Tick& tick, Iteration& now, const Vec3& way, bool compared) noexcept {
  TrustRegion& trust = now.trust;
  Balanced& to = now.to;
  const double step = to.step.norm();
  const bool by_balance = anchored(tick.balance);
  if (!varies(tick, now)) {
    trust.forgetLeast();
  } else if (step < trust.least) {
    trust.least = step;
    trust.least_at = now.read_at;
    trust.least_target = by_balance ? to.proxy : to.target;
  }
  const bool free = varies(tick, now) && tick.balance.surfaces == 0;
  const double tolerance = tick.scene.step.tolerance_voxels * now.voxel;
  const bool back = compared && to.step.dot(way) < -0.25 * way.squaredNorm();
  if (back) {
    trust.radius = 0.5 * std::min(way.norm(), step);
    // The balance lies between two readings, because their steps point to each other.
    trust.ahead = free && trust.went > 0.0 ? way.norm() : kUnknown;
  } else {
    trust.radius *= 2.0;
    trust.ahead = trust.ahead > way.norm() ? trust.ahead - way.norm() : kUnknown;
  }
  // Without primitives the force is zero, so the step goes to the side that has primitives.
  const bool found = trust.ahead <= 2.0 * tolerance;
  const bool nothing = tick.balance.primitives.size() == 0;
  if (trust.ahead < kUnknown) trust.radius = (found && nothing ? 1.0 : 0.5) * trust.ahead;
  trust.went = way.norm();
  const double reach = reachOfStrengths(tick);
  const Vec3 offset = now.read_at - tick.probe;
  const double most = std::max(reach, trust.reach);
  trust.closed = step > tolerance && found && !nothing && offset.norm() <= most + tolerance;
  trust.reach = reach;
  if (trust.closed) {
    // The strengths limit the distance of the balance from the hand.
    const Vec3 held = offset.norm() > most ? Vec3(most / offset.norm() * offset) : offset;
    to.target = by_balance ? to.proxy : Vec3(tick.probe + held);
    to.target_offset = by_balance ? to.offset : held;
  }
}

bool onSurfaces(const Tick& tick, const Vec3& p, double within) noexcept {
  const auto off = [&](const Mode& mode, ModeMemory& memory, const Felt& felt, std::size_t) {
    const ContactReference touch = touchOf(mode, memory);
    if (touch.level == nullptr || touch.contact->plane < 0) return false;
    const Load load = touch.contact->load;
    if (load == Load::kYielding) return false;
    const auto field = static_cast<std::size_t>(touch.skin->field);
    const Body* body = tick.around.bodies.of(felt.graph().scalar_motions[field]);
    const double height =
        felt.bound.heightAt(*touch.skin, *touch.level, body == nullptr ? p : body->pose.toRest(p));
    return !((load == Load::kHeld ? std::abs(height) : -height) * touch.skin->voxel <= within);
  };
  return tick.balance.surfaces == 0 || !anySurface(tick.felt(), off);
}

bool steady(const Tick& tick, const Iteration& now) noexcept {
  const BalanceMemory& b = tick.balance;
  if (!varies(tick, now) || now.trust.closed) return true;
  const double tolerance = tick.scene.step.tolerance_voxels * now.voxel;
  // `waiting` is a shift that keeps the proxy on a curve, and not a part of the error.
  const double step = (now.to.step - now.rail.waiting).norm();
  double reach = reachOfStrengths(tick);
  for (const Varying& one : b.primitives.varying()) {
    reach += std::max(0.0, one.slope.dot(now.to.step)) / b.stiffness;
  }
  if (now.to.target_offset.norm() - reach > tolerance) return false;
  if (step <= tolerance) return !anchored(b) || (now.to.proxy - now.read_at).norm() <= tolerance;
  const double went = now.trust.went;
  if (now.follows || b.surfaces != b.primitives.size() || step > kFalls * went) return false;
  return step * step / went <= kRest * tolerance &&
         onSurfaces(tick, now.to.target, kRest * tolerance);
}

Vec3 answer(const Tick& tick, const Iteration& now) noexcept {
  const double tolerance = tick.scene.step.tolerance_voxels * now.voxel;
  const double residual = (now.to.proxy - now.read_at).norm();
  const auto sure = [&](const Vec3& p) { return onSurfaces(tick, p, kSure * tolerance); };
  if (!varies(tick, now) || now.trust.closed) return now.to.target;
  const double step = now.to.step.norm();
  // If only surfaces hold the proxy, Newton's target is the balance to second order. With G(x)
  // instead, the proxy of a resting hand would creep from tick to tick.
  const bool alone = !now.follows && tick.balance.surfaces == tick.balance.primitives.size();
  if (alone && step <= tolerance && sure(now.to.target)) return now.to.target;
  if (residual <= tolerance && sure(now.to.proxy)) return now.to.proxy;
  return step > tolerance || sure(now.to.target) ? now.to.target : now.read_at;
}

double reachOfStrengths(const Tick& tick) noexcept {
  double most = 0.0;
  for (const Primitive& primitive : tick.balance.primitives.items()) most += primitive.strength;
  return most / tick.balance.stiffness;
}

}  // namespace palpate
