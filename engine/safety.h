/// What may go wrong between an engine and a hand: causes, their remedies, and the checks of the
/// hand's position. Each cause cuts the force and is latched: ProxyState::clearFault lets it out
/// again, by an engagement (limit_force.h).
#pragma once

#include <cstddef>
#include <cstdint>

#include "palpate/engine/types.h"

namespace palpate {

/// Why the force is cut.
enum class Fault : std::uint8_t {
  kNone,
  kNotFinite,   ///< A position, sample or force was not finite: mend the device or the volume.
  kLate,        ///< A tick came later than WatchLimits::late: give the loop a core, real-time
                ///< priority or a lower rate.
  kStale,       ///< The device's position is older than WatchLimits::stale, or something else that
                ///< it has to say is older than it may be: see to its cable, or to the program that
                ///< shares it.
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
  kStopped,      ///< Somebody asked for it, by a key, a signal or HapticThread::cut.
};
inline constexpr std::size_t kFaults = 15;

/// What happened, for messages: "the device's reports are too old".
[[nodiscard]] const char* wordsFor(Fault fault) noexcept;
/// What to do about it: "see to its cable".
[[nodiscard]] const char* remedyFor(Fault fault) noexcept;
/// A word for traces and JSON: "stale".
[[nodiscard]] const char* wordFor(Fault fault) noexcept;

/// One reading of the hand.
struct HandState {
  Vec3 position = Vec3::Zero();  ///< The probe in W [m].
  double age = 0.0;    ///< Of that position [s]: an arm that is slower than the loop gives
                       ///< the same one again, older,
  bool fresh = true;   ///< and says here that it is none that was read since. Whatever is
                       ///< counted by ways and times (the energy tank) relies on it.
  bool ready = true;   ///< Homed, and its dead-man switch held, where it has them. Else no
                       ///< force, and an engagement when it is.
  double still = 0.0;  ///< So long have its counters stood still, to the last count [s]; 0 where
                       ///< the device does not look. See StillFade.
  Fault fault = Fault::kNone;  ///< What the device reports.
  /// Projects a force onto those that its motors can give where it is: a planar arm gives none
  /// across its plane. What is counted and limited is what is left.
  Mat3 drives = Mat3::Identity();
  /// Filled in by HandWatch.
  Vec3 velocity = Vec3::Zero();  ///< [m/s]
  bool too_fast = false;         ///< To be braked: faster than
  double max_speed = 0.0;        ///< [m/s].
};

/// What a hand may do. Defaults: SAFETY of any desktop arm.
struct WatchLimits {
  double stale = 0.05;     ///< [s], by the device's profile.
  double max_speed = 3.0;  ///< [m/s]; braked above, cut after kBraked.
  double late = 0.005;     ///< [s], or three ticks where they are longer.
};

/// Looks at positions as they come in.
class HandWatch {
 public:
  explicit HandWatch(const WatchLimits& limits = {}) noexcept : limits_(limits) {}

  /// Fills in velocity and too_fast.
  ///
  /// @param now   [s], of any clock that does not go back.
  /// @return      Why the force is to be cut; kNone: it is not.
  /// RT: no allocation.
  [[nodiscard]] Fault look(HandState& hand, double now) noexcept PALPATE_NONBLOCKING;
  /// As after a fault: the next position is the first.
  void forget() noexcept {
    known_ = false;
    fast_since_ = -1.0;
  }

 private:
  static constexpr double kJumpSpeed = 5.0;   ///< [m/s]: no hand steps faster.
  static constexpr double kLeastJump = 1e-3;  ///< [m]: less hurts nobody; covers uneven stamps.
  static constexpr double kSmooth = 0.005;    ///< [s], time constant of the velocity.
  static constexpr double kBraked = 0.05;     ///< [s] too fast although braked: cut.

  WatchLimits limits_;
  bool known_ = false;
  double time_ = 0.0;  ///< Of the last new position [s].
  Vec3 position_ = Vec3::Zero();
  Vec3 velocity_ = Vec3::Zero();
  double fast_since_ = -1.0;  ///< [s]; below 0: is not.
};

/// Takes the force off an arm that does not move under it. Firmware that sends its last counters
/// again and again would keep whatever force was right when it stopped to look.
///
/// Nothing tells such an arm from one that is held still but that it stays so: where no counter has
/// moved for kStill while more force goes out than friction can hold, the force fades, in kFade to
/// nothing. A hand that lives is moved by that long before, by a count, and the force comes back at
/// the same pace. Meanwhile friction has held the arm: of what the motors did not give a hand feels
/// no more than that friction and its own stiffness times a count.
class StillFade {
 public:
  /// What is left of the force, 0 to 1.
  ///
  /// @param force     That goes out [N].
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

/// The force on a hand that is too fast: nothing that drives it, and against its motion
/// kBrake (|v| - max_speed).
[[nodiscard]] Vec3 brake(const Vec3& force, const Vec3& velocity,
                         double max_speed) noexcept PALPATE_NONBLOCKING;
inline constexpr double kBrake = 2.0;  ///< [N s/m]: half of what common arms render (Touch: 4).

}  // namespace palpate
