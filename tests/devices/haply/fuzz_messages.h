/// Passes arbitrary bytes to the parser of Haply's messages, and checks invariants that hold for
/// any bytes.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <string_view>

#include "palpate/devices/plugins/haply_messages.h"

namespace palpate::test {

/// Returns "" if all invariants hold; otherwise a description of the violation.
inline std::string fuzzHaplyMessage(std::string_view bytes) {
  using namespace palpate::haply;
  static Message message;
  const Verdict verdict = readMessage(bytes, message);
  if (verdict != Verdict::kState) {
    const bool empty = message.arm_count == 0 && message.grip_count == 0 &&
                       message.generation == Generation::kUnknown;
    return empty ? "" : "a refused message left data in the output";
  }
  if (message.generation == Generation::kUnknown) return "a state without a generation";
  if (message.arm_count > kMaxArms || message.grip_count > kMaxGrips) return "too many devices";
  const auto within = [](const auto& values, double limit) {
    return std::all_of(values.begin(), values.end(),
                       [&](double v) { return std::abs(v) <= limit; });
  };
  std::array<ForceTo, kMaxArms> forces{};
  for (std::size_t i = 0; i < message.arm_count; ++i) {
    const ArmState& arm = message.arms[i];
    if (arm.id.view().empty()) return "an arm without an id";
    if (!within(arm.position_D, kFarthest)) return "a position beyond kFarthest";
    if (!within(arm.velocity_D, kFastest)) return "a velocity above kFastest";
    if (!within(arm.joints, 63.0)) return "a joint angle above 63 rad";
    forces[i] = {arm.id.view(), {1e-300, -4.0, 1.0 / 3.0}};
  }
  for (std::size_t i = 0; i < message.grip_count; ++i) {
    const auto& q = message.grips[i].orientation_D;
    const double length = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (message.grips[i].turned && !(std::abs(length - 1.0) < 1e-9))
      return "an orientation that is not a unit quaternion";
    if (message.grips[i].id.view().empty()) return "a handle without an id";
    if (message.grips[i].button_count > 4 || message.grips[i].buttons > 15)
      return "more than four buttons";
  }
  // Ids that were read add no quotation marks to a message to the service.
  std::array<char, kRoom> room{};
  const std::size_t size =
      writeForces(Generation::k35, {forces.data(), message.arm_count}, true, room);
  if (size == 0) return "a message to the service that does not fit";
  if (std::count(room.begin(), room.begin() + static_cast<long>(size), '"') !=
      12 + static_cast<long>(message.arm_count) * 16) {
    return "an id with quotes";
  }
  return "";
}

}  // namespace palpate::test
