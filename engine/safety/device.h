/// Interface of a haptic device, which reports the hand's position and applies the force.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "palpate/engine/safety/limit_force.h"
#include "palpate/engine/safety/safety.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Abilities of a device, with the source of the numbers.
struct DeviceInfo {
  std::string name;    ///< Name of the device for messages and reports.
  ForceLimits limits;  ///< Limits of the force [N] and of its growth [N/s].
  /// Largest coupling stiffness that the device renders stably [N/m].
  double max_stiffness = 1000.0;
  double max_damping = 1e9;  ///< Largest coupling damping that the device renders stably [N s/m].
  double workspace_radius = 0.1;  ///< Radius of the workspace about the origin of W [m].
  double mass = 0.0;              ///< Mass that a hand moves in free space [kg]; 0 if unknown.
  /// Rate at which the device accepts forces [Hz]; 0 if it accepts every force. If the loop is
  /// faster, the device applies the newest force, at most one period of this rate late. If the loop
  /// is slower, the device applies each force at once.
  double output_rate = 0.0;
  std::string source;  ///< Source of the numbers above.
  WatchLimits watch;   ///< Limits of the hand's motion on the device.
  HandleInfo handle;   ///< Further readings that the device reports.
  bool hand = true;    ///< True if a force may reach a hand; false for recorded paths.
};

/// Bytes that set the force of a device to zero. Any process with the descriptor can write them.
struct ZeroForce {
  /// Largest size of `bytes`, which a guardian can store [bytes].
  static constexpr std::size_t kMostBytes = 256;
  /// Descriptor for these bytes, separate from the device's own; -1 if not available.
  int descriptor = -1;
  /// Bytes of one write, at most kMostBytes. The device owns them.
  std::span<const std::byte> bytes;
  std::uint32_t version = 1;  ///< Number that changes when the descriptor refers to another device.
};

/// An arm with a hand on it, real or simulated. Only one thread may use a device at a time.
class Device {
 public:
  Device() = default;
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;
  virtual ~Device() = default;

  /// Returns the abilities of the device. A HapticLoop copies the limits when it is made.
  [[nodiscard]] virtual const DeviceInfo& info() const noexcept = 0;
  /// Returns the newest reading of the hand. RT: no allocation, no lock.
  [[nodiscard]] virtual HandState read() noexcept PALPATE_NONBLOCKING = 0;
  /// Sends a force [N]: the result of limitForce, or zero. The force acts until the next write. A
  /// device in virtual time advances by one tick. RT: no allocation, no lock.
  virtual void write(const Vec3& force) noexcept PALPATE_NONBLOCKING = 0;
  /// Sets whether the motors may carry the arm's weight in addition to the force, if the device
  /// knows that weight. Initially the motors may not. After `true` the support grows over kEngage;
  /// after `false` the support ends at once. The loop calls it before every write, with true only
  /// while the hand is ready and no fault is latched. RT: no allocation, no lock.
  virtual void carry(bool /*may*/) noexcept PALPATE_NONBLOCKING {}
  /// Returns the share, 0 to 1, of the last written force that the motors could apply within their
  /// limits. The motors keep the direction. Rounding, lag and delay are not included
  /// (ArmDissipation). The loop calls it after the write of each tick. RT: no allocation, no lock.
  [[nodiscard]] virtual double given() const noexcept PALPATE_NONBLOCKING { return 1.0; }
  /// Returns true when there are no more readings, as at the end of a recorded path.
  [[nodiscard]] virtual bool ended() const noexcept { return false; }
  /// Returns the zero force for a guardian (devices/arm/guardian.h), valid while the device exists.
  [[nodiscard]] virtual ZeroForce zeroForce() const noexcept { return {}; }
};

}  // namespace palpate
