#include "palpate/devices/hid/kinematics.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include "palpate/engine/error.h"

namespace palpate {

namespace {

/// Least margin of a reachable pose of a parallel arm from a singular pose: the sine of the angle
/// between its two rods, or the determinant of the unit vectors along its three rods.
constexpr double kHold = 1e-2;

void requireLengths(const char* model, std::initializer_list<double> lengths) {
  for (const double length : lengths) {
    if (length > 0.0 && std::isfinite(length)) continue;
    throw DeviceError(std::string("kinematics ") + model,
                      "a length is " + std::to_string(length) + " m", "give finite lengths > 0");
  }
}

class Slides final : public Kinematics {
 public:
  explicit Slides(std::span<const int> axes) : axes_(axes.begin(), axes.end()) {}
  [[nodiscard]] std::size_t joints() const noexcept override { return axes_.size(); }
  [[nodiscard]] ArmPose at(const Joints& joints) const noexcept override {
    return on(axes_.size() - 1, Vec3::Zero(), joints);
  }
  [[nodiscard]] std::size_t links() const noexcept override { return axes_.size(); }
  [[nodiscard]] ArmPose on(std::size_t link, const Vec3& place,
                           const Joints& joints) const noexcept override {
    ArmPose pose;
    pose.position_D = place;
    for (std::size_t i = 0; i <= link; ++i) {
      pose.jacobian[i] = Vec3::Unit(axes_[i]);
      pose.position_D += joints[i] * pose.jacobian[i];
    }
    return pose;
  }

 private:
  std::vector<int> axes_;
};

class Chain final : public Kinematics {
 public:
  Chain(std::span<const ChainLink> links, const Vec3& tip)
      : links_(links.begin(), links.end()), tip_(tip) {}
  [[nodiscard]] std::size_t joints() const noexcept override { return links_.size(); }
  [[nodiscard]] ArmPose at(const Joints& joints) const noexcept override {
    return on(links_.size() - 1, tip_, joints);
  }
  [[nodiscard]] std::size_t links() const noexcept override { return links_.size(); }
  [[nodiscard]] ArmPose on(std::size_t end, const Vec3& place,
                           const Joints& joints) const noexcept override {
    std::array<Vec3, kMostJoints> axis;
    std::array<Vec3, kMostJoints> point;
    Mat3 turned = Mat3::Identity();
    Vec3 origin = Vec3::Zero();
    for (std::size_t i = 0; i <= end; ++i) {
      const ChainLink& link = links_[i];
      axis[i] = turned.col(2);
      point[i] = origin;
      const double c = std::cos(joints[i] + link.turn);
      const double s = std::sin(joints[i] + link.turn);
      const double ct = std::cos(link.twist);
      const double st = std::sin(link.twist);
      Mat3 step;
      step << c, -s * ct, s * st,  //
          s, c * ct, -c * st,      //
          0, st, ct;
      origin += turned * Vec3(link.across * c, link.across * s, link.along);
      turned = Mat3(turned * step);
    }
    ArmPose pose;
    pose.position_D = origin + turned * place;
    for (std::size_t i = 0; i <= end; ++i) {
      pose.jacobian[i] = axis[i].cross(pose.position_D - point[i]);
    }
    return pose;
  }

 private:
  std::vector<ChainLink> links_;
  Vec3 tip_;
};

class CapstanArm final : public Kinematics {
 public:
  CapstanArm(double a, double b, double c) : a_(a), b_(b), c_(c) {}
  [[nodiscard]] std::size_t joints() const noexcept override { return 3; }
  [[nodiscard]] ArmPose at(const Joints& joints) const noexcept override {
    return on(2, {c_, 0.0, 0.0}, joints);
  }
  [[nodiscard]] std::size_t links() const noexcept override { return 3; }
  [[nodiscard]] ArmPose on(std::size_t link, const Vec3& place,
                           const Joints& joints) const noexcept override {
    const double cb = std::cos(joints[1]);
    const double sb = std::sin(joints[1]);
    const double cc = std::cos(joints[2]);
    const double sc = std::sin(joints[2]);
    // The position at A = 0, and its derivatives with respect to B and C.
    const Vec3 upper(sb, 0.0, cb);
    const Vec3 upper_turns(cb, 0.0, -sb);
    const Vec3 lower(sc, 0.0, -cc);
    const Vec3 lower_turns(cc, 0.0, sc);
    Vec3 at = place;
    std::array<Vec3, 2> moves{Vec3::Zero(), Vec3::Zero()};
    if (link == 1) {
      at = {0.0, place.y(), a_};
      at += place.x() * upper + place.z() * upper_turns;
      moves[0] = place.x() * upper_turns - place.z() * upper;
    } else if (link == 2) {
      at = {0.0, place.y(), a_};
      at += b_ * upper + place.x() * lower + place.z() * lower_turns;
      moves = {b_ * upper_turns, place.x() * lower_turns - place.z() * lower};
    }
    const double ca = std::cos(joints[0]);
    const double sa = std::sin(joints[0]);
    Mat3 turn;
    turn << ca, -sa, 0, sa, ca, 0, 0, 0, 1;
    ArmPose pose;
    pose.position_D = turn * at;
    pose.jacobian[0] = Vec3::UnitZ().cross(pose.position_D);
    pose.jacobian[1] = turn * moves[0];
    pose.jacobian[2] = turn * moves[1];
    return pose;
  }

