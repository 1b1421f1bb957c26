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

/// Measurements of `palpate devices --test`; all zero if the arm was not measured.
struct MeasuredArm {
  double viscous = 0.0;  ///< Viscous friction [N s/m]; a lower bound for all axes with motors.
  double coulomb = 0.0;  ///< Coulomb friction [N]; a lower bound for all axes with motors.
  /// Delay from reading a position to applying its force [s]; middle of the uncertainty range.
  double delay = 0.0;
  double doubt = 0.0;  ///< Half the width of the uncertainty range of `delay` [s].
  double mass = 0.0;   ///< Mass [kg]; the smallest of the masses along the axes.
};

/// Limits of an arm that has not passed `palpate devices --test`.
inline constexpr double kUntestedForce = 1.0;        ///< Largest force [N].
inline constexpr double kUntestedStiffness = 100.0;  ///< Largest stiffness of a coupling [N/m].

/// Applies the limits of an untested arm, and notes them in DeviceInfo::source.
inline void holdUntested(DeviceInfo& info) {
  info.limits.peak = std::min(info.limits.peak, kUntestedForce);
  info.max_stiffness = std::min(info.max_stiffness, kUntestedStiffness);
  info.source += "; untested: limited to 1 N and 100 N/m until palpate devices --test has passed";
}

/// Functions and settings that a program passes when it opens an arm. The functions may be empty.
struct ArmHost {
  /// Prints a line for the user. A thread of the arm may also call it, for example while it opens a
  /// lost arm again.
  std::function<void(const std::string&)> say = nullptr;
  /// Returns true if the program must end. Then all waits for the user end. Called on the thread
  /// that opens the arm, and on a thread of the arm.
  std::function<bool()> stop = nullptr;
  /// Ends the program, because a plug-in in this process has not closed its arm for 5 s. Called on
  /// another thread. If it is null or returns, the program ends by std::_Exit(1).
  std::function<void()> stuck = nullptr;
  /// The arm's measurements; zeros if they are unknown. The functions that open an arm by its name
  /// replace them by measuredArm().
  MeasuredArm measured = {};
  /// Use of the energy tank. The tank is off if the arm's friction is unknown or too small.
  TankUse tank = TankUse::kObserve;
  double refill = 0.0;  ///< TankParams::refill [W].
  /// True during `palpate devices --test`. A PID device then has its full gain; other limits hold.
  bool tests = false;
  /// Largest weight at the tip that the motors may carry before the arm has passed its test [N].
  double carries = 1.0;
  /// Clock for the ages of reports and writes [ns]. Ticks call it. Tests replace it.
  std::int64_t (*now)() noexcept = nowNs;
};

/// Key of an arm's test result, which is valid only for the same arm with the same description.
struct ArmIdentity {
  std::string name;  ///< Profile's name, or `plugin:NAME`.
  /// Serial number, or the port where the arm is plugged in. Empty: both are unknown.
  std::string own;
  std::uint64_t fingerprint = 0;  ///< fingerprintOf() of the arm's whole description.
  bool numbered = true;           ///< True: `own` is a serial number. False: it is a port.
};

/// Returns the FNV-1a hash of a text, such as an arm's description or name.
[[nodiscard]] constexpr std::uint64_t fingerprintOf(std::string_view text) noexcept {
  std::uint64_t print = 14695981039346656037ULL;
  for (const char c : text) print = (print ^ static_cast<unsigned char>(c)) * 1099511628211ULL;
  return print;
}

/// Counts of readings and writes since an arm was opened.
struct ArmTraffic {
  std::int64_t dropped = 0;     ///< Reports that were discarded because they were old.
  std::int64_t writes = 0;      ///< Forces that were sent or passed on to a plug-in.
  std::int64_t longest_ns = 0;  ///< The longest write [ns].
};

/// Properties of an arm that never change.
struct ArmTraits {
  bool drives = true;             ///< The arm has motors.
  Mat3 moves = Mat3::Identity();  ///< Projector onto the directions of W in which the arm can move.
  Vec3 down_W = -Vec3::UnitZ();   ///< Direction of gravity in W, a unit vector.
  double input_rate = 1000.0;     ///< Rate of new positions [Hz].
  double stiffness = 0.0;         ///< Largest coupling stiffness that the tested arm allows [N/m].
  double workspace_radius = 0.0;  ///< Radius of a ball about the origin of W [m].
  bool carries = false;           ///< The motors carry the arm's own weight.
};

/// A device that is an arm: adds the arm's traits and diagnostics to Device.
class Arm : public Device {
 public:
  /// Returns the arm's traits, which are constant while the arm is open.
  [[nodiscard]] virtual const ArmTraits& traits() const noexcept = 0;
  /// Returns why the last read() was not ready, with a remedy; else "". Call it on read()'s thread.
  [[nodiscard]] virtual std::string whyNotReady() const = 0;
  /// Returns the tip's travel per count of each encoder in the last pose [m]; empty: unknown. An
  /// arm of a plug-in has one number for all encoders.
  [[nodiscard]] virtual std::vector<double> steps() const = 0;
  /// Returns the counts since the opening. Call it on the thread that calls read().
  [[nodiscard]] virtual ArmTraffic traffic() const = 0;
};

}  // namespace palpate
