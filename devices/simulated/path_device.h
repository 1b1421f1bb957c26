/// A hand that follows a path exactly, tick by tick: `path:FILE.csv`.
#pragma once

#include <istream>
#include <string>
#include <vector>

#include "palpate/engine/safety/device.h"

namespace palpate {

/// Position of a hand, or of its target, at a time.
struct PathPoint {
  double t = 0.0;         ///< Time [s].
  Vec3 p = Vec3::Zero();  ///< Position in W [m].
};

/// Returns the position at time t: linear between points, constant before the first and after the
/// last. `hint` is the index at which the search starts, and is updated: amortised O(1) if t rises.
/// `path` is not empty. RT: no allocation.
[[nodiscard]] Vec3 positionAt(const std::vector<PathPoint>& path, double t,
                              std::size_t& hint) noexcept;

/// Reads CSV with the header t,x,y,z: seconds and metres, t ascending, at least one row. Throws
/// DeviceError with `name`, and with the line if a row is wrong.
[[nodiscard]] std::vector<PathPoint> readPath(std::istream& in, const std::string& name);

/// A hand that follows a path, independent of the force. Each write is one tick of 1/rate.
class PathDevice final : public Device {
 public:
  /// `path` is not empty, its t ascends; `rate` [Hz], > 0.
  PathDevice(std::vector<PathPoint> path, double rate);

  /// Returns a description named "path", with the peak force of a delta.3 (20 N) and a stiffness
  /// limit of 1e5 N/m. The limit is high because the force does not move this hand.
  [[nodiscard]] const DeviceInfo& info() const noexcept override { return info_; }
  [[nodiscard]] HandState read() noexcept override;
  void write(const Vec3& force) noexcept override;
  [[nodiscard]] bool ended() const noexcept override;

 private:
  DeviceInfo info_;
  std::vector<PathPoint> path_;
  double rate_;
  std::int64_t tick_ = 0;
  std::size_t hint_ = 0;
};

}  // namespace palpate
