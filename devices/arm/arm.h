/// The interface of an arm: a HID device with a profile, a device of USB's PID class or a plug-in.
#pragma once

#include <algorithm>
#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "palpate/engine/loop/realtime.h"
#include "palpate/engine/safety/device.h"

namespace palpate {

/// Results of `palpate devices --test`, as bounds that are safe for passivity and stability. Zeros
/// mean not measured.
struct MeasuredArm {
  double viscous = 0.0;  ///< [N s/m], a lower bound for all axes with motors.
  double coulomb = 0.0;  ///< [N], a lower bound for all axes with motors.
  /// Delay from a reading to its force [s], the middle of its possible range.
  double delay = 0.0;
  double doubt = 0.0;  ///< Half the width of the delay's range [s].
  double mass = 0.0;   ///< [kg], the smallest of the masses measured along the axes.
};

/// Limits of an arm that has not passed `palpate devices --test`.
inline constexpr double kUntestedForce = 1.0;        ///< [N]
inline constexpr double kUntestedStiffness = 100.0;  ///< [N/m]

/// Applies the limits of an untested arm, and notes them in DeviceInfo::source.
inline void holdUntested(DeviceInfo& info) {
  info.limits.peak = std::min(info.limits.peak, kUntestedForce);
  info.max_stiffness = std::min(info.max_stiffness, kUntestedStiffness);
  info.source += "; untested: limited to 1 N and 100 N/m until palpate devices --test has passed";
}

/// Functions and settings of the program that opens an arm. All members may be empty.
struct ArmHost {
  /// Prints an instruction for the user. Another thread calls it when a lost arm returns.
  std::function<void(const std::string&)> say = nullptr;
  /// Returns true if the program should end; this also ends every wait for the user.
  std::function<bool()> stop = nullptr;
  /// The arm's measured friction, for the energy tank; zeros if it is unknown.
  MeasuredArm measured = {};
  /// Use of the energy tank. If too little is known of the arm's friction, the tank is off.
  TankUse tank = TankUse::kObserve;
  double refill = 0.0;  ///< TankParams::refill [W].
  /// The arm is being tested. A PID device then has its full gain; all other limits hold.
  bool tests = false;
  /// Largest weight at the tip that the motors may carry before the arm has passed its test [N].
  double carries = 1.0;
  /// Clock for the age of reports and writes [ns], called in ticks. Tests replace it.
  std::int64_t (*now)() noexcept = nowNs;
};

/// Key of an arm's test result, which holds only for the same arm with the same description.
struct ArmIdentity {
  std::string name;  ///< Profile's name, or `plugin:NAME`.
  /// Serial number, or the port where the arm is plugged in. Empty: both are unknown.
  std::string own;
  std::uint64_t fingerprint = 0;  ///< fingerprintOf() the whole description.
  bool numbered = true;           ///< True: `own` is a serial number. False: it is a port.
};

/// Returns a fingerprint of a text, such as an arm's description or name: FNV-1a.
[[nodiscard]] constexpr std::uint64_t fingerprintOf(std::string_view text) noexcept {
  std::uint64_t print = 14695981039346656037ULL;
  for (const char c : text) print = (print ^ static_cast<unsigned char>(c)) * 1099511628211ULL;
  return print;
}

/// Counts of readings and writes since an arm was opened.
struct ArmTraffic {
  std::int64_t dropped = 0;     ///< Reports that were discarded unread because they were old.
  std::int64_t writes = 0;      ///< Forces that were sent.
  std::int64_t longest_ns = 0;  ///< The longest write [ns].
};

/// Properties of an arm that never change.
struct ArmTraits {
  bool drives = true;             ///< The arm has motors.
  Mat3 moves = Mat3::Identity();  ///< Projector onto the directions of W in which the arm can move.
  Vec3 down_W = -Vec3::UnitZ();   ///< Direction in which masses fall.
  double input_rate = 1000.0;     ///< Positions per second [Hz].
  double stiffness = 0.0;         ///< Largest coupling stiffness of the tested arm [N/m].
  double workspace_radius = 0.0;  ///< [m]
  bool carries = false;           ///< The motors carry the arm's own weight.
};

/// An arm with a hand on it.
class Arm : public Device {
 public:
  /// Constant while the arm is open.
  [[nodiscard]] virtual const ArmTraits& traits() const noexcept = 0;
  /// Returns why the last read() was not ready, with a remedy; empty if it was ready. Call it on
  /// the thread that calls read().
  [[nodiscard]] virtual std::string whyNotReady() const = 0;
  /// Returns the tip's travel per count of each encoder, at the last reading [m]; empty: unknown.
  [[nodiscard]] virtual std::vector<double> steps() const = 0;
  /// Returns the counts since the opening. Call it on the thread that calls read().
  [[nodiscard]] virtual ArmTraffic traffic() const = 0;
};

}  // namespace palpate
