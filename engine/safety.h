/// What may go wrong between an engine and a hand: causes, their remedies, and the checks of the
/// hand's position. Each cause cuts the force and is latched: ProxyState::clearFault lets force out
/// again, by an engagement (limit_force.h).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "palpate/engine/handle.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Why the force is cut.
enum class Fault : std::uint8_t {
  kNone,
  kNotFinite,   ///< A position, sample or force was not finite: mend the device or the volume.
  kLate,        ///< A tick came later than WatchLimits::late: give the loop a core, real-time
                ///< priority or a lower rate.
  kStale,       ///< The device's position is older than WatchLimits::stale, or something else that
                ///< the device reports is older than it may be: see to its cable, or to the program
                ///< that shares it.
  kJump,        ///< The position stepped faster than a hand can: an encoder lost count; home the
                ///< device.
  kOverSpeed,   ///< The device was faster than it may be, and stayed so although it was braked:
                ///< hold it; if it runs away by itself its motors' signs are wrong.
  kWrite,       ///< The device did not take a force in time: see to its cable.
  kGone,        ///< The device is unplugged: plug it in again.
  kMiscounted,  ///< Nobody has read the device for so long that its counters may have gone round:
                ///< home the arm again.
  kTemperature,  ///< The device says that it is too hot: let it cool.
  kPower,        ///< The device says that it has no power: switch it on.
  kSwitch,       ///< The device's safety switch is open: close it.
  kHeartbeat,    ///< The application has not called HapticThread::beat in time: it hangs.
  kUnguarded,    ///< The guardian process shows no life: start the program again.
  kStopped,      ///< Somebody asked for the cut, by a key, a signal or HapticThread::cut.
  kVolume,       ///< What a volume is fetched from is not there any more: bring it back.
};
inline constexpr std::size_t kFaults = 16;  ///< Number of values of Fault, kNone among them.

/// What happened at a fault, for messages: "the device's reports are too old".
[[nodiscard]] const char* wordsFor(Fault fault) noexcept;
/// What to do about a fault: "see to its cable".
[[nodiscard]] const char* remedyFor(Fault fault) noexcept;
/// A fault's word for traces and JSON: "stale".
[[nodiscard]] const char* wordFor(Fault fault) noexcept;

/// One reading of the hand.
struct HandState {
  Vec3 position = Vec3::Zero();  ///< The probe in W [m].
  double age = 0.0;    ///< Time since `position` was read [s]: an arm that is slower than the loop
                       ///< gives the same position again, older. Whatever is counted by paths and
                       ///< times (the energy tank) relies on this: see NewReadings.
  bool ready = true;   ///< The arm is homed, and its dead-man switch held, where it has them. Else
                       ///< no force goes out, and an engagement begins when it is ready.
  double still = 0.0;  ///< How long its counters have stood still, to the last count [s]; 0 where
                       ///< the device does not measure this. See StillFade.
  Fault fault = Fault::kNone;  ///< Fault that the device reports.
  /// Projects a force onto those that the motors can give at this position: a planar arm gives none
  /// across its plane. The projected force is the one that is counted and limited.
  Mat3 drives = Mat3::Identity();
  Handle handle{};  ///< What else the arm says.
  /// The members from here on are filled in by HandWatch.
  Vec3 velocity = Vec3::Zero();  ///< Velocity of the hand [m/s].
  bool too_fast = false;         ///< The hand is faster than `max_speed` and to be braked.
  double max_speed = 0.0;        ///< WatchLimits::max_speed [m/s].
};

/// Tells new readings from repeated ones: a repeated position has the same bits and a greater age.
/// A new reading of the same bits that happens to be older than the last one counts as repeated:
/// then the hand rests, and the next one counts for the whole time.
class NewReadings {
 public:
  /// True if the position was read since the last call, or this is the first call. RT: no
  /// allocation.
  [[nodiscard]] bool look(const HandState& hand) noexcept PALPATE_NONBLOCKING;

 private:
  bool known_ = false;
  Vec3 position_ = Vec3::Zero();
  double age_ = 0.0;
};

/// What a hand may do. The defaults are safe for any desktop arm.
struct WatchLimits {
  double stale = 0.05;     ///< Largest age of a position [s], set by the device's profile.
  double max_speed = 3.0;  ///< Largest speed [m/s]: braked above it, cut after kBraked.
  double late = 0.005;     ///< Largest delay of a tick [s], or three ticks where they are longer.
};

/// Checks positions as they come in.
class HandWatch {
 public:
  /// Knows no position yet: the first one cannot be a jump, and has no velocity.
  explicit HandWatch(const WatchLimits& limits = {}) noexcept : limits_(limits) {}

