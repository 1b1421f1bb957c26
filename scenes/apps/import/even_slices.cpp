#include "palpate/scenes/apps/import/even_slices.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include <tbb/parallel_for.h>

#include "palpate/scenes/apps/import/differences.h"

namespace palpate::importer {
namespace {

/// Two neighbouring slices: the index of the lower one, and the weight of the upper one.
struct Neighbours {
  std::size_t first = 0;
  double weight = 0.0;
};

/// Returns the slices around a depth. Ignores differences below the rounding of the depths.
Neighbours slicesAround(const std::vector<double>& depths, double depth) {
  constexpr double kRounding = 1e-6;
  const auto above = std::upper_bound(depths.begin(), depths.end(), depth + kRounding);
  const auto first =
      static_cast<std::size_t>(std::max<std::ptrdiff_t>(above - depths.begin(), 1)) - 1;
  if (above == depths.end() || depth - depths[first] <= kRounding) return {first, 0.0};
  return {first, (depth - depths[first]) / (depths[first + 1] - depths[first])};
}

class SliceReader {
 public:
  SliceReader(const Values& values, const Values& hidden, const std::vector<double>& depths)
      : values_(&values),
        hidden_(&hidden),
        depths_(&depths),
        each_(values.tuples() / depths.size()) {}

  /// Returns the interpolated value; NaN if one of the slices lacks data there.
  [[nodiscard]] double at(const Neighbours& slices, std::size_t point, int component) const {
    const double one = in(slices.first, point, component);
    if (slices.weight == 0.0) return one;
    return (1.0 - slices.weight) * one + slices.weight * in(slices.first + 1, point, component);
  }
  [[nodiscard]] Neighbours around(double depth) const { return slicesAround(*depths_, depth); }

 private:
  [[nodiscard]] double in(std::size_t slice, std::size_t point, int component) const {
    const std::size_t tuple = slice * each_ + point;
    if (!hidden_->none() && hidden_->as<std::uint8_t>()[tuple] != 0) {
      return std::numeric_limits<double>::quiet_NaN();
    }
    return values_->at(tuple, component);
  }

  const Values* values_;
  const Values* hidden_;
  const std::vector<double>* depths_;
  std::size_t each_;
};

ResamplingError errorBetween(const SliceReader& before, const SliceReader& after,
                             const std::vector<double>& depths, std::size_t plane, int components) {
  Differences differences;
  double lowest = std::numeric_limits<double>::infinity();
  double highest = -lowest;
  const std::size_t stride = plane * depths.size() / 200000 + 1;
  for (std::size_t at = 0; at < plane * depths.size(); at += stride) {
    const Neighbours own{at / plane, 0.0};
    const Neighbours now = after.around(depths[own.first]);
    double square = 0.0;
    double length = 0.0;
    for (int c = 0; c < components; ++c) {
      const double value = before.at(own, at % plane, c);
      length += value * value;
      square += std::pow(after.at(now, at % plane, c) - value, 2);
      if (components == 1) lowest = std::isfinite(value) ? std::min(lowest, value) : lowest;
      if (components == 1) highest = std::isfinite(value) ? std::max(highest, value) : highest;
    }
    if (components > 1 && std::isfinite(length)) {
      lowest = 0.0;
      highest = std::max(highest, std::sqrt(length));
    }
    if (std::isfinite(square)) differences.within.add(std::sqrt(square));
  }
  return differences.relativeTo(highest - lowest);
}

}  // namespace

ResamplingError evenSlices(Piece& image, Array& array) {
  if (image.depths.empty()) return {};
  const std::vector<double> depths = std::exchange(image.depths, {});
  const std::size_t plane =
      static_cast<std::size_t>(image.size[0]) * static_cast<std::size_t>(image.size[1]);
  const auto count = static_cast<std::size_t>(std::lround(depths.back())) + 1;
  const int components = array.values.components();
  const SliceReader before(array.values, image.hidden, depths);
  Values out(Type::kFloat32, components, plane * count);
  out.setLost(floatLoss(array.values));
  tbb::parallel_for(std::size_t{0}, count, [&](std::size_t k) {
    const Neighbours slices = before.around(static_cast<double>(k));
    float* to = out.as<float>() + k * plane * static_cast<std::size_t>(components);
    for (std::size_t point = 0; point < plane; ++point) {
      for (int c = 0; c < components; ++c) *to++ = static_cast<float>(before.at(slices, point, c));
    }
  });

  std::vector<double> even(count);
  for (std::size_t k = 0; k < count; ++k) even[k] = static_cast<double>(k);
  const Values none;
  const ResamplingError error =
      errorBetween(before, SliceReader(out, none, even), depths, plane, components);
  image.hidden = {};
  image.size[2] = static_cast<int>(count);
  array.values = out;
  return error;
}

}  // namespace palpate::importer
