/// Finds out whether an arm goes where it is pushed, and what its friction is, with small forces.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "palpate/engine/device.h"
#include "palpate/engine/types.h"

namespace palpate {

/// The axes of the hand's world, turned by as little as brings them into what an arm can do.
struct ArmAxes {
  Mat3 along = Mat3::Identity();              ///< Columns: x, y, z; orthonormal.
  std::array<bool, 3> has{true, true, true};  ///< What it cannot do is not there.
  /// As "x", or with its direction where it is turned.
  [[nodiscard]] std::string name(int axis) const;
};
/// Of what a projector lets through (ProfileFacts::moves, HandState::drives).
[[nodiscard]] ArmAxes axesWithin(const Mat3& projector);

/// What an arm is to be pushed along, how hard and how far, and what its reports are held to.
struct SelfTestParams {
  ArmAxes axes;              ///< Those that it is pushed along.
  double force = 0.5;        ///< The largest [N].
  double travel = 0.04;      ///< The farthest from where it begins [m]; farther ends the test.
  Vec3 down = Vec3::Zero();  ///< Where its masses fall to, a unit vector; zero: nobody knows.
  double input_rate = 0.0;   ///< Positions a second that it is to have; 0: not judged.
  double stale = 0.0;        ///< The longest pause between two of them [s]; 0: not judged.
};

/// What was found along one of ArmAxes.
struct AxisResult {
  bool driven = false;     ///< It has a motor there; else all below is nothing.
  bool moved = false;      ///< Within the largest force.
  double breakaway = 0.0;  ///< [N], the mean of both ways: the force at which it began to move.
  double along = 0.0;      ///< Where it went: the cosine to where it was pushed, the worse of both
                           ///< ways. 1: there.
  double mass = 0.0;       ///< [kg], m of m v' = F - b v - c sign(v) + bias,
  double viscous = 0.0;    ///< b [N s/m],
  double coulomb = 0.0;    ///< c [N],
  double bias = 0.0;       ///< gravity, a spring [N],
  double delay = 0.0;      ///< and from a position to the force that follows from it [s];
  double viscous_error = 0.0;  ///< standard errors of b, c
  double coulomb_error = 0.0;  ///< [N s/m], [N],
  double delay_error = 0.0;  ///< and the delay [s], as if what is left were independent from row to
                             ///< row: low, so whoever relies on them takes three, and more.
  bool fitted = false;       ///< The fit has finite numbers and a mass > 0.
};

/// What a test has found of an arm, which has passed where there are no problems.
struct SelfTestResult {
  std::array<AxisResult, 3> axes;  ///< Along the columns of SelfTestParams::axes.
  /// What the arm says of a way that the user has measured along it, over that; 0: not measured.
  std::array<double, 3> scale{};
  Vec3 falls = Vec3::Zero();  ///< Let go of it goes there by itself, a unit vector; zero: it stays,
  double weight = 0.0;        ///< pushed by this [N]; 0: not known,
  bool held = false;     ///< and could be held: else it is what its friction does not hold of it.
  double noise = 0.0;    ///< Of the position at rest, rms [m].
  double slowest = 0.0;  ///< The longest pause between new positions [s].
  std::int64_t positions = 0;         ///< New ones, over
  double seconds = 0.0;               ///< [s].
  std::vector<std::string> problems;  ///< In words, with remedies; none: it has passed.
};

/// A test that is asked every tick what force it wants. Pure: no clock, no device.
///
/// Two seconds to let go of it, and at rest for one. If it falls it is pushed back, which tells its
/// weight, and that is the end. Then along +x, -x, +y, ... in turn, where it has motors: a force
/// that grows by 0.4 N/s until the arm moves by 2 mm, is held for 12 mm, then opposed until it
/// stands; then, where it is known to go where it is pushed, a weak spring brings it back. The
/// friction is a least-squares fit of m v' = F - b v - c sign(v) + bias, integrated twice, to all
/// that moved, for the delay of F that fits best. RT: next() takes no memory.
class SelfTest {
 public:
  explicit SelfTest(const SelfTestParams& params = {});  ///< Allocates what next() fills.

