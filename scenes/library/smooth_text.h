/// Private to scenes: the text form of a smoothing width, such as "1.5 mm".
#pragma once

#include <optional>
#include <string>

#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Regular expression for the text: a number, and m, cm, mm, um or file.
inline constexpr const char* kSmoothPattern = "^[0-9]{1,9}(\\.[0-9]{1,9})? ?(m|cm|mm|um|file)$";

/// A width with a unit.
struct SmoothText {
  double size = 0.0;    ///< Width in this unit.
  double metres = 0.0;  ///< Metres per unit; 0 for the file's unit.
};

/// Parses a text that matches kSmoothPattern. Returns no value for other texts.
[[nodiscard]] std::optional<SmoothText> readSmoothText(const std::string& text);

}  // namespace palpate
