/// Private to the importer: units of length, and the words for them in files and options.
#pragma once

#include <string_view>

namespace palpate::importer {

/// A word for a unit of length.
struct LengthUnit {
  std::string_view word;  ///< The word, in UTF-8 or as a format escapes it.
  const char* unit;       ///< The unit's name in palpate's output.
  double metres;          ///< Metres per unit.
};

/// Returns the unit of a word; null for other words.
[[nodiscard]] const LengthUnit* lengthUnitOf(std::string_view word) noexcept;

/// Returns true if scenes know the unit: m, cm, mm or um.
[[nodiscard]] bool isSceneUnit(const LengthUnit& unit) noexcept;

}  // namespace palpate::importer