  /// The force wanted; zero when it is done. `hand`: position and its age; `now` [s],
  /// ascending; `sent`: what limitForce let through after the call before [N]; when it acted the
  /// fit finds.
  [[nodiscard]] Vec3 next(const HandState& hand, double now, const Vec3& sent) noexcept;
  [[nodiscard]] bool done() const noexcept { return phase_ == Phase::kDone; }  ///< No more force.
  [[nodiscard]] bool begun() const noexcept { return started_; }  ///< next() was called.
  /// When it is done. Fits every axis for some sixty delays: not in a tick.
  [[nodiscard]] SelfTestResult result() const;

 private:
  enum class Phase : std::uint8_t { kRest, kCatch, kRamp, kPush, kOppose, kSettle, kReturn, kDone };
  struct Sample {
    double time;
    Vec3 position, force;
    std::int8_t run;  ///< Which push it is of.
  };
  /// One way of the arm, all of one push.
  struct Way {
    /// A tick of it.
    struct Point {
      double time,   ///< Since the test began [s].
          position,  ///< From SelfTest::home_, along the way [m].
          force;     ///< What was sent, along the way [N].
    };
    std::vector<Point> path;
    std::size_t start = 0;  ///< Where it is the arm's own.
  };
  [[nodiscard]] Vec3 axis() const noexcept;
  /// Pushes along an axis, there and back.
  [[nodiscard]] std::vector<Way> pushes(int axis) const;
  [[nodiscard]] std::vector<Way> fall() const;
  void enter(Phase phase, double now) noexcept;
  void nextRun(double now) noexcept;
  /// What a fit leaves over.
  struct Left {
    double square = 0.0;  ///< Sum over rows,
    long freedom = 0;     ///< more than there are unknowns by so many; 0: too few.
  };
  /// With the force so many samples late, whole or parts of them; results by it. One or two ways.
  Left fit(const std::vector<Way>& ways, double late, AxisResult& result) const;
  /// With the force as late as leaves least.
  void fitDelay(const std::vector<Way>& ways, AxisResult& result) const;
  /// What is said of an arm that falls; fills in SelfTestResult::weight.
  [[nodiscard]] std::string weigh(SelfTestResult& result) const;
  /// Of the ticks, mean [s].
  [[nodiscard]] double period() const noexcept {
    return (last_ - began_) / static_cast<double>(ticks_);
  }

  SelfTestParams params_;
  Phase phase_ = Phase::kRest;
  int run_ = 0;  ///< 0 to 5: +x, -x, +y, ...
  bool started_ = false;
  double entered_ = 0.0;
  double began_ = 0.0;
  double last_ = 0.0;
  std::int64_t ticks_ = 0;
  Vec3 home_ = Vec3::Zero();
  Vec3 falls_ = Vec3::Zero();  ///< SelfTestResult::falls.
  double still_since_ = 0.0;   ///< [s]
  bool caught_ = false;        ///< It came to rest, or back.
  Vec3 from_ = Vec3::Zero();
  Vec3 before_ = Vec3::Zero();
  Vec3 velocity_ = Vec3::Zero();
  double level_ = 0.0;  ///< Of the push [N].
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

/// What is wrong with an arm whose tip has gone `way` [m] by its own account where a hand has moved
/// it by `length` along the axis, in words; empty: a hand with a ruler would not find it. An arm
/// whose encoders or geometry are wrong goes where it is pushed all the same, and feels as many
/// times stiffer than it should; one whose signs are wrong twice, of encoders and motors, shows a
/// mirrored world.
[[nodiscard]] std::string rulerTrouble(const Vec3& way, double length, const ArmAxes& axes,
                                       int axis);

}  // namespace palpate
