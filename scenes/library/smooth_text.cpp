#include "palpate/scenes/library/smooth_text.h"

#include <array>
#include <charconv>
#include <regex>
#include <utility>

namespace palpate {

std::optional<SmoothText> readSmoothText(const std::string& text) {
  static const std::regex pattern(kSmoothPattern);
  static const std::array<std::pair<const char*, double>, 5> units{
      {{"file", 0.0}, {"m", 1.0}, {"cm", 1e-2}, {"mm", 1e-3}, {"um", 1e-6}}};
  std::smatch match;
  if (!std::regex_match(text, match, pattern)) return std::nullopt;
  SmoothText out;
  (void)std::from_chars(text.data(), text.data() + text.size(), out.size);
  for (const auto& [unit, metres] : units) {
    if (match[2] == unit) out.metres = metres;
  }
  return out;
}

}  // namespace palpate
