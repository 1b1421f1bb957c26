/// Where the hand is, and where the force goes.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "palpate/engine/limit_force.h"
#include "palpate/engine/safety.h"
#include "palpate/engine/types.h"

namespace palpate {

/// What a device can do, and where each number comes from.
struct DeviceInfo {
  std::string name;               ///< Names the device in messages and reports.
  ForceLimits limits;             ///< Limits of its force [N], [N/s].
  double max_stiffness = 1000.0;  ///< Largest coupling stiffness that it renders stably [N/m].
  double max_damping = 1e9;       ///< Largest coupling damping that it renders stably [N s/m].
  double workspace_radius = 0.1;  ///< Radius of the workspace about the origin of W [m].
  double mass = 0.0;              ///< Mass that a hand feels in free space [kg]; 0: not known.
  double output_rate = 0.0;       ///< Forces a second that the device takes [Hz]; 0: all. Of a
                                  ///< faster loop it takes the newest, at most a period of this
                                  ///< late; of a slower one each, at once.
  std::string source;             ///< Where the numbers above come from.
  WatchLimits watch;              ///< Limits of what a hand on it may do.
  HandleInfo handle;              ///< What it says beside where its tip is.
  bool hand = true;               ///< A force may reach a hand; false for recorded paths.
};

/// Zero force for whoever holds the descriptor, perhaps another process: the bytes of one write
/// that the device takes as zero force.
struct ZeroForce {
  static constexpr std::size_t kMostBytes = 256;  ///< Room that a guardian has for it [bytes].
  int descriptor = -1;  ///< A descriptor of its own, apart from the device's; -1: none.
  std::span<const std::byte> bytes;  ///< What is written, at most kMostBytes; the device owns it.
  std::uint32_t version = 1;         ///< Changes when the descriptor leads to another device.
};

/// A hand on an arm, real or simulated. One thread may use it at a time.
class Device {
 public:
  Device() = default;
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;
  virtual ~Device() = default;

  /// What it can do. A HapticLoop takes over the limits when it is made.
  [[nodiscard]] virtual const DeviceInfo& info() const noexcept = 0;
  /// The newest reading of the hand. RT: no allocation, no lock.
  [[nodiscard]] virtual HandState read() noexcept PALPATE_NONBLOCKING = 0;
  /// Sends a force [N] that has passed limitForce; it holds until the next one. A device in virtual
  /// time moves on by one tick. RT: no allocation, no lock.
  virtual void write(const Vec3& force) noexcept PALPATE_NONBLOCKING = 0;
  /// Says whether from the next write on the motors may also carry the arm's weight, if the device
  /// knows it; at first not. That comes in over kEngage and ends at once. Called before every
  /// write; true only while the hand is ready and no fault is latched. RT: no allocation, no lock.
  virtual void carry(bool /*may*/) noexcept PALPATE_NONBLOCKING {}
  /// The share of the last force written that the motors' limits leave, 0 to 1, direction kept;
  /// asked after every write. Rounding, lag and delay are ArmDissipation's. RT: no allocation, no
  /// lock.
  [[nodiscard]] virtual double given() const noexcept PALPATE_NONBLOCKING { return 1.0; }
  /// True when there is nothing more to read, as at the end of a recorded path.
  [[nodiscard]] virtual bool ended() const noexcept { return false; }
  /// Zero force for a guardian (devices/guardian.h); valid as long as the device.
  [[nodiscard]] virtual ZeroForce zeroForce() const noexcept { return {}; }
};

}  // namespace palpate
