#include "palpate/scenes/apps/import/smooth.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/gaussian.h"
#include "palpate/scenes/apps/import/shared_progress.h"

namespace palpate::importer {
namespace {

/// A line of points along an axis of an image.
struct Line {
  float* first = nullptr;
  std::size_t count = 0;
  std::size_t stride = 0;  ///< Distance in memory between points of the line [floats].
  std::size_t components = 1;
};

void smoothLine(const Line& line, const std::vector<double>& weights, std::vector<float>& copy) {
  const std::size_t components = line.components;
  copy.resize(line.count * components);
  for (std::size_t i = 0; i < line.count; ++i) {
    std::memcpy(&copy[i * components], line.first + i * line.stride, components * sizeof(float));
  }
  const std::size_t reach = weights.size() - 1;
  for (std::size_t i = 0; i < line.count; ++i) {
    const std::size_t low = i - std::min(i, reach);
    const std::size_t high = std::min(i + reach, line.count - 1);
    for (std::size_t c = 0; c < components; ++c) {
      double sum = 0.0;
      double whole = 0.0;
      for (std::size_t n = low; n <= high; ++n) {
        const double weight = weights[n < i ? i - n : n - i];
        sum += weight * static_cast<double>(copy[n * components + c]);
        whole += weight;
      }
      line.first[i * line.stride + c] = static_cast<float>(sum / whole);
    }
  }
}

/// Returns the standard deviations along i, j and k [points].
Vec3 deviationsOf(const Affine& file_from_index, const SmoothWidth& width) {
  if (!width.in_file_units) return Vec3::Constant(width.sigma);
  const Vec3 spacing = file_from_index.linear.colwise().norm().transpose();
  return {width.sigma / spacing[0], width.sigma / spacing[1], width.sigma / spacing[2]};
}

void smoothAlong(std::size_t axis, const Piece& image, const Values& values, double deviation,
                 SharedProgress& progress) {
  std::size_t size[3];
  for (std::size_t a = 0; a < 3; ++a) size[a] = static_cast<std::size_t>(image.size[a]);
  const std::vector<double> weights = gaussianWeights(deviation, size[axis] - 1);
  size[2] = static_cast<std::size_t>(image.slices().count);
  if (weights.size() == 1) return;
  const auto components = static_cast<std::size_t>(values.components());
  const std::size_t strides[3] = {components, components * size[0], components * size[0] * size[1]};
  const std::size_t b = axis == 0 ? 1 : 0;
  const std::size_t c = axis == 2 ? 1 : 2;
  const std::size_t lines = size[b] * size[c];
  std::atomic<std::size_t> done = 0;
  tbb::parallel_for(
      tbb::blocked_range<std::size_t>(0, lines, 16),
      [&](const tbb::blocked_range<std::size_t>& part) {
        std::vector<float> copy;
        for (std::size_t n = part.begin(); n < part.end(); ++n) {
          Line line;
          line.first = values.as<float>() + n % size[b] * strides[b] + n / size[b] * strides[c];
          line.count = size[axis];
          line.stride = strides[axis];
          line.components = components;
          smoothLine(line, weights, copy);
        }
        done += part.size();
        progress.tell(
            (static_cast<double>(axis) + static_cast<double>(done) / static_cast<double>(lines)) /
            3.0);
      });
}

/// Sum of the squared changes of a slice, and its range after smoothing.
struct SliceChange {
  double squares = 0.0;
  double low = std::numeric_limits<double>::infinity();
  double high = -std::numeric_limits<double>::infinity();
};

SliceChange changeOfSlice(const float* from, const float* to, std::size_t count, int components) {
  SliceChange out;
  for (std::size_t i = 0; i < count; ++i) {
    const double change = static_cast<double>(to[i]) - static_cast<double>(from[i]);
    out.squares += change * change;
  }
  if (components == 1) {
    for (std::size_t i = 0; i < count; ++i) {
      out.low = std::min(out.low, static_cast<double>(to[i]));
      out.high = std::max(out.high, static_cast<double>(to[i]));
    }
  } else {
    out.low = 0.0;
    for (std::size_t i = 0; i + 2 < count; i += 3) {
      out.high = std::max(out.high, Vec3(to[i], to[i + 1], to[i + 2]).norm());
    }
  }
  return out;
}

Smoothed changeOf(const Piece& image, const Values& before, const Values& after,
                  const Shared& shared) {
  const Slab own = shared.own(image.size[2]);
  const Values old = slicesOf(image, before, own);
  const Values now = slicesOf(image, after, own);
  // Sums each slice first, so that the total does not depend on the number of ranks.
  std::vector<SliceChange> changes(shared.isKnown() ? 0 : static_cast<std::size_t>(own.count));
  for (std::size_t k = 0; k < changes.size(); ++k) {
    const std::size_t each = now.size() / changes.size();
    changes[k] = changeOfSlice(old.as<float>() + k * each, now.as<float>() + k * each, each,
                               now.components());
  }
  double squares = 0.0;
  double low = std::numeric_limits<double>::infinity();
  double high = -low;
  for (const SliceChange& one : gatherAll(shared.group(), changes)) {
    squares += one.squares;
    low = std::min(low, one.low);
    high = std::max(high, one.high);
  }
  double count = 1.0;
  for (const int size : image.size) count *= size;
  return {std::sqrt(squares / (count * now.components())), high - low};
}

}  // namespace

std::size_t smoothingReach(const Affine& file_from_index, int slices, const SmoothWidth& width) {
  if (!(width.sigma > 0.0)) return 0;
  return gaussianReach(deviationsOf(file_from_index, width)[2],
                       static_cast<std::size_t>(slices - 1));
}

Smoothed smoothImage(const Piece& image, Array& array, const SmoothWidth& width,
                     const std::string& file, const Progress& progress) {
  SingleProcess alone;
  return smoothImage(image, array, width, file, progress, Shared(alone));
}

Smoothed smoothImage(const Piece& image, Array& array, const SmoothWidth& width,
                     const std::string& file, const Progress& progress, const Shared& shared) {
  // Replaces the original by floats, and so frees it: an array may need most of the memory, so that
  // only one copy is possible.
  array.values = floatsOf(array.values);
  const Values original = array.values;
  const auto* before = original.as<float>();
  const std::size_t count = original.size();
  const auto bad = std::count_if(before, before + count, [](float v) { return !std::isfinite(v); });
  if (bad > 0 || !image.hidden.none()) {
    throw VolumeError(
        file, fmt::format("{} has voxels without data, which smoothing would spread", array.name),
        "omit --smooth");
  }
  const Values smoothed(Type::kFloat32, original.components(), original.tuples());
  std::copy(before, before + count, smoothed.as<float>());
  const Vec3 deviations = deviationsOf(image.file_from_index, width);
  SharedProgress told(progress, 1);
  for (std::size_t axis = 0; axis < 3; ++axis) {
    smoothAlong(axis, image, smoothed, deviations[static_cast<Eigen::Index>(axis)], told);
  }
  array.values = smoothed;
  return changeOf(image, original, smoothed, shared);
}

}  // namespace palpate::importer
