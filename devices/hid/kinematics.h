/// Computes the position of an arm's tip from its joints, and the motors' torques for a force at
/// the tip.
///
/// Frame D is the arm's own: the model defines its axes and origin. Right-handed, metres, radians.
#pragma once

#include <array>
#include <cstddef>
#include <memory>
#include <span>

#include "palpate/engine/safety/handle.h"
#include "palpate/engine/types.h"

namespace palpate {

inline constexpr std::size_t kMotors = 3;  ///< Only the first joints may have motors; others are
                                           ///< only sensed.
/// Joints of a model, in order; surplus entries are unused.
using Joints = std::array<double, kMostJoints>;

/// The tip's pose at given joints.
struct ArmPose {
  Vec3 position_D = Vec3::Zero();  ///< [m]
  /// Column i: d position / d joint i [m/rad]; [-] for a joint that slides.
  std::array<Vec3, kMostJoints> jacobian = standing();
  /// False at joints that the arm cannot have (links that do not meet), and where a parallel arm's
  /// motors lose hold of its tip. Then `position_D` is the nearest possible position, and no motor
  /// may be driven.
  bool reachable = true;

  /// Returns the Jacobian of a point that does not move with any joint.
  [[nodiscard]] static std::array<Vec3, kMostJoints> standing() noexcept {
    std::array<Vec3, kMostJoints> zero;
    zero.fill(Vec3::Zero());
    return zero;
  }
};

/// The geometry of an arm. Const and shared.
class Kinematics {
 public:
  Kinematics() = default;
  Kinematics(const Kinematics&) = delete;
  Kinematics& operator=(const Kinematics&) = delete;
  virtual ~Kinematics() = default;

  [[nodiscard]] virtual std::size_t joints() const noexcept = 0;  ///< Number of joints, 1 to
                                                                  ///< kMostJoints.
  /// Returns the tip's pose. For finite joints every number is finite. RT: no allocation; under 0.5
  /// us.
  [[nodiscard]] virtual ArmPose at(const Joints& joints) const noexcept PALPATE_NONBLOCKING = 0;

  /// Number of moving links, counted from the base. The factory functions below define the frame of
  /// each link in which `on` takes a place.
  [[nodiscard]] virtual std::size_t links() const noexcept = 0;
  /// Returns the pose of a point fixed to a link, such as a mass; as `at` for the tip.
  ///
  /// @pre link < links().
  [[nodiscard]] virtual ArmPose on(std::size_t link, const Vec3& place,
                                   const Joints& joints) const noexcept PALPATE_NONBLOCKING = 0;

  /// Returns the torque of joint i for a force at the tip: tau_i = J_i . f [N m], [N] for a joint
  /// that slides. Zero if the arm is not reachable.
  [[nodiscard]] static double torque(const ArmPose& pose, std::size_t joint,
                                     const Vec3& force_D) noexcept {
    return pose.reachable ? pose.jacobian[joint].dot(force_D) : 0.0;
  }
};

/// Makes three slides: the joints are the position. Link i moves with the slides up to i, in the
/// arm's axes.
[[nodiscard]] std::shared_ptr<const Kinematics> makeCartesian();
/// Makes slides along some of the axes only: 0 is x.
///
/// @pre 1 to 3 axes, each once.
[[nodiscard]] std::shared_ptr<const Kinematics> makeSlides(std::span<const int> axes);

/// One link of a chain by Denavit and Hartenberg: turn about z by joint + turn, shift along z by
/// `along`, along the new x by `across`, turn about it by `twist`. The link's own frame is the one
/// at its end.
struct ChainLink {
  double turn = 0.0;    ///< theta [rad]
  double along = 0.0;   ///< d [m]
  double across = 0.0;  ///< a [m]
  double twist = 0.0;   ///< alpha [rad]
};

/// Makes a chain of 3 to 6 turning joints. `tip` is in the last link's frame [m]. Throws
/// DeviceError for another count or for numbers that are not finite.
[[nodiscard]] std::shared_ptr<const Kinematics> makeChain(std::span<const ChainLink> links,
                                                          const Vec3& tip = Vec3::Zero());

/// Makes the arm of WoodenHaptics and of the first Polhem: a base that turns (A) and two links.
/// Both links are driven from the base, so B and C are angles to the vertical, not to each other:
///   x = cos A (b sin B + c sin C), y = sin A (b sin B + c sin C), z = a + b cos B - c cos C
/// (Kinematics::computePosition of haptikfabrikenapi, forsslund/haptikfabrikenapi).
///
/// Link 0 is the part that turns with A only, in the arm's frame at A = 0. Links 1 and 2 are the
/// upper and the lower link: x along it from the joint where it begins, y as A turns, z as its
/// angle grows. Throws DeviceError for lengths that are not positive.
[[nodiscard]] std::shared_ptr<const Kinematics> makeCapstanArm(double a, double b, double c);

/// Makes a planar loop of five bars (Campion, Wang and Hayward 2005). Motors at (0, 0) and (-base,
/// 0) turn bars of length[0] and length[3]. From their ends, bars of length[1] and length[2] meet
/// at the tip, on the side of larger y. z is 0. The links are the bars: x along it from the motor's
/// side, y to the left of x. Throws DeviceError for lengths that are not positive.
[[nodiscard]] std::shared_ptr<const Kinematics> makePantograph(const std::array<double, 4>& length,
                                                               double base);

/// Makes Clavel's delta. Three motors on a circle of radius `base`, at 0, 120 and 240 degrees about
/// z, turn upper arms down from the horizontal. Forearms in parallelograms carry a plate whose
/// joints are on a circle of radius `plate`. The tip is below.
///
/// Links 0 to 2 are the upper arms: x along it from its motor, y level, z up of it. Link 3 is the
/// plate, from the tip, in the arm's axes. Of a forearm's mass one half goes with its upper arm's
/// end, one with the plate. Throws DeviceError for lengths that are not positive.
[[nodiscard]] std::shared_ptr<const Kinematics> makeDelta(double base, double plate, double upper,
                                                          double fore);

}  // namespace palpate
