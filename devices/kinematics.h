/// Where an arm's tip is, from its joints, and what its motors do for a force at the tip.
///
/// Frame D is the arm's own: its axes and origin are the model's. Right-handed, metres, radians.
#pragma once

#include <array>
#include <cstddef>
#include <memory>
#include <span>

#include "palpate/engine/handle.h"
#include "palpate/engine/types.h"

namespace palpate {

inline constexpr std::size_t kMotors = 3;  ///< Of the first joints; others are only sensed.
/// Of a model's joints the first ones; the others mean nothing.
using Joints = std::array<double, kMostJoints>;

/// The tip at some joints.
struct ArmPose {
  Vec3 position_D = Vec3::Zero();  ///< [m]
  /// Column i: d position / d joint i [m/rad]; [-] for a joint that slides.
  std::array<Vec3, kMostJoints> jacobian = standing();
  /// False at joints that the arm cannot have (links that do not meet) and where a parallel arm's
  /// motors lose hold of its tip: then `position_D` is the nearest that it can have, and no motor
  /// may be driven.
  bool reachable = true;

  /// No joint moves it.
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

  [[nodiscard]] virtual std::size_t joints() const noexcept = 0;  ///< 1 to kMostJoints.
  /// For finite joints every number is finite. RT: no allocation; under 0.5 us.
  [[nodiscard]] virtual ArmPose at(const Joints& joints) const noexcept PALPATE_NONBLOCKING = 0;

  /// Its moving links, from the base; of which frame `on` takes a place the makers below say.
  [[nodiscard]] virtual std::size_t links() const noexcept = 0;
  /// A point that is fixed to a link, as `at` has the tip: where an arm has its masses.
  ///
  /// @pre link < links().
  [[nodiscard]] virtual ArmPose on(std::size_t link, const Vec3& place,
                                   const Joints& joints) const noexcept PALPATE_NONBLOCKING = 0;

  /// What joint i must give for a force at the tip: tau_i = J_i . f [N m], [N] for one that slides;
  /// zero where the arm is not reachable.
  [[nodiscard]] static double torque(const ArmPose& pose, std::size_t joint,
                                     const Vec3& force_D) noexcept {
    return pose.reachable ? pose.jacobian[joint].dot(force_D) : 0.0;
  }
};

/// Three slides: the joints are the position. Link i moves with the slides up to i, in the arm's
/// axes.
[[nodiscard]] std::shared_ptr<const Kinematics> makeCartesian();
/// The same along some of the axes only: 0 is x.
///
/// @pre 1 to 3, each once.
[[nodiscard]] std::shared_ptr<const Kinematics> makeSlides(std::span<const int> axes);

/// One link of a chain by Denavit and Hartenberg: turn about z by joint + turn, shift along z by
/// `along`, along the new x by `across`, turn about it by `twist`. Its own frame is the one that it
/// ends in.
struct ChainLink {
  double turn = 0.0;    ///< theta [rad]
  double along = 0.0;   ///< d [m]
  double across = 0.0;  ///< a [m]
  double twist = 0.0;   ///< alpha [rad]
};

/// A chain of 3 to 6 turning joints. `tip`: in the last link's frame [m]. Throws DeviceError for
/// another count or numbers that are not finite.
[[nodiscard]] std::shared_ptr<const Kinematics> makeChain(std::span<const ChainLink> links,
                                                          const Vec3& tip = Vec3::Zero());

/// WoodenHaptics and the first Polhem: a base that turns (A) and two links, both driven from it, so
/// that B and C are angles to the vertical and not to each other:
///   x = cos A (b sin B + c sin C), y = sin A (b sin B + c sin C), z = a + b cos B - c cos C
/// (Kinematics::computePosition of haptikfabrikenapi, forsslund/haptikfabrikenapi). Links: what
/// turns with A only, in the arm's frame at A = 0; the upper and the lower link, x along it from
/// the joint where it begins, y as A turns, z as its angle grows. Throws DeviceError for lengths
/// that are not positive.
[[nodiscard]] std::shared_ptr<const Kinematics> makeCapstanArm(double a, double b, double c);

/// A planar loop of five bars (Campion, Wang and Hayward 2005): motors at (0, 0) and (-base, 0)
/// turn bars of length[0] and length[3]; from their ends length[1] and length[2] meet at the tip,
/// on the side of larger y. z is 0. Links: the bars, x along it from the motor's side, y to the
/// left of that. Throws DeviceError for lengths that are not positive.
[[nodiscard]] std::shared_ptr<const Kinematics> makePantograph(const std::array<double, 4>& length,
                                                               double base);

/// Clavel's delta: three motors on a circle of radius `base`, at 0, 120 and 240 degrees about z,
/// turn upper arms down from the horizontal; forearms in parallelograms carry a plate whose own
/// joints are on a circle of radius `plate`. The tip is below. Links: the upper arms, x along it
/// from its motor, y level, z up of it; the plate, from the tip, in the arm's axes (of a forearm
/// one half goes with its upper arm's end, one with the plate). Throws DeviceError for lengths that
/// are not positive.
[[nodiscard]] std::shared_ptr<const Kinematics> makeDelta(double base, double plate, double upper,
                                                          double fore);

}  // namespace palpate
