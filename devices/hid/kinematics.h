/// Computes an arm's tip position from its joints, and the joints' torques for a force at the tip.
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

/// Largest number of joints with motors; these joints come first.
inline constexpr std::size_t kMotors = 3;
/// Joint positions of a model [rad or m], in order; surplus entries are unused.
using Joints = std::array<double, kMostJoints>;

/// The tip's position and its derivatives at given joints.
struct ArmPose {
  Vec3 position_D = Vec3::Zero();  ///< Position of the tip [m].
  /// Column i: d position / d joint i [m/rad], dimensionless for a sliding joint.
  std::array<Vec3, kMostJoints> jacobian = standing();
  /// False if the links cannot meet at these joints, or if a parallel arm's motors cannot hold its
  /// tip there. Then `position_D` may be only approximate, and no motor may be driven.
  bool reachable = true;

  /// Returns the Jacobian of a point that does not move with any joint.
  [[nodiscard]] static std::array<Vec3, kMostJoints> standing() noexcept {
    std::array<Vec3, kMostJoints> zero;
    zero.fill(Vec3::Zero());
    return zero;
  }
};

/// The geometry of an arm. Immutable and shared.
class Kinematics {
 public:
  Kinematics() = default;
  Kinematics(const Kinematics&) = delete;
  Kinematics& operator=(const Kinematics&) = delete;
  virtual ~Kinematics() = default;

  [[nodiscard]] virtual std::size_t joints() const noexcept = 0;  ///< Returns 1 to kMostJoints.
  /// Returns the tip's position and Jacobian, finite for finite joints. RT: no allocation.
  [[nodiscard]] virtual ArmPose at(const Joints& joints) const noexcept PALPATE_NONBLOCKING = 0;

  /// Returns the number of moving links, from the base; see the factory functions for their frames.
  [[nodiscard]] virtual std::size_t links() const noexcept = 0;
  /// Returns the position and Jacobian of a point fixed to a link, such as a centre of mass.
  /// `place` is in the link's frame [m].
  ///
  /// @pre link < links().
  [[nodiscard]] virtual ArmPose on(std::size_t link, const Vec3& place,
                                   const Joints& joints) const noexcept PALPATE_NONBLOCKING = 0;

  /// Returns the torque of joint i for a force at the tip: tau_i = J_i . f [N m], or [N] for a
  /// sliding joint. Returns zero if the pose is not reachable.
  [[nodiscard]] static double torque(const ArmPose& pose, std::size_t joint,
                                     const Vec3& force_D) noexcept {
    return pose.reachable ? pose.jacobian[joint].dot(force_D) : 0.0;
  }
};

/// Makes three sliding joints along x, y, z: their values are the tip's coordinates. Link i moves
/// with joints 0 to i. Its frame has the arm's axes; at joint values 0 its origin is the arm's.
[[nodiscard]] std::shared_ptr<const Kinematics> makeCartesian();
/// Makes sliding joints along `axes` only; 0 is x.
///
/// @pre 1 to 3 axes, each once.
[[nodiscard]] std::shared_ptr<const Kinematics> makeSlides(std::span<const int> axes);

/// One link of a chain by Denavit and Hartenberg: turn about z by joint + turn, shift along z by
/// `along`, shift along the new x by `across`, turn about that x by `twist`. The link's own frame
/// is the frame after these four steps.
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
/// Link 0 turns with A only; its frame is the arm's at A = 0. Links 1 and 2 are the upper and the
/// lower link. Their origin is the joint where the link begins, x points along the link, y in the
/// direction in which A turns, z in the direction in which its own angle grows. So the frame of
/// link 1 is left-handed. Throws DeviceError unless b and c are positive and all lengths are
/// finite.
[[nodiscard]] std::shared_ptr<const Kinematics> makeCapstanArm(double a, double b, double c);

/// Makes a planar loop of five bars (Campion, Wang and Hayward 2005). Motors at (0, 0) and (-base,
/// 0) turn bars of length[0] and length[3]. From the ends of these, bars of length[1] and length[2]
/// meet at the tip, on the side of larger y unless the motors' bars cross. z is 0. The links are
/// the bars, with x along the bar, away from the motor, and y to the left of x. Throws DeviceError
/// unless all lengths are positive and `base` is 0 or more.
[[nodiscard]] std::shared_ptr<const Kinematics> makePantograph(const std::array<double, 4>& length,
                                                               double base);

/// Makes Clavel's delta. Three motors on a circle of radius `base`, at 0, 120 and 240 degrees about
/// z, turn upper arms down from the horizontal. Forearms in parallelograms carry a plate whose
/// joints are on a circle of radius `plate`. The tip is below the motors.
///
/// Links 0 to 2 are the upper arms: the origin is the motor, x points along the arm, y is
/// horizontal, z is perpendicular to both and points up. Link 3 is the plate, with its origin at
/// the tip and the arm's axes. Assign half of a forearm's mass to the end of its upper arm and half
/// to the plate. Throws DeviceError for lengths that are not positive.
[[nodiscard]] std::shared_ptr<const Kinematics> makeDelta(double base, double plate, double upper,
                                                          double fore);

}  // namespace palpate
