#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

#include "palpate/scenes/guess/sampling.h"
#include "palpate/scenes/guess/scalar_parts.h"

namespace palpate::guess {
namespace {

bool isKnown(const ScalarSample& s) {
  return s.known[0] && s.known[1] && s.known[2];
}

template <class F>
void forValues(const ScalarSample& s, const F& f) {
  f(s.value);
  for (std::size_t a = 0; a < 3; ++a) {
    f(s.before[a]);
    f(s.after[a]);
  }
}

/// Values of constant regions, and whether the values are cut off at their lowest and highest.
struct Plateaus {
  std::vector<float> values;  ///< Ascending.
  float low = std::numeric_limits<float>::max();
  float high = std::numeric_limits<float>::lowest();
  bool cut_low = false;  ///< True if the values are cut off at the lowest value.
  bool cut_high = false;
  bool from_background = false;  ///< True if addBackground() has set `low` or `high`.

  [[nodiscard]] bool contains(float value) const {
    return std::binary_search(values.begin(), values.end(), value);
  }
  [[nodiscard]] bool onBothSides() const {
    return cut_low && cut_high && low < 0.0F && high > 0.0F;
  }
  /// Returns the value at which distances in any unit are cut off on both sides. Returns 0 if the
  /// plateaus do not show this value. Distances divided by this value may have a plateau only at -1
  /// or only at 1.
  [[nodiscard]] double limit() const {
    constexpr double kRounding = 0.01;  // whole numbers may end at -128 and 127
    const double limit = std::max(-low, high);
    const bool symmetric = onBothSides() && std::min(-low, high) >= (1.0 - kRounding) * limit;
    const bool divided = limit == 1.0 && ((cut_low && low == -1.0F) || (cut_high && high == 1.0F));
    return symmetric || divided ? limit : 0.0;
  }
  /// If the background is beyond the values of the active voxels, by at most `step`, it becomes an
  /// end at which the values are cut off.
  void addBackground(double background, double step) {
    if (background - high > step || low - background > step) return;
    const auto value = static_cast<float>(background);
    if (value > high) {
      high = value;
      cut_high = from_background = true;
    } else if (value < low) {
      low = value;
      cut_low = from_background = true;
    }
  }
};

Plateaus plateausOf(const std::vector<ScalarSample>& samples) {
  // A value is a plateau if more than this fraction of the samples is in constant regions with it.
  // The lowest and the highest value also count as cut off if more than this fraction is beside
  // inactive voxels with this value.
  constexpr double kOften = 0.01;
  Plateaus found;
  std::vector<float> flat;
  std::size_t known = 0;
  for (const ScalarSample& s : samples) {
    if (!isKnown(s)) continue;
    ++known;
    bool same = true;
    forValues(s, [&](float value) {
      same = same && value == s.value;
      found.low = std::min(found.low, value);
      found.high = std::max(found.high, value);
    });
    if (same) flat.push_back(s.value);
  }
  const double least = kOften * static_cast<double>(known);
  std::sort(flat.begin(), flat.end());
  for (auto at = flat.begin(); at != flat.end();) {
    const auto end = std::upper_bound(at, flat.end(), *at);
    if (static_cast<double>(end - at) > least) found.values.push_back(*at);
    at = end;
  }
  // In a sparse grid, the inactive neighbours at the edge have the lowest or the highest value.
  std::size_t lows = 0;
  std::size_t highs = 0;
  for (const ScalarSample& s : samples) {
    if (!isKnown(s) || !s.at_edge) continue;
    bool low = false;
    bool high = false;
    forValues(s, [&](float value) {
      low = low || value == found.low;
      high = high || value == found.high;
    });
    lows += low ? 1 : 0;
    highs += high ? 1 : 0;
  }
  found.cut_low = found.contains(found.low) || static_cast<double>(lows) > least;
  found.cut_high = found.contains(found.high) || static_cast<double>(highs) > least;
  return found;
}

/// Lengths of the gradient at samples where the values are not cut off.
struct Slopes {
  std::vector<double> lengths;  ///< Ascending [values per unit of the file].
  double below = 0.0;
  double common = 0.0;  ///< Length of the mean of all directions; 1 in a linear ramp.

