/// The interface of an arm to tests, lists and programs. It is the same for a HID device with a
/// profile, a device of the PID class and a plug-in.
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

/// Results of `palpate devices --test` for an arm, on the safe side; zeros: not measured.
struct MeasuredArm {
  double viscous = 0.0;  ///< [N s/m], a lower bound for all axes with motors.
  double coulomb = 0.0;  ///< [N], a lower bound for all axes with motors.
  double delay = 0.0;    ///< Delay from a reading to its force [s]: middle of the possible range.
  double doubt = 0.0;    ///< Half the width of this range [s].
  double mass = 0.0;     ///< [kg], the smallest along any axis.
};

/// Limits of an arm that has not passed `palpate devices --test`.
inline constexpr double kUntestedForce = 1.0;        ///< [N]
inline constexpr double kUntestedStiffness = 100.0;  ///< [N/m]

/// Applies these limits to an arm with a hand on it that has not passed, and notes them in its
/// source.
inline void holdUntested(DeviceInfo& info) {
  info.limits.peak = std::min(info.limits.peak, kUntestedForce);
  info.max_stiffness = std::min(info.max_stiffness, kUntestedStiffness);
  info.source += "; untested: limited to 1 N and 100 N/m until palpate devices --test has passed";
}

/// Functions and settings that an arm gets from the program that opens it. All may be empty.
struct ArmHost {
  /// Prints an instruction for the user. When a lost arm returns, another thread calls it.
  std::function<void(const std::string&)> say = nullptr;
  /// Returns true if the program should end; waits for the user then end.
  std::function<bool()> stop = nullptr;
  /// The arm's measured friction, for the energy tank; zeros if it is unknown.
  MeasuredArm measured = {};
  TankUse tank = TankUse::kObserve;  ///< Off if too little is known of the friction.
  double refill = 0.0;               ///< TankParams::refill [W].
  bool tests = false;    ///< Being tested: a PID device has its full gain; all limits still hold.
  double carries = 1.0;  ///< Largest weight at the tip that an arm carries before it has passed its
                         ///< test [N]. A tested arm carries as much as its motors can.
  /// Clock for the age of reports and writes [ns]; called in ticks. The machine's clock, or a
  /// test's.
  std::int64_t (*now)() noexcept = nowNs;
};

/// The key under which an arm's test is stored. A test is valid only for this arm with the same
/// description.
struct ArmIdentity {
  std::string name;  ///< Name of the description: a profile's name, `plugin:NAME`.
  std::string own;   ///< Serial number, or the port where it is plugged in; empty: neither.
  std::uint64_t fingerprint = 0;  ///< Fingerprint of the whole description.
  bool numbered = true;           ///< `own` is a serial number.
};

/// Returns a fingerprint of a text, such as an arm's description or name: FNV-1a.
[[nodiscard]] constexpr std::uint64_t fingerprintOf(std::string_view text) noexcept {
  std::uint64_t print = 14695981039346656037ULL;
  for (const char c : text) print = (print ^ static_cast<unsigned char>(c)) * 1099511628211ULL;
  return print;
}

/// Counts of readings and writes since an arm was opened.
struct ArmTraffic {
  std::int64_t dropped = 0;     ///< Readings that were discarded because they were old.
  std::int64_t writes = 0;      ///< Forces that were sent.
  std::int64_t longest_ns = 0;  ///< The longest write [ns].
};

/// Properties of an arm that never change.
struct ArmTraits {
  bool drives = true;             ///< The arm has motors.
  Mat3 moves = Mat3::Identity();  ///< Projects onto the directions of W in which it moves.
  Vec3 down_W = -Vec3::UnitZ();   ///< Direction in which masses fall.
  double input_rate = 1000.0;     ///< Positions per second [Hz].
  double stiffness = 0.0;         ///< Largest coupling stiffness of the tested arm [N/m].
  double workspace_radius = 0.0;  ///< [m]
  bool carries = false;           ///< The motors carry the arm's weight.
};

/// An arm with a hand on it.
class Arm : public Device {
 public:
  [[nodiscard]] virtual const ArmTraits& traits() const noexcept = 0;  ///< They never change.
  /// Returns why the last read() was not ready, with a remedy; empty: it was ready. Call it on the
  /// thread that reads.
  [[nodiscard]] virtual std::string whyNotReady() const = 0;
  /// Returns the tip's step for one count of each encoder, at the last reading [m]; empty: unknown.
  [[nodiscard]] virtual std::vector<double> steps() const = 0;
  /// Returns the counts. Call it on the thread that reads.
  [[nodiscard]] virtual ArmTraffic traffic() const = 0;
};

}  // namespace palpate
