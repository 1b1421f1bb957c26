#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <numeric>

#include "palpate/scenes/guess/scalar_parts.h"

namespace palpate::guess {
namespace {

struct Scale {
  double low = 0.0;
  double width = 0.0;  ///< Width of a bin, in the unit of the values.

  explicit Scale(const ScalarAnalysis& scalar)
      : low(scalar.low), width(scalar.range() / static_cast<double>(kBins)) {}
  [[nodiscard]] double valueAt(std::size_t bin) const {
    return low + (static_cast<double>(bin) + 0.5) * width;
  }
};

/// Returns true for a material without noise, which has no dip of the gradient: its bin has at
/// least as many voxels as the 64 neighbouring bins together (32 on each side).
bool isConstantMaterial(const Bins& count, std::size_t bin) {
  constexpr std::size_t kNear = 32;
  double near = 0.0;
  for (std::size_t i = bin > kNear ? bin - kNear : 0; i < std::min(kBins, bin + kNear + 1); ++i) {
    if (i != bin) near += count[i];
  }
  return count[bin] > 0.0 && count[bin] >= near;
}

struct GradientProfile {
  Bins area{};
  Bins gradient{};
  Bins mean{};  ///< Mean gradient magnitude at each level; 0 at a material without noise.
};

GradientProfile profileOf(const LevelIntegrals& levels) {
  GradientProfile profile;
  profile.area = smoothed(levels.area);
  profile.gradient = smoothed(levels.gradient);
  const Bins& area = profile.area;
  const Bins& gradient = profile.gradient;
  Bins& mean = profile.mean;
  for (std::size_t i = 0; i < kBins; ++i) {
    mean[i] = area[i] > 0.0 ? gradient[i] / area[i] : (i > 0 ? mean[i - 1] : 0.0);
  }
  for (std::size_t i = 0; i < kBins; ++i) {
    if (isConstantMaterial(levels.count, i)) mean[i] = 0.0;
  }
  return profile;
}

/// A minimum (dip) or maximum (peak) of the mean gradient magnitude.
struct Turn {
  std::size_t bin = 0;
  bool peak = false;
};

std::vector<Turn> turnsOf(const Bins& mean) {
  // Least ratio of a peak to the dips beside it. Noise alone usually gives a lower ratio.
  constexpr double kContrast = 1.6;
  std::vector<Turn> turns;
  std::size_t highest = 0;
  std::size_t lowest = 0;
  enum class Course : std::uint8_t { kUnknown, kUp, kDown };
  Course course = Course::kUnknown;
  for (std::size_t i = 1; i < kBins; ++i) {
    if (mean[i] > mean[highest]) highest = i;
    if (mean[i] < mean[lowest]) lowest = i;
    if (course != Course::kDown && kContrast * mean[i] <= mean[highest] && mean[highest] > 0.0) {
      turns.push_back({highest, true});
      course = Course::kDown;
      lowest = i;
    } else if (course != Course::kUp && mean[i] >= kContrast * mean[lowest] && mean[i] > 0.0) {
      turns.push_back({lowest, false});
      course = Course::kUp;
      highest = i;
    }
  }
  if (course == Course::kUp) turns.push_back({highest, true});
  if (course == Course::kDown) turns.push_back({lowest, false});
  return turns;
}

/// Returns the first bin from dip to peak where the mean gradient has risen from its value at the
/// dip by the fraction `part` of the difference to `slope`.
std::size_t riseOf(const Bins& mean, std::size_t dip, std::size_t peak, double slope, double part) {
  const double level = mean[dip] + part * (slope - mean[dip]);
  std::size_t i = dip;
  while (i != peak && mean[i] < level) i < peak ? ++i : --i;
  return i;
}

void placeBoundary(Boundary& b, const Bins& mean, const Scale& scale, std::size_t from,
                   std::size_t peak, std::size_t to) {
  // Between two known materials, the boundary is midway between the two values at which the mean
  // gradient has risen halfway from its dip to b.slope (riseOf). With one known material, it is at
  // the value where the gradient has risen by two thirds: the noise of that material alone can
  // raise the gradient by half.
  constexpr double kHalf = 0.5;
  constexpr double kTwoThirds = 2.0 / 3.0;
  const auto rise = [&](std::size_t dip, double part) {
    return scale.valueAt(riseOf(mean, dip, peak, b.slope, part));
  };
  if (b.lower_known && b.upper_known) {
    b.value = 0.5 * (rise(from, kHalf) + rise(to, kHalf));
  } else {
    b.value = b.lower_known ? rise(from, kTwoThirds) : rise(to, kTwoThirds);
  }
  b.foot = b.lower_known ? rise(from, kTwoThirds) : b.value;
}

/// Returns the boundary at a peak; `share` is its integral of the gradient. Returns no value if the
/// field is smooth there, or if the boundary encloses no object.
std::optional<Boundary> boundaryOf(const GradientProfile& profile, const std::vector<Turn>& turns,
                                   std::size_t t, const ScalarAnalysis& scalar, double edge,
                                   bool image) {
  // Greatest thickness of a boundary [voxels]; a thicker one is part of a smooth field. An image
  // may have been smoothed. A mesh's voxels are by default smaller than its cells.
  constexpr double kThickestOfImage = 15.0;
  constexpr double kThickestOfMesh = 6.0;
  // Least fraction of a mesh's voxels on either side. A smaller region is only the margin of a
  // smooth field.
  constexpr double kLeastOfMesh = 0.01;

  Boundary b;
  b.lower_known = t > 0;
  b.upper_known = t + 1 < turns.size();
  const bool closed = b.lower_known && b.upper_known;
  if (!closed && (!image || (!b.lower_known && !b.upper_known))) return std::nullopt;
  const std::size_t peak = turns[t].bin;
  const std::size_t from = b.lower_known ? turns[t - 1].bin : 0;
  const std::size_t to = b.upper_known ? turns[t + 1].bin : kBins - 1;
  const Scale scale(scalar);
  b.lower = b.lower_known ? scale.valueAt(from) : scalar.low;
  b.upper = b.upper_known ? scale.valueAt(to) : scalar.high;
  const auto sum = [&](const Bins& bins) {
    return std::accumulate(bins.begin() + static_cast<std::ptrdiff_t>(from),
                           bins.begin() + static_cast<std::ptrdiff_t>(to) + 1, 0.0);
  };
  b.share = sum(profile.gradient) * scale.width;
  b.slope = sum(profile.gradient) / std::max(sum(profile.area), std::numeric_limits<double>::min());
  if (b.upper - b.lower > (image ? kThickestOfImage : kThickestOfMesh) * edge * b.slope) {
    return std::nullopt;
  }
  placeBoundary(b, profile.mean, scale, from, peak, to);
  const double above = scalar.shareAbove(b.value);
  if (!image && std::min(above, 1.0 - above) < kLeastOfMesh) return std::nullopt;
  return b;
}

/// Keeps the greatest boundaries, sorted by value, and divides each `share` by the greatest one.
void keepGreatest(std::vector<Boundary>& found) {
  constexpr std::size_t kMost = 3;
  // A boundary with a smaller share of the greatest integral is not the surface of an object.
  constexpr double kLeastShare = 0.05;
  std::stable_sort(found.begin(), found.end(),
                   [](const Boundary& a, const Boundary& b) { return a.share > b.share; });
  if (found.size() > kMost) found.resize(kMost);
  for (std::size_t i = found.size(); i-- > 0;) found[i].share /= found[0].share;
  while (!found.empty() && found.back().share < kLeastShare) found.pop_back();
  std::sort(found.begin(), found.end(),
            [](const Boundary& a, const Boundary& b) { return a.value < b.value; });
}

}  // namespace

std::vector<Boundary> findBoundaries(const LevelIntegrals& levels, const ScalarAnalysis& scalar,
                                     double edge, bool image) {
  const GradientProfile profile = profileOf(levels);
  const std::vector<Turn> turns = turnsOf(profile.mean);
  std::vector<Boundary> found;
  for (std::size_t t = 0; t < turns.size(); ++t) {
    if (!turns[t].peak) continue;
    if (const auto b = boundaryOf(profile, turns, t, scalar, edge, image)) found.push_back(*b);
  }
  keepGreatest(found);
  return found;
}

}  // namespace palpate::guess
