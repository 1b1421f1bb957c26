/// What an arm says beside where its tip is: for the application, which has it by
/// Telemetry::input. No force follows from any of it.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace palpate {

inline constexpr std::size_t kMostJoints = 6;  ///< Of an arm.

/// Numbers of one reading; which of them an arm has is HandleInfo's. All finite.
struct Handle {
  std::uint32_t buttons = 0;  ///< Bit i: HandleInfo::buttons[i] is pressed.
  /// Unit quaternion (w, x, y, z): turns the handle's axes into those of W.
  std::array<double, 4> orientation{1.0, 0.0, 0.0, 0.0};
  /// Of the tip, as the arm measures it itself, in W [m/s]. HandState::velocity is of positions.
  std::array<double, 3> velocity{};
  double gripper = 0.0;  ///< How far the gripper is open [rad]; [m] where it slides.
  std::array<double, kMostJoints> joints{};  ///< As measured [rad]; [m] of one that slides.
};

/// What of a Handle an arm has. What it has not is as initialised for ever.
struct HandleInfo {
  static constexpr std::size_t kMostButtons = 32;  ///< Bits of Handle::buttons.
  std::vector<std::string> buttons;                ///< Names, at most kMostButtons.
  bool orientation = false;                        ///< It measures how it is held.
  bool gripper = false;                            ///< It has one, and measures it.
  std::size_t joints = 0;                          ///< It measures so many, at most kMostJoints.
  bool velocity = false;                           ///< It measures its velocity itself.
};

}  // namespace palpate