  [[nodiscard]] double median() const { return lengths[lengths.size() / 2]; }
  /// Returns the fraction of the lengths that are within `part` of `length`.
  [[nodiscard]] double shareNear(double length, double part) const {
    const auto from =
        std::lower_bound(lengths.begin(), lengths.end(), length - part * std::abs(length));
    const auto to =
        std::upper_bound(lengths.begin(), lengths.end(), length + part * std::abs(length));
    return static_cast<double>(to - from) / static_cast<double>(lengths.size());
  }
};

Slopes slopesOf(const std::vector<ScalarSample>& samples, const Plateaus& plateaus,
                const std::array<double, 3>& edges) {
  Slopes slopes;
  openvdb::Vec3d mean(0.0);
  std::size_t below = 0;
  for (const ScalarSample& s : samples) {
    if (!isKnown(s) || s.at_edge) continue;
    bool open = true;
    forValues(s, [&](float value) {
      open = open && !plateaus.contains(value) && !(plateaus.cut_low && value == plateaus.low) &&
             !(plateaus.cut_high && value == plateaus.high);
    });
    if (!open) continue;
    openvdb::Vec3d slope;
    for (std::size_t a = 0; a < 3; ++a) {
      slope[static_cast<int>(a)] =
          (static_cast<double>(s.after[a]) - s.before[a]) / (2.0 * edges[a]);
    }
    const double length = slope.length();
    slopes.lengths.push_back(length);
    if (length > 0.0) mean += slope / length;
    below += s.value < 0.0F ? 1 : 0;
  }
  const double count = std::max(1.0, static_cast<double>(slopes.lengths.size()));
  slopes.below = static_cast<double>(below) / count;
  slopes.common = mean.length() / count;
  std::sort(slopes.lengths.begin(), slopes.lengths.end());
  return slopes;
}

/// Returns true if more than three quarters of the values on the faces of the box are negative. If
/// `beyond` is true, reads the voxels around the box instead. If the extent is unknown,
/// SuggestInput::inactive_is_data replaces `beyond`.
bool isPositiveInside(const SuggestInput& input, bool beyond) {
  // A ground that fills up to 7/8 of its box's height covers up to 3/4 of the box's faces.
  constexpr double kNearlyAllFaces = 0.75;
  openvdb::CoordBBox box = input.extent;
  if (box.empty()) {
    box = input.grid->evalActiveVoxelBoundingBox();
    beyond = input.inactive_is_data;
  }
  if (beyond) box.expand(1);
  const Readings faces = readAt(input, facesOf(box));
  std::size_t below = 0;
  std::size_t all = 0;
  for (std::size_t i = 0; i < faces.values.size(); ++i) {
    const float value = faces.values[i];
    // A scanner writes 0 for voxels that it has not measured.
    if (value == 0.0F || (!input.inactive_is_data && !faces.active[i])) continue;
    ++all;
    below += value < 0.0F ? 1 : 0;
  }
  return static_cast<double>(below) > kNearlyAllFaces * static_cast<double>(all);
}

Distance kindOf(const Plateaus& plateaus, const Slopes& slopes, double edge) {
  constexpr double kNearlyAll = 0.8;   // fraction of the voxels; ridges have other slopes
  constexpr double kTolerance = 0.05;  // tolerance of the slope 1
  // Tolerance of the slope for noisy values. Nearly all slopes of a blurred step are outside it.
  constexpr double kNoisy = 0.25;
  constexpr double kVarying = 0.5;  // largest length of the mean direction
  const bool varying = slopes.common < kVarying;
  const bool exact = std::max(slopes.shareNear(1.0, kTolerance),
                              slopes.shareNear(1.0 / edge, kTolerance)) > kNearlyAll;
  if (!varying && !plateaus.onBothSides()) return Distance::kNone;
  if (exact) return Distance::kFull;
  const double slope = slopes.median();
  if (!(slope > 0.0)) return Distance::kNone;
  const bool one = std::min(std::abs(slope - 1.0), std::abs(slope * edge - 1.0)) < kTolerance;
  const bool known =
      (one && plateaus.onBothSides()) || slope * edge <= (1.0 + kTolerance) * plateaus.limit();
  return known && slopes.shareNear(slope, kNoisy) > kNearlyAll ? Distance::kTruncated
                                                               : Distance::kNone;
}

}  // namespace

void analyseDistance(const std::vector<ScalarSample>& samples, const SuggestInput& input,
                     ScalarAnalysis& scalar) {
  constexpr std::size_t kLeast = 64;  // with fewer samples, fractions would have errors above 5 %
  constexpr double kBothSigns = 0.01;
  const std::array<double, 3> edges = edgesOf(*input.grid);
  Plateaus plateaus = plateausOf(samples);
  const Slopes slopes = slopesOf(samples, plateaus, edges);
  if (slopes.lengths.size() < kLeast || !(slopes.below > kBothSigns) ||
      !(slopes.below < 1.0 - kBothSigns)) {
    return;
  }
  if (scalar.outside) {
    constexpr double kRounding = 1.05;
    plateaus.addBackground(*scalar.outside,
                           kRounding * slopes.median() * std::max({edges[0], edges[1], edges[2]}));
  }
  scalar.distance = kindOf(plateaus, slopes, std::cbrt(edges[0] * edges[1] * edges[2]));
  if (scalar.distance == Distance::kNone) return;
  scalar.positive_inside = isPositiveInside(input, plateaus.from_background);
}

}  // namespace palpate::guess
