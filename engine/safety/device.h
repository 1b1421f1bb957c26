/// Interface of a haptic device: it reads the hand and takes the force.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "palpate/engine/safety/limit_force.h"
#include "palpate/engine/safety/safety.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Abilities of a device, and the source of each number.
struct DeviceInfo {
  std::string name;               ///< Names the device in messages and reports.
  ForceLimits limits;             ///< Limits of its force [N], [N/s].
  double max_stiffness = 1000.0;  ///< Largest coupling stiffness that it renders stably [N/m].
  double max_damping = 1e9;       ///< Largest coupling damping that it renders stably [N s/m].
  double workspace_radius = 0.1;  ///< Radius of the workspace about the origin of W [m].
  double mass = 0.0;              ///< Mass that a hand feels in free space [kg]; 0: not known.
  double output_rate = 0.0;       ///< Rate at which the device takes forces [Hz]; 0: all. From a
                                  ///< faster loop it takes the newest force, at most a period of
                                  ///< this rate late; from a slower one each force, at once.
  std::string source;             ///< Source of the numbers above.
  WatchLimits watch;              ///< Limits for a hand on the device.
  HandleInfo handle;              ///< Further readings that it reports beside its position.
  bool hand = true;               ///< True if a force may reach a hand; false for recorded paths.
};

/// Zero force for any holder of the descriptor, such as another process: the bytes of one write
/// that the device takes as zero force.
struct ZeroForce {
  static constexpr std::size_t kMostBytes = 256;  ///< Room for `bytes` in a guardian [bytes].
  int descriptor = -1;  ///< A descriptor apart from the device's own; -1: not available.
  std::span<const std::byte> bytes;  ///< Bytes to write, at most kMostBytes; the device owns them.
  std::uint32_t version = 1;         ///< Changes when the descriptor leads to another device.
};

/// A hand on an arm, real or simulated. One thread may use it at a time.
class Device {
 public:
  Device() = default;
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;
  virtual ~Device() = default;

  /// Returns the abilities of the device. A HapticLoop takes its limits when the loop is made.
  [[nodiscard]] virtual const DeviceInfo& info() const noexcept = 0;
  /// Returns the newest reading of the hand. RT: no allocation, no lock.
  [[nodiscard]] virtual HandState read() noexcept PALPATE_NONBLOCKING = 0;
  /// Sends a force [N] that has passed limitForce; the force holds until the next one. A device in
  /// virtual time moves on by one tick. RT: no allocation, no lock.
  virtual void write(const Vec3& force) noexcept PALPATE_NONBLOCKING = 0;
  /// Sets whether the motors may also carry the arm's weight from the next write on, if the device
  /// knows that weight; at first they may not. After true the support grows over kEngage, after
  /// false it ends at once. Called before every write; true only while the hand is ready and no
  /// fault is latched. RT: no allocation, no lock.
  virtual void carry(bool /*may*/) noexcept PALPATE_NONBLOCKING {}
  /// Returns the share of the last written force that the motors' limits leave, 0 to 1, direction
  /// kept. Called after every write. Rounding, lag and delay are not part of it: see
  /// ArmDissipation. RT: no allocation, no lock.
  [[nodiscard]] virtual double given() const noexcept PALPATE_NONBLOCKING { return 1.0; }
  /// Returns true when there are no more readings, as at the end of a recorded path.
  [[nodiscard]] virtual bool ended() const noexcept { return false; }
  /// Returns the zero force for a guardian (devices/arm/guardian.h); valid as long as the device.
  [[nodiscard]] virtual ZeroForce zeroForce() const noexcept { return {}; }
};

}  // namespace palpate
