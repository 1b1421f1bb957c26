/// Faults between an engine and a hand: causes, remedies, and the checks of the hand's position.
/// Each cause cuts the force and is latched. ProxyState::clearFault lets force out again, by an
/// engagement (limit_force.h).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "palpate/engine/safety/handle.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Cause of a cut of the force.
enum class Fault : std::uint8_t {
  kNone,
  kNotFinite,    ///< A position, sample or force was not finite: repair the device or the volume.
  kLate,         ///< A tick came later than WatchLimits::late: give the loop a core, real-time
                 ///< priority or a lower rate.
  kStale,        ///< The device's position is older than WatchLimits::stale, or another report of
                 ///< the device is too old: check its cable, or the program that shares it.
  kJump,         ///< The position stepped faster than a hand can move: an encoder lost count; home
                 ///< the device.
  kOverSpeed,    ///< The device was too fast, and stayed so although it was braked: hold it. If it
                 ///< runs away by itself, the signs of its motors are wrong.
  kWrite,        ///< The device did not take a force in time: check its cable.
  kGone,         ///< The device is unplugged: plug it in again.
  kMiscounted,   ///< The device was not read for so long that its counters may have wrapped round:
                 ///< home the arm again.
  kTemperature,  ///< The device reports that it is too hot: let it cool.
  kPower,        ///< The device reports that it has no power: switch it on.
  kSwitch,       ///< The device's safety switch is open: close it.
  kHeartbeat,    ///< The application has not called HapticThread::beat in time: it hangs.
  kUnguarded,    ///< The guardian process does not respond: start the program again.
  kStopped,      ///< The cut was requested, by a key, a signal or HapticThread::cut.
  kVolume,       ///< The source of a volume is missing: restore it.
};
inline constexpr std::size_t kFaults = 16;  ///< Number of values of Fault, kNone included.

/// Returns the description of a fault for messages: "the device's reports are too old".
[[nodiscard]] const char* wordsFor(Fault fault) noexcept;
/// Returns the remedy for a fault: "see to its cable".
[[nodiscard]] const char* remedyFor(Fault fault) noexcept;
/// Returns a fault's word for traces and JSON: "stale".
[[nodiscard]] const char* wordFor(Fault fault) noexcept;

/// One reading of the hand.
struct HandState {
  Vec3 position = Vec3::Zero();  ///< The probe in W [m].
  double age = 0.0;    ///< Time since `position` was read [s]: an arm that is slower than the loop
                       ///< repeats the same position, older. All counts of paths and times (the
                       ///< energy tank) rely on this: see NewReadings.
  bool ready = true;   ///< The arm is homed and its dead-man switch held, if it has them. Else the
                       ///< force is zero, and an engagement begins when the arm is ready.
  double still = 0.0;  ///< Time for which its counters have stood still, to the last count [s]; 0
                       ///< if the device does not measure this. See StillFade.
  Fault fault = Fault::kNone;  ///< Fault that the device reports.
  /// Projects a force onto those that the motors can give at this position: a planar arm gives none
  /// across its plane. The projected force is the one that is counted and limited.
  Mat3 drives = Mat3::Identity();
  Handle handle{};  ///< Further readings of the arm.
  /// HandWatch fills in the members from here on.
  Vec3 velocity = Vec3::Zero();  ///< Velocity of the hand [m/s].
  bool too_fast = false;         ///< The hand is faster than `max_speed` and must be braked.
  double max_speed = 0.0;        ///< WatchLimits::max_speed [m/s].
};

/// Distinguishes new readings from repeated ones: a repeated position has the same bits and a
/// greater age. A new reading with the same bits that happens to be older than the last one counts
/// as repeated. The hand then rests, and the next reading counts for the whole time.
class NewReadings {
 public:
  /// Returns true if the position was read since the last call, or this is the first call. RT: no
  /// allocation.
  [[nodiscard]] bool look(const HandState& hand) noexcept PALPATE_NONBLOCKING;

 private:
  bool known_ = false;
  Vec3 position_ = Vec3::Zero();
  double age_ = 0.0;
};

/// Limits for a hand. The defaults are safe for any desktop arm.
struct WatchLimits {
  double stale = 0.05;     ///< Largest age of a position [s], set by the device's profile.
  double max_speed = 3.0;  ///< Largest speed [m/s]: braked above it, cut after kBraked.
  double late = 0.005;     ///< Largest delay of a tick [s], or three ticks if they are longer.
};

/// Checks incoming positions.
class HandWatch {
 public:
  /// Starts without a position: the first one cannot be a jump, and has no velocity.
  explicit HandWatch(const WatchLimits& limits = {}) noexcept : limits_(limits) {}

  /// Fills in velocity, max_speed and too_fast, from positions alone: a velocity reported by the
  /// device (Handle::velocity) neither brakes a hand nor hides that it is too fast.
  ///
  /// @param now   Time [s], of any clock that does not go back.
  /// @return      Cause for a cut of the force; kNone: the force need not be cut.
  /// RT: no allocation.
  [[nodiscard]] Fault look(HandState& hand, double now) noexcept PALPATE_NONBLOCKING;
  /// Forgets all positions, as after a fault: the next position is the first.
  void forget() noexcept {
    known_ = false;
    fast_since_ = -1.0;
  }