 private:
  double a_, b_, c_;
};

class Pantograph final : public Kinematics {
 public:
  Pantograph(const std::array<double, 4>& length, double base) : length_(length), base_(base) {}
  [[nodiscard]] std::size_t joints() const noexcept override { return 2; }
  [[nodiscard]] ArmPose at(const Joints& joints) const noexcept override {
    const Vec3 right(std::cos(joints[0]), std::sin(joints[0]), 0.0);
    const Vec3 left(std::cos(joints[1]), std::sin(joints[1]), 0.0);
    const Vec3 elbow = length_[0] * right;
    const Vec3 other = length_[3] * left - Vec3(base_, 0.0, 0.0);
    // The tip is an intersection of two circles about the elbows.
    const Vec3 between = other - elbow;
    const double distance = std::max(between.norm(), 1e-12);
    const Vec3 ahead = between / distance;
    const double along = std::clamp(
        (length_[1] * length_[1] - length_[2] * length_[2]) / (2.0 * distance) + 0.5 * distance,
        -length_[1], length_[1]);
    const double off2 = length_[1] * length_[1] - along * along;
    const Vec3 off(ahead.y(), -ahead.x(), 0.0);
    ArmPose pose;
    pose.position_D = elbow + along * ahead + std::sqrt(std::max(0.0, off2)) * off;
    // Each rod keeps its length: (P - E) . dP = (P - E) . dE.
    const Vec3 rod = pose.position_D - elbow;
    const Vec3 rod2 = pose.position_D - other;
    const double det = rod.x() * rod2.y() - rod.y() * rod2.x();
    pose.reachable = std::abs(rod.norm() - length_[1]) < 1e-6 * length_[1] &&
                     std::abs(rod2.norm() - length_[2]) < 1e-6 * length_[2] &&
                     std::abs(det) > kHold * length_[1] * length_[2];
    if (!pose.reachable) return pose;
    const double pull = rod.dot(length_[0] * Vec3(-right.y(), right.x(), 0.0));
    const double pull2 = rod2.dot(length_[3] * Vec3(-left.y(), left.x(), 0.0));
    pose.jacobian[0] = pull / det * Vec3(rod2.y(), -rod2.x(), 0.0);
    pose.jacobian[1] = pull2 / det * Vec3(-rod.y(), rod.x(), 0.0);
    return pose;
  }
  [[nodiscard]] std::size_t links() const noexcept override { return 4; }
  [[nodiscard]] ArmPose on(std::size_t link, const Vec3& place,
                           const Joints& joints) const noexcept override {
    // The motor of this link's bar, or of the bar at the start of this link.
    const std::size_t motor = link < 2 ? 0 : 1;
    const double bar = length_[motor == 0 ? 0 : 3];
    const Vec3 out(std::cos(joints[motor]), std::sin(joints[motor]), 0.0);
    const Vec3 base(motor == 0 ? 0.0 : -base_, 0.0, 0.0);
    ArmPose pose = at(joints);
    std::array<Vec3, 2> begins{Vec3::Zero(), Vec3::Zero()};  // derivatives of the link's origin
    std::array<Vec3, 2> turns = begins;                      // derivatives of the link's direction
    Vec3 from = base;
    Vec3 ahead = out;
    if (link == 0 || link == 3) {
      turns[motor] = left(out);
    } else {
      from = base + bar * out;
      begins[motor] = bar * left(out);
      ahead = (pose.position_D - from) / length_[link];
      for (std::size_t i = 0; i < 2; ++i) turns[i] = (pose.jacobian[i] - begins[i]) / length_[link];
    }
    const auto offset = [&](const Vec3& x) -> Vec3 { return place.x() * x + place.y() * left(x); };
    pose.position_D = from + offset(ahead) + place.z() * Vec3::UnitZ();
    for (std::size_t i = 0; i < 2; ++i) pose.jacobian[i] = begins[i] + offset(turns[i]);
    return pose;
  }

 private:
  static Vec3 left(const Vec3& v) noexcept { return {-v.y(), v.x(), 0.0}; }

