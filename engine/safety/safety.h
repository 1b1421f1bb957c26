/// Faults, and the checks of the hand's position. A fault cuts the force and stays latched.
/// ProxyState::clearFault lets the force return through an engagement (limit_force.h).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "palpate/engine/safety/handle.h"
#include "palpate/engine/types.h"

namespace palpate {

/// The cause of a cut of the force, with the remedy.
enum class Fault : std::uint8_t {
  kNone,
  kNotFinite,  ///< A position, sample or force was not finite, or a position was 1e6 m or more.
               ///< Repair the device or the volume.
  kLate,   ///< A tick was too late or too long (WatchLimits::late), or the guardian cut the force.
           ///< Give the loop a core, real-time priority or a lower rate.
  kStale,  ///< The device's position or another report is too old (WatchLimits::stale). Check the
           ///< cable, or the program that shares the device.
  kJump,   ///< The position changed too fast for a hand: an encoder may have lost counts. Home the
           ///< device.
  kOverSpeed,  ///< The device stayed too fast although it was braked. Hold it, and check the signs
               ///< of its motors.
  kWrite,      ///< The device did not take a force in time. Check its cable or plug-in.
  kGone,  ///< The device is unplugged, or its plug-in no longer answers. Plug it in again, or check
          ///< the plug-in.
  kMiscounted,   ///< The device's counters may have wrapped around between two readings. Home it.
  kTemperature,  ///< The device reports that it is too hot. Let it cool.
  kPower,        ///< The device reports that it has no power. Switch it on.
  kSwitch,       ///< The device's safety switch is open. Close it.
  kHeartbeat,    ///< The application did not call HapticThread::beat in time.
  kUnguarded,    ///< The guardian process does not respond. Start the program again.
  kStopped,      ///< A key, a signal or HapticThread::cut requested the cut.
  kVolume,       ///< The source of a volume is missing. Restore it.
};
inline constexpr std::size_t kFaults = 16;  ///< Number of values of Fault, including kNone.

/// Returns the description of a fault for messages, such as "the device's reports are too old".
[[nodiscard]] const char* wordsFor(Fault fault) noexcept;
/// Returns the remedy for a fault, such as "check its cable".
[[nodiscard]] const char* remedyFor(Fault fault) noexcept;
/// Returns the word for a fault in traces and JSON, such as "stale".
[[nodiscard]] const char* wordFor(Fault fault) noexcept;

/// One reading of the hand.
struct HandState {
  Vec3 position = Vec3::Zero();  ///< Position of the probe in W [m].
  double age =
      0.0;  ///< Age of `position` [s]; it grows while an arm repeats a position (NewReadings).
  /// True if the arm is homed and its dead-man switch is held, as far as it has these. If false,
  /// the force is zero. An engagement begins when the arm becomes ready.
  bool ready = true;
  double still =
      0.0;  ///< Time for which no counter has changed [s]; 0 if not measured. See StillFade.
  Fault fault = Fault::kNone;  ///< Fault that the device reports.
  /// Projects a force on the directions in which the motors can push here; a planar arm has two.
  /// The engine counts and limits the projected force.
  Mat3 drives = Mat3::Identity();
  Handle handle{};  ///< Further readings of the arm.
  /// HandWatch fills in the members below.
  Vec3 velocity = Vec3::Zero();  ///< Velocity of the hand [m/s].
  bool too_fast =
      false;  ///< True if the hand is faster than `max_speed`; the loop then brakes the hand.
  double max_speed = 0.0;  ///< WatchLimits::max_speed [m/s].
};

/// Distinguishes new readings from repeated ones, which have the same position and a greater age.
/// If the hand rests, a new reading may look repeated. The next reading that counts as new then
/// covers the time of both.
class NewReadings {
 public:
  /// Returns false if `hand` has the position of the last call and a greater age; else true. RT: no
  /// allocation.
  [[nodiscard]] bool look(const HandState& hand) noexcept PALPATE_NONBLOCKING;

 private:
  bool known_ = false;
  Vec3 position_ = Vec3::Zero();
  double age_ = 0.0;
};

/// Limits of the hand's motion and timing. The defaults suit desktop arms.
struct WatchLimits {
  double stale = 0.05;  ///< Largest age of a position [s]; set by the device's profile.
  /// Largest speed [m/s]. The loop brakes a faster hand, and after 0.05 s cuts the force.
  double max_speed = 3.0;
  double late = 0.005;  ///< Largest delay of a tick [s]; the loop allows at least three periods.
};

/// Checks incoming positions.
class HandWatch {
 public:
  /// Starts without a position. The first position cannot be a jump, and has zero velocity.
  explicit HandWatch(const WatchLimits& limits = {}) noexcept : limits_(limits) {}

  /// Fills in velocity, max_speed and too_fast, from positions only (not Handle::velocity). Leaves
  /// them unchanged if it returns a fault other than kOverSpeed.
  ///
  /// @param now   Time [s] of any monotonic clock.
  /// @return      The cause if the force must be cut, else kNone.
  /// RT: no allocation.
  [[nodiscard]] Fault look(HandState& hand, double now) noexcept PALPATE_NONBLOCKING;
  /// Forgets all positions, for example after a fault. The next position counts as the first.
  void forget() noexcept {
    known_ = false;
    fast_since_ = -1.0;
  }

