/// Tests with small forces whether an arm moves in their direction, and measures its friction, mass
/// and delay.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "palpate/engine/safety/device.h"
#include "palpate/engine/types.h"

namespace palpate {

/// The axes of W, rotated by the smallest angle into the directions in which the arm can move.
struct ArmAxes {
  /// Columns are the unit vectors of x, y, z; orthonormal.
  Mat3 along = Mat3::Identity();
  std::array<bool, 3> has{true, true, true};  ///< False: the arm cannot move along this axis.
  /// Returns the axis' name, such as "x". If the axis is turned by more than 2.6 degrees, the name
  /// includes its direction.
  [[nodiscard]] std::string name(int axis) const;
};
/// Returns axes within the directions onto which `projector` projects (ProfileFacts::moves or
/// HandState::drives).
[[nodiscard]] ArmAxes axesWithin(const Mat3& projector);

/// Axes, forces and distances of a test, and limits for the arm's reports.
struct SelfTestParams {
  ArmAxes axes;        ///< Axes along which the arm is pushed.
  double force = 0.5;  ///< Largest force [N].
  /// Distance from the place of rest at which the test ends [m]; before the arm has rested, the
  /// distance from the first position.
  double travel = 0.04;
  /// Direction of gravity in W, a unit vector; zero: unknown.
  Vec3 down = Vec3::Zero();
  double input_rate = 0.0;  ///< Expected positions per second [Hz]; 0: the rate is not checked.
  /// Longest allowed pause between two positions [s]; 0: pauses are not checked.
  double stale = 0.0;
};

/// Results along one axis of ArmAxes.
struct AxisResult {
  /// The arm has motors for this axis. If false, the fields below are not set.
  bool driven = false;
  /// The test has begun to push along this axis. If the arm falls or the test ends early, some axes
  /// are not pushed.
  bool pushed = false;
  bool moved = false;  ///< Both pushes, with at most SelfTestParams::force, moved the arm.
  /// Mean force of both pushes at which the arm began to move [N]; 0 for a push that did not move
  /// it.
  double breakaway = 0.0;
  /// Cosine of the angle between push and motion, for the worse direction; 1: aligned.
  double along = 0.0;
  // The fields below are set only if `moved` is true, and if every axis that moved was aligned with
  // its pushes.
  double mass = 0.0;           ///< m [kg] of m v' = F - b v - c sign(v) + bias.
  double viscous = 0.0;        ///< b [N s/m].
  double coulomb = 0.0;        ///< c [N].
  double bias = 0.0;           ///< bias [N], a constant force such as gravity or a spring.
  double delay = 0.0;          ///< Delay from a position to the force that follows from it [s].
  double viscous_error = 0.0;  ///< Standard error of b [N s/m].
  double coulomb_error = 0.0;  ///< Standard error of c [N].
  /// Standard error of the delay [s]. The standard errors assume independent residuals, so they are
  /// too small: multiply them by 3 or more.
  double delay_error = 0.0;
  bool fitted = false;  ///< The fit has finite numbers and a mass > 0.
};

/// Results of a test. The arm has passed if `problems` is empty.
struct SelfTestResult {
  std::array<AxisResult, 3> axes;  ///< Along the columns of SelfTestParams::axes.
  /// Reported path divided by the path that the user measured with a ruler; 0: not measured.
  std::array<double, 3> scale{};
  /// Direction in W in which the released arm moves by itself, a unit vector; zero: it stays.
  Vec3 falls = Vec3::Zero();
  /// Force that moves the released arm in that direction [N]; 0: unknown.
  double weight = 0.0;
  /// The test force could stop the falling arm. If false, `weight` is the arm's weight less its
  /// Coulomb friction.
  bool held = false;
  double noise = 0.0;                 ///< RMS noise of the position at rest [m].
  double slowest = 0.0;               ///< Longest pause between new positions [s].
  std::int64_t positions = 0;         ///< Number of new positions.
  double seconds = 0.0;               ///< Duration of the test [s].
  std::vector<std::string> problems;  ///< Problems with remedies, as text; empty: passed.
};

/// A test that computes, in each tick, the force to apply. Uses no clock and no device.
///
/// The user has 2 s to let go of the arm, and the arm must rest for 1 s; after 6 s the pushes begin
/// anyway. If the arm falls, the test pushes it back, computes its weight from this motion, and
/// ends. Otherwise the test pushes along +x, -x, +y, ... in turn, if the arm has motors there.
///
/// Each push grows by 0.4 N/s, at most to SelfTestParams::force, until the arm has moved by 2 mm.
/// If the arm has moved in the direction of all its pushes, the largest force then acts up to 12
/// mm, and is reversed until the arm stops. Each of these two steps takes at most 2 s. Then a weak
/// spring brings the arm back.
///
/// The friction comes from a least-squares fit of m v' = F - b v - c sign(v) + bias, integrated
/// twice, to all samples since the arm began to move. The fit uses the delay of F that leaves the
/// smallest error. RT: next() does not allocate.
class SelfTest {
 public:
  /// Allocates the memory that next() fills.
  explicit SelfTest(const SelfTestParams& params = {});

