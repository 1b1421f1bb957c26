/// Derives forces, reach and resolution from a profile, to check it before any force is sent.
#pragma once

#include <string>
#include <vector>

#include "palpate/devices/hid/hid_profile.h"

namespace palpate {

/// The load of one motor at ProfileFacts::middle.
struct MotorFact {
  std::size_t joint = 0;  ///< Index in HidProfile::joints.
  std::string field;      ///< Its output field.
  /// Output value for the profile's force in the worst direction [unit of the field, often A].
  double asked = 0.0;
  double room = 0.0;  ///< Limit of the field: the smaller of the limits for both signs.
  /// Value that the motor can hold forever, at most `room`: HidJoint::continuous, or `room`.
  double continuous = 0.0;
  double carries = 0.0;  ///< Output value that carries the profile's masses [unit of the field].
};

/// Results of factsOf. Unless a member's comment says otherwise, all joints are at `middle`.
struct ProfileFacts {
  Vec3 home_W = Vec3::Zero();  ///< The tip when every joint is at its `home` [m].
  /// Joints at which the tip is at the origin of W, or as near to the origin as the search came.
  Joints middle{};
  /// Distance from the origin of W to the tip at `middle` [m]. Infinite: the search has failed, and
  /// `middle` is the home pose.
  double off = 0.0;
  /// Bound of the tip's travel if each joint's integer field moves by one count [m].
  double step = 0.0;
  double joint_step = 0.0;  ///< Largest share of one joint in `step` [m].
  /// Motors in the order of their joints; a joint without a motor has no entry.
  std::vector<MotorFact> motors;
  Vec3 carried_W = Vec3::Zero();  ///< Force at the tip by which the motors carry the masses [N].
  /// Projector onto the directions in W in which the joints move the tip, from poses around the
  /// middle. For a planar arm these are the directions of its plane; for most arms, all directions.
  Mat3 moves = Mat3::Identity();
  Mat3 drives = Mat3::Identity();  ///< Like `moves`, but with the joints that have motors only.
};

/// Finds the joints that bring the tip to the origin of W, by damped Gauss-Newton from many start
/// poses. Then finds the directions in which the tip can move near these joints. Takes
/// milliseconds.
///
/// @pre profile.kinematics is set, and profile.joints has one entry for each of its joints.
[[nodiscard]] ProfileFacts factsOf(const HidProfile& profile);

/// Returns the raw number of each joint's field at facts.middle.
[[nodiscard]] std::vector<double> rawInMiddle(const HidProfile& profile, const ProfileFacts& facts);
/// Returns each joint's raw number in the home pose, directly after the `home` steps.
[[nodiscard]] std::vector<double> rawAtHome(const HidProfile& profile);

/// Returns a joint's value [rad], or [m] for a sliding joint, for a raw number that Unwrapped has
/// extended. `home_raw`: raw number in the home pose, for home_at_open.
[[nodiscard]] double jointAt(const HidProfile& profile, std::size_t joint, double raw,
                             double home_raw) noexcept PALPATE_NONBLOCKING;

/// Returns the joint torques that carry a profile's masses: the gradient of the masses' potential
/// energy [N m], or [N] for a sliding joint. Returns zero if the pose is not reachable. RT: no
/// allocation; computes one pose per mass.
[[nodiscard]] Joints carryingTorques(const HidProfile& profile,
                                     const Joints& joints) noexcept PALPATE_NONBLOCKING;
/// Returns the smallest force at the tip that gives these motor torques [N], by damped least
/// squares. RT: no allocation.
[[nodiscard]] Vec3 forceOf(const HidProfile& profile, const ArmPose& pose,
                           const Joints& torques) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
