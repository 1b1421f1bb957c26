/// Readings of an arm for the application (Telemetry::input). The force does not depend on them.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace palpate {

inline constexpr std::size_t kMostJoints = 6;  ///< Largest number of joints of an arm.

/// Numbers of one reading, all finite. HandleInfo states which of them the arm measures.
struct Handle {
  std::uint32_t buttons = 0;  ///< Bit i: HandleInfo::buttons[i] is pressed.
  /// Unit quaternion (w, x, y, z) that rotates the handle's axes into those of W.
  std::array<double, 4> orientation{1.0, 0.0, 0.0, 0.0};
  /// Velocity of the tip as measured by the arm (unlike HandState::velocity), in W [m/s].
  std::array<double, 3> velocity{};
  double gripper = 0.0;  ///< Opening of the gripper: angle [rad], or width [m] if it slides.
  /// Measured joint angles [rad], or lengths [m] of joints that slide.
  std::array<double, kMostJoints> joints{};
};

/// The members of a Handle that an arm measures. Other members keep their initial values.
struct HandleInfo {
  static constexpr std::size_t kMostButtons = 32;  ///< Number of bits in Handle::buttons.
  std::vector<std::string> buttons;                ///< Names of the buttons, at most kMostButtons.
  bool orientation = false;  ///< True if the arm measures its handle's orientation.
  bool gripper = false;      ///< True if the arm measures the opening of a gripper.
  std::size_t joints = 0;    ///< Number of measured joints, at most kMostJoints.
  bool velocity = false;     ///< True if the arm measures the velocity of its tip.
};

}  // namespace palpate
