#include "palpate/devices/simulated/path_device.h"

#include <algorithm>

#include "palpate/devices/recording/csv.h"
#include "palpate/engine/error.h"

namespace palpate {

Vec3 positionAt(const std::vector<PathPoint>& path, double t, std::size_t& hint) noexcept {
  if (t <= path.front().t) return path.front().p;
  if (t >= path.back().t) return path.back().p;
  if (hint + 1 >= path.size() || path[hint].t > t) hint = 0;
  while (path[hint + 1].t < t) ++hint;
  const PathPoint& a = path[hint];
  const PathPoint& b = path[hint + 1];
  const double span = b.t - a.t;
  return span > 0.0 ? Vec3(a.p + ((t - a.t) / span) * (b.p - a.p)) : b.p;
}

std::vector<PathPoint> readPath(std::istream& in, const std::string& name) {
  const std::vector<CsvRow> rows = readCsv(in, {"t", "x", "y", "z"}, name);
  std::vector<PathPoint> path;
  for (const auto& [line, row] : rows) {
    if (!path.empty() && !(row[0] > path.back().t)) {
      throw DeviceError(name + " line " + std::to_string(line), "the time does not rise",
                        "sort the rows by t and drop equal times");
    }
    path.push_back({row[0], {row[1], row[2], row[3]}});
  }
  if (path.empty()) throw DeviceError(name, "it has no rows", "give at least one position");
  return path;
}

PathDevice::PathDevice(std::vector<PathPoint> path, double rate)
    : path_(std::move(path)), rate_(rate) {
  info_.name = "path";
  info_.limits = {20.0, 2000.0};
  info_.max_stiffness = 1e5;
  info_.hand = false;
  // A path has no real hand that a late tick could hurt.
  info_.watch.late = 60.0;
  info_.source =
      "no hardware: the largest force is that of a delta.3 (20 N, CHAI3D 3.3.0); the probe "
      "does not yield, so any stiffness is stable";
}

HandState PathDevice::read() noexcept {
  const double t = path_.front().t + static_cast<double>(tick_) / rate_;
  return {positionAt(path_, t, hint_)};
}

void PathDevice::write(const Vec3& /*force*/) noexcept {
  ++tick_;
}

bool PathDevice::ended() const noexcept {
  // Adds half a tick for rounding errors, so that the last row is included.
  return static_cast<double>(tick_) / rate_ > path_.back().t - path_.front().t + 0.5 / rate_;
}

}  // namespace palpate
