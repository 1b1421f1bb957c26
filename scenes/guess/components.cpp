#include "palpate/scenes/guess/components.h"

#include <algorithm>
#include <cctype>
#include <optional>

namespace palpate {
namespace {

bool isWord(char c) {
  return std::isalnum(static_cast<unsigned char>(c)) != 0;
}

char lower(char c) {
  return static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
}

/// Removes the letter at `at` and the separator beside it.
std::string without(const std::string& name, std::size_t at) {
  std::string before = name.substr(0, at);
  std::string after = name.substr(at + 1);
  while (!before.empty() && !isWord(before.back())) before.pop_back();
  while (!after.empty() && !isWord(after.front())) after.erase(after.begin());
  // In "velocity_x_mean" the two other parts need a separator; in "VelXMean" they do not.
  const bool apart = at > 0 && !isWord(name[at - 1]) && !before.empty() && !after.empty();
  return apart ? before + name[at - 1] + after : before + after;
}

std::optional<std::string> stemOf(const std::string& name, std::size_t at, bool speed) {
  const bool opens = at == 0 || !isWord(name[at - 1]);
  const bool ends = at + 1 == name.size() || !isWord(name[at + 1]);
  if (speed && !(opens && ends)) return std::nullopt;
  std::string stem = without(name, at);
  if (stem.empty()) return speed ? std::optional<std::string>("velocity") : std::nullopt;
  return stem;
}

/// Returns true if the letter at `at` is one of two that name a component of a tensor, as in T_xx:
/// then `names` contains a name with another letter beside it, such as T_xy, T_yy or T_zz.
bool isOfTensor(const std::vector<std::string>& names, const std::string& name, std::size_t at) {
  for (const std::size_t beside : {at - 1, at + 1}) {
    if (beside >= name.size()) continue;
    for (const char other : {'x', 'y', 'z', 'X', 'Y', 'Z'}) {
      if (other == name[beside]) continue;
      for (char letter = 0; letter < 3; ++letter) {
        std::string tried = name;
        tried[beside] = other;
        tried[at] = static_cast<char>(tried[at] + letter);
        if (std::find(names.begin(), names.end(), tried) != names.end()) return true;
      }
    }
  }
  return false;
}

}  // namespace

std::vector<Components> findComponents(const std::vector<std::string>& names) {
  std::vector<Components> found;
  std::vector<bool> used(names.size(), false);
  for (std::size_t i = 0; i < names.size(); ++i) {
    const std::string& first = names[i];
    for (std::size_t at = 0; at < first.size() && !used[i]; ++at) {
      const bool speed = lower(first[at]) == 'u';
      if (!speed && lower(first[at]) != 'x') continue;
      const std::optional<std::string> stem = stemOf(first, at, speed);
      if (!stem || (!speed && isOfTensor(names, first, at))) continue;
      Components components{*stem, {i, i, i}};
      bool whole = true;
      for (std::size_t c = 1; c < 3; ++c) {
        std::string other = first;
        other[at] = static_cast<char>(other[at] + static_cast<char>(c));
        const auto there = std::find(names.begin(), names.end(), other);
        components.parts[c] = static_cast<std::size_t>(there - names.begin());
        whole = whole && there != names.end() && !used[components.parts[c]];
      }
      if (!whole) continue;
      for (const std::size_t part : components.parts) used[part] = true;
      found.push_back(std::move(components));
    }
  }
  return found;
}

}  // namespace palpate
