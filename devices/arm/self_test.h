/// Tests with small forces whether an arm goes where it is pushed, and measures its friction.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "palpate/engine/safety/device.h"
#include "palpate/engine/types.h"

namespace palpate {

/// The axes of the hand's world, turned by the smallest rotation into the directions in which the
/// arm can move.
struct ArmAxes {
  Mat3 along = Mat3::Identity();              ///< Columns: x, y, z; orthonormal.
  std::array<bool, 3> has{true, true, true};  ///< False: the arm cannot move along it.
  /// Returns a name such as "x"; for a turned axis with its direction.
  [[nodiscard]] std::string name(int axis) const;
};
/// Returns the axes of the directions that a projector keeps (ProfileFacts::moves,
/// HandState::drives).
[[nodiscard]] ArmAxes axesWithin(const Mat3& projector);

/// Axes, forces and distances of a test, and limits for the arm's reports.
struct SelfTestParams {
  ArmAxes axes;              ///< Axes along which the arm is pushed.
  double force = 0.5;        ///< Largest force [N].
  double travel = 0.04;      ///< Largest distance from the start [m]; a larger one ends the test.
  Vec3 down = Vec3::Zero();  ///< Direction in which its masses fall, a unit vector; zero: unknown.
  double input_rate = 0.0;   ///< Expected positions per second; 0: not judged.
  double stale = 0.0;        ///< Longest allowed pause between two positions [s]; 0: not judged.
};

/// Results along one of ArmAxes.
struct AxisResult {
  bool driven = false;     ///< The arm has a motor there; if not, the fields below are not set.
  bool moved = false;      ///< The arm moved within the largest force.
  double breakaway = 0.0;  ///< [N], the force at which it began to move, mean of both directions.
  double along = 0.0;      ///< Cosine between push and motion, the worse of both directions;
                           ///< 1: aligned.
  double mass = 0.0;       ///< m [kg] of m v' = F - b v - c sign(v) + bias.
  double viscous = 0.0;    ///< b [N s/m].
  double coulomb = 0.0;    ///< c [N].
  double bias = 0.0;       ///< bias [N]: gravity, a spring.
  double delay = 0.0;      ///< Delay from a position to the force that follows from it [s].
  double viscous_error = 0.0;  ///< Standard error of b [N s/m].
  double coulomb_error = 0.0;  ///< Standard error of c [N].
  double delay_error = 0.0;    ///< Standard error of the delay [s]. All three assume residuals that
                               ///< are independent from row to row: they are too low, so use three
                               ///< standard errors or more.
  bool fitted = false;         ///< The fit has finite numbers and a mass > 0.
};

/// Results of a test. The arm has passed if there are no problems.
struct SelfTestResult {
  std::array<AxisResult, 3> axes;  ///< Along the columns of SelfTestParams::axes.
  /// The path that the arm reports, divided by the path that the user measured along the axis; 0:
  /// not measured.
  std::array<double, 3> scale{};
  Vec3 falls = Vec3::Zero();  ///< Direction in which the released arm goes by itself, a unit
                              ///< vector; zero: it stays.
  double weight = 0.0;        ///< Force that moves it there [N]; 0: unknown.
  bool held = false;   ///< The arm could be held. If not, `weight` is what friction does not hold.
  double noise = 0.0;  ///< Noise of the position at rest, rms [m].
  double slowest = 0.0;               ///< Longest pause between new positions [s].
  std::int64_t positions = 0;         ///< New positions.
  double seconds = 0.0;               ///< Duration of the test [s].
  std::vector<std::string> problems;  ///< Problems with remedies, as text; empty: passed.
};

/// A test that returns the force that it wants, in each tick. Pure: no clock, no device.
///
/// The user has two seconds to let go of the arm, and the arm must rest for one second. If the arm
/// falls, the test pushes it back, which gives its weight, and ends. Otherwise the test pushes
/// along +x, -x, +y, ... in turn, if the arm has motors there. Each push grows by 0.4 N/s until the
/// arm moves by 2 mm. The largest force then holds until 12 mm, and opposes the motion until the
/// arm stands. If the arm is known to go where it is pushed, a weak spring brings it back. The
/// friction is a least-squares fit of m v' = F - b v - c sign(v) + bias, integrated twice, to all
/// samples in motion, with the delay of F that fits best. RT: next() does not allocate.
class SelfTest {
 public:
  explicit SelfTest(const SelfTestParams& params = {});  ///< Allocates what next() fills.

  /// Returns the force wanted; zero when the test is done. `hand`: position and its age; `now` [s],
  /// ascending; `sent`: the force that limitForce let through after the previous call [N]. The fit
  /// finds the time at which it acted.
  [[nodiscard]] Vec3 next(const HandState& hand, double now, const Vec3& sent) noexcept;
  [[nodiscard]] bool done() const noexcept { return phase_ == Phase::kDone; }  ///< No more force.
  [[nodiscard]] bool begun() const noexcept { return started_; }  ///< next() was called.
  /// Returns the result after done(). Fits every axis for about sixty delays: not in a tick.
  [[nodiscard]] SelfTestResult result() const;

