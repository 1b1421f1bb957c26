/// Tests the limits of stability and passivity against independent simulations.
#include "palpate/devices/simulated/stability.h"

#include <algorithm>
#include <cmath>
#include <complex>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/engine/loop/haptic_loop.h"
#include "tests/support/random.h"
#include "tests/support/scenes.h"
#include "tests/support/thinned.h"

namespace palpate::stability_test {
using test::Random;

namespace {

ArmParams bare(double mass, double viscous, double delay = 0.0) {
  ArmParams arm;
  arm.mass = mass;
  arm.viscous = viscous;
  arm.coulomb = 0.0;
  arm.encoder = 0.0;
  arm.delay = delay;
  return arm;
}

constexpr GripParams kReleased{0.0, 0.0};

/// The motion of a damped oscillator between two events, in closed form.
class Oscillator {
 public:
  Oscillator(double m, double b, double k, double t) {
    const double s = b / (2.0 * m);
    const double w2 = k / m;
    if (k == 0.0) {
      const double gone = -std::expm1(-b * t / m);
      xx_ = 1.0;
      xv_ = b > 0.0 ? m / b * gone : t;
      vx_ = 0.0;
      vv_ = 1.0 - gone;
      xf_ = b > 0.0 ? (t - xv_) / b : t * t / (2.0 * m);
      vf_ = xv_ / m;
      return;
    }
    const double d = w2 - s * s;
    const double e = std::exp(-s * t);
    const double r = std::sqrt(std::abs(d));
    const double c = d > 0.0 ? std::cos(r * t) : std::cosh(r * t);
    const double n = d > 0.0 ? std::sin(r * t) / r : std::sinh(r * t) / r;
    xx_ = e * (c + s * n);
    xv_ = e * n;
    vx_ = -e * w2 * n;
    vv_ = e * (c - s * n);
    xf_ = (1.0 - xx_) / k;
    vf_ = -vx_ / k;
  }
  void pass(double& x, double& v, double f) const {
    const double next = xx_ * x + xv_ * v + xf_ * f;
    v = vx_ * x + vv_ * v + vf_ * f;
    x = next;
  }

