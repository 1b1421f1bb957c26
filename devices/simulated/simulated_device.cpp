#include "palpate/devices/simulated/simulated_device.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include <Eigen/Geometry>

#include "palpate/devices/simulated/stability.h"
#include "palpate/engine/error.h"

namespace palpate {
namespace {

void require(bool good, const char* what, const char* remedy) {
  if (!good) throw DeviceError("simulated device", what, remedy);
}

/// Distance of the hand from the box's centre at the start and end of a visit, relative to the
/// radius of the box's ellipsoid in the hand's direction.
constexpr double kOutside = 1.25;

/// Position of the hand during a visit of one side: its distance from the box's centre and the
/// radius of its circle, both relative to the radius of the box's ellipsoid in the hand's
/// direction.
struct Visit {
  double distance, circle;
};

Visit visitAt(double u) {
  struct Key {
    double t;
    Visit visit;
  };
  constexpr std::array<Key, 9> kKeys{{{0.0, {kOutside, 0.0}},
                                      {0.15, {1.0, 0.0}},
                                      {0.25, {0.8, 0.0}},
                                      {0.3, {0.8, 0.15}},
                                      {0.6, {0.8, 0.15}},
                                      {0.65, {0.8, 0.0}},
                                      {0.8, {0.3, 0.0}},
                                      {0.87, {0.3, 0.0}},
                                      {1.0, {kOutside, 0.0}}}};
  std::size_t i = 0;
  while (i + 2 < kKeys.size() && kKeys[i + 1].t <= u) ++i;
  const Key& a = kKeys[i];
  const Key& b = kKeys[i + 1];
  const double share = std::clamp((u - a.t) / (b.t - a.t), 0.0, 1.0);
  const double smooth = share * share * (3.0 - 2.0 * share);
  return {a.visit.distance + smooth * (b.visit.distance - a.visit.distance),
          a.visit.circle + smooth * (b.visit.circle - a.visit.circle)};
}

}  // namespace

SimulatedDevice::SimulatedDevice(const ArmParams& arm, const GripParams& grip, HandTarget target,
                                 double rate)
    : arm_(arm), grip_(grip), target_(std::move(target)), rate_(rate) {
  const auto positive = [](double v) { return std::isfinite(v) && v > 0.0; };
  const auto not_negative = [](double v) { return std::isfinite(v) && v >= 0.0; };
  require(positive(arm.mass), "the mass is not a finite number above 0", "give kg, such as 0.1");
  require(not_negative(arm.viscous), "the arm's viscous friction is negative or not finite",
          "give N s/m, such as 0.5");
  require(not_negative(arm.coulomb), "the arm's Coulomb friction is negative or not finite",
          "give N, such as 0.02");
  require(not_negative(arm.encoder), "the encoder's step is negative or not finite",
          "give metres, such as 1e-5");
  require(not_negative(grip.stiffness), "the grip's stiffness is negative or not finite",
          "give N/m, such as 300");
  require(not_negative(grip.damping), "the grip's damping is negative or not finite",
          "give N s/m, such as 5");
  require(not_negative(arm.delay) && arm.delay <= 0.1, "the delay is not 0 to 0.1 s",
          "give seconds, such as 0.001");
  require(not_negative(arm.lag) && arm.lag <= 0.1, "the amplifiers' lag is not 0 to 0.1 s",
          "give seconds, such as 0.0002");
  require(positive(rate), "the rate is not a finite number above 0", "give Hz, such as 1000");
  require(target_.at != nullptr, "the hand has no target", "set HandTarget::at");
  require(not_negative(target_.seconds),
          "the duration of the hand's target is negative or not finite", "give seconds, such as 5");

  info_.name = "simulated";
  info_.hand = arm.hand;
  info_.watch.late = arm.late;
  info_.limits = {7.9, 2000.0};
  info_.max_stiffness = 1000.0;
  info_.mass = arm.mass;
  if (arm.viscous > 0.0) {
    info_.limits.tank.use = arm.tank;
    info_.limits.tank.refill = arm.refill;
    // The readings of all three axes are rounded, each with an error of up to half a step.
    ArmDissipation& known = info_.limits.tank.arm;
    known.viscous = arm.viscous;
    known.coulomb = arm.coulomb;
    known.step = std::sqrt(3.0) * arm.encoder;
    known.delay = arm.delay;
    known.lag = arm.lag;
  }
  info_.source =
      "as a Phantom Desktop: 7.9 N, 1000 N/m (CHAI3D 3.3.0); slew: engine/safety/limit_force.h";
  position_ = aim_ = target_.at(0.0);

  // A force acts `delay` after its reading. The oldest force that can still act was written `whole
  // + 1` ticks ago.
  const DelayInPeriods delay = inPeriods(arm.delay, rate);
  queue_.assign(static_cast<std::size_t>(delay.whole) + 2, Vec3::Zero());
  early_ = propagator(delay.part / rate);
  late_ = propagator((1.0 - delay.part) / rate);
}

SimulatedDevice::Propagator SimulatedDevice::propagator(double time) const {
  // Solves x'' = -2 s x' - w2 x + f/m by its matrix exponential. With a spring of stiffness k the
  // arm comes to rest at f/k. Without a spring, uses the limit for k = 0.
  const double m = arm_.mass;
  const double s = (arm_.viscous + grip_.damping) / (2.0 * m);
  const double w2 = grip_.stiffness / m;
  const double d = w2 - s * s;
  // e^{-s t} cos(w t) and e^{-s t} sin(w t)/w, with w^2 = d. If the arm does not oscillate, their
  // limits for w = 0 or the same terms with cosh and sinh.
  const double e = std::exp(-s * time);
  double cosine = e;
  double sine = e * time;
  if (d > 1e-12) {
    cosine = e * std::cos(std::sqrt(d) * time);
    sine = e * std::sin(std::sqrt(d) * time) / std::sqrt(d);
  } else if (d < -1e-12) {
    const double r = std::sqrt(-d);  // at most s: neither exponent is positive
    const double slow = std::exp(-w2 / (s + r) * time);
    const double fast = std::exp(-(s + r) * time);
    cosine = 0.5 * (slow + fast);
    sine = 0.5 * (slow - fast) / r;
  }
  Propagator p{};
  p.time = time;
  p.xx = cosine + s * sine;
  p.xv = sine;
  p.vx = -w2 * sine;
  p.vv = cosine - s * sine;
  p.vf = p.xv / m;
  if (grip_.stiffness > 0.0) {
    p.xf = (1.0 - p.xx) / grip_.stiffness;
  } else if (s > 0.0) {
    p.xf = (time - p.xv) / (2.0 * s * m);
  } else {
    p.xf = 0.5 * time * time / m;
  }
  if (arm_.lag > 0.0) {
    const AxisStep step = axisStep(arm_, grip_, time);
    p.xa = step(0, 2);
    p.va = step(1, 2);
    p.aa = step(2, 2);
    p.au = step(2, 3);
    p.xu = step(0, 3);
    p.vu = step(1, 3);
  }
  return p;
}

void SimulatedDevice::advance(const Propagator& step, const Vec3& order,
                              const Vec3& pull) noexcept {
  if (step.time <= 0.0) return;
  const bool lags = arm_.lag > 0.0;
  const Vec3 force = lags ? pull : Vec3(order + pull);
  Vec3 x = step.xx * position_ + step.xv * velocity_ + step.xf * force;
  velocity_ = step.vx * position_ + step.vv * velocity_ + step.vf * force;
  if (lags) {
    x += step.xa * amplifier_ + step.xu * order;
    velocity_ += step.va * amplifier_ + step.vu * order;
    amplifier_ = step.aa * amplifier_ + step.au * order;
  }
  position_ = x;
  // Coulomb friction opposes the motion, and at most stops the arm.
  const double speed = velocity_.norm();
  if (speed <= 0.0) return;
  const Vec3 direction = velocity_ / speed;
  const double stops = speed / step.vf;
  const double friction = std::min(arm_.coulomb, stops);
  position_ -= step.xf * friction * direction;
  velocity_ = friction < stops ? Vec3(velocity_ - step.vf * friction * direction) : Vec3::Zero();
}

HandState SimulatedDevice::read() noexcept {
  if (arm_.encoder <= 0.0) return {position_};
  return {(position_ / arm_.encoder).array().round().matrix() * arm_.encoder};
}

void SimulatedDevice::write(const Vec3& force) noexcept {
  // `pull`: the part of the hand's force from its target. The propagator contains the other part.
  const double t = static_cast<double>(tick_) / rate_;
  const Vec3 before = std::exchange(aim_, target_.at(t));
  const Vec3 pull = grip_.stiffness * aim_ + grip_.damping * rate_ * (aim_ - before);

  // The older force was written `whole + 1` ticks ago. It acts for the fractional part of the
  // delay, then the newer force acts.
  queue_[next_] = force;
  const std::size_t size = queue_.size();
  const Vec3& older = queue_[(next_ + 1) % size];
  const Vec3& newer = queue_[(next_ + 2) % size];
  advance(early_, older, pull);
  advance(late_, newer, pull);
  next_ = (next_ + 1) % size;
  ++tick_;
}

bool SimulatedDevice::ended() const noexcept {
  return static_cast<double>(tick_) / rate_ > target_.seconds + 0.5 / rate_;
}

HandTarget explore(const Box& bounds, double seconds) {
  constexpr double kVisit = 5.0;  // [s] for one side
  // Share of the visit in which the hand moves around the box from the previous side.
  constexpr double kRound = 0.2;
  const int visits = std::max(1, static_cast<int>(std::lround(seconds / kVisit)));
  const double length = seconds / visits;
  const Vec3 centre = bounds.centre();
  const Vec3 half = (0.5 * bounds.size()).cwiseMax(1e-6);
  const auto at = [=](double t) -> Vec3 {
    const std::array<Vec3, 5> sides{Vec3(0.0, 1.0, 0.2), Vec3(0.7, 0.5, 0.4), Vec3(0.1, 0.3, 1.0),
                                    Vec3(-0.8, 0.4, 0.3), Vec3(0.3, -0.9, 0.2)};
    const int visit = std::clamp(static_cast<int>(t / length), 0, visits - 1);
    const double u = std::clamp(t / length - visit, 0.0, 1.0);
    const auto side = [&](int n) {
      return Vec3(sides[static_cast<std::size_t>(n) % sides.size()].normalized());
    };
    // Radius of the box's ellipsoid in direction `out`.
    const auto radius = [&](const Vec3& out) { return 1.0 / out.cwiseQuotient(half).norm(); };

    // First the hand moves around the outside from the previous side, along a great circle.
    if (visit > 0 && u < kRound) {
      const Vec3 from = side(visit - 1);
      const Vec3 to = side(visit);
      const double share = u / kRound;
      const double angle = share * share * (3.0 - 2.0 * share) * std::acos(from.dot(to));
      const Vec3 across = (to - from.dot(to) * from).normalized();
      const Vec3 out = std::cos(angle) * from + std::sin(angle) * across;
      return centre + kOutside * radius(out) * out;
    }
    const double v = visit > 0 ? (u - kRound) / (1.0 - kRound) : u;
    const Vec3 out = side(visit);
    const Vec3 across = out.unitOrthogonal();
    const Visit now = visitAt(v);
    const double angle = 4.0 * M_PI * (v - 0.3) / 0.3;
    return centre +
           radius(out) * (now.distance * out + now.circle * (std::cos(angle) * across +
                                                             std::sin(angle) * out.cross(across)));
  };
  return {at, seconds};
}

HandTarget alongPath(std::vector<PathPoint> path) {
  const double start = path.front().t;
  const double seconds = path.back().t - start;
  return {[path = std::move(path), start, hint = std::size_t{0}](double t) mutable {
            return positionAt(path, start + t, hint);
          },
          seconds};
}

}  // namespace palpate
