/// Private to devices: reads and writes the messages of Haply's Inverse Service.
///
/// The service's JSON has three versions (generations). Each message shows its generation. Sources:
///   3.5  docs.haply.co/inverseSDK: "WebSocket Protocol", "Control Commands", "Basis Permutation",
///        "Mount & Workspace Transforms", "Simulation Channel". A message has `session_id`,
///        `config` has `preset`, `basis` and `mount`; a force is `set_cursor_force.vector`.
///   3.1  Haply's Python tutorials of that version, Isaac Lab's se3_haply.py, SofaHaplyRobotics:
///        the same lists without these fields; a force is `set_cursor_force.values`.
///   3.0  docs.haply.co/inverseSDK/3.0.x/service: `inverse3` is an object by device id. We found
///        no publication of its force message, so this generation gets no force.
///
/// Vectors are in the service's own axes (p_D): x right, y forward, z up, right-handed ("Basis
/// Permutation"). W has the same axes but another origin.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>

namespace palpate::haply {

using Triple = std::array<double, 3>;

/// Longest accepted message [bytes].
inline constexpr std::size_t kMessageLimit = 65536;
inline constexpr int kDepthLimit = 16;  ///< Largest depth of nesting; a state has 6.
/// Largest number of arms that are read from a message; further arms are ignored.
inline constexpr std::size_t kMaxArms = 4;
inline constexpr std::size_t kMaxGrips = 4;
inline constexpr double kFarthest = 2.0;   ///< [m] along an axis; larger values are invalid.
inline constexpr double kFastest = 100.0;  ///< [m/s] along an axis; larger values are invalid.
inline constexpr double kWidest = 3600.0;  ///< Largest magnitude of a joint's angle [deg].

/// A device's id. It has only letters, digits and `_.:-`, so it is safe in a message.
struct DeviceId {
  std::array<char, 48> text{};  ///< Zero-terminated.
  [[nodiscard]] std::string_view view() const noexcept { return text.data(); }
  /// Copies `from`. If `from` is not a valid id, leaves the id empty and returns false.
  bool assign(std::string_view from) noexcept;
};

enum class Generation : std::uint8_t { kUnknown, k30, k31, k35 };

/// Origin of positions p_D, as the arm's `preset` sets it.
enum class Origin : std::uint8_t {
  kBase,    ///< At the arm's base: defaults, arm_front, or no preset.
  kCentre,  ///< In the middle of the workspace: arm_front_centered.
  kOther,   ///< Any other preset.
};

/// Properties of an arm that the service sends only in the first message, and on request.
struct ArmConfig {
  Origin origin = Origin::kBase;
  bool plain_axes = true;  ///< The basis is XYZ, so the axes are not permuted.
  /// The arm is a Minverse, which has other, unknown limits.
  bool miniature = false;
  bool left = false;  ///< The arm is built for the left hand.
};

struct ArmState {
  DeviceId id;
  bool placed = false;
  Triple position_D{};       ///< Position of the tip [m].
  Triple velocity_D{};       ///< [m/s]; zeros if the message gives no velocity.
  Triple joints{};           ///< [rad]; zeros if the message gives no joints.
  bool transformed = false;  ///< The arm's workspace was moved, turned or scaled.
  // 1: true; 0: false; -1: not in the message.
  std::int8_t powered = -1;
  std::int8_t ready = -1;
  std::int8_t calibrated = -1;
  bool configured = false;
  ArmConfig config;
};

struct GripState {
  DeviceId id;
  bool turned = false;
  std::array<double, 4> orientation_D{};  ///< Unit quaternion w, x, y, z; zeros if not `turned`.
  std::uint32_t buttons = 0;
  int button_count = 0;  ///< Number of buttons in the message; 1 for a handle with a cable.
};

struct Message {
  Generation generation = Generation::kUnknown;
  std::size_t arm_count = 0;
  std::size_t grip_count = 0;
  std::array<ArmState, kMaxArms> arms;
  std::array<GripState, kMaxGrips> grips;
};

/// Result of readMessage(). `out` is valid only for kState.
enum class Verdict : std::uint8_t {
  kState,  ///< The message has a list of arms, which may be empty.
  kOther,  ///< The message is JSON without a list of arms.
  kTooLong,
  kTooDeep,
  kNotJson,
};

/// Reads a message. Any bytes are safe: every number in `out` is finite and within the limits
/// above, and every id is safe to send. Allocates.
Verdict readMessage(std::string_view bytes, Message& out);

struct ForceTo {
  std::string_view id;
  Triple force_D{};  ///< [N], finite.
};

/// Room for the longest message to the service [bytes].
inline constexpr std::size_t kRoom = 1024;

/// Writes the forces as a message of generation k31 or k35. `introduce` adds this program's name
/// (k35 only). Returns the message's length; 0 if it does not fit, or if the generation has no
/// force message. No allocation.
std::size_t writeForces(Generation generation, std::span<const ForceTo> forces, bool introduce,
                        std::span<char> out) noexcept;

/// Requests the full state, with `config`. Also keeps a connection without an arm alive.
inline constexpr std::string_view kAskForAll = R"({"session":{"force_render_full_state":{}}})";

}  // namespace palpate::haply
