/// What a profile's numbers come to: what its author looks at before any force comes.
#pragma once

#include <string>
#include <vector>

#include "palpate/devices/hid_profile.h"

namespace palpate {

/// One motor, the tip in the middle of the hand's world.
struct MotorFact {
  std::size_t joint = 0;    ///< Of HidProfile::joints.
  std::string field;        ///< Of the output.
  double asked = 0.0;       ///< For the profile's force, in the direction that asks most, in the
                            ///< output's units: amperes, as a rule.
  double room = 0.0;        ///< The most that the field lets it have, of its two signs the smaller.
  double continuous = 0.0;  ///< Of that, what it can hold for ever: HidJoint::continuous, or all.
  double carries = 0.0;     ///< For the profile's masses, as asked.
};

/// What factsOf finds; where nothing else is said, with every joint at `middle`.
struct ProfileFacts {
  Vec3 home_W = Vec3::Zero();  ///< The tip with every joint at its `home` [m].
  Joints middle{};    ///< Where the tip is in the middle of the hand's world, or nearest to it.
  double off = 0.0;   ///< From the middle of the hand's world to the nearest place that the
                      ///< tip was found to reach [m]; infinite: it reaches none from about
                      ///< home, and what follows is of home.
  double step = 0.0;  ///< What a position there may be off by, twice: the way of the tip by a
                      ///< count of every joint that counts [m].
  std::vector<MotorFact> motors;  ///< Of the joints that have one, in their order.
  Vec3 carried_W = Vec3::Zero();  ///< What its motors give at the tip to carry its masses [N].
  /// Project onto the directions of the hand's world that its joints move the tip in, and its
  /// motors push it in, at some pose about the middle: for most arms all, for a planar one those of
  /// a plane.
  Mat3 moves = Mat3::Identity();
  Mat3 drives = Mat3::Identity();  ///< By joints with motors only.
};

/// Searches the joints that bring the tip to the middle of the hand's world, by damped Gauss-Newton
/// from many poses; looks about there for where it can go. Milliseconds.
///
/// @pre profile.kinematics, and a joint for each of its.
[[nodiscard]] ProfileFacts factsOf(const HidProfile& profile);

/// The raw number of each joint's field there: a counter that wraps is taken for the one nearest to
/// it.
[[nodiscard]] std::vector<double> rawInMiddle(const HidProfile& profile, const ProfileFacts& facts);
/// And where each joint is at its home, as an arm is whose `home` steps have just ended.
[[nodiscard]] std::vector<double> rawAtHome(const HidProfile& profile);

/// A joint where its field, followed beyond its ends, has this raw number [rad], of a slide [m].
///
/// @param home_raw  Its raw number in the home pose, where that is how the arm is opened.
[[nodiscard]] double jointAt(const HidProfile& profile, std::size_t joint, double raw,
                             double home_raw) noexcept PALPATE_NONBLOCKING;

/// What joints must give to carry a profile's masses: the gradient of their potential energy [N m],
/// [N] for one that slides; zero where the arm is not reachable. RT: no allocation; 0.3 us a mass.
[[nodiscard]] Joints carryingTorques(const HidProfile& profile,
                                     const Joints& joints) noexcept PALPATE_NONBLOCKING;
/// The force at the tip that torques of the joints with motors make, the smallest that has them
/// [N]. RT: no allocation.
[[nodiscard]] Vec3 forceOf(const HidProfile& profile, const ArmPose& pose,
                           const Joints& torques) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
