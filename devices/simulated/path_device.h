/// A hand that follows a path exactly, in virtual time: `path:FILE.csv`.
#pragma once

#include <istream>
#include <string>
#include <vector>

#include "palpate/engine/safety/device.h"

namespace palpate {

/// Position of a hand, or its target, at a time.
struct PathPoint {
  double t = 0.0;         ///< [s]
  Vec3 p = Vec3::Zero();  ///< [m] in W.
};

/// Returns the position at time t: linear between points, constant beyond the ends. `hint` is the
/// index to search first and is updated: amortised O(1) for rising t. RT: no allocation.
[[nodiscard]] Vec3 positionAt(const std::vector<PathPoint>& path, double t,
                              std::size_t& hint) noexcept;

/// Reads CSV with the header t,x,y,z: seconds and metres, t ascending, at least one row. Throws
/// DeviceError with `name` and the line.
[[nodiscard]] std::vector<PathPoint> readPath(std::istream& in, const std::string& name);

/// Follows the path independent of the force; each write is one tick of 1/rate.
class PathDevice final : public Device {
 public:
  PathDevice(std::vector<PathPoint> path, double rate);  ///< Not empty, t ascending; [Hz], > 0.

  /// Named "path", with the 20 N of a delta.3, and 1e5 N/m, because the probe does not yield.
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
