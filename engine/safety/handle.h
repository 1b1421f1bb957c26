/// Readings of an arm beside the position of its tip, for the application: Telemetry::input has
/// them. The force does not depend on them.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace palpate {

inline constexpr std::size_t kMostJoints = 6;  ///< Most joints of an arm.

/// Numbers of one reading, all finite. HandleInfo states which numbers an arm has.
struct Handle {
  std::uint32_t buttons = 0;  ///< Bit i: HandleInfo::buttons[i] is pressed.
  /// Unit quaternion (w, x, y, z): turns the handle's axes into those of W.
  std::array<double, 4> orientation{1.0, 0.0, 0.0, 0.0};
  /// Velocity of the tip, as the arm itself measures it, in W [m/s]. HandState::velocity is
  /// computed from positions.
  std::array<double, 3> velocity{};
  double gripper = 0.0;                      ///< Opening of the gripper [rad]; [m] if it slides.
  std::array<double, kMostJoints> joints{};  ///< Joints as measured [rad]; [m] for a joint that
                                             ///< slides.
};

/// Members of a Handle that an arm has. The others keep their initial value.
struct HandleInfo {
  static constexpr std::size_t kMostButtons = 32;  ///< Bits of Handle::buttons.
  std::vector<std::string> buttons;                ///< Names, at most kMostButtons.
  bool orientation = false;                        ///< The arm measures its handle's orientation.
  bool gripper = false;                            ///< The arm has a gripper and measures it.
  std::size_t joints = 0;                          ///< Number of joints measured, at most
                                                   ///< kMostJoints.
  bool velocity = false;                           ///< The arm measures its velocity itself.
};

}  // namespace palpate
