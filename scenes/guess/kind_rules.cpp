/// Rules that determine the kind of a grid. mode_rules.cpp makes the modes of each kind.
#include <array>
#include <cctype>
#include <span>
#include <vector>

#include <fmt/format.h>

#include "palpate/scenes/guess/body.h"
#include "palpate/scenes/guess/candidate.h"

namespace palpate::guess {
namespace {

struct Evidence {
  const SuggestInput& input;
  const ScalarAnalysis& scalar;
  const VectorAnalysis& vector;
  const std::vector<Label>& segments;
  GuessFor stated;
};

struct KindRule {
  bool (*holds)(const Evidence&);
  Kind kind;
  const char* why;  ///< Reason for the kind; explain() replaces the names in braces.
};

/// If more than this fraction of the values are whole numbers, the grid counts as a grid of whole
/// numbers.
constexpr double kNearlyWhole = 0.95;

bool always(const Evidence&) {
  return true;
}

template <GuessFor kStated>
bool isStated(const Evidence& e) {
  return e.stated == kStated;
}

bool isLevelSet(const Evidence& e) {
  return e.input.isScalar() && e.input.grid->getGridClass() == openvdb::GRID_LEVEL_SET;
}
bool isBodyRegion(const Evidence& e) {
  return (*e.input.grid)[kMetaBodyOf] != nullptr;
}
bool hasOtherTransforms(const Evidence& e) {
  return e.input.apart;
}
bool hasOtherType(const Evidence& e) {
  return !e.input.isVector() && !e.input.isScalar();
}

constexpr std::array kGridRules{
    KindRule{isLevelSet, Kind::kLevelSet, "a level set, according to its grid class"},
    KindRule{isBodyRegion, Kind::kBody,
             "the region of the largest body, according to its metadata"},
    KindRule{hasOtherTransforms, Kind::kOther, "components with different transforms"},
    KindRule{hasOtherType, Kind::kOther, "values of type {type} are not supported"},
};

bool isConstantVector(const Evidence& e) {
  return e.vector.constant;
}
bool isAxial(const Evidence& e) {
  return e.input.axial;
}
bool hasLengthOne(const Evidence& e) {
  constexpr double kNearlyAll = 0.99;  // fraction of the vectors of the flow
  return e.vector.unit >= kNearlyAll && e.stated != GuessFor::kCfd;
}

constexpr std::array kVectorRules{
    KindRule{isConstantVector, Kind::kConstant, "nearly all values are equal"},
    KindRule{isStated<GuessFor::kFibres>, Kind::kDirections, "directions, set by --for fibres"},
    KindRule{isAxial, Kind::kDirections,
             "directions without a sign, according to the file's metadata"},
    KindRule{hasLengthOne, Kind::kDirections,
             "vectors of length 1: directions without a sign (if this is a flow, use --for cfd)"},
    KindRule{always, Kind::kFlow,
             "a flow: vectors with lengths mostly from {slowest} to {fastest}{unit}"},
};

bool isConstantScalar(const Evidence& e) {
  return !varies(e.scalar);
}
bool isLabelsStated(const Evidence& e) {
  return e.stated == GuessFor::kLabels && e.scalar.whole > kNearlyWhole &&
         e.scalar.distinct.size() > 1;
}

/// Returns true if at least 0.2 % of the values, or the value around an image, are below -20 [HU],
/// as air is. Raw values of a scanner are rarely negative.
bool hasAir(const ScalarAnalysis& scalar) {
  return scalar.low < -20.0;
}
bool isHounsfieldStated(const Evidence& e) {
  return e.stated == GuessFor::kCt && hasAir(e.scalar);
}

/// Returns true if --for leaves the kind of scalars open: metadata and values then determine the
/// kind. `--for fibres` states only the kind of vectors.
bool isOpen(const Evidence& e) {
  return e.stated == GuessFor::kAnything || e.stated == GuessFor::kFibres;
}
bool isSegmentation(const Evidence& e) {
  return (isOpen(e) || e.stated == GuessFor::kLabels) && !e.segments.empty();
}
bool isStatedAsCt(const Evidence& e) {
  return e.stated == GuessFor::kCt || e.input.modality == Modality::kCt;
}
bool isRawCt(const Evidence& e) {
  return isStatedAsCt(e) && !hasAir(e.scalar);
}
bool hasOtherUnit(const Evidence& e) {
  const std::string unit = lowerCase(e.input.value_unit);
  return !unit.empty() && unit != "hu" && unit != "hounsfield";
}
bool isHounsfieldByMetadata(const Evidence& e) {
  // Without a unit, values of air show that the unit is HU.
  return isOpen(e) && !hasOtherUnit(e) &&
         (!e.input.value_unit.empty() || (isStatedAsCt(e) && hasAir(e.scalar)));
}
bool isMrByMetadata(const Evidence& e) {
  return isOpen(e) && e.input.modality == Modality::kMr;
}

/// Returns true if air (about -1000), tissue (0 to 100) and bone (800 or more) occur, and tissue
/// has a peak.
bool isHounsfieldByValues(const Evidence& e) {
  constexpr double kBone = 800.0;        // the highest value must reach this
  constexpr double kHighest = 32768.0;   // range of 16-bit values
  constexpr double kPadding = -3100.0;   // scanners pad images with values down to -3024
  constexpr double kLeastWhole = 0.005;  // least fraction of voxels with air, and with tissue
  // the same for values that were resampled or smoothed
  constexpr double kLeastSmooth = 0.05;
  constexpr double kAir = -1000.0;
  constexpr double kAboutAir = 100.0;
  // least ratio of voxels with tissue to voxels in a range of equal width on either side
  constexpr double kPeak = 2.0;

  const ScalarAnalysis& scalar = e.scalar;
  if (!isOpen(e) || hasOtherUnit(e) || scalar.values.empty() || scalar.values.back() < kBone ||
      percentile(scalar.values, 99.9) > kHighest || scalar.low < kPadding) {
    return false;
  }
  const double least = scalar.whole > kNearlyWhole ? kLeastWhole : kLeastSmooth;
  const bool air_outside =
      scalar.outside && *scalar.outside > kAir - kAboutAir && *scalar.outside < kAir + kAboutAir;
  const double tissue = scalar.shareWithin(0.0, 100.0);
  return (air_outside || scalar.shareWithin(kAir - kAboutAir, kAir + kAboutAir) > least) &&
         tissue > least && tissue > kPeak * scalar.shareWithin(150.0, 250.0) &&
         tissue > kPeak * scalar.shareWithin(-500.0, -400.0);
}
bool isDistanceByValues(const Evidence& e) {
  return isOpen(e) && e.scalar.distance == Distance::kFull;
}
bool isTruncatedByValues(const Evidence& e) {
  return isOpen(e) && e.scalar.distance == Distance::kTruncated;
}

/// Returns true for labels, of which any two can be neighbours. At a boundary in an image, all
/// values in between occur.
bool isLabelsByValues(const Evidence& e) {
  constexpr double kAllWhole = 0.999;      // fraction of the voxels
  constexpr double kConstantPieces = 0.5;  // fraction of equal neighbours
  constexpr double kAnyOrder = 0.1;        // fraction of unequal neighbours with a label in between
  const ScalarAnalysis& scalar = e.scalar;
  return isOpen(e) && scalar.whole > kAllWhole && scalar.distinct.size() > 2 &&
         scalar.alike > kConstantPieces && scalar.skips > kAnyOrder;
}
bool hasNoBoundary(const Evidence& e) {
  return e.scalar.boundaries.empty();
}
bool hasFront(const Evidence& e) {
  return e.scalar.boundaries.front().front;
}
bool hasOneBoundary(const Evidence& e) {
  return e.scalar.boundaries.size() == 1;
}

constexpr std::array kScalarRules{
    KindRule{isSegmentation, Kind::kSegments,
             "{values}: {segments} labels, according to the file's metadata"},
    KindRule{isConstantScalar, Kind::kConstant, "nearly all values are equal"},
    // Rules for the user's --for.
    KindRule{isStated<GuessFor::kCfd>, Kind::kScalar, "{values}: a field, set by --for cfd"},
    KindRule{isStated<GuessFor::kMri>, Kind::kMagnetic, "{values}: an MR image, set by --for mri"},
    KindRule{isLabelsStated, Kind::kLabels, "{values}: {labels} labels, set by --for labels"},
    KindRule{isHounsfieldStated, Kind::kHounsfield, "{values}: Hounsfield units, set by --for ct"},
    // Rules for the file's metadata.
    KindRule{isHounsfieldByMetadata, Kind::kHounsfield,
             "{values}: Hounsfield units, according to the file's metadata"},
    KindRule{isMrByMetadata, Kind::kMagnetic,
             "{values}: an MR image, according to the file's metadata"},
    // Rules for the values.
    KindRule{isHounsfieldByValues, Kind::kHounsfield,
             "{values}: air near -1000 and tissue at 0 to 100: Hounsfield units (if this is wrong, "
             "use --for cfd)"},
    KindRule{isDistanceByValues, Kind::kDistance,
             "{values}: they change by 1 per unit or voxel nearly everywhere: the distance to a "
             "surface"},
    KindRule{isTruncatedByValues, Kind::kDistance,
             "{values}: they change evenly up to a limit: the distance to a surface, truncated"},
    KindRule{isLabelsByValues, Kind::kLabels,
             "{values}: {labels} values in constant regions, any two of which can touch: labels"},
    KindRule{isRawCt, Kind::kScalar,
             "{values}: CT without values of air, below -20: raw values of a scanner"},
    KindRule{hasNoBoundary, Kind::kScalar, "{values}: no boundary was found"},
    KindRule{hasFront, Kind::kScalar, "{values}: a sharp front"},
    KindRule{hasOneBoundary, Kind::kScalar, "{values}: a boundary between materials"},
    KindRule{always, Kind::kScalar, "{values}: {boundaries} boundaries between materials"},
};

/// Returns for example "values from 0.1 to 2.5 Pa (99.6 % of them)".
std::string rangeOf(const Candidate& c) {
  const ScalarAnalysis& scalar = c.scalar;
  const bool whole = scalar.whole > kNearlyWhole && c.kind != Kind::kDistance;
  const auto end = [&](double value) { return whole ? value : scalar.round(value); };
  const std::string no_data =
      scalar.no_data ? fmt::format(", {} marks missing data", shown(*scalar.no_data)) : "";
  const std::string common =
      scalar.common ? fmt::format(", {} in nearly all voxels", shown(*scalar.common)) : "";
  return fmt::format("{} from {} to {}{} (99.6 % of them){}{}", whole ? "whole numbers" : "values",
                     end(scalar.low), end(scalar.high), c.unit(), no_data, common);
}

std::string explain(const char* why, const Candidate& c) {
  const std::vector<float>& speed = c.vector.speed;
  return fmt::format(
      fmt::runtime(why), fmt::arg("type", c.input->grid->valueType()), fmt::arg("unit", c.unit()),
      fmt::arg("values", rangeOf(c)), fmt::arg("labels", c.scalar.distinct.size()),
      fmt::arg("segments", c.segments.size()), fmt::arg("boundaries", c.scalar.boundaries.size()),
      fmt::arg("slowest", speed.empty() ? 0.0 : shown(speed.front())),
      fmt::arg("fastest", speed.empty() ? 0.0 : shown(speed.back())));
}

/// Applies the first rule whose condition holds. Returns false if there is no such rule.
bool decide(std::span<const KindRule> rules, GuessFor stated, Candidate& c) {
  const Evidence evidence{*c.input, c.scalar, c.vector, c.segments, stated};
  for (const KindRule& rule : rules) {
    if (!rule.holds(evidence)) continue;
    c.kind = rule.kind;
    c.seen = explain(rule.why, c);
    return true;
  }
  return false;
}

}  // namespace

std::string lowerCase(std::string text) {
  for (char& c : text) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return text;
}

void classify(Candidate& candidate, GuessFor stated) {
  if (decide(kGridRules, stated, candidate)) return;
  if (candidate.input->isVector()) {
    candidate.vector = analyseVector(*candidate.input);
    decide(kVectorRules, stated, candidate);
  } else {
    candidate.scalar = analyseScalar(*candidate.input);
    candidate.segments = segmentsOf(*candidate.input);
    decide(kScalarRules, stated, candidate);
  }
}

}  // namespace palpate::guess
