/// What a profile's numbers come to: what its author looks at before any force comes.
#pragma once

#include <string>
#include <vector>

#include "devices/hid_profile.h"

namespace palpate {

/// One motor, the tip in the middle of the hand's world.
struct MotorFact {
  std::size_t joint = 0;
  std::string field;   ///< Of the output.
  double asked = 0.0;  ///< For the profile's force, in the direction that asks most, in the units
                       ///< that torque_constant is by: amperes, as a rule.
  double room = 0.0;   ///< The most that the field lets it have, of its two signs the smaller.
};

struct ProfileFacts {
  Vec3 home_W = Vec3::Zero();  ///< The tip with every joint at its `home` [m].
  double off = 0.0;   ///< From the middle of the hand's world to the nearest place that the
                      ///< tip was found to reach [m].
  double step = 0.0;  ///< The longest way of the tip in the middle by one count of a joint
                      ///< [m]; 0: no joint counts.
  std::vector<MotorFact> motors;
};

/// Searches the joints that bring the tip to the middle of the hand's world, by damped Gauss-Newton
/// from many poses. Milliseconds.
[[nodiscard]] ProfileFacts factsOf(const HidProfile& profile);

}  // namespace palpate
