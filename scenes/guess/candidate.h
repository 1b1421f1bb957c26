/// Private to the scene guess: a grid with its analysis and its kind.
#pragma once

#include <cmath>
#include <cstdint>
#include <string>

#include "palpate/scenes/guess/analysis.h"
#include "palpate/scenes/guess/guess.h"

namespace palpate::guess {

/// Kind of a grid. It decides on the rules that make modes for the grid.
enum class Kind : std::uint8_t {
  kOther,  ///< No mode can use the grid.
  kConstant,
  kLevelSet,
  kHounsfield,
  kMagnetic,  ///< An image of magnetic resonance.
  kLabels,
  kDistance,
  kScalar,  ///< A scalar of another kind than those above.
  kDirections,
  kFlow,
  kBody,  ///< The region of the largest body in an image (body.h).
};

/// A grid that a scene may use.
struct Candidate {
  const SuggestInput* input = nullptr;
  std::string grid;  ///< Name in the .vdb.
  std::string name;  ///< Name in the scene.
  ScalarAnalysis scalar;
  VectorAnalysis vector;
  double score = 0.0;  ///< Score of a scalar. Scalars with higher scores come first.
  Kind kind = Kind::kOther;
  std::string seen;  ///< Reason for `kind`, as text.

  /// Returns the grid's name in the .vdb. If it has none, returns its name in the scene.
  [[nodiscard]] const std::string& shownName() const { return grid.empty() ? name : grid; }
  /// Returns a space and the unit of the values; an empty text if the unit is unknown.
  [[nodiscard]] std::string unit() const {
    return input->value_unit.empty() ? "" : " " + input->value_unit;
  }
};

/// Rounds a number to 4 digits, to be printed. Whole numbers keep all digits.
inline double shown(double value) {
  return value == std::round(value) ? value : rounded(value, std::abs(value));
}

/// Returns the text with all ASCII letters in lower case.
[[nodiscard]] std::string lowerCase(std::string text);

/// Analyses a grid and sets its kind, with the reason. The first rule in kind_rules.cpp that
/// applies decides. `stated` is the value of --for.
void classify(Candidate& candidate, GuessFor stated);

}  // namespace palpate::guess
