/// What Haply's Inverse Service says and is told, bytes to numbers and back: no network, no
/// threads.
///
/// Three generations of its JSON are told apart by the message itself. Where each is published:
///   3.5  docs.haply.co/inverseSDK: "WebSocket Protocol", "Control Commands", "Basis Permutation",
///        "Mount & Workspace Transforms", "Simulation Channel". A message has `session_id`,
///        `config` has `preset`, `basis` and `mount`; a force is `set_cursor_force.vector`.
///   3.1  Haply's Python tutorials of that version, Isaac Lab's se3_haply.py, SofaHaplyRobotics:
///   the
///        same lists without those; a force is `set_cursor_force.values`.
///   3.0  docs.haply.co/inverseSDK/3.0.x/service: `inverse3` is an object by device id. What tells
///   a
///        force is not published where we could read it: it is recognised, and gets none.
///
/// Every vector is in the service's own axes (p_D): x right, y forward, z up, right-handed ("Basis
/// Permutation"), which are those of the hand's world; only the origin differs.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>

namespace palpate::haply {

using Triple = std::array<double, 3>;

inline constexpr std::size_t kMessageLimit = 65536;  ///< [bytes]; a state of two arms has 2,000.
inline constexpr int kDepthLimit = 16;               ///< Of nesting; a state has 6.
inline constexpr std::size_t kMaxArms = 4;           ///< In a message; what is beyond is left out.
inline constexpr std::size_t kMaxGrips = 4;
inline constexpr double kFarthest = 2.0;   ///< [m], along an axis: farther is no position.
inline constexpr double kFastest = 100.0;  ///< [m/s], likewise.
inline constexpr double kWidest = 3600.0;  ///< [deg], of an angle of a joint.

/// A device's id as the service spells it, fit to be sent back: letters, digits and `_.:-`.
struct DeviceId {
  std::array<char, 48> text{};  ///< Ends with a zero.
  [[nodiscard]] std::string_view view() const noexcept { return text.data(); }
  /// False, and empty, where the text is none.
  bool assign(std::string_view from) noexcept;
};

enum class Generation : std::uint8_t { kUnknown, k30, k31, k35 };

/// Where p_D begins (`preset`).
enum class Origin : std::uint8_t {
  kBase,    ///< At the arm's base: defaults, arm_front, and whatever has no presets.
  kCentre,  ///< In the middle of its workspace: arm_front_centered.
  kOther,   ///< Anywhere else.
};

/// What is said of an arm once: in the first message, and when it is asked for.
struct ArmConfig {
  Origin origin = Origin::kBase;
  bool plain_axes = true;  ///< The basis is XYZ.
  bool miniature = false;  ///< A Minverse: another arm, whose limits are not known here.
  bool left = false;       ///< Built for the left hand.
};

/// An arm in a message.
struct ArmState {
  DeviceId id;
  bool placed = false;       ///< `position` is one: the rest is as it was where it is false.
  Triple position_D{};       ///< [m]
  Triple velocity_D{};       ///< [m/s]; zeros where there is none.
  Triple joints{};           ///< [rad]; zeros where there are none.
  bool transformed = false;  ///< Somebody has moved, turned or scaled its workspace.
  // What is not said is -1.
  std::int8_t powered = -1;
  std::int8_t ready = -1;
  std::int8_t calibrated = -1;
  bool configured = false;  ///< `config` is there.
  ArmConfig config;
};

/// A handle in a message.
struct GripState {
  DeviceId id;
  bool turned = false;                    ///< `orientation` is one.
  std::array<double, 4> orientation_D{};  ///< Unit quaternion w, x, y, z.
  std::uint32_t buttons = 0;
  int button_count = 0;  ///< 1 with a cable; 3 or 4 without.
};

/// A message of the service.
struct Message {
  Generation generation = Generation::kUnknown;
  std::size_t arm_count = 0;
  std::size_t grip_count = 0;
  std::array<ArmState, kMaxArms> arms;
  std::array<GripState, kMaxGrips> grips;
};

/// What came of a message's bytes. Only kState has something in it.
enum class Verdict : std::uint8_t {
  kState,    ///< Lists of devices, which may be empty.
  kOther,    ///< JSON, and not about devices.
  kTooLong,  ///< More than kMessageLimit.
  kTooDeep,  ///< Nested deeper than kDepthLimit.
  kNotJson,
};

/// Reads a message. Whatever the bytes are: every number in `out` is finite and within the limits
/// above, and every id is fit to be sent. Allocates.
Verdict readMessage(std::string_view bytes, Message& out);

/// A force for an arm.
struct ForceTo {
  std::string_view id;
  Triple force_D{};  ///< [N], finite.
};

/// Room for the longest message to the service.
inline constexpr std::size_t kRoom = 1024;

/// Writes the forces as a message of k31 or k35, `introduce` with this program's name for the
/// Haply Hub (k35). Returns its length; 0: it does not fit or there is no such message. No
/// allocation.
std::size_t writeForces(Generation generation, std::span<const ForceTo> forces, bool introduce,
                        std::span<char> out) noexcept;

/// Asks for everything, `config` too: what keeps a connection without an arm alive.
inline constexpr std::string_view kAskForAll = R"({"session":{"force_render_full_state":{}}})";

}  // namespace palpate::haply