  /// Returns the force to apply in W [N]; zero when the test is done.
  ///
  /// @param hand  Position and its age.
  /// @param now   Time [s], ascending.
  /// @param sent  Force that limitForce permitted after the previous call [N].
  [[nodiscard]] Vec3 next(const HandState& hand, double now, const Vec3& sent) noexcept;
  /// Returns true if the test has ended and applies no more force.
  [[nodiscard]] bool done() const noexcept { return phase_ == Phase::kDone; }
  /// Returns true if next() was called at least once.
  [[nodiscard]] bool begun() const noexcept { return started_; }
  /// Returns the result. Before done() the result has a problem. Not for a tick: fits the motion
  /// along each axis about 80 times.
  [[nodiscard]] SelfTestResult result() const;

 private:
  enum class Phase : std::uint8_t { kRest, kCatch, kRamp, kPush, kOppose, kSettle, kReturn, kDone };
  struct Sample {
    double time;
    Vec3 position, force;
    std::int8_t run;
  };
  /// The recorded motion of one push, or of the fall before the pushes.
  struct Way {
    /// A position and a force.
    struct Point {
      double time;      ///< Time since the test began [s].
      double position;  ///< Distance from SelfTest::home_, along the path [m].
      double force;     ///< Force that was sent, along the path [N].
    };
    std::vector<Point> path;
    std::size_t start = 0;  ///< Earliest sample of the fit; earlier motion may be the hand's.
  };
  [[nodiscard]] Vec3 axis() const noexcept;
  [[nodiscard]] std::vector<Way> pushes(int axis) const;
  [[nodiscard]] std::vector<Way> fall() const;
  void enter(Phase phase) noexcept;
  void nextRun() noexcept;
  [[nodiscard]] double inPhase() const noexcept { return now_ - entered_; }
  void countPosition(double age) noexcept;
  void recordSample(const Vec3& sent) noexcept;
  Vec3 runPhase() noexcept;
  // One function per phase: kRest, kCatch, kRamp, kPush, kOppose, kSettle, kReturn.
  void awaitRest() noexcept;
  Vec3 catchFall() noexcept;
  Vec3 raiseForce() noexcept;
  Vec3 holdForce() noexcept;
  Vec3 opposeMotion() noexcept;
  void awaitStandstill() noexcept;
  Vec3 pullHome() noexcept;
  struct Left {
    double square = 0.0;
    long freedom = 0;  ///< Number of rows less the number of unknowns; 0: too few rows.
  };
  /// Fits one or two paths with the force delayed by `late` samples, which may be a fraction.
  Left fit(const std::vector<Way>& ways, double late, AxisResult& result) const;
  void fitDelay(const std::vector<Way>& ways, AxisResult& result) const;
  /// Sets SelfTestResult::weight and held. Returns the problem of an arm that falls, as text.
  [[nodiscard]] std::string weigh(SelfTestResult& result) const;
  [[nodiscard]] double period() const noexcept {
    return (now_ - began_) / static_cast<double>(ticks_);
  }
  void checkReadings(SelfTestResult& result) const;
  void judgeAxis(int a, SelfTestResult& result) const;
  /// `where`: direction of the push, as text.
  void checkDirection(std::size_t run, const std::string& where, SelfTestResult& result) const;
  /// Returns the problem of a fit as text; empty if the fit is good.
  [[nodiscard]] std::string fitTrouble(const AxisResult& axis) const;

  SelfTestParams params_;
  Phase phase_ = Phase::kRest;
  int run_ = 0;  ///< 0 to 5: +x, -x, +y, ...
  bool started_ = false;
  double entered_ = 0.0;
  double began_ = 0.0;
  double now_ = 0.0;
  std::int64_t ticks_ = 0;
  Vec3 home_ = Vec3::Zero();
  Vec3 falls_ = Vec3::Zero();
  double still_since_ = 0.0;
  bool caught_ = false;  ///< The falling arm came to rest or turned back.
  Vec3 from_ = Vec3::Zero();
  Vec3 position_ = Vec3::Zero();
  Vec3 velocity_ = Vec3::Zero();
  double level_ = 0.0;
  bool trusted_ = true;
  bool far_ = false;
  std::array<double, 6> breakaway_{};  ///< [N] per push; 0: the arm did not move.
  std::array<bool, 6> went_{};
  std::array<bool, 3> pushed_{};  ///< AxisResult::pushed, for each axis.
  std::array<double, 6> along_{};
  std::vector<Sample> samples_;
  // The next three members are sums over the positions at rest, in the phase kRest.
  Vec3 sum_ = Vec3::Zero();
  double sum2_ = 0.0;
  std::int64_t rest_ = 0;
  double read_at_ = 0.0;
  double fresh_at_ = 0.0;
  double slowest_ = 0.0;
  std::int64_t positions_ = 0;
};

/// Compares the path `way` [m] that the arm reports with the distance `length` [m] by which a user
/// has moved its tip along the axis. Returns the problem as text; empty if length and direction
/// agree to within a ruler's error. The pushes cannot detect a wrong scale, which would give a
/// wrong stiffness. They also cannot detect wrong signs of both encoders and motors, with which the
/// arm would render a mirrored world.
[[nodiscard]] std::string rulerTrouble(const Vec3& way, double length, const ArmAxes& axes,
                                       int axis);

}  // namespace palpate