 private:
  /// Largest speed between two positions of a hand [m/s]; a greater speed is a jump.
  static constexpr double kJumpSpeed = 5.0;
  /// A step up to this is not a jump, because uneven time stamps can cause it [m].
  static constexpr double kLeastJump = 1e-3;
  static constexpr double kSmooth = 0.005;  ///< Time constant of the velocity [s].
  /// Longest time that a braked hand may exceed `max_speed` [s].
  static constexpr double kBraked = 0.05;

  WatchLimits limits_;
  bool known_ = false;
  double time_ = 0.0;
  Vec3 position_ = Vec3::Zero();
  Vec3 velocity_ = Vec3::Zero();
  /// Time at which the hand became too fast [s]; below 0 if it is not.
  double fast_since_ = -1.0;
};

/// Decides when the force returns after a cut that only late ticks caused. After another fault, or
/// a pause of more than kPause, the application must clear the fault. After kMost returns within
/// kWithin, the force stays cut until kWithin is over or the application clears the fault.
class Reengagement {
 public:
  /// @param after  Time without late ticks after which the force returns [s]; 0 for never.
  explicit Reengagement(double after) noexcept : after_(after) { returned_.fill(-kWithin); }

  /// Returns true if the loop must clear the fault now. An engagement then ramps the force up.
  ///
  /// @param latched  The latched fault; kNone if the force is not cut.
  /// @param wrong    The fault condition since the last call; kLate only if there was no other.
  /// @param now      Time [s] of any monotonic clock, >= 0.
  /// RT: no allocation.
  [[nodiscard]] bool look(Fault latched, Fault wrong, double now) noexcept PALPATE_NONBLOCKING;

  static constexpr std::size_t kMost = 3;  ///< Largest number of returns within kWithin.
  static constexpr double kWithin = 60.0;  ///< Time span for kMost [s].
  static constexpr double kPause = 0.5;    ///< After a longer pause the force does not return [s].

 private:
  double after_;
  double last_ = 0.0;
  double good_since_ = 0.0;
  bool others_ = false;  ///< True if there was another fault condition or a pause since the cut.
  std::array<double, kMost> returned_{};  ///< Times of the last returns [s].
  std::size_t next_ = 0;
};

/// Fades the force on an arm that does not move under the force. If the firmware stops reading its
/// encoders but keeps sending the last counts, the last force would stay on.
///
/// Only the time distinguishes this arm from an arm that a hand holds still. If no counter has
/// changed for kStill while the force is larger than the friction, the force fades to zero in
/// kFade. A real hand usually moves by a count long before kStill. When a counter changes, or the
/// force falls to the friction, the force returns at the same rate. The force that is missing at
/// that moment is at most twice the friction, plus the stiffness of the hand times one count.
class StillFade {
 public:
  /// Returns the share of the force that is left, 0 to 1.
  ///
  /// @param force     Magnitude of the force before the fade [N].
  /// @param still     HandState::still [s].
  /// @param friction  A smaller force than this may fail to move the arm [N].
  /// @param dt        Time since the last tick [s]. If not above 0, the share stays.
  /// RT: no allocation.
  [[nodiscard]] double pass(double force, double still, double friction,
                            double dt) noexcept PALPATE_NONBLOCKING;

  /// Time without a changed counter after which the fade begins [s].
  static constexpr double kStill = 0.5;
  static constexpr double kFade = 0.5;  ///< Length of the fade [s].

 private:
  double left_ = 1.0;
};

/// Smooths a step of the force that changing data cause, such as a surface of a sequence that
/// leaves the data between two ticks.
///
/// From this step on the force f follows the wanted force, by df/dt = (wanted - f) / (kBegin (1 -
/// t/kEnd)). f stays between the forces that were wanted since then. After kEnd, f is the wanted
/// force. The remainder h = f - wanted also falls by k for each metre that the hand moves along h.
/// So its work on the hand is at most |h|^2 / (2 k), the energy that the spring held.
class DataFade {
 public:
  /// Returns the smoothed force [N].
  ///
  /// @param wanted  The spring's force in this tick [N].
  /// @param step    Smallest step that counts as caused by the data [N]; infinite if they have not
  ///                changed.
  /// @param eased   k times the hand's displacement since the last tick [N].
  /// @param dt      Time since the last tick [s]. If not above 0, the wanted force is returned.
  /// RT: no allocation.
  [[nodiscard]] Vec3 pass(const Vec3& wanted, double step, const Vec3& eased,
                          double dt) noexcept PALPATE_NONBLOCKING;
  /// Forgets the last force. Call this function if no force or another force is sent.
  void forget() noexcept { *this = {}; }

  static constexpr double kBegin = 0.02;  ///< Initial time constant [s].
  static constexpr double kEnd = 0.1;     ///< Time after which the force is the wanted force [s].

 private:
  Vec3 wanted_ = Vec3::Zero();
  Vec3 out_ = Vec3::Zero();
  double left_ = 0.0;  ///< Time until the returned force is the wanted force [s].
  bool known_ = false;
};

/// Returns the force on a hand that is too fast [N]: `force` without the part that drives the hand,
/// plus kBrake (|v| - max_speed) against the motion.
[[nodiscard]] Vec3 brake(const Vec3& force, const Vec3& velocity,
                         double max_speed) noexcept PALPATE_NONBLOCKING;
/// Damping of brake() [N s/m]: half of the damping that common arms render stably (Touch: 4).
inline constexpr double kBrake = 2.0;

}  // namespace palpate