 private:
  double xx_, xv_, vx_, vv_, xf_, vf_;
};

/// Returns the growth rate of the oscillation's envelope, by least squares. The loop is stable if
/// the rate is negative. The simulation advances from event to event and uses no eigenvalues.
double envelopeSlope(const ArmParams& arm, const GripParams& grip, double period, double stiffness,
                     double damping, int span, int swings) {
  const double ticks = arm.delay / period;
  const auto whole = static_cast<std::size_t>(std::floor(ticks + 1e-9));
  const double part = std::max(0.0, ticks - static_cast<double>(whole));
  const double b = arm.viscous + grip.damping;
  const Oscillator first(arm.mass, b, grip.stiffness, part * period);
  const Oscillator rest(arm.mass, b, grip.stiffness, (1.0 - part) * period);
  const double w = std::sqrt((stiffness + grip.stiffness) / arm.mass);
  const long window = 3 * std::max(4L, std::lround(std::ceil(2.0 * M_PI / (w * period))));
  const long samples = window * swings / 3;
  std::vector<double> orders(whole + 2, 0.0);
  std::size_t head = 0;
  double x = 1.0;
  double v = 0.0;
  std::vector<double> before(static_cast<std::size_t>(span), x);
  double scale = 0.0;
  double largest = 0.0;
  std::vector<double> envelope;
  for (long k = 0; k < samples; ++k) {
    double& then = before[static_cast<std::size_t>(k % span)];
    orders[head] = -(stiffness * x + damping * (x - then) / (span * period));
    then = x;
    const std::size_t n = orders.size();
    if (part > 0.0) first.pass(x, v, orders[(head + n - whole - 1) % n]);
    rest.pass(x, v, orders[(head + n - whole) % n]);
    head = (head + 1) % n;
    largest = std::max(largest, std::sqrt(stiffness * x * x + arm.mass * v * v));
    if ((k + 1) % window != 0) continue;
    envelope.push_back(std::log(largest) + scale);
    if (largest > 1e50 || largest < 1e-50) {
      for (double* value : {&x, &v}) *value /= largest;
      for (double& value : before) value /= largest;
      for (double& order : orders) order /= largest;
      scale += std::log(largest);
    }
    largest = 0.0;
  }
  double n = 0;
  double sx = 0;
  double sy = 0;
  double sxx = 0;
  double sxy = 0;
  for (std::size_t i = envelope.size() / 4; i < envelope.size(); ++i) {
    const auto at = static_cast<double>(i);
    n += 1;
    sx += at;
    sy += envelope[i];
    sxx += at * at;
    sxy += at * envelope[i];
  }
  return (n * sxy - sx * sy) / (n * sxx - sx * sx);
}

}  // namespace

TEST_CASE("the stability boundary from eigenvalues equals that of an event-by-event simulation",
          "[stability]") {
  Random random(7);
  long cases = 0;
  for (long tried = 0; cases < test::cases(250); ++tried) {
    const double period = std::vector<double>{1e-4, 2.5e-4, 5e-4, 1e-3, 2e-3, 4e-3}[tried % 6];
    ArmParams arm = bare(random.logUniform(0.05, 0.5), random.logUniform(0.02, 5.0));
    const double kind = random.uniform();
    if (kind > 0.2) arm.delay = random.uniform(0.0, 5.0) * period;
    if (kind > 0.2 && kind < 0.5) arm.delay = std::floor(arm.delay / period) * period;
    arm.delay = std::min(arm.delay, 5e-3);
    GripParams grip = kReleased;
    if (random.uniform() < 0.5) {
      grip = {random.logUniform(20.0, 1000.0), random.logUniform(0.5, 20.0)};
    }
    const double most = arm.mass / period / (0.5 + arm.delay / period);
    const double damping = random.uniform() < 0.3 ? 0.0 : random.logUniform(1e-3, 1.2) * 0.5 * most;
    const double back = tried % 2 == 0 ? kRateTime : 0.0;
    const int span = rateSpan(1.0 / period, back);
    const double boundary = stableStiffness(arm, grip, 1.0 / period, damping, back);
    if (boundary <= 0.0) continue;
    ++cases;
    CAPTURE(arm.mass, arm.viscous, period, arm.delay, grip.stiffness, grip.damping, damping, span,
            boundary);
    REQUIRE(envelopeSlope(arm, grip, period, 0.995 * boundary, damping, span, 60) < 0.0);
    REQUIRE(envelopeSlope(arm, grip, period, 1.005 * boundary, damping, span, 60) > 0.0);
    CHECK(growth(arm, grip, 1.0 / period, 0.999 * boundary, damping, back) < 1.0);
    CHECK(growth(arm, grip, 1.0 / period, 1.001 * boundary, damping, back) > 1.0);
  }
}

TEST_CASE("without hand and delay the stability boundary equals the closed form", "[stability]") {
  Random random(8);
  for (int i = 0; i < 100; ++i) {
    const double m = random.logUniform(0.05, 0.5);
    const double b = random.logUniform(0.02, 5.0);
    const double period = random.logUniform(1e-4, 4e-3);
    const double tau = m / b;
    const double e = std::exp(-period / tau);
    const double slow = b * (1.0 - e) / (tau * (1.0 - e) - e * period);
    const double fast = 2.0 * b * (1.0 + e) / (period * (1.0 + e) - 2.0 * tau * (1.0 - e));
    const double expected = fast > 0.0 ? std::min(slow, fast) : slow;
    CAPTURE(m, b, period);
    CHECK(stableStiffness(bare(m, b), kReleased, 1.0 / period) == Approx(expected).epsilon(1e-6));
    // In this case the coupling's damping is the only friction.
    const double beta = random.uniform(0.01, 0.8);
    const double damping = 2.0 * m * beta / period;
    CHECK(stableStiffness(bare(m, 0.0), kReleased, 1.0 / period, damping, 0.0) ==
          Approx(4.0 * m / (period * period) * beta * (1.0 - beta) / (1.0 + beta)).epsilon(1e-6));
  }
}

TEST_CASE("above the passive stiffness the worst-case motion of the hand gains energy",
          "[passivity]") {
  // Computes the energy at the port for positions x_n = z^n with |z| = 1, per |x_{n+1} - x_n|^2.
  // Between samples, the arm moves such that the hand gains most (docs/passivity.md, section 1).
  // Returns true if the hand gains energy for some z.
  const auto gains = [](double k, double b, double period, int whole, double part,
                        double damping = 0.0, int span = 1) {
    double least = 1e9;
    for (int i = 1; i <= 4000; ++i) {
      const double w = M_PI * std::pow(10.0, -4.0 * (1.0 - i / 4000.0));
      const std::complex<double> z = std::polar(1.0, w);
      const auto wall = k + damping / (span * period) * (1.0 - std::pow(z, -span));
      const auto force = wall * std::pow(z, -whole) * (1.0 - part + part / z) / (z - 1.0);
      const double jumps = part * (1.0 - part) * period * std::norm(wall) / (4.0 * b);
      least = std::min(least, force.real() + b / period - jumps);
    }
    return least < 0.0;
  };
  Random random(9);
  for (int i = 0; i < 60; ++i) {
    const double b = random.logUniform(0.05, 5.0);
    const double period = random.logUniform(1e-4, 4e-3);
    const int whole = i % 4;
    const double part = i % 3 == 0 ? 0.0 : random.uniform();
    const ArmParams arm = bare(0.1, b, (whole + part) * period);
    const double k = passiveStiffness(arm, 1.0 / period);
    CAPTURE(b, period, whole, part, k);
    CHECK_FALSE(gains(k * (1.0 - 1e-4), b, period, whole, part));
    CHECK(gains(k * (1.0 + 1e-4), b, period, whole, part));
    // The coupling's damping reduces the usable friction of the arm by the same amount. The number
    // of periods over which the damper measures velocity has no effect.
    const double damping = 0.3 * b;
    const double damped = passiveStiffness(arm, 1.0 / period, damping);
    CHECK(damped < k);
    for (const int span : {1, 2, 5, 20}) {
      CAPTURE(span);
      CHECK_FALSE(gains(damped * (1.0 - 1e-4), b, period, whole, part, damping, span));
    }
    CHECK(passiveStiffness(arm, 1.0 / period, b) == 0.0);
  }
  // The bounds of Abbott and Okamura: 2 b / T and 2 c / D. b is viscous friction, c Coulomb
  // friction, T the period and D the encoder step.
  ArmParams arm = bare(0.1, 0.5);
  arm.coulomb = 0.02;
  arm.encoder = 1e-5;
  CHECK(passiveStiffness(arm, 1000.0) == Approx(1000.0));
  CHECK(quietStiffness(arm, 1000.0) == Approx(4000.0));
  arm.encoder = 0.0;
  CHECK(std::isinf(quietStiffness(arm, 1000.0)));
}

TEST_CASE("an axis with a lagging amplifier moves as its differential equation predicts",
          "[stability]") {
  // Compares with a Runge-Kutta integration in ten thousand steps.
  Random random(10);
  for (int i = 0; i < 20; ++i) {
    ArmParams arm = bare(random.logUniform(0.05, 0.5), random.logUniform(0.02, 5.0));
    arm.lag = random.logUniform(5e-5, 5e-3);
    const GripParams grip{random.uniform(0.0, 500.0), random.uniform(0.0, 10.0)};
    const double time = random.logUniform(1e-4, 4e-3);
    const double order = random.uniform(-5.0, 5.0);
    using State = Eigen::Vector3d;
    const auto rate = [&](const State& y) {
      return State(y[1],
                   (y[2] - grip.stiffness * y[0] - (arm.viscous + grip.damping) * y[1]) / arm.mass,
                   (order - y[2]) / arm.lag);
    };
    State y(random.uniform(-1e-3, 1e-3), random.uniform(-0.1, 0.1), random.uniform(-5.0, 5.0));
    const Eigen::Vector4d from(y[0], y[1], y[2], order);
    constexpr int kSteps = 10000;
    const double h = time / kSteps;
    for (int n = 0; n < kSteps; ++n) {
      const State a = rate(y);
      const State b = rate(y + 0.5 * h * a);
      const State c = rate(y + 0.5 * h * b);
      const State d = rate(y + h * c);
      y += h / 6.0 * (a + 2.0 * b + 2.0 * c + d);
    }
    const State exact = axisStep(arm, grip, time) * from;
    CHECK((exact - y).cwiseQuotient(State(1e-3, 0.1, 5.0)).norm() < 1e-9);
  }
  // A simulated device with a tiny lag must agree with one without lag.
  const auto swing = [](double lag) {
    ArmParams arm = bare(0.1, 0.5, 1.5e-3);
    arm.lag = lag;
    SimulatedDevice device(arm, {100.0, 1.0}, {[](double) { return Vec3(1e-3, 0, 0); }, 10.0},
                           1000.0);
    for (int n = 0; n < 200; ++n) device.write({std::sin(0.1 * n), 0.5, 0});
    return device.position();
  };
  CHECK((swing(1e-9) - swing(0.0)).norm() < 1e-9);
  CHECK((swing(1e-3) - swing(0.0)).norm() > 1e-7);
}

TEST_CASE("beyond the stability boundary Coulomb friction stops only small oscillations",
          "[stability]") {
  ArmParams arm = bare(0.1, 0.5);
  arm.coulomb = 0.1;
  const double boundary = stableStiffness(arm, kReleased, 1000.0);
  for (const double more : {1.5, 3.0}) {
    const double k = more * boundary;
    const double most = holdingAmplitude(arm, 1000.0, k);
    const auto ends = [&](double start) {
      SimulatedDevice device(arm, kReleased, {[=](double) { return Vec3(start, 0, 0); }, 1e9},
                             1000.0);
      double last = start;
      for (int n = 0; n < 20000; ++n) {
        device.write(-k * device.read().position);
        last = std::max(0.999 * last, std::abs(device.position().x()));
        if (last > 10.0 * start) break;
      }
      return last / start;
    };
    CAPTURE(k, most);
    CHECK(ends(0.85 * most) < 0.5);
    CHECK(ends(1.15 * most) > 2.0);
  }
  CHECK(std::isinf(holdingAmplitude(arm, 1000.0, 0.5 * passiveStiffness(arm, 1000.0))));
}

TEST_CASE("the stability margin contains the rate and friction at which a coupling becomes passive",
          "[stability]") {
  ArmParams arm = bare(0.1, 0.5, 1e-3);
  arm.coulomb = 0.02;
  const CouplingRoom room = roomFor(arm, {300.0, 5.0}, 1000.0, 400.0, 0.0);
  CHECK(room.passive == Approx(0.5 / 1.5e-3));
  CHECK(room.stable > 2000.0);
  CHECK(room.amplitude > 0.0);
  REQUIRE(room.rate > 1000.0);
  CHECK(passiveStiffness(arm, room.rate) >= 400.0);
  CHECK(passiveStiffness(arm, 0.98 * room.rate) < 400.0);
  arm.viscous = room.viscous;
  CHECK(passiveStiffness(arm, 1000.0) == Approx(400.0).epsilon(1e-5));
  arm.viscous = 0.5;
  // The arm's delay can be too long for any rate.
  CHECK(roomFor(arm, {300.0, 5.0}, 1000.0, 600.0, 0.0).rate == 0.0);
}

namespace {

/// Returns a scene with an almost flat wall below z = 0, a ball of 100 m radius, and a coupling of
/// this stiffness [N/m].
std::shared_ptr<const Scene> wallScene(double stiffness) {
  const double radius = 100.0;
  return test::ballScene(makeSphere(Vec3(0, 0, -radius), radius), 50.0, {stiffness, 0.0});
}

struct Pressed {
  double early = 0.0;  ///< Amplitude about the resting position from 2.02 s to 2.2 s [m].
  double later = 0.0;  ///< Amplitude about the resting position after 3.5 s [m].
  double force = 0.0;  ///< Mean force that was sent [N].
  /// Share of ticks in which the tank reduced the force, or would have reduced it if active.
  double drained = 0.0;
};

/// Runs the whole loop. A hand slowly presses into the wall with `load` [N], and is displaced by
/// `kick` [m] for 20 ms at 2 s.
Pressed press(const ArmParams& arm, const GripParams& grip, double rate, double stiffness,
              double load, double kick) {
  const double depth = load / grip.stiffness + load / stiffness;
  const auto target = [=](double t) -> Vec3 {
    const double in = depth * std::min(1.0, t / 0.5);
    const double more = t > 2.0 && t < 2.02 ? kick : 0.0;
    return {0, 0, 0.001 - (0.001 + in) * std::min(1.0, t / 0.5) - more};
  };
  SimulatedDevice device(arm, grip, {target, 1e9}, rate);
  struct Sink final : TickSink {
    void take(const Telemetry& tick, const ProxyState&) noexcept override {
      drained += static_cast<long>(tick.report.share < 1.0);
      if (tick.time > 1.0) {
        force += tick.report.force.norm();
        ++ticks;
      }
    }
    long drained = 0;
    double force = 0.0;
    long ticks = 0;
  } sink;
  HapticLoop loop(device, rate, &sink);
  loop.publish(wallScene(stiffness));
  TickTime time;
  time.dt = 1.0 / rate;
  Pressed out;
  double rest = 0.0;
  const auto ticks = static_cast<long>(4.0 * rate);
  for (long i = 0; i < ticks; ++i) {
    time.now = static_cast<double>(i) / rate;
    loop.tick(time);
    const double z = device.position().z();
    if (time.now < 2.0) rest = z;
    const double swing = std::abs(z - rest);
    if (time.now > 2.02 && time.now < 2.2) out.early = std::max(out.early, swing);
    if (time.now > 3.5) out.later = std::max(out.later, swing);
  }
  out.force = sink.force / static_cast<double>(sink.ticks);
  out.drained = static_cast<double>(sink.drained) / static_cast<double>(ticks);
  return out;
}

}  // namespace

TEST_CASE("the whole loop on a wall is stable up to its stability boundary and not beyond",
          "[stability]") {
  const GripParams grip{200.0, 1.0};
  test::Thinned rates(3);
  for (const double rate : {1000.0, 4000.0, 10000.0}) {
    if (!rates.runs()) continue;
    for (const double delay : {0.0, 1.0, 1.5}) {
      const ArmParams arm = bare(0.1, 0.5, delay / rate);
      const double boundary = stableStiffness(arm, grip, rate);
      const Pressed below = press(arm, grip, rate, 0.98 * boundary, 1.0, 1e-6);
      const Pressed above = press(arm, grip, rate, 1.02 * boundary, 1.0, 1e-6);
      CAPTURE(rate, delay, boundary, below.early, below.later, above.early, above.later);
      CHECK(below.early > 1e-9);
      CHECK(below.later < below.early);
      CHECK(above.later > above.early);
    }
  }
}

TEST_CASE("the energy tank reduces the force of a passive wall by at most one percent",
          "[passivity]") {
  const GripParams grip{200.0, 1.0};
  test::Thinned rates(3);
  for (const double rate : {1000.0, 4000.0, 10000.0}) {
    if (!rates.runs()) continue;
    for (const double encoder : {1e-7, 1e-6, 1e-5}) {
      ArmParams arm = bare(0.1, 0.5, 1.0 / rate);
      // Without Coulomb friction, the arm may vibrate by one encoder step (quietStiffness).
      arm.coulomb = 0.02;
      arm.encoder = encoder;
      arm.tank = TankUse::kObserve;
      const double k = 0.95 * passiveStiffness(arm, rate);
      const Pressed seen = press(arm, grip, rate, k, 2.0, 1e-3);
      arm.tank = TankUse::kAct;
      const Pressed kept = press(arm, grip, rate, k, 2.0, 1e-3);
      const double lost = 1.0 - kept.force / seen.force;
      CAPTURE(rate, encoder, k, seen.force, kept.force, seen.drained, kept.drained);
      CHECK(std::abs(lost) <= 0.01);
      CHECK(seen.force > 1.5);
    }
  }
}

TEST_CASE("the stable stiffness is at least the passive one for random arms, hands and rates",
          "[stability]") {
  test::Random random(31);
  for (int i = 0; i < 60; ++i) {
    ArmParams arm;
    arm.mass = random.logUniform(1e-3, 1.0);
    arm.viscous = random.logUniform(0.01, 100.0);
    const double rate = random.logUniform(10.0, 10000.0);
    arm.delay = random.uniform(0.0, 3.0) / rate;
    const GripParams grip{random.logUniform(10.0, 3000.0), random.logUniform(0.1, 30.0)};
    const double passive = passiveStiffness(arm, rate);
    const double stable = stableStiffness(arm, grip, rate);
    CAPTURE(arm.mass, arm.viscous, rate, arm.delay, grip.stiffness, grip.damping);
    CHECK(stable >= passive);
    if (!std::isfinite(stable)) continue;
    CHECK(growth(arm, grip, rate, 0.999 * stable, 0.0) < 1.0);
    CHECK(growth(arm, grip, rate, 1.001 * stable, 0.0) > 1.0);
  }
}

TEST_CASE("the friction at which a coupling becomes passive is found for 500 N/m and for 100 kN/m",
          "[stability]") {
  ArmParams arm;
  arm.delay = 0.02;
  for (const double stiffness : {500.0, 1e5}) {
    const CouplingRoom room = roomFor(arm, {300.0, 5.0}, 1000.0, stiffness, 0.0);
    arm.viscous = room.viscous;
    CHECK(passiveStiffness(arm, 1000.0) == Approx(stiffness).epsilon(1e-4));
    arm.viscous = ArmParams{}.viscous;
  }
}

}  // namespace palpate::stability_test