 private:
  enum class Phase : std::uint8_t { kRest, kCatch, kRamp, kPush, kOppose, kSettle, kReturn, kDone };
  struct Sample {
    double time;
    Vec3 position, force;
    std::int8_t run;  ///< Number of its push.
  };
  /// One path of the arm: all points of one push.
  struct Way {
    /// One tick of the path.
    struct Point {
      double time,   ///< Since the test began [s].
          position,  ///< From SelfTest::home_, along the path [m].
          force;     ///< Force that was sent, along the path [N].
    };
    std::vector<Point> path;
    std::size_t start = 0;  ///< Index from which the arm moves by itself.
  };
  [[nodiscard]] Vec3 axis() const noexcept;
  /// Returns the pushes along an axis, in both directions.
  [[nodiscard]] std::vector<Way> pushes(int axis) const;
  [[nodiscard]] std::vector<Way> fall() const;
  void enter(Phase phase) noexcept;
  void nextRun() noexcept;
  /// Returns the time since the phase began [s].
  [[nodiscard]] double inPhase() const noexcept { return now_ - entered_; }
  /// Counts the position if it is new, and measures the pause before it.
  void countPosition(double age) noexcept;
  /// Keeps this tick for the fit, if the phase is one that is fitted.
  void recordSample(const Vec3& sent) noexcept;
  /// Returns the force of the present phase, and enters the next one when it is over.
  Vec3 runPhase() noexcept;
  // The phases: kRest, kCatch, kRamp, kPush, kOppose, kSettle, kReturn.
  void awaitRest() noexcept;
  Vec3 catchFall() noexcept;
  Vec3 raiseForce() noexcept;
  Vec3 holdForce() noexcept;
  Vec3 opposeMotion() noexcept;
  void awaitStandstill() noexcept;
  Vec3 pullHome() noexcept;
  /// Residuals of a fit.
  struct Left {
    double square = 0.0;  ///< Sum of squares over all rows.
    long freedom = 0;     ///< Rows minus unknowns; 0: too few rows.
  };
  /// Fits with the force delayed by `late` samples, which need not be whole; fills in `result`.
  /// Takes one or two paths.
  Left fit(const std::vector<Way>& ways, double late, AxisResult& result) const;
  /// Fits with the delay of the force that leaves the smallest residuals.
  void fitDelay(const std::vector<Way>& ways, AxisResult& result) const;
  /// Returns the problem of an arm that falls, as text; fills in SelfTestResult::weight.
  [[nodiscard]] std::string weigh(SelfTestResult& result) const;
  /// Returns the mean period of the ticks [s].
  [[nodiscard]] double period() const noexcept {
    return (now_ - began_) / static_cast<double>(ticks_);
  }
  /// Reports positions that come too seldom, or after too long a pause.
  void checkReadings(SelfTestResult& result) const;
  /// Fills in the result of axis `a`, and reports its problems.
  void judgeAxis(int a, SelfTestResult& result) const;
  /// Reports a push that moved the arm elsewhere. `where`: direction of the push, as text.
  void checkDirection(std::size_t run, const std::string& where, SelfTestResult& result) const;
  /// Returns the problem of a fit, as text; empty: none.
  [[nodiscard]] std::string fitTrouble(const AxisResult& axis) const;

  SelfTestParams params_;
  Phase phase_ = Phase::kRest;
  int run_ = 0;  ///< 0 to 5: +x, -x, +y, ...
  bool started_ = false;
  double entered_ = 0.0;
  double began_ = 0.0;
  double now_ = 0.0;  ///< Time of the last tick [s].
  std::int64_t ticks_ = 0;
  Vec3 home_ = Vec3::Zero();
  Vec3 falls_ = Vec3::Zero();  ///< SelfTestResult::falls.
  double still_since_ = 0.0;   ///< [s]
  bool caught_ = false;        ///< The falling arm came to rest, or back.
  Vec3 from_ = Vec3::Zero();
  Vec3 position_ = Vec3::Zero();  ///< In the last tick [m].
  Vec3 velocity_ = Vec3::Zero();
  double level_ = 0.0;  ///< Force of the push [N].
  bool trusted_ = true;
  bool far_ = false;
  std::array<double, 6> breakaway_{};  ///< 0: did not move.
  std::array<bool, 6> went_{};
  std::array<double, 6> along_{};
  std::vector<Sample> samples_;
  // At rest.
  Vec3 sum_ = Vec3::Zero();
  double sum2_ = 0.0;
  std::int64_t rest_ = 0;
  double read_at_ = 0.0;
  double fresh_at_ = 0.0;
  double slowest_ = 0.0;
  std::int64_t positions_ = 0;
};

/// Compares the path `way` [m] that the arm reports with the distance `length` by which a hand has
/// moved its tip along the axis. Returns the problem as text; empty: a hand with a ruler would not
/// find one. The pushes do not find wrong encoders or geometry: the arm still goes where it is
/// pushed, but feels as many times stiffer than it should. If signs are wrong twice, of encoders
/// and of motors, the arm shows a mirrored world.
[[nodiscard]] std::string rulerTrouble(const Vec3& way, double length, const ArmAxes& axes,
                                       int axis);

}  // namespace palpate
