#include "palpate/devices/arm/self_test.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdio>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>

namespace palpate {

namespace {

constexpr double kLetGo = 2.0;  // [s] for the user to let go of the arm
constexpr double kRest = 1.0;   // [s] without motion before the first push
// [s]: the pushes start after this time even if the arm never rests.
constexpr double kUneasy = 6.0;
// [m]: an arm that moved farther is falling, because a hand that lets go moves it less.
constexpr double kFell = 0.01;
constexpr double kCaught = 1.0;    // [s]: longest time for which a falling arm is pushed back
constexpr double kGravity = 9.8;   // [m/s^2]
constexpr double kRamp = 0.4;      // [N/s], growth of a push
constexpr double kMoved = 0.002;   // [m]: an arm that moved farther has followed the push
constexpr double kBegun = 0.0003;  // [m]: smallest motion that exceeds encoder steps and trembling
constexpr double kPushed = 0.012;  // [m]: length of a push
constexpr double kLongest = 2.0;   // [s]: longest time of kPush, kOppose and kSettle
constexpr double kStill = 0.002;   // [m/s]: a slower arm counts as resting
constexpr double kBack = 1.5;      // [s] for the spring to bring the arm back
constexpr double kSpring = 15.0;   // [N/m], of the spring that brings the arm back
constexpr double kDamper = 1.5;    // [N s/m], of the damper parallel to this spring
constexpr double kSmooth = 0.01;   // [s]: time constant of the velocity filter
// Smallest accepted cosine of the angle between push and motion. At a larger angle the spring that
// brings the arm back could add energy.
constexpr double kStraight = 0.9;
constexpr double kLightest = 0.02;  // [kg], of a real arm; a smaller mass shows a wrong unit
constexpr double kHeaviest = 2.0;
constexpr double kAlike = 5.0;   // largest ratio between the masses along a real arm's axes
constexpr double kRuler = 0.1;   // largest relative error of a measurement with a ruler
constexpr double kAxis = 0.999;  // cosine of the largest turn at which an axis keeps its plain name
constexpr int kRuns = 6;
constexpr std::int8_t kFall = -1;  // `run` of samples before the pushes
constexpr int kLatest = 20;        // largest delay of the force that a fit tries [samples]
constexpr std::size_t kMostSamples = 60000;
const char* const kAxes = "xyz";

std::string inWords(double value) {
  std::array<char, 32> out{};
  std::snprintf(out.data(), out.size(), "%.3g", value);
  return out.data();
}

std::string inWords(const Vec3& v) {
  std::string words;
  for (int a = 0; a < 3; ++a) {
    words += (a == 0 ? "(" : ", ") + inWords(std::abs(v[a]) < 5e-4 ? 0.0 : v[a]);
  }
  return words + ")";
}

/// If `result` has no problem yet, adds one if the masses along the driven axes differ more than on
/// a real arm.
void compareMasses(SelfTestResult& result, const ArmAxes& axes) {
  const AxisResult* light = nullptr;
  const AxisResult* heavy = nullptr;
  for (const AxisResult& axis : result.axes) {
    if (!axis.driven) continue;
    if (light == nullptr || axis.mass < light->mass) light = &axis;
    if (heavy == nullptr || axis.mass > heavy->mass) heavy = &axis;
  }
  if (!result.problems.empty() || light == nullptr || !(heavy->mass > kAlike * light->mass)) return;
  const auto along = [&](const AxisResult* axis) {
    return inWords(axis->mass) + " kg along " +
           axes.name(static_cast<int>(axis - result.axes.data()));
  };
  result.problems.push_back("the measured mass is " + along(light) + " and " + along(heavy) +
                            ", a ratio above " + inWords(kAlike) +
                            ": correct the scale of a motor");
}

}  // namespace

std::string ArmAxes::name(int axis) const {
  std::string letter(1, kAxes[axis]);
  if (along(axis, axis) > kAxis) return letter;
  return letter + " " + inWords(along.col(axis));
}

ArmAxes axesWithin(const Mat3& projector) {
  const Eigen::SelfAdjointEigenSolver<Mat3> solver(projector);  // ascending: 0s, then 1s
  const auto rank = (solver.eigenvalues().array() > 0.5).count();
  ArmAxes axes;
  if (rank == 3) return axes;
  // `one` is the normal of a plane, or the direction of a line. The axes turn by the smallest angle
  // that brings the nearest axis onto `one`.
  Vec3 one = solver.eigenvectors().col(rank == 2 ? 0 : 2);
  Eigen::Index next = 0;
  one.cwiseAbs().maxCoeff(&next);
  if (one[next] < 0.0) one = -one;
  if (rank > 0) {
    axes.along = Eigen::Quaterniond::FromTwoVectors(Vec3::Unit(next), one).toRotationMatrix();
  }
  for (int a = 0; a < 3; ++a) {
    axes.has[static_cast<std::size_t>(a)] = rank == 2 ? a != next : rank == 1 && a == next;
  }
  return axes;
}

SelfTest::SelfTest(const SelfTestParams& params) : params_(params) {
  samples_.reserve(kMostSamples);
}

Vec3 SelfTest::axis() const noexcept {
  return (run_ % 2 == 0 ? 1.0 : -1.0) * params_.axes.along.col(run_ / 2);
}

void SelfTest::enter(Phase phase) noexcept {
  phase_ = phase;
  entered_ = now_;
}

void SelfTest::nextRun() noexcept {
  do {
    ++run_;
  } while (run_ < kRuns && !params_.axes.has[static_cast<std::size_t>(run_ / 2)]);
  if (run_ < kRuns) pushed_[static_cast<std::size_t>(run_ / 2)] = true;
  enter(run_ < kRuns ? Phase::kRamp : Phase::kDone);
  from_ = position_;
  level_ = 0.0;
}

Vec3 SelfTest::next(const HandState& hand, double now, const Vec3& sent) noexcept {
  if (!started_) {
    started_ = true;
    began_ = entered_ = now_ = fresh_at_ = now;
    home_ = from_ = position_ = hand.position;
    still_since_ = now;
  }
  const double dt = std::max(now - now_, 1e-6);
  now_ = now;
  ++ticks_;
  velocity_ += (1.0 - std::exp(-dt / kSmooth)) * ((hand.position - position_) / dt - velocity_);
  position_ = hand.position;
  countPosition(hand.age);
  if (phase_ != Phase::kDone && (position_ - home_).norm() > params_.travel) {
    far_ = true;
    enter(Phase::kDone);
  }
  recordSample(sent);
  const Vec3 force = runPhase();
  return phase_ == Phase::kDone ? Vec3(Vec3::Zero()) : force;
}

void SelfTest::countPosition(double age) noexcept {
  // `age` is measured slightly after `now_`, so `read_at` of one position may vary by this time.
  constexpr double kApart = 1e-4;  // [s]
  const double read_at = now_ - age;
  if (positions_ != 0 && !(read_at > read_at_ + kApart)) return;
  read_at_ = read_at;
  ++positions_;
  slowest_ = std::max(slowest_, now_ - fresh_at_);
  fresh_at_ = now_;
}

void SelfTest::recordSample(const Vec3& sent) noexcept {
  const bool rests = phase_ == Phase::kRest || phase_ == Phase::kCatch;
  if ((rests || phase_ == Phase::kRamp || phase_ == Phase::kPush || phase_ == Phase::kOppose) &&
      samples_.size() < kMostSamples) {
    samples_.push_back(
        {now_ - began_, position_ - home_, sent, rests ? kFall : static_cast<std::int8_t>(run_)});
  }
}

Vec3 SelfTest::runPhase() noexcept {
  switch (phase_) {
    case Phase::kRest:
      awaitRest();
      break;
    case Phase::kCatch:
      return catchFall();
    case Phase::kRamp:
      return raiseForce();
    case Phase::kPush:
      return holdForce();
    case Phase::kOppose:
      return opposeMotion();
    case Phase::kSettle:
      awaitStandstill();
      break;
    case Phase::kReturn:
      return pullHome();
    case Phase::kDone:
      break;
  }
  return Vec3::Zero();
}

void SelfTest::awaitRest() noexcept {
  // Each motion restarts the wait, because the user may still be letting go of the arm.
  if ((position_ - from_).norm() > kBegun) {
    from_ = position_;
    still_since_ = now_;
    rest_ = 0;
    sum_.setZero();
    sum2_ = 0.0;
  }
  sum_ += position_ - from_;
  sum2_ += (position_ - from_).squaredNorm();
  ++rest_;
  if (const Vec3 gone = position_ - home_; gone.norm() > kFell) {
    falls_ = gone.normalized();
    enter(Phase::kCatch);
  } else if ((inPhase() > kLetGo && now_ - still_since_ > kRest) || inPhase() > kUneasy) {
    home_ = position_;
    run_ = -1;
    nextRun();
  }
}

Vec3 SelfTest::catchFall() noexcept {
  // If the arm has stopped or turned back, the motors can hold it.
  if (velocity_.dot(falls_) < kStill) caught_ = true;
  if ((position_ - home_).dot(falls_) < kMoved || inPhase() > kCaught) enter(Phase::kDone);
  return -params_.force * falls_;
}

Vec3 SelfTest::raiseForce() noexcept {
  const Vec3 ahead = axis();
  const Vec3 moved = position_ - from_;
  const auto slot = static_cast<std::size_t>(run_);
  level_ = std::min(params_.force, kRamp * inPhase());
  if (moved.norm() > kBegun && breakaway_[slot] == 0.0) breakaway_[slot] = level_;
  if (moved.norm() > kMoved) {
    went_[slot] = true;
    along_[slot] = moved.dot(ahead) / moved.norm();
    trusted_ = trusted_ && along_[slot] > kStraight;
    enter(trusted_ ? Phase::kPush : Phase::kSettle);
  } else if (inPhase() > params_.force / kRamp + 0.5) {
    breakaway_[slot] = 0.0;  // the arm trembles, or a hand or friction holds it
    enter(Phase::kSettle);
  }
  return level_ * ahead;
}

Vec3 SelfTest::holdForce() noexcept {
  const Vec3 ahead = axis();
  if ((position_ - from_).dot(ahead) > kPushed || inPhase() > kLongest) enter(Phase::kOppose);
  return params_.force * ahead;
}

Vec3 SelfTest::opposeMotion() noexcept {
  const Vec3 ahead = axis();
  if (velocity_.dot(ahead) < 0.0 || inPhase() > kLongest) enter(Phase::kSettle);
  return -params_.force * ahead;
}

void SelfTest::awaitStandstill() noexcept {
  if (!(velocity_.norm() < kStill && inPhase() > 0.1) && !(inPhase() > kLongest)) return;
  // If the arm moved in another direction than the push, the spring could add energy.
  if (trusted_) {
    enter(Phase::kReturn);
  } else {
    nextRun();
  }
}

Vec3 SelfTest::pullHome() noexcept {
  Vec3 force = Vec3::Zero();
  for (int a = 0; a < 3; ++a) {
    if (!went_[2 * static_cast<std::size_t>(a)]) continue;
    const Vec3 back = params_.axes.along.col(a);
    force -= (kSpring * (position_ - home_) + kDamper * velocity_).dot(back) * back;
  }
  if (force.norm() > params_.force) force *= params_.force / force.norm();
  if (inPhase() > kBack) nextRun();
  return force;
}

std::vector<SelfTest::Way> SelfTest::pushes(int axis) const {
  std::vector<Way> ways;
  const Vec3 along = params_.axes.along.col(axis);
  for (int run = 2 * axis; run < 2 * axis + 2; ++run) {
    if (breakaway_[static_cast<std::size_t>(run)] == 0.0) continue;
    Way way;
    for (const Sample& s : samples_) {
      if (s.run == run) way.path.push_back({s.time, s.position.dot(along), s.force.dot(along)});
    }
    ways.push_back(std::move(way));
  }
  return ways;
}

std::vector<SelfTest::Way> SelfTest::fall() const {
  Way way;
  bool gone = false;
  for (const Sample& s : samples_) {
    if (s.run != kFall) continue;
    way.path.push_back({s.time, s.position.dot(falls_), s.force.dot(falls_)});
    // A hand that lets go of the arm moves it by less than kMoved before it falls.
    gone = gone || s.position.norm() > kFell;
    if (!gone && s.position.norm() < kMoved) way.start = way.path.size();
  }
  return {std::move(way)};
}

SelfTest::Left SelfTest::fit(const std::vector<Way>& ways, double late, AxisResult& result) const {
  // The equation of motion, integrated twice, because differentiated positions would magnify the
  // encoders' error. ahead and back: time of motion in + and - direction.
  // m (x - x0 - v0 t) + b int (x - x0) + c int (ahead - back) - bias t^2 / 2 = int impulse
  // One row per sample since the arm began to move. Each push has separate unknowns x0 and v0.
  constexpr int kUnknown = 8;
  using Row = Eigen::Matrix<double, kUnknown, 1>;
  Eigen::Matrix<double, kUnknown, kUnknown> normal =
      Eigen::Matrix<double, kUnknown, kUnknown>::Zero();
  Row right = Row::Zero();
  double square = 0.0;
  long rows = 0;
  constexpr std::size_t kHalf = 4;  // samples on each side from which a velocity is computed
  const double whole = std::floor(late);
  const double part = late - whole;
  const auto back = static_cast<std::size_t>(whole);
  for (const Way& way : ways) {
    const std::vector<Way::Point>& path = way.path;
    if (path.size() < 8 * kHalf) continue;
    const auto speed = [&](std::size_t i) {
      return (path[i + kHalf].position - path[i - kHalf].position) /
             (path[i + kHalf].time - path[i - kHalf].time);
    };
    // Starts at the same row for every delay, so that the residuals can be compared.
    std::size_t start = std::max(way.start, kHalf + kLatest + 1);
    while (start + kHalf < path.size() && std::abs(speed(start)) < 0.01) ++start;
    if (start + kHalf >= path.size()) continue;

    double impulse = 0.0;
    double pushed = 0.0;  // integral of `impulse`
    double sense = 0.0;
    double turned = 0.0;
    double area = 0.0;
    for (std::size_t i = start + 1; i + kHalf < path.size(); ++i) {
      const double dt = path[i].time - path[i - 1].time;
      // For the fraction `part` of the sample period the older force acts, then the newer one.
      const double older = path[i - back - 1].force;
      const double newer = path[i - back].force;
      pushed += impulse * dt +
                (older * part * (2.0 - part) + newer * (1.0 - part) * (1.0 - part)) * 0.5 * dt * dt;
      impulse += ((1.0 - part) * newer + part * older) * dt;
      const double ahead = speed(i) > 0.0 ? 1.0 : -1.0;
      turned += sense * dt + 0.5 * ahead * dt * dt;
      sense += ahead * dt;
      area += 0.5 * (path[i].position + path[i - 1].position - 2.0 * path[start].position) * dt;
      const double t = path[i].time - path[start].time;
      Row row = Row::Zero();
      row.head<4>() << path[i].position - path[start].position, area, turned, -0.5 * t * t;
      row.segment<2>(&way == &ways[0] ? 4 : 6) << t, 1.0;
      normal += row * row.transpose();
      right += pushed * row;
      square += pushed * pushed;
      ++rows;
    }
  }
  const long freedom = rows - kUnknown;
  constexpr long kFew = 30;
  if (freedom < kFew) return {};
  // The ridge makes the matrix invertible if the data cannot separate two terms: friction and
  // weight of an arm that only falls, or x0 and v0 of a missing path.
  constexpr double kRidge = 1e-9;
  for (int i = 0; i < kUnknown; ++i) {
    normal(i, i) = normal(i, i) > 0.0 ? (1.0 + kRidge) * normal(i, i) : 1.0;
  }
  const Eigen::LDLT<Eigen::Matrix<double, kUnknown, kUnknown>> solver(normal);
  const Row found = solver.solve(right);
  const Eigen::Matrix<double, kUnknown, kUnknown> inverse =
      solver.solve(Eigen::Matrix<double, kUnknown, kUnknown>::Identity());
  const double left = std::max(0.0, square - found.dot(right));
  const double variance = left / static_cast<double>(freedom);
  result.fitted = found.allFinite() && found[0] > 0.0;
  result.mass = found[0];
  result.viscous = found[1];
  result.coulomb = found[2];
  result.bias = found[3];
  result.delay = late * period();
  result.viscous_error = std::sqrt(std::max(0.0, variance * inverse(1, 1)));
  result.coulomb_error = std::sqrt(std::max(0.0, variance * inverse(2, 2)));
  return {left, freedom};
}

void SelfTest::fitDelay(const std::vector<Way>& ways, AxisResult& result) const {
  const AxisResult plain = result;
  const auto left = [&](double late) {
    AxisResult tried = plain;
    return fit(ways, late, tried).square;
  };
  double least = 0.0;
  for (int late = 1; late <= kLatest; ++late) {
    if (left(late) < left(least)) least = late;
  }
  double most = std::min<double>(kLatest, least + 1.0);
  least = std::max(0.0, least - 1.0);
  for (int i = 0; i < 20; ++i) {
    const double third = (most - least) / 3.0;
    if (left(least + third) < left(most - third)) {
      most -= third;
    } else {
      least += third;
    }
  }
  const double best = 0.5 * (least + most);
  const Left found = fit(ways, best, result);
  if (found.freedom == 0) return;
  // A delay that is off by one standard error increases the sum of squares by its mean per degree
  // of freedom. The error follows from the increase at a delay that is off by kFar.
  constexpr double kFar = 1.0;  // samples
  const double grows = left(best + kFar) - found.square;
  const double mean = found.square / static_cast<double>(found.freedom);
  const double errors = grows > 0.0 ? std::sqrt(mean / grows) : kLatest;
  result.delay_error = kFar * errors * period();
}

std::string SelfTest::weigh(SelfTestResult& result) const {
  AxisResult fell;
  fitDelay(fall(), fell);
  // If the push did not stop the falling arm, only its weight minus Coulomb friction is known.
  result.held = caught_ && !far_;
  result.weight = result.held ? fell.bias : fell.bias - fell.coulomb;
  std::string words = "the released arm moves in direction " + inWords(result.falls) + " by itself";
  if (!fell.fitted || !(result.weight > 0.0)) {
    result.weight = 0.0;
    return words + ": hold the tip still until you let go of it, and run the test again";
  }
  const double mass = result.weight / kGravity;
  words += result.held ? ", with " + inWords(result.weight) + " N"
                       : ", with " + inWords(result.weight) + " N more than its friction holds";
  if (params_.down.isZero()) return words + ": counterweight the arm, or find what pulls it";
  const double down = params_.down.dot(result.falls);
  if (down > kStraight) {
    return words +
           ": counterweight the arm; if its profile has \"kinematics\", its motors can carry it: "
           "add a mass of " +
           inWords(mass) + " kg to gravity/masses of its profile, as {\"mass\": " + inWords(mass) +
           "} for a mass at the tip, or the masses and centres of its links";
  }
  if (down < -kStraight) {
    return words + ": this direction is upwards: reduce gravity/masses of its profile by " +
           inWords(mass) + " kg at the tip, or its counterweight";
  }
  return words +
         ": this direction is not gravity/down of its profile (-z by default): check whether a "
         "spring, a cable or a motor pulls it, or correct mount";
}

SelfTestResult SelfTest::result() const {
  SelfTestResult result;
  result.seconds = now_ - began_;
  result.positions = positions_;
  result.slowest = slowest_;
  for (std::size_t a = 0; a < 3; ++a) {
    result.axes[a].driven = params_.axes.has[a];
    result.axes[a].pushed = pushed_[a];
  }
  if (rest_ > 0) {
    const double n = static_cast<double>(rest_);
    result.noise = std::sqrt(std::max(0.0, sum2_ / n - (sum_ / n).squaredNorm()));
  }
  if (!done()) {
    result.problems.emplace_back("the test ended early: run it again");
    return result;
  }
  result.falls = falls_;
  if (result.falls.norm() > 0.0) {
    result.problems.push_back(weigh(result));
    return result;
  }
  if (far_) {
    result.problems.push_back("the arm moved farther than " + inWords(params_.travel) +
                              " m from its start: do not push it, check whether it falls or moves "
                              "by itself, and correct the scale of its motors");
  }
  checkReadings(result);
  for (int a = 0; a < 3; ++a) judgeAxis(a, result);
  // After a push that moved the arm in another direction, the test neither pushes with the largest
  // force nor brings the arm back. The motions are then too short for a fit.
  const bool straight =
      std::none_of(result.axes.begin(), result.axes.end(),
                   [](const AxisResult& axis) { return axis.moved && axis.along <= kStraight; });
  if (!straight) return result;
  for (int a = 0; a < 3; ++a) {
    AxisResult& axis = result.axes[static_cast<std::size_t>(a)];
    if (!axis.moved) continue;
    fitDelay(pushes(a), axis);
    const std::string trouble = fitTrouble(axis);
    if (!trouble.empty()) {
      result.problems.push_back(std::string(params_.axes.name(a)) + ": " + trouble);
    }
  }
  compareMasses(result, params_.axes);
  return result;
}

void SelfTest::checkReadings(SelfTestResult& result) const {
  const double rate = static_cast<double>(positions_) / std::max(result.seconds, 1e-9);
  const double asked =
      std::min(params_.input_rate, static_cast<double>(ticks_) / std::max(result.seconds, 1e-9));
  if (rate < 0.5 * asked) {
    result.problems.push_back(
        "the arm sends " + inWords(rate) +
        " positions per second, less than half of the expected " +
        std::to_string(std::lround(asked)) +
        ": correct rate/input of its profile or the rate of its plug-in, or check its firmware");
  }
  if (params_.stale > 0.0 && result.slowest > params_.stale) {
    result.problems.push_back("a pause of " + inWords(1e3 * result.slowest) +
                              " ms between two positions is longer than the limit of " +
                              inWords(1e3 * params_.stale) +
                              " ms (stale): check the arm's cable or firmware");
  }
}

void SelfTest::judgeAxis(int a, SelfTestResult& result) const {
  AxisResult& axis = result.axes[static_cast<std::size_t>(a)];
  if (!axis.driven) return;
  const std::string name = params_.axes.name(a);
  const std::size_t plus = 2 * static_cast<std::size_t>(a);
  axis.moved = went_[plus] && went_[plus + 1];
  axis.breakaway = 0.5 * (breakaway_[plus] + breakaway_[plus + 1]);
  axis.along = std::min(along_[plus], along_[plus + 1]);
  if (!axis.moved && !far_ && trusted_) {
    const std::string sign = went_[plus] == went_[plus + 1] ? "" : went_[plus] ? "-" : "+";
    result.problems.push_back(sign + name + ": " + inWords(params_.force) +
                              " N did not move the arm: let go of it, switch its motors on, or, if "
                              "the friction is larger, reduce the friction or increase --force");
  }
  checkDirection(plus, "+" + name, result);
  checkDirection(plus + 1, "-" + name, result);
}

void SelfTest::checkDirection(std::size_t run, const std::string& where,
                              SelfTestResult& result) const {
  if (!went_[run] || along_[run] > kStraight) return;
  result.problems.push_back(
      "pushed to " + where + "," +
      (along_[run] < -kStraight
           ? " the arm moved the other way: change the sign of its motors' scale, or of its "
             "encoders' scale (in a PID profile, of \"force\" or \"way\"; in a plug-in, of this "
             "axis in its force or its position)"
           : " the arm moved in another direction (the cosine to the push is " +
                 inWords(along_[run]) + ", not above " + inWords(kStraight) +
                 "): check whether motors are exchanged, or correct the geometry"));
}

std::string SelfTest::fitTrouble(const AxisResult& axis) const {
  // A clearly negative friction comes from a hand on the arm, or from a wrong scale of an encoder
  // or a motor in the profile.
  if (!axis.fitted || axis.coulomb < -3.0 * axis.coulomb_error - 0.02) {
    return "the friction cannot be measured: let go of the arm during the test; if that does not "
           "help, correct the scale of its encoders and motors, or use finer encoders";
  }
  if (axis.delay > (kLatest - 1) * period()) {
    return "the force comes " + inWords(1e3 * axis.delay) +
           " ms late or later: check the arm's firmware and cable, and end other programs that use "
           "the arm";
  }
  if (axis.mass < kLightest || axis.mass > kHeaviest) {
    return "the measured mass is " + inWords(axis.mass) + " kg, outside of " + inWords(kLightest) +
           " to " + inWords(kHeaviest) + " kg: correct the scale of the encoders or motors";
  }
  return {};
}

std::string rulerTrouble(const Vec3& way, double length, const ArmAxes& axes, int axis) {
  const double gone = way.norm();
  const std::string reports =
      "over " + inWords(length) + " m of ruler along +" + axes.name(axis) + " the arm reports ";
  if (!(std::abs(gone / length - 1.0) <= kRuler)) {  // true for NaN
    return reports + inWords(gone) +
           " m: correct the scale of its encoders, its gears or its lengths";
  }
  const double straight = way.dot(axes.along.col(axis)) / gone;
  if (straight > kStraight) return {};
  if (straight < -kStraight) {
    return reports +
           "the opposite direction: change the sign of an encoder's ratio and of its "
           "motor's scale, or correct mount";
  }
  return reports + "the direction " + inWords(Vec3(way / gone)) +
         ": check whether encoders are exchanged, or correct the mount or the geometry";
}

}  // namespace palpate
