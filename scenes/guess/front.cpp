#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "palpate/scenes/guess/sampling.h"
#include "palpate/scenes/guess/scalar_parts.h"

namespace palpate::guess {
namespace {

/// Half the length of the line along the gradient that is searched for a front [voxels].
constexpr int kHalfLine = 6;

/// A sampled voxel, with values on the line through the voxel along the gradient.
struct LineSample {
  std::array<std::pair<float, float>, 3> near{};  ///< Lower and upper neighbour of each axis.
  std::array<double, 3> slope{};
  double length = 0.0;
  float value = 0.0F;
  double jump = 0.0;      ///< Difference between the line's ends.
  double steepest = 0.0;  ///< Largest difference over two voxel edges of the line.
  float middle = 0.0F;    ///< Value where the line is steepest.
  bool known = false;     ///< True if all neighbours and the whole line have data.
};

template <class Reader>
bool readLine(const Reader& reader, const SuggestInput& input, const openvdb::Coord& at,
              const openvdb::Vec3d& step, LineSample& sample) {
  std::array<float, 2 * kHalfLine + 1> values{};
  for (std::size_t i = 0; i < values.size(); ++i) {
    const double along = static_cast<double>(i) - kHalfLine;
    const openvdb::Coord c = at + openvdb::Coord::round(step * along);
    float& value = values[i];
    const bool active = reader.probeValue(c, value);
    const bool within = input.extent.empty() || input.extent.isInside(c);
    if (!(active || (input.inactive_is_data && within)) || !std::isfinite(value)) return false;
  }
  sample.jump = std::abs(static_cast<double>(values.back()) - values.front());
  for (std::size_t i = 1; i + 1 < values.size(); ++i) {
    const double change = std::abs(static_cast<double>(values[i + 1]) - values[i - 1]);
    if (change <= sample.steepest) continue;
    sample.steepest = change;
    sample.middle = values[i];
  }
  return true;
}

template <class Reader>
LineSample lineAt(const Reader& reader, const SuggestInput& input, const openvdb::Coord& c,
                  const std::array<double, 3>& edges) {
  LineSample sample;
  sample.value = reader.getValue(c);
  openvdb::Vec3d step;
  for (int axis = 0; axis < 3; ++axis) {
    const auto near = neighboursOf(reader, c, axis, input);
    if (!near.known || !std::isfinite(near.before) || !std::isfinite(near.after)) return sample;
    const auto a = static_cast<std::size_t>(axis);
    sample.near[a] = std::minmax(near.before, near.after);
    const double slope = (static_cast<double>(near.after) - near.before) / (2.0 * edges[a]);
    sample.slope[a] = std::abs(slope);
    step[axis] = slope / edges[a];
  }
  sample.length = std::hypot(sample.slope[0], sample.slope[1], sample.slope[2]);
  if (!(sample.length > 0.0)) return sample;
  const double edge = std::cbrt(edges[0] * edges[1] * edges[2]);
  step *= edge / sample.length;  // now one voxel edge along the gradient, in index coordinates
  sample.known = readLine(reader, input, c, step, sample);
  return sample;
}

/// Returns true if the values on the line change by a large part of the range, nearly all of this
/// change within a few voxels.
bool crossesFront(const LineSample& sample, double range) {
  constexpr double kLarge = 0.08;  // fraction of the range
  // A simulation spreads a shock over three cells of up to two voxels each. A linear field would
  // have the thickness of the whole line, 12.
  constexpr double kThickest = 6.0;  // [voxels]
  return sample.jump >= kLarge * range && sample.jump <= kThickest * 0.5 * sample.steepest;
}

/// Returns the median of the values at the steepest points, weighted by the inverse slope. The
/// isosurface of this value is nearest to these points.
double steepestValueOf(const std::vector<LineSample>& samples, double range) {
  std::vector<std::pair<double, double>> places;
  double all = 0.0;
  for (const LineSample& s : samples) {
    if (!s.known || !crossesFront(s, range)) continue;
    places.emplace_back(s.middle, 1.0 / s.steepest);
    all += places.back().second;
  }
  std::sort(places.begin(), places.end());
  double sum = 0.0;
  for (const auto& [value, weight] : places) {
    sum += weight;
    if (sum >= 0.5 * all) return value;
  }
  return 0.0;
}

/// Area of an isosurface, and the part of it that is on a front.
struct FrontArea {
  double all = 0.0;
  double front = 0.0;
  double slope = 0.0;  ///< Integral of the length of the gradient over the front.
};

FrontArea areaAt(double value, const std::vector<LineSample>& samples, double range,
                 const std::array<double, 3>& edges) {
  FrontArea area;
  for (const LineSample& s : samples) {
    if (!s.known) continue;
    for (std::size_t a = 0; a < 3; ++a) {
      if (s.near[a].first >= value || s.near[a].second < value) continue;
      const double part = s.slope[a] / s.length / edges[a];
      area.all += part;
      if (!crossesFront(s, range)) continue;
      area.front += part;
      area.slope += part * s.length;
    }
  }
  return area;
}

}  // namespace

std::optional<Boundary> findFront(const SuggestInput& input, const ScalarAnalysis& scalar) {
  // If more voxels than this fraction are at a front, the field is coarse or noisy.
  constexpr double kMostly = 0.2;
  // Least fraction of the voxels on either side. A smaller region surrounds only a source.
  constexpr double kLeastBeside = 0.1;
  constexpr double kNearlyAll = 0.7;  // fraction of an isosurface's area
  const std::array<double, 3> edges = edgesOf(*input.grid);
  const auto samples =
      withScalars(input, [&]<class R, class G>(std::type_identity<R>, std::type_identity<G>) {
        return gather<LineSample, R, G>(input, kSuggestSamples,
                                        [&](const R& reader, const openvdb::Coord& c) {
                                          return lineAt(reader, input, c, edges);
                                        });
      });
  const double range = scalar.range();
  const auto steep = std::count_if(samples.begin(), samples.end(), [&](const LineSample& s) {
    return s.known && crossesFront(s, range);
  });
  const auto count = static_cast<double>(samples.size());
  if (steep == 0 || static_cast<double>(steep) > kMostly * count) return std::nullopt;
  Boundary b;
  b.front = true;
  b.value = b.foot = steepestValueOf(samples, range);
  const FrontArea area = areaAt(b.value, samples, range, edges);
  const double above = scalar.shareAbove(b.value);
  if (area.front < kNearlyAll * area.all || !(area.front > 0.0) ||
      std::min(above, 1.0 - above) < kLeastBeside) {
    return std::nullopt;
  }
  b.slope = area.slope / area.front;
  b.share = 1.0;
  b.lower = scalar.low;
  b.upper = scalar.high;
  return b;
}

}  // namespace palpate::guess
