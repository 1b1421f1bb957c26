/// Private to the scene guess: a grid, its analysis and its kind.
#pragma once

#include <cmath>
#include <cstdint>
#include <string>

#include "palpate/scenes/guess/analysis.h"
#include "palpate/scenes/guess/guess.h"

namespace palpate::guess {

/// Kind of a grid, from one analysis.
enum class Kind : std::uint8_t {
  kOther,  ///< Not usable.
  kConstant,
  kLevelSet,
  kHounsfield,
  kMagnetic,  ///< MR.
  kLabels,
  kDistance,
  kScalar,  ///< Any other scalar.
  kDirections,
  kFlow,
};

/// A grid that may be used.
struct Candidate {
  const SuggestInput* input = nullptr;
  std::string grid;  ///< Name in the .vdb.
  std::string name;  ///< Name in the scene.
  ScalarAnalysis scalar;
  VectorAnalysis vector;
  double score = 0.0;  ///< Order of scalars, the best one highest.
  Kind kind = Kind::kOther;
  std::string seen;  ///< Reason for `kind`.

  /// Returns the name in the .vdb, else the name in the scene.
  [[nodiscard]] const std::string& shownName() const { return grid.empty() ? name : grid; }
  /// Returns the unit of the values after a space; empty: unknown.
  [[nodiscard]] std::string unit() const {
    return input->value_unit.empty() ? "" : " " + input->value_unit;
  }
};

/// Rounds a number to 4 digits for a text; whole numbers keep all digits.
inline double shown(double value) {
  return value == std::round(value) ? value : rounded(value, std::abs(value));
}

/// Returns the text with ASCII letters in lower case.
[[nodiscard]] std::string lowerCase(std::string text);

/// Returns true if values between the 5th and the 95th percentile differ, rounded: a drag can grow
/// with them.
[[nodiscard]] bool hasSpread(const ScalarAnalysis& scalar);

/// Analyses a grid once, and sets its kind and the reason. The rules are in kind_rules.cpp; the
/// first one that holds decides. `stated` is the user's --for.
void classify(Candidate& candidate, GuessFor stated);

}  // namespace palpate::guess
