#include "palpate/engine/field/field.h"

#include <algorithm>
#include <atomic>
#include <cmath>

#include "palpate/engine/field/trace_cells.h"

namespace palpate {
namespace {

/// Adapts a smooth vector field to traceCells(). Coordinates are in voxels.
struct SmoothFlow {
  static constexpr bool kCells = false;
  const VectorField& field;
  FieldCache& cache;
  double voxel;

  bool enter(const Vec3& /*u*/, const Vec3& /*direction*/) const noexcept { return true; }
  bool pass(int /*axis*/, int /*side*/) const noexcept { return true; }
  [[nodiscard]] static Vec3 lower() noexcept { return Vec3::Zero(); }
  [[nodiscard]] Vec3 value(const Vec3& u) const noexcept {
    const VectorSample sample = field.sample(voxel * u, cache);
    return sample.inside ? sample.value : Vec3::Zero();
  }
  [[nodiscard]] static Vec3 rate(const Vec3& v) noexcept { return v; }
};

}  // namespace

std::uint64_t nextFieldId() noexcept {
  static std::atomic<std::uint64_t> next{1};
  return next++;
}

Mat3 ScalarField::gradientJacobian(const Vec3& p_W, FieldCache& cache) const noexcept {
  const double step = 1e-3 * frame().voxel;
  Mat3 out;
  for (int a = 0; a < 3; ++a) {
    const Vec3 aside = step * Vec3::Unit(a);
    const Vec3 ahead = sample(p_W + aside, cache).gradient;
    out.col(a) = (ahead - sample(p_W - aside, cache).gradient) / (2.0 * step);
  }
  return out;
}

Crossing ScalarField::firstFall(const Vec3& a_W, const Vec3& b_W, double level, double sign,
                                FieldCache& cache) const noexcept {
  constexpr int kMostSteps = 256;
  constexpr int kHalvings = 40;
  Crossing out;
  const Vec3 way = b_W - a_W;
  const auto height = [&](double share) {
    ++out.cells;
    const ScalarSample at = sample(a_W + share * way, cache);
    return at.inside ? sign * (at.value - level) : 1.0;
  };
  const double count = std::max(std::ceil(way.norm() / (0.5 * frame().voxel)), 1.0);
  if (!std::isfinite(count)) {
    out.share = 0.0;
    return out;
  }
  const int looked = static_cast<int>(std::min<double>(count, kMostSteps));
  double last = height(0.0);
  bool above = false;
  for (int i = 1; i <= looked; ++i) {
    const double share = i / count;
    const double here = height(share);
    const double from = (i - 1) / count;
    above = above || last > 0.0;
    if (here < 0.0 && (above || (i == 1 && here < last))) {
      out.found = true;
      if (last <= 0.0) {
        out.share = from;
        return out;
      }
      double low = from;
      double high = share;
      for (int n = 0; n < kHalvings; ++n) {
        const double middle = 0.5 * (low + high);
        (height(middle) > 0.0 ? low : high) = middle;
      }
      out.share = low;
      return out;
    }
    last = here;
  }
  out.share = looked / count;
  out.behind = !above && last < 0.0;
  return out;
}

Trace VectorField::trace(const Vec3& p_W, const TraceOrder& order,
                         FieldCache& cache) const noexcept {
  const double voxel = frame().voxel;
  SmoothFlow flow{*this, cache, voxel};
  TraceOrder scaled = order;
  scaled.length = order.length / voxel;
  scaled.hand = order.hand / voxel;
  Trace out = traceCells(flow, p_W / voxel, scaled);
  out.position *= voxel;
  out.length *= voxel;
  return out;
}

}  // namespace palpate