  std::array<double, 4> length_;
  double base_;
};

class Delta final : public Kinematics {
 public:
  Delta(double base, double plate, double upper, double fore)
      : base_(base), shift_(base - plate), upper_(upper), fore_(fore) {}
  [[nodiscard]] std::size_t joints() const noexcept override { return 3; }
  [[nodiscard]] ArmPose at(const Joints& joints) const noexcept override {
    // Moves the elbows inwards by the plate's radius. The forearms then all end at the tip, so the
    // tip is an intersection of three spheres about the elbows.
    std::array<Vec3, 3> elbow;
    std::array<Vec3, 3> moves;
    for (std::size_t i = 0; i < 3; ++i) {
      const double angle = 2.0 * M_PI / 3.0 * static_cast<double>(i);
      const Vec3 out(std::cos(angle), std::sin(angle), 0.0);
      const double c = std::cos(joints[i]);
      const double s = std::sin(joints[i]);
      elbow[i] = (shift_ + upper_ * c) * out - upper_ * s * Vec3::UnitZ();
      moves[i] = -upper_ * s * out - upper_ * c * Vec3::UnitZ();
    }
    // The tip is on the axis of the elbows' circle, below their plane.
    const Vec3 p = elbow[1] - elbow[0];
    const Vec3 q = elbow[2] - elbow[0];
    const Vec3 normal = p.cross(q);
    const double area = normal.squaredNorm();
    ArmPose pose;
    if (!(area > 1e-16)) {
      pose.position_D = elbow[0];
      pose.reachable = false;
      return pose;
    }
    const Vec3 to_centre =
        (p.squaredNorm() * q.cross(normal) + q.squaredNorm() * normal.cross(p)) / (2.0 * area);
    const double height2 = fore_ * fore_ - to_centre.squaredNorm();
    const Vec3 down = normal.z() > 0.0 ? Vec3(-normal) : normal;
    pose.position_D = elbow[0] + to_centre + std::sqrt(std::max(0.0, height2) / area) * down;
    // Each forearm keeps its length: (P - E_i) . dP = (P - E_i) . dE_i.
    Mat3 rods;
    for (int i = 0; i < 3; ++i) {
      rods.row(i) = (pose.position_D - elbow[static_cast<std::size_t>(i)]) / fore_;
    }
    pose.reachable = height2 > 0.0 && std::abs(rods.determinant()) > kHold;
    if (!pose.reachable) return pose;
    const Mat3 inverse = rods.inverse();
    for (int i = 0; i < 3; ++i) {
      const auto k = static_cast<std::size_t>(i);
      pose.jacobian[k] = rods.row(i).dot(moves[k].transpose()) * inverse.col(i);
    }
    return pose;
  }
  [[nodiscard]] std::size_t links() const noexcept override { return 4; }
  [[nodiscard]] ArmPose on(std::size_t link, const Vec3& place,
                           const Joints& joints) const noexcept override {
    ArmPose pose = at(joints);
    if (link == 3) {
      pose.position_D += place;
      return pose;
    }
    const double angle = 2.0 * M_PI / 3.0 * static_cast<double>(link);
    const Vec3 out(std::cos(angle), std::sin(angle), 0.0);
    const Vec3 level = Vec3::UnitZ().cross(out);
    const double c = std::cos(joints[link]);
    const double s = std::sin(joints[link]);
    const Vec3 along = c * out - s * Vec3::UnitZ();
    const Vec3 up = s * out + c * Vec3::UnitZ();
    pose.position_D = base_ * out + place.x() * along + place.y() * level + place.z() * up;
    pose.jacobian = ArmPose::standing();
    pose.jacobian[link] = place.z() * along - place.x() * up;
    return pose;
  }

 private:
  double base_, shift_, upper_, fore_;
};

}  // namespace

std::shared_ptr<const Kinematics> makeCartesian() {
  return makeSlides(std::array{0, 1, 2});
}

std::shared_ptr<const Kinematics> makeSlides(std::span<const int> axes) {
  return std::make_shared<const Slides>(axes);
}

std::shared_ptr<const Kinematics> makeChain(std::span<const ChainLink> links, const Vec3& tip) {
  if (links.size() < 3 || links.size() > kMostJoints) {
    throw DeviceError("kinematics chain", "it has " + std::to_string(links.size()) + " links",
                      "give 3 to 6");
  }
  bool finite = tip.allFinite();
  for (const ChainLink& link : links) {
    finite = finite && std::isfinite(link.turn + link.along + link.across + link.twist);
  }
  if (!finite) {
    throw DeviceError("kinematics chain", "a number is not finite", "give finite numbers");
  }
  return std::make_shared<const Chain>(links, tip);
}

std::shared_ptr<const Kinematics> makeCapstanArm(double a, double b, double c) {
  requireLengths("capstan-arm", {b, c});
  if (!std::isfinite(a)) {
    throw DeviceError("kinematics capstan-arm", "the length \"a\" is not finite",
                      "give a finite length");
  }
  return std::make_shared<const CapstanArm>(a, b, c);
}

std::shared_ptr<const Kinematics> makePantograph(const std::array<double, 4>& length, double base) {
  requireLengths("pantograph", {length[0], length[1], length[2], length[3]});
  if (!(base >= 0.0 && std::isfinite(base))) {
    throw DeviceError("kinematics pantograph", "the base is " + std::to_string(base) + " m",
                      "give metres >= 0");
  }
  return std::make_shared<const Pantograph>(length, base);
}

std::shared_ptr<const Kinematics> makeDelta(double base, double plate, double upper, double fore) {
  requireLengths("delta", {base, plate, upper, fore});
  return std::make_shared<const Delta>(base, plate, upper, fore);
}

}  // namespace palpate
