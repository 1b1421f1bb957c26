#include "palpate/scenes/library/smooth_text.h"

#include <charconv>
#include <regex>

#include "palpate/scenes/library/length_units.h"

namespace palpate {

std::optional<SmoothText> readSmoothText(const std::string& text) {
  static const std::regex pattern(kSmoothPattern);
  std::smatch match;
  if (!std::regex_match(text, match, pattern)) return std::nullopt;
  SmoothText out;
  (void)std::from_chars(text.data(), text.data() + text.size(), out.size);
  for (const SceneUnit& unit : kSceneUnits) {
    if (match[2] == unit.name) out.metres = unit.metres;
  }
  return out;
}

}  // namespace palpate