  /// Fills in velocity, max_speed and too_fast, by positions alone: what a device says of its
  /// velocity (Handle::velocity) neither brakes a hand nor hides that it is too fast.
  ///
  /// @param now   Time [s], of any clock that does not go back.
  /// @return      Why the force is to be cut; kNone: the force need not be cut.
  /// RT: no allocation.
  [[nodiscard]] Fault look(HandState& hand, double now) noexcept PALPATE_NONBLOCKING;
  /// Forgets all positions, as after a fault: the next position is the first.
  void forget() noexcept {
    known_ = false;
    fast_since_ = -1.0;
  }

 private:
  static constexpr double kJumpSpeed = 5.0;   ///< [m/s]: a hand does not step faster.
  static constexpr double kLeastJump = 1e-3;  ///< [m]: less hurts nobody; covers uneven stamps.
  static constexpr double kSmooth = 0.005;    ///< [s]: time constant of the velocity.
  static constexpr double kBraked = 0.05;     ///< [s]: too fast for longer although braked is cut.

  WatchLimits limits_;
  bool known_ = false;
  double time_ = 0.0;  ///< Time of the last new position [s].
  Vec3 position_ = Vec3::Zero();
  Vec3 velocity_ = Vec3::Zero();
  double fast_since_ = -1.0;  ///< Since when the hand is too fast [s]; below 0: it is not.
};

/// Returns the force after a cut whose only cause was late ticks, as on a loaded machine. Any other
/// fault stays latched until the application clears it, and so does a pause of more than kPause: a
/// program that was stopped, or a machine that slept.
class Reengagement {
 public:
  /// @param after  Time without a late tick before the force returns [s]; 0: it never returns.
  explicit Reengagement(double after) noexcept : after_(after) { returned_.fill(-kWithin); }

  /// Returns true if the loop shall clear the fault now; an engagement then ramps the force up.
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

/// Takes the force off an arm that does not move under the force. Firmware that sends its last
/// counters again and again would keep whatever force was right when it stopped to read them.
///
/// Nothing tells such an arm from one that is held still but the time that it stays so. Where no
/// counter has moved for kStill while more force goes out than friction can hold, the force fades
/// to nothing in kFade. A living hand is moved by a count long before that, and the force comes
/// back at the same pace. Meanwhile friction has held the arm: of the force that the motors did not
/// give, a hand feels no more than that friction and its own stiffness times a count.
class StillFade {
 public:
  /// The share of the force that is left, 0 to 1.
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

/// Lets out little by little what data that change by themselves do to the force at once. A surface
/// that is played and leaves the voxels that have data is gone between two ticks, and what it held
/// with it. A force may fall as fast as it likes where the hand has let it; not where nothing but
/// the data has moved.
///
/// From such a step on the force follows what is wanted, by df/dt = (wanted - f) / (kBegin (1 -
/// t/kEnd)): never more than what was wanted since, nor otherwise directed, and after kEnd all of
/// it. The part held back, h = f - wanted, also falls by k for each metre that the hand moves along
/// it, as the coupling spring's force does. So it does at most |h|^2 / (2 k) of work on the hand,
/// the energy that the spring held.
class DataFade {
 public:
  /// The force that is let out [N].
  ///
  /// @param wanted  The spring's force in this tick [N].
  /// @param step    A step by more than this is the data's [N]; infinite: they have not changed.
  /// @param eased   k times the hand's displacement since the last tick [N].
  /// @param dt      Time since the last tick [s]; without time nothing is held back.
  /// RT: no allocation.
  [[nodiscard]] Vec3 pass(const Vec3& wanted, double step, const Vec3& eased,
                          double dt) noexcept PALPATE_NONBLOCKING;
  /// To be called where no force goes out, or another one.
  void forget() noexcept { *this = {}; }

  static constexpr double kBegin = 0.02;  ///< [s]
  static constexpr double kEnd = 0.1;     ///< [s]

 private:
  Vec3 wanted_ = Vec3::Zero();  ///< In the last tick [N],
  Vec3 out_ = Vec3::Zero();     ///< and what was let out.
  double left_ = 0.0;           ///< Until it is all [s].
  bool known_ = false;          ///< There was a last tick.
};

/// The force on a hand that is too fast [N]: `force` without what drives the hand, and against the
/// motion kBrake (|v| - max_speed).
[[nodiscard]] Vec3 brake(const Vec3& force, const Vec3& velocity,
                         double max_speed) noexcept PALPATE_NONBLOCKING;
inline constexpr double kBrake = 2.0;  ///< [N s/m]: half of what common arms render (Touch: 4).

}  // namespace palpate