 private:
  static constexpr double kJumpSpeed = 5.0;   ///< [m/s]: a hand does not step faster.
  static constexpr double kLeastJump = 1e-3;  ///< [m]: less is harmless; covers uneven time stamps.
  static constexpr double kSmooth = 0.005;    ///< [s]: time constant of the velocity.
  static constexpr double kBraked = 0.05;     ///< [s]: if a braked hand stays too fast for longer,
                                              ///< the force is cut.

  WatchLimits limits_;
  bool known_ = false;
  double time_ = 0.0;  ///< Time of the last new position [s].
  Vec3 position_ = Vec3::Zero();
  Vec3 velocity_ = Vec3::Zero();
  double fast_since_ = -1.0;  ///< Time since when the hand is too fast [s]; below 0: it is not.
};

/// Lets the force return after a cut that only late ticks caused, as on a loaded machine. Any other
/// fault stays latched until the application clears it. The same holds after a pause of more than
/// kPause: a program that was stopped, or a machine that slept.
class Reengagement {
 public:
  /// @param after  Time without a late tick before the force returns [s]; 0: it never returns.
  explicit Reengagement(double after) noexcept : after_(after) { returned_.fill(-kWithin); }

  /// Returns true if the loop must clear the fault now; an engagement then ramps the force up.
  ///
  /// @param latched  The latched fault; kNone: the force is not cut.
  /// @param wrong    Fault condition since the last call: kLate only if there was no other.
  /// @param now      Time [s], of any clock that does not go back, >= 0.
  /// RT: no allocation.
  [[nodiscard]] bool look(Fault latched, Fault wrong, double now) noexcept PALPATE_NONBLOCKING;

  static constexpr std::size_t kMost = 3;  ///< Most returns
  static constexpr double kWithin = 60.0;  ///< within this time [s].
  static constexpr double kPause = 0.5;    ///< [s]

 private:
  double after_;
  double last_ = 0.0;  ///< Time of the last call [s].
  double good_since_ = 0.0;
  bool others_ = false;                   ///< Another fault condition occurred since the cut.
  std::array<double, kMost> returned_{};  ///< Times of the last returns [s].
  std::size_t next_ = 0;
};

/// Removes the force from an arm that does not move under the force. If the firmware stops reading
/// its encoders but keeps sending the last counts, the last force would stay on.
///
/// Only the time distinguishes this arm from one that is held still. If no counter has moved for
/// kStill while the force is larger than friction can hold, the force fades to zero in kFade. A
/// living hand moves by a count long before that, and the force then comes back at the same pace.
/// During the fade friction has held the arm. So of the force that the motors did not give, a hand
/// feels at most that friction and its own stiffness times a count.
class StillFade {
 public:
  /// Returns the share of the force that is left, 0 to 1.
  ///
  /// @param force     Magnitude of the force that goes out [N].
  /// @param still     HandState::still [s].
  /// @param friction  Less force than this may leave the arm where it is [N].
  /// RT: no allocation.
  [[nodiscard]] double pass(double force, double still, double friction,
                            double dt) noexcept PALPATE_NONBLOCKING;

  static constexpr double kStill = 0.5;  ///< [s]
  static constexpr double kFade = 0.5;   ///< [s]

 private:
  double left_ = 1.0;
};

/// Spreads out in time the step of the force that changing data cause. If a surface that is played
/// leaves the voxels that have data, it disappears between two ticks, and its force with it. A
/// force may fall at any rate if the hand has released it, but not if only the data have moved.
///
/// From this step on the force f follows the wanted force, by df/dt = (wanted - f) / (kBegin (1 -
/// t/kEnd)). It never exceeds the forces wanted since, nor has another direction, and after kEnd it
/// is the wanted force. The part held back, h = f - wanted, also falls by k for each metre that the
/// hand moves along it, as the coupling spring's force does. So it does at most |h|^2 / (2 k) of
/// work on the hand, the energy that the spring held.
class DataFade {
 public:
  /// Returns the force that is let out [N].
  ///
  /// @param wanted  The spring's force in this tick [N].
  /// @param step    A larger step is caused by the data [N]; infinite: they have not changed.
  /// @param eased   k times the hand's displacement since the last tick [N].
  /// @param dt      Time since the last tick [s]; if not above 0, the whole force is let out.
  /// RT: no allocation.
  [[nodiscard]] Vec3 pass(const Vec3& wanted, double step, const Vec3& eased,
                          double dt) noexcept PALPATE_NONBLOCKING;
  /// Call this if no force goes out, or another one.
  void forget() noexcept { *this = {}; }

  static constexpr double kBegin = 0.02;  ///< [s]
  static constexpr double kEnd = 0.1;     ///< [s]

 private:
  Vec3 wanted_ = Vec3::Zero();  ///< Force wanted in the last tick [N].
  Vec3 out_ = Vec3::Zero();     ///< Force let out in the last tick [N].
  double left_ = 0.0;           ///< Time until all of it is let out [s].
  bool known_ = false;          ///< There was a last tick.
};

/// Returns the force on a hand that is too fast [N]: `force` without the part that drives the hand,
/// and kBrake (|v| - max_speed) against the motion.
[[nodiscard]] Vec3 brake(const Vec3& force, const Vec3& velocity,
                         double max_speed) noexcept PALPATE_NONBLOCKING;
inline constexpr double kBrake = 2.0;  ///< [N s/m]: half of what common arms render (Touch: 4).

}  // namespace palpate
