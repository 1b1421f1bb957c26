#include "palpate/scenes/import/smooth.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <vector>

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/import/shared_progress.h"

namespace palpate::importer {
namespace {

/// Half of a Gaussian over so many points: its middle and what is to one side.
std::vector<double> weightsOf(double deviation, std::size_t count) {
  const auto last = static_cast<double>(count - 1);
  const auto reach = static_cast<std::size_t>(std::min(3.0 * deviation, last));
  std::vector<double> weights;
  for (std::size_t n = 0; n <= reach; ++n) {
    const double x = static_cast<double>(n) / std::max(deviation, 1e-12);
    weights.push_back(std::exp(-0.5 * x * x));
  }
  return weights;
}

/// One line of an image's points.
struct Line {
  float* first = nullptr;
  std::size_t count = 0;
  std::size_t stride = 0;  ///< Floats from a point to the next.
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

/// Along one axis, all lines of it in parallel.
void smoothAlong(std::size_t axis, const Piece& image, const Values& values, double deviation,
                 SharedProgress& progress) {
  std::size_t size[3];
  for (std::size_t a = 0; a < 3; ++a) size[a] = static_cast<std::size_t>(image.size[a]);
  const std::vector<double> weights = weightsOf(deviation, size[axis]);
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

}  // namespace

Smoothed smoothImage(const Piece& image, Array& array, double width, const std::string& file,
                     const Progress& progress) {
  // Floats, and then one copy: an array may be all the memory that there is.
  array.values = floatsOf(array.values);
  const Values original = array.values;
  const auto* before = original.as<float>();
  const std::size_t count = original.size();
  const auto bad = std::count_if(before, before + count, [](float v) { return !std::isfinite(v); });
  if (bad > 0 || !image.hidden.none()) {
    throw VolumeError(
        file, fmt::format("{} has voxels without data, which smoothing would spread", array.name),
        "import it without --smooth");
  }
  const Values smoothed(Type::kFloat32, original.components(), original.tuples());
  auto* after = smoothed.as<float>();
  std::copy(before, before + count, after);
  const Vec3 spacing = image.file_from_index.linear.colwise().norm().transpose();
  SharedProgress shared(progress, 1);
  for (std::size_t axis = 0; axis < 3; ++axis) {
    smoothAlong(axis, image, smoothed, width / spacing[static_cast<Eigen::Index>(axis)], shared);
  }

  Smoothed out;
  double squares = 0.0;
  for (std::size_t i = 0; i < count; ++i) {
    const double change = static_cast<double>(after[i]) - static_cast<double>(before[i]);
    squares += change * change;
  }
  out.rms_change = std::sqrt(squares / static_cast<double>(count));
  array.values = smoothed;
  if (smoothed.components() == 1) {
    const auto [low, high] = std::minmax_element(after, after + count);
    out.range = static_cast<double>(*high) - static_cast<double>(*low);
    return out;
  }
  for (std::size_t i = 0; i + 2 < count; i += 3) {
    const Vec3 v(after[i], after[i + 1], after[i + 2]);
    out.range = std::max(out.range, v.norm());
  }
  return out;
}

}  // namespace palpate::importer
