/// What a test, a list and a program that opens an arm ask of any, whatever speaks to it: a HID
/// device by its profile, one of the PID class, a plug-in.
#pragma once

#include <algorithm>
#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "palpate/engine/device.h"
#include "palpate/engine/realtime.h"

namespace palpate {

/// What `palpate devices --test` has found of an arm, from the safe side; zeros: nothing.
struct MeasuredArm {
  double viscous = 0.0;  ///< [N s/m], at most the arm's along any axis that it has motors for.
  double coulomb = 0.0;  ///< [N], likewise.
  double delay = 0.0;    ///< From a reading to the force that follows from it [s], the middle of
  double doubt = 0.0;    ///< what the test leaves possible, and half its width [s].
  double mass = 0.0;     ///< [kg], the least along any axis.
};

/// What an arm that has not passed `palpate devices --test` is held to.
inline constexpr double kUntestedForce = 1.0;        ///< [N]
inline constexpr double kUntestedStiffness = 100.0;  ///< [N/m]

/// Holds an arm with a hand on it that has not passed to that, and says so in its source.
inline void holdUntested(DeviceInfo& info) {
  info.limits.peak = std::min(info.limits.peak, kUntestedForce);
  info.max_stiffness = std::min(info.max_stiffness, kUntestedStiffness);
  info.source += "; untested: 1 N and 100 N/m until palpate devices --test has passed";
}

/// What an arm asks of the program that opens it. All may be empty.
struct ArmHost {
  /// Told what the user is to do; when the arm has come back, on a thread of its own.
  std::function<void(const std::string&)> say = nullptr;
  /// True: the program is to end, so that nobody waits for a button any more.
  std::function<bool()> stop = nullptr;
  /// What is known of the arm's friction, and what the energy tank does with it; nothing where it
  /// is not known.
  MeasuredArm measured = {};
  TankUse tank = TankUse::kObserve;  ///< Off where too little is known of its friction.
  double refill = 0.0;               ///< TankParams::refill [W].
  bool tests = false;    ///< The arm is to be tested: what it gives is what it is asked for.
  double carries = 1.0;  ///< The most of its weight that an arm carries that has not passed its
                         ///< test, at the tip [N]; others as their motors can.
  /// What reports and writes grow old by [ns]; called in ticks. The machine's clock, or a test's.
  std::int64_t (*now)() noexcept = nowNs;
};

/// By what an arm's test is remembered: what has passed is this very arm, described as it was.
struct ArmIdentity {
  std::string name;               ///< What describes it: a profile's name, `plugin:NAME`.
  std::string own;                ///< Its serial number, or where it is plugged in; empty: neither.
  std::uint64_t fingerprint = 0;  ///< Of all that describes it.
  bool numbered = true;           ///< `own` is a serial number.
};

/// Tells descriptions of arms, names and such apart: FNV-1a.
[[nodiscard]] constexpr std::uint64_t fingerprintOf(std::string_view text) noexcept {
  std::uint64_t print = 14695981039346656037ULL;
  for (const char c : text) print = (print ^ static_cast<unsigned char>(c)) * 1099511628211ULL;
  return print;
}

/// What has come and gone since an arm was opened.
struct ArmTraffic {
  std::int64_t dropped = 0;     ///< Readings that were thrown away, being old.
  std::int64_t writes = 0;      ///< Forces that were sent.
  std::int64_t longest_ns = 0;  ///< The longest write [ns].
};

/// What never changes of an arm.
struct ArmTraits {
  bool drives = true;             ///< It has motors.
  Mat3 moves = Mat3::Identity();  ///< Projects onto the directions of W in which it moves.
  Vec3 down_W = -Vec3::UnitZ();   ///< Where masses fall to.
  double input_rate = 1000.0;     ///< Positions a second [Hz].
  double stiffness = 0.0;         ///< Largest coupling stiffness, once tested [N/m].
  double workspace_radius = 0.0;  ///< [m]
  bool carries = false;           ///< Its motors carry its weight.
};

/// An arm with a hand on it.
class Arm : public Device {
 public:
  [[nodiscard]] virtual const ArmTraits& traits() const noexcept = 0;  ///< Never change.
  /// Why the last read() was not ready, with a remedy; empty: it was. On the thread that reads.
  [[nodiscard]] virtual std::string whyNotReady() const = 0;
  /// The tip's step for one count of each of its encoders, at the last reading [m]; empty: unknown.
  [[nodiscard]] virtual std::vector<double> steps() const = 0;
  /// On the thread that reads.
  [[nodiscard]] virtual ArmTraffic traffic() const = 0;
};

}  // namespace palpate
