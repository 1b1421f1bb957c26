/// Private to the scene guess: a grid with its analysis and its kind.
#pragma once

#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "palpate/scenes/guess/analysis.h"
#include "palpate/scenes/guess/guess.h"

namespace palpate::guess {

/// Kind of a grid, which determines the rules that make the grid's modes.
enum class Kind : std::uint8_t {
  kOther,  ///< No mode can use the grid.
  kConstant,
  kLevelSet,
  kHounsfield,
  kMagnetic,  ///< An image of magnetic resonance.
  kSegments,  ///< Labels that the metadata state.
  kLabels,    ///< Values that resemble labels.
  kDistance,
  kScalar,  ///< A scalar of no other kind.
  kDirections,
  kFlow,
  kBody,  ///< The region of the largest body in an image (body.h).
};

struct Candidate {
  const SuggestInput* input = nullptr;
  std::string grid;
  std::string name;
  ScalarAnalysis scalar;
  VectorAnalysis vector;
  std::vector<Label> segments;  ///< Labels of a scalar's metadata, as segmentsOf() returns them.
  double score = 0.0;           ///< Score of a scalar; higher scores come first.
  Kind kind = Kind::kOther;
  std::string seen;

  [[nodiscard]] const std::string& shownName() const { return grid.empty() ? name : grid; }
  /// Returns a space and the unit of the values; "" if the unit is unknown.
  [[nodiscard]] std::string unit() const {
    return input->value_unit.empty() ? "" : " " + input->value_unit;
  }
};

/// Rounds a number to 4 digits; whole numbers stay unchanged.
inline double shown(double value) {
  return value == std::round(value) ? value : rounded(value, std::abs(value));
}

[[nodiscard]] std::string lowerCase(std::string text);

/// Sets the kind and its reason by the first rule that applies. `stated` is the value of --for.
void classify(Candidate& candidate, GuessFor stated);

}  // namespace palpate::guess
