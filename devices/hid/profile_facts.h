/// Derives forces, reach and resolution from a profile's numbers, for its author to check before
/// any force is sent.
#pragma once

#include <string>
#include <vector>

#include "palpate/devices/hid/hid_profile.h"

namespace palpate {

/// One motor, with the tip in the middle of the hand's world.
struct MotorFact {
  std::size_t joint = 0;    ///< Index in HidProfile::joints.
  std::string field;        ///< Its output field.
  double asked = 0.0;       ///< Needed for the profile's force in the most demanding direction, in
                            ///< the output's units: usually amperes.
  double room = 0.0;        ///< Limit of the field, the smaller of both signs.
  double continuous = 0.0;  ///< Part of `room` that it can hold forever: HidJoint::continuous, or
                            ///< all.
  double carries = 0.0;     ///< Needed for the profile's masses, in the unit of `asked`.
};

/// Results of factsOf. Unless a member says otherwise, every joint is at `middle`.
struct ProfileFacts {
  Vec3 home_W = Vec3::Zero();  ///< The tip with every joint at its `home` [m].
  Joints middle{};    ///< Joints with the tip in the middle of the hand's world, or nearest to it.
  double off = 0.0;   ///< Distance from the middle of the hand's world to the nearest place that
                      ///< the search reached [m]. Infinite: no place is reachable from around home,
                      ///< and the members below are for home.
  double step = 0.0;  ///< Travel of the tip for one count of every joint with an integer field
                      ///< [m]; twice the largest error of a position there.
  std::vector<MotorFact> motors;  ///< For joints with a motor, in their order.
  Vec3 carried_W = Vec3::Zero();  ///< Force of its motors at the tip to carry its masses [N].
  /// Project onto directions of the hand's world, taken over poses around the middle: those in
  /// which the joints move the tip, and those in which the motors push it. For most arms these are
  /// all directions, for a planar one those of a plane.
  Mat3 moves = Mat3::Identity();
  Mat3 drives = Mat3::Identity();  ///< For joints with motors only.
};

/// Finds the joints that bring the tip to the middle of the hand's world, by damped Gauss-Newton
/// from many poses. Then finds the directions in which the tip can move there. Milliseconds.
///
/// @pre profile.kinematics, and a joint for each of its joints.
[[nodiscard]] ProfileFacts factsOf(const HidProfile& profile);

/// Returns the raw number of each joint's field at facts.middle. HidDevice takes the first
/// reading of a counter that wraps as the number nearest to it.
[[nodiscard]] std::vector<double> rawInMiddle(const HidProfile& profile, const ProfileFacts& facts);
/// Returns the raw number of each joint's field at its home, right after the profile's `home`
/// steps.
[[nodiscard]] std::vector<double> rawAtHome(const HidProfile& profile);

/// Returns a joint from the raw number of its field, extended beyond its ends [rad], for a slide
/// [m].
///
/// @param home_raw  Raw number in the home pose, if the profile has home_at_open.
[[nodiscard]] double jointAt(const HidProfile& profile, std::size_t joint, double raw,
                             double home_raw) noexcept PALPATE_NONBLOCKING;

/// Returns the joint torques that carry a profile's masses: the gradient of their potential energy
/// [N m], [N] for a joint that slides. Zero if the arm is not reachable. RT: no allocation; 0.3 us
/// a mass.
[[nodiscard]] Joints carryingTorques(const HidProfile& profile,
                                     const Joints& joints) noexcept PALPATE_NONBLOCKING;
/// Returns the smallest force at the tip that the given torques of joints with motors produce [N].
/// RT: no allocation.
[[nodiscard]] Vec3 forceOf(const HidProfile& profile, const ArmPose& pose,
                           const Joints& torques) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
