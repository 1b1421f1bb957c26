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
  std::string name;
  ForceLimits limits;             ///< [N], [N/s].
  double max_stiffness = 1000.0;  ///< Largest coupling stiffness that it renders stably [N/m],
  double max_damping = 1e9;       ///< and damping [N s/m].
  double workspace_radius = 0.1;  ///< [m], about the origin of W.
  double mass = 0.0;              ///< That a hand feels in free space [kg]; 0: not known.
  double output_rate = 0.0;       ///< Forces a second that it takes [Hz]: of a loop that is faster
                                  ///< the newest, a period of this later at most; of others each
                                  ///< at once. 0: all.
  std::string source;             ///< Of the numbers above.
  WatchLimits watch;              ///< What a hand on it may do.
  bool hand = true;               ///< A force may reach one; false for recorded paths.
};

/// Zero force for whoever holds the descriptor, another process perhaps: bytes that the device
/// takes as such in one write.
struct ZeroForce {
  static constexpr std::size_t kMostBytes = 256;
  int descriptor = -1;  ///< Its own, apart from the device's; -1: there is none.
  std::span<const std::byte> bytes;
  std::uint32_t version = 1;  ///< Another one when the descriptor leads to another device.
};

/// A hand on an arm, real or simulated. One thread at a time.
class Device {
 public:
  Device() = default;
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;
  virtual ~Device() = default;

  [[nodiscard]] virtual const DeviceInfo& info() const noexcept = 0;
  /// The newest position. RT: no allocation, no lock.
  [[nodiscard]] virtual HandState read() noexcept PALPATE_NONBLOCKING = 0;
  /// Sends a force [N] that has passed limitForce; it holds until the next one. A device in virtual
  /// time moves on by one tick. RT: no allocation, no lock.
  virtual void write(const Vec3& force) noexcept PALPATE_NONBLOCKING = 0;
  /// Whether, from the next write on, its motors may carry the arm's own weight beside the force,
  /// if the device knows it; at first not. It comes in over kEngage and goes at once. Told before
  /// every write: only while the hand is ready and no fault is latched. RT: no allocation, no lock.
  virtual void carry(bool /*may*/) noexcept PALPATE_NONBLOCKING {}
  /// What the motors' limits leave of the force that was written last, 0 to 1, direction kept;
  /// asked after every write. Rounding, lag and delay are ArmDissipation's. RT: no allocation, no
  /// lock.
  [[nodiscard]] virtual double given() const noexcept PALPATE_NONBLOCKING { return 1.0; }
  /// True when there is nothing more to read, as at the end of a recorded path.
  [[nodiscard]] virtual bool ended() const noexcept { return false; }
  /// For a guardian (devices/guardian.h); stays as long as the device.
  [[nodiscard]] virtual ZeroForce zeroForce() const noexcept { return {}; }
};

}  // namespace palpate
