/// Rules that make the modes for each kind of grid. All strengths are in N and at most 3.5 N.
#include "palpate/scenes/guess/mode_rules.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <optional>
#include <utility>

#include <fmt/format.h>

namespace palpate::guess {
namespace {

/// Strength of a firm surface, such as that of a level set or of a material [N].
constexpr double kFirm = 3.0;
/// Strength of a surface that a firm push passes, such as the skin [N].
constexpr double kYielding = 1.5;
/// Strength of bone, and of the innermost of three surfaces [N].
constexpr double kInnermost = 3.5;

// Hounsfield units: air -1000, lung -700 to -500, fat -100, water 0, muscle 50, bone from 300.

constexpr double kFewVoxels = 1e-4;

/// Returns true if more than 1 of 10,000 voxels is above -200 HU, as fat, muscle and bone are.
bool hasFlesh(const ScalarAnalysis& scalar) {
  return scalar.shareAbove(-200.0) > kFewVoxels;
}

void addHounsfieldSkin(const Candidate& c, std::vector<Json>& modes) {
  constexpr double kAir = -500.0;
  if (!(c.scalar.low < kAir && hasFlesh(c.scalar))) return;
  modes.push_back(isosurface(
      "skin", c.name, kSkinHounsfield, true, kYielding,
      "The surface between air (-1000 HU) and skin (about 0 HU). It yields to a firm push."));
}

/// If more than 1 of 10,000 voxels is above 400 HU, adds the surface of bone: at the lowest
/// boundary from 150 to 500 HU, otherwise at 300 HU.
void addHounsfieldBone(const Candidate& c, std::vector<Json>& modes) {
  constexpr double kBone = 300.0;
  constexpr double kWithin = 100.0;  // some voxels must exceed kBone by this value
  constexpr double kLowest = 150.0;  // a boundary from this value to kHighest is that of bone
  constexpr double kHighest = 500.0;
  const ScalarAnalysis& scalar = c.scalar;
  if (!(scalar.shareAbove(kBone + kWithin) > kFewVoxels)) return;
  double bone = kBone;
  std::string how = "Bone and contrast agent are above 300 HU.";
  for (const Boundary& b : scalar.boundaries) {
    if (b.value < kLowest || b.value > kHighest) continue;
    bone = b.value;
    how = fmt::format("Bone: values change fastest near {} HU. A first guess.", scalar.round(bone));
    break;
  }
  modes.push_back(isosurface("bone", c.name, scalar.round(bone), true, kInnermost, how));
}

void addHounsfieldTissue(const Candidate& c, std::vector<Json>& modes) {
  constexpr double kFat = -100.0;
  if (!(hasFlesh(c.scalar) && c.scalar.low < kFat)) return;
  modes.push_back(drag("soft tissue", c.name, {{-300, 0}, {-100, 0.1}, {50, 0.2}, {300, 0.3}},
                       "A drag that grows from lung through fat (-100 HU) and muscle (50 HU) to "
                       "bone."));
}

// The values of MR images have no common scale.

struct SignalLevels {
  double skin = 0.0;
  double middle = 0.0;  ///< Median of the values inside the skin.
  double bright = 0.0;  ///< 95th percentile of the values inside the skin.
};

/// Returns the levels at and above the lowest boundary that is above the surroundings; no value
/// without such a boundary.
std::optional<SignalLevels> signalLevelsOf(const ScalarAnalysis& scalar) {
  // The noise of air has a Rayleigh distribution: 99.9 % is below this multiple of the median
  // (Gudbjartsson and Patz, The Rician distribution of noisy MRI data, 1995).
  constexpr double kNoise = 3.2;
  const double outside = scalar.outside.value_or(scalar.low);
  for (const Boundary& b : scalar.boundaries) {
    if (b.value <= outside) continue;
    const std::vector<float> inside(
        std::upper_bound(scalar.values.begin(), scalar.values.end(), static_cast<float>(b.foot)),
        scalar.values.end());
    const std::vector<float> air(
        scalar.values.begin(),
        std::lower_bound(scalar.values.begin(), scalar.values.end(), static_cast<float>(b.foot)));
    const double zero = scalar.low < 0.0 ? outside : 0.0;
    const double noise = std::max(0.0, percentile(air, 50.0) - zero);
    const double foot = std::clamp(zero + kNoise * noise, b.foot, b.value);
    return SignalLevels{scalar.round(foot), scalar.round(percentile(inside, 50.0)),
                        scalar.round(percentile(inside, 95.0))};
  }
  return std::nullopt;
}

void addSignalSkin(const Candidate& c, std::vector<Json>& modes) {
  const std::optional<SignalLevels> levels = signalLevelsOf(c.scalar);
  if (!levels) return;
  modes.push_back(isosurface("skin", c.name, levels->skin, true, kYielding,
                             fmt::format("The signal rises above the noise of the air at {}. This "
                                         "value is low, so that dark tissue is inside. A first "
                                         "guess.",
                                         levels->skin)));
}

/// Adds a drag that depends on the signal, but no inner surface: bright tissue may be soft.
void addSignalTissue(const Candidate& c, std::vector<Json>& modes) {
  const std::optional<SignalLevels> levels = signalLevelsOf(c.scalar);
  if (!levels) return;
  modes.push_back(
      drag("tissue", c.name, {{levels->skin, 0}, {levels->middle, 0.15}, {levels->bright, 0.3}},
           "A drag that grows with the signal, from the skin to the 95th percentile of the "
           "values inside the skin."));
}

// One isosurface can separate only the lowest or the highest label from all others.

double betweenLabels(const Candidate& c, std::size_t i) {
  return 0.5 * (double{c.scalar.distinct[i - 1]} + c.scalar.distinct[i]);
}

/// If the lowest label surrounds the others, adds one surface around them. Otherwise adds the
/// surface of the lowest label.
void addLowestLabel(const Candidate& c, std::vector<Json>& modes) {
  constexpr double kOneBody = 2.0;
  const std::vector<float>& all = c.scalar.distinct;
  const bool two = all.size() == 2;
  const bool lowest_is_outside = !c.scalar.outside || *c.scalar.outside <= double{all[0]};
  if (!lowest_is_outside) {
    modes.push_back(isosurface(fmt::format("{} label {}", c.name, shown(all[0])), c.name,
                               betweenLabels(c, 1), false, kFirm,
                               "The lowest label alone: no other label is below it."));
  } else if (two) {
    modes.push_back(isosurface(c.name, c.name, betweenLabels(c, 1), true, kOneBody,
                               "Half way between the two labels."));
  } else {
    modes.push_back(isosurface(
        c.name + " all labels", c.name, betweenLabels(c, 1), true, kYielding,
        fmt::format("All labels as one body, except {0}, which surrounds them: half way between "
                    "{0} and the next label. This surface leaves out the boundaries within the "
                    "body.",
                    shown(all[0]))));
  }
}

void addHighestLabel(const Candidate& c, std::vector<Json>& modes) {
  const std::vector<float>& all = c.scalar.distinct;
  const std::size_t last = all.size() - 1;
  if (last < 2) return;
  modes.push_back(isosurface(fmt::format("{} label {}", c.name, shown(all[last])), c.name,
                             betweenLabels(c, last), true, kFirm,
                             "The highest label alone: no other label is above it."));
}

/// Adds the surface of each label of a segmentation. If there are several, a firm push passes them.
void addSegments(const Candidate& c, std::vector<Json>& modes) {
  for (const Label& label : c.segments) {
    const bool by_name = !label.name.empty();
    const Json key = by_name ? Json(label.name) : Json(static_cast<std::int64_t>(label.value));
    modes.push_back(
        makeMode(by_name ? label.name : fmt::format("{} label {}", c.name, shown(label.value)),
                 "isosurface", c.name, {{"label", key}}, c.segments.size() > 1 ? kYielding : kFirm,
                 "The surface of this label, smoothed by one voxel."));
  }
}

void addDistanceSurface(const Candidate& c, std::vector<Json>& modes) {
  const bool above = c.scalar.positive_inside;
  modes.push_back(isosurface(c.name, c.name, 0.0, above, kFirm,
                             above ? "The surface at distance 0, solid where the values are above "
                                     "0, because most values on the volume's faces are below 0."
                                   : "The surface at distance 0, solid where the values are below "
                                     "0."));
}

struct ModeRule {
  Kind kind;
  void (*add)(const Candidate&, std::vector<Json>&);
};

/// The most important modes come first. Other scalars get surfaces at their boundaries.
constexpr std::array kModeRules{
    ModeRule{Kind::kHounsfield, addHounsfieldSkin},
    ModeRule{Kind::kHounsfield, addHounsfieldBone},
    ModeRule{Kind::kHounsfield, addHounsfieldTissue},
    ModeRule{Kind::kMagnetic, addSignalSkin},
    ModeRule{Kind::kMagnetic, addSignalTissue},
    ModeRule{Kind::kSegments, addSegments},
    ModeRule{Kind::kLabels, addLowestLabel},
    ModeRule{Kind::kLabels, addHighestLabel},
    ModeRule{Kind::kDistance, addDistanceSurface},
};

/// Names and strengths of one, two or three nested surfaces. Outer surfaces yield to a firm push.
struct Layer {
  const char* word = "";
  double strength = 0.0;  ///< [N]
};
constexpr std::array<std::array<Layer, 3>, 3> kLayers{{
    {{{"surface", 2.0}, {}, {}}},
    {{{"outer", kYielding}, {"inner", kFirm}, {}}},
    {{{"outer", 1.0}, {"middle", 2.0}, {"inner", kInnermost}}},
}};

std::string reasonOf(const Boundary& b, const Candidate& c) {
  const auto value = [&](double v) { return fmt::format("{}{}", c.scalar.round(v), c.unit()); };
  if (b.front) {
    return fmt::format(
        "A front, such as a shock: nearly everywhere, values jump within a few voxels where they "
        "pass {}, which is the value at the steepest places. A first guess.",
        value(b.value));
  }
  if (b.lower_known && b.upper_known) {
    return fmt::format(
        "Values change fastest between {} and {}. The isovalue is the middle, {}. A first guess.",
        value(b.lower), value(b.upper), value(b.value));
  }
  return fmt::format(
      "At {} the values leave a material, whose value is {}. They then change fast and reach no "
      "other material. A first guess.",
      value(b.value), value(b.lower_known ? b.lower : b.upper));
}

std::vector<Boundary> greatestOf(const ScalarAnalysis& scalar, std::size_t most) {
  std::vector<Boundary> found = scalar.boundaries;
  std::stable_sort(found.begin(), found.end(),
                   [](const Boundary& a, const Boundary& b) { return a.share > b.share; });
  if (found.size() > most) found.resize(most);
  return found;
}

/// Adds a drag that grows from the outermost to the innermost boundary of `side`. These boundaries
/// have values above that of the surroundings if `above` is true, otherwise below. With one
/// boundary, the drag grows up to the value of the enclosed material.
void addDragWithin(const Candidate& c, const std::vector<Boundary>& side, bool above,
                   std::vector<Json>& modes) {
  constexpr double kMost = 0.2;  // [N]: weaker than every surface
  const Boundary& outer = side.front();
  const Boundary& inner = side.back();
  const double edge = c.scalar.round(outer.value);
  const double end = c.scalar.round(side.size() > 1 ? inner.value
                                    : above         ? inner.upper
                                                    : inner.lower);
  if (edge == end) return;
  Knots knots{{edge, 0}, {end, kMost}};
  if (!above) std::swap(knots[0], knots[1]);
  const char* within = side.size() > 1 ? "Between the surfaces" : "Within the surface";
  modes.push_back(drag(c.name + " drag", c.name, knots,
                       std::string(within) + ": a drag that grows from one material to the next."));
}

/// Returns isosurfaces, the outermost first, and a drag on the side with the greatest boundary.
std::vector<Json> boundaryModes(const Candidate& c, std::size_t most) {
  std::vector<Boundary> found = greatestOf(c.scalar, most);
  if (found.empty()) return {};
  const double outside = c.scalar.outside.value_or(c.scalar.low);
  const bool main_above = found.front().value > outside;
  std::stable_sort(found.begin(), found.end(), [outside](const auto& a, const auto& b) {
    return std::abs(a.value - outside) < std::abs(b.value - outside);
  });

  std::vector<Json> modes;
  std::vector<Json> between;
  for (const bool above : {main_above, !main_above}) {
    std::vector<Boundary> side;
    std::copy_if(found.begin(), found.end(), std::back_inserter(side),
                 [&](const Boundary& b) { return (b.value > outside) == above; });
    if (side.empty()) continue;
    for (std::size_t i = 0; i < side.size(); ++i) {
      const Layer layer = kLayers.at(side.size() - 1).at(i);
      const char* dark = !above && side.size() < found.size() ? " dark " : " ";
      modes.push_back(isosurface(c.name + dark + layer.word, c.name, c.scalar.round(side[i].value),
                                 above, layer.strength, reasonOf(side[i], c)));
    }
    if (above == main_above) addDragWithin(c, side, above, between);
  }
  modes.insert(modes.end(), between.begin(), between.end());
  return modes;
}

Json dragByValue(const Candidate& c) {
  const double low = c.scalar.round(percentile(c.scalar.values, 5.0));
  const double high = c.scalar.round(percentile(c.scalar.values, 95.0));
  // Without surfaces, this drag is the only mode of the scalar. So it is stronger than the drag of
  // addDragWithin.
  return drag(c.name + " drag", c.name, {{low, 0}, {high, 0.4}},
              fmt::format("A drag that grows with the value, from its 5th to its 95th "
                          "percentile ({} to {}{}): no clear boundary was found.",
                          low, high, c.unit()));
}

/// Returns a curve of the speed: 0 N at the 10th percentile, 1 N at the median, 2 N at the 95th
/// percentile. If all speeds are about equal: 0 N at half the median, 1.5 N at 0.9 of it.
Json strengthBySpeed(const VectorAnalysis& flow) {
  // if the 95th percentile is below this multiple of the 10th, all speeds count as equal
  constexpr double kOneSpeed = 1.05;
  const double slow = percentile(flow.speed, 10.0);
  const double middle = percentile(flow.speed, 50.0);
  const double fast = percentile(flow.speed, 95.0);
  // If all speeds are equal, the curve separates points in the flow from points at rest.
  if (fast < kOneSpeed * slow) {
    return curve({{rounded(0.5 * middle, middle), 0}, {rounded(0.9 * middle, middle), 1.5}});
  }
  return curve({{rounded(slow, fast), 0}, {rounded(middle, fast), 1}, {rounded(fast, fast), 2}});
}

}  // namespace

std::vector<Json> scalarModes(const Candidate& c, std::size_t most) {
  std::vector<Json> modes;
  for (const ModeRule& rule : kModeRules) {
    if (rule.kind == c.kind) rule.add(c, modes);
  }
  if (modes.empty()) modes = boundaryModes(c, most);
  if (modes.empty()) modes.push_back(dragByValue(c));
  if (modes.size() > most) modes.resize(most);
  return modes;
}

Json levelSetSurface(const Candidate& c) {
  return isosurface(c.name, c.name, 0.0, false, kFirm,
                    "The surface of the level set, at the value 0. Values below 0 are solid.");
}

Json materialSurface(const Candidate& c, double share) {
  constexpr double kHalf = 0.5;
  return isosurface(c.name, c.name, kHalf, true, kFirm,
                    fmt::format("The material's surface, where its fraction is one half. The "
                                "material fills {} % of the volume.",
                                shown(100.0 * share)));
}

Json followDirections(const Candidate& directions) {
  return makeMode(
      "along " + directions.name, "follow", directions.name, Json::object(),
      strengthBySpeed(directions.vector),
      "The hand moves freely both ways along the direction, and a force resists motion across "
      "it. The strength grows with the length of the vectors. A first guess.");
}

Json followDirectionsBy(const Candidate& anisotropy, const Candidate& directions) {
  const std::string name = "along " + directions.name;
  const std::string free =
      "The hand moves freely along the fibres, and a force resists motion across them. The "
      "strength "
      "grows with the anisotropy. ";
  const ScalarAnalysis& scalar = anisotropy.scalar;
  // Fractional anisotropy is at most 1. A measure with all values below kMiddle is not fractional
  // anisotropy.
  constexpr double kHighest = 1.001;
  constexpr double kMiddle = 0.4;
  if (scalar.low >= 0.0 && scalar.high <= kHighest && scalar.high > kMiddle) {
    return makeMode(name, "follow", directions.name, {{"by", anisotropy.name}},
                    curve({{0.15, 0}, {kMiddle, 1}, {0.7, 2}}),
                    free + "Below an anisotropy of 0.15 the strength is zero.");
  }
  const auto at = [&](double percent) { return scalar.round(percentile(scalar.values, percent)); };
  return makeMode(name, "follow", directions.name, {{"by", anisotropy.name}},
                  curve({{at(25.0), 0}, {at(60.0), 1}, {at(95.0), 2}}),
                  free + fmt::format("The strength is zero up to the 25th percentile of {}, whose "
                                     "values do not have the usual range of fractional anisotropy.",
                                     anisotropy.name));
}

Json followFlow(const Candidate& flow, const std::string& speed) {
  const double median = percentile(flow.vector.speed, 50.0);
  return makeMode("along " + flow.name, "follow", flow.name, {{"by", speed}},
                  strengthBySpeed(flow.vector),
                  fmt::format("The hand moves freely along the stream, and a force resists motion "
                              "across it. The strength grows with the speed. The median "
                              "speed, without still places, is "
                              "{}{}. A first guess.",
                              rounded(median, median), flow.unit()));
}

Json followUniform(const Candidate& vector) {
  return makeMode(
      "along " + vector.name, "follow", vector.name, Json::object(), 1.0,
      "All vectors have the same direction. The hand moves freely along it, and a force "
      "resists motion across it.");
}

bool hasVortices(const VectorAnalysis& flow) {
  // the curl is irrelevant in a flow with a lower `turning` (shear has 0.5, a vortex 1)
  constexpr double kTurning = 0.1;
  const double middle = percentile(flow.curl, 50.0);
  const double most = percentile(flow.curl, 95.0);
  return !(flow.turning < kTurning) && rounded(most, most) > rounded(middle, most);
}

bool hasVortexCores(const VectorAnalysis& flow) {
  constexpr double kCore = 0.75;  // midway between shear (0.5) and the core of a vortex (1)
  return flow.core > kCore;
}

Json vortexTube(const Candidate& flow) {
  const double middle = percentile(flow.vector.curl, 50.0);
  const double most = percentile(flow.vector.curl, flow.vector.core_percent);
  return makeMode(
      "vortices", "vortex_tube", flow.name, Json::object(),
      curve({{rounded(middle, most), 0}, {rounded(most, most), 1.5}}),
      fmt::format("The hand moves freely along and around a vortex, and a force resists motion "
                  "towards its core or away from it. The strength grows with the vorticity, from "
                  "its median to its {:.0f}th percentile. A first guess.",
                  flow.vector.core_percent));
}

Json vortexDrag(const VectorAnalysis& flow, const std::string& vorticity) {
  const double middle = percentile(flow.curl, 50.0);
  const double most = percentile(flow.curl, 95.0);
  return drag("vorticity drag", vorticity, {{rounded(middle, most), 0}, {rounded(most, most), 0.3}},
              "A drag where the stream turns or shears. It is zero below the median of the "
              "vorticity.");
}

}  // namespace palpate::guess
