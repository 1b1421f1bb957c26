#include "palpate/devices/hid/profile_facts.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

namespace palpate {

namespace {

Joints jointsAtHome(const HidProfile& profile) {
  Joints joints{};
  for (std::size_t i = 0; i < profile.joints.size(); ++i) joints[i] = profile.joints[i].home;
  return joints;
}

/// Moves `joints` to bring the tip near to `place`, by a local search. Returns the distance [m];
/// infinite if the first pose is not reachable.
double reach(const Kinematics& arm, const Vec3& place, Joints& joints) {
  constexpr int kSteps = 60;
  const std::size_t n = arm.joints();
  double damping = 1e-3;  // share of the trace of J J^T
  ArmPose pose = arm.at(joints);
  const auto off_of = [&](const ArmPose& p) {
    return p.reachable ? (place - p.position_D).norm() : std::numeric_limits<double>::infinity();
  };
  double off = off_of(pose);
  for (int i = 0; i < kSteps && std::isfinite(off) && off > 1e-9; ++i) {
    // J J^T is 3 x 3 for any number of joints, so this matrix is solved instead of J^T J.
    Mat3 square = Mat3::Zero();
    for (std::size_t j = 0; j < n; ++j) square += pose.jacobian[j] * pose.jacobian[j].transpose();
    square.diagonal().array() += damping * square.trace() + 1e-12;
    const Vec3 pull = square.ldlt().solve(place - pose.position_D);
    Joints next = joints;
    for (std::size_t j = 0; j < n; ++j) next[j] += pose.jacobian[j].dot(pull);
    const ArmPose there = arm.at(next);
    const double left = off_of(there);
    if (left < off) {
      joints = next;
      pose = there;
      off = left;
      damping = std::max(1e-9, 0.3 * damping);
    } else {
      damping *= 4.0;
    }
  }
  return off;
}

/// Returns the projector onto the directions in which the tip moves, given the sum of J J^T.
Mat3 within(const Mat3& squares) {
  constexpr double kNone = 0.01;  // share of the longest lever; shorter levers count as zero
  const Eigen::SelfAdjointEigenSolver<Mat3> solver(squares);
  Mat3 onto = Mat3::Zero();
  for (int i = 0; i < 3; ++i) {
    if (!(solver.eigenvalues()[i] > kNone * kNone * solver.eigenvalues()[2])) continue;
    onto += solver.eigenvectors().col(i) * solver.eigenvectors().col(i).transpose();
  }
  return onto;
}

/// Sets ProfileFacts::moves and ProfileFacts::drives, from poses around the middle.
void lookAbout(const HidProfile& profile, ProfileFacts& facts) {
  // Step between the poses in each joint [rad], or [m] for a sliding joint.
  constexpr double kAside = 0.3;
  constexpr int kPoses = 27;
  Mat3 moves = Mat3::Zero();
  Mat3 drives = Mat3::Zero();
  for (int at = 0; at < kPoses; ++at) {
    Joints joints = facts.middle;
    int rest = at;
    for (std::size_t j = 0; j < 3; ++j, rest /= 3) joints[j] += kAside * (rest % 3 - 1);
    const ArmPose pose = profile.kinematics->at(joints);
    for (std::size_t j = 0; pose.reachable && j < profile.joints.size(); ++j) {
      const Mat3 square = pose.jacobian[j] * pose.jacobian[j].transpose();
      moves += square;
      if (profile.joints[j].to) drives += square;
    }
  }
  const Mat3& turn = profile.world_from_device;
  facts.moves = turn * within(moves) * turn.transpose();
  facts.drives = turn * within(drives) * turn.transpose();
}

}  // namespace

Joints carryingTorques(const HidProfile& profile, const Joints& joints) noexcept {
  constexpr double kGravity = 9.80665;  // [m/s^2]
  Joints torques{};
  for (const HidMass& mass : profile.masses) {
    const ArmPose at = mass.link ? profile.kinematics->on(*mass.link, mass.centre, joints)
                                 : profile.kinematics->at(joints);
    if (!at.reachable) return {};
    for (std::size_t i = 0; i < profile.joints.size(); ++i) {
      torques[i] -= mass.mass * kGravity * at.jacobian[i].dot(profile.down_D);
    }
  }
  return torques;
}

Vec3 forceOf(const HidProfile& profile, const ArmPose& pose, const Joints& torques) noexcept {
  Mat3 square = Mat3::Zero();
  Vec3 pull = Vec3::Zero();
  for (std::size_t i = 0; i < profile.joints.size(); ++i) {
    if (!profile.joints[i].to) continue;
    square += pose.jacobian[i] * pose.jacobian[i].transpose();
    pull += torques[i] * pose.jacobian[i];
  }
  // Share of the levers' squares; makes directions without a lever solvable.
  constexpr double kDamping = 1e-6;
  square.diagonal().array() += kDamping * square.trace() + 1e-12;
  return square.ldlt().solve(pull);
}

ProfileFacts factsOf(const HidProfile& profile) {
  const Kinematics& arm = *profile.kinematics;
  const Joints home = jointsAtHome(profile);
  ProfileFacts facts;
  facts.home_W = profile.world_from_device * (arm.at(home).position_D - profile.origin_D);
  facts.off = std::numeric_limits<double>::infinity();
  Joints middle = home;
  // Starts at the home pose, then at poses around it in which the first three joints differ.
  constexpr double kApart = 0.8;  // [rad]; [m] for a sliding joint
  constexpr int kWide = 5;
  constexpr double kThere = 1e-6;  // [m]: the tip then counts as being at the origin of W
  const std::size_t turned = std::min<std::size_t>(3, arm.joints());
  const int starts = static_cast<int>(std::pow(kWide, turned));
  for (int start = 0; start < starts && !(facts.off < kThere); ++start) {
    Joints joints = home;
    // Multiples 0, 1, -1, 2, -2 of kApart for each joint.
    int rest = start;
    for (std::size_t j = 0; j < turned; ++j, rest /= kWide) {
      const int step = rest % kWide;
      joints[j] += kApart * (step % 2 == 1 ? (step + 1) / 2 : -step / 2);
    }
    const double off = reach(arm, profile.origin_D, joints);
    if (off >= facts.off) continue;
    facts.off = off;
    middle = joints;
  }

  facts.middle = middle;
  const ArmPose pose = arm.at(middle);
  const Joints carries = carryingTorques(profile, middle);
  facts.carried_W = profile.world_from_device * forceOf(profile, pose, carries);
  for (std::size_t i = 0; i < profile.joints.size(); ++i) {
    const HidJoint& joint = profile.joints[i];
    const double way = pose.jacobian[i].norm();
    const ReportField& from = profile.input[joint.from.report].fields[joint.from.field];
    if (from.type != ReportField::Type::kFloat) {
      const double step = way * std::abs(from.scale / joint.ratio);
      facts.step += step;
      facts.joint_step = std::max(facts.joint_step, step);
    }
    if (!joint.to) continue;
    const ReportField& to = profile.output->fields[*joint.to];
    const double room = std::min(to.most - to.offset, to.offset - to.least);
    facts.motors.push_back(
        {i, to.name, profile.limits.force * way / std::abs(joint.ratio * joint.torque_constant),
         room / std::abs(to.scale),
         joint.continuous > 0.0 ? joint.continuous : room / std::abs(to.scale),
         std::abs(carries[i] / (joint.ratio * joint.torque_constant))});
  }
  lookAbout(profile, facts);
  return facts;
}

namespace {

/// Returns the raw number for which jointAt() returns `value`, for an arm without home_at_open.
double rawAt(const HidProfile& profile, std::size_t joint, double value) {
  const HidJoint& of = profile.joints[joint];
  const ReportField& field = profile.input[of.from.report].fields[of.from.field];
  return ((value - of.home) * of.ratio - field.offset) / field.scale;
}

}  // namespace

std::vector<double> rawInMiddle(const HidProfile& profile, const ProfileFacts& facts) {
  std::vector<double> raw;
  for (std::size_t i = 0; i < profile.joints.size(); ++i) {
    raw.push_back(rawAt(profile, i, facts.middle[i]));
  }
  return raw;
}

std::vector<double> rawAtHome(const HidProfile& profile) {
  std::vector<double> raw;
  for (std::size_t i = 0; i < profile.joints.size(); ++i) {
    raw.push_back(rawAt(profile, i, profile.joints[i].home));
  }
  return raw;
}

double jointAt(const HidProfile& profile, std::size_t joint, double raw, double home_raw) noexcept {
  const HidJoint& of = profile.joints[joint];
  const ReportField& field = profile.input[of.from.report].fields[of.from.field];
  // In the home pose a joint has its `home`, for any raw value of its field.
  const double value =
      profile.home_at_open ? field.scale * (raw - home_raw) : field.scale * raw + field.offset;
  return value / of.ratio + of.home;
}

}  // namespace palpate
