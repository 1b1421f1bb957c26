#include "palpate/scenes/apps/common/say.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <utility>

#include "palpate/engine/error.h"

namespace palpate::cli {
namespace {

/// A character of UTF-8 text, or a byte that does not begin a valid character.
struct Character {
  std::size_t bytes = 1;
  char32_t point = 0;
  bool valid = false;
};

/// Returns the first character of `text`, which must not be empty. Overlong forms and surrogates
/// are invalid.
Character firstOf(std::string_view text) {
  const auto byte = [&](std::size_t i) { return static_cast<unsigned char>(text[i]); };
  const unsigned lead = byte(0);
  if (lead < 0x80) return {1, lead, true};
  const std::size_t bytes = lead < 0xc2   ? 0
                            : lead < 0xe0 ? 2
                            : lead < 0xf0 ? 3
                            : lead < 0xf5 ? 4
                                          : 0;
  if (bytes == 0 || text.size() < bytes) return {};
  char32_t point = lead & (0x7fU >> bytes);
  for (std::size_t i = 1; i < bytes; ++i) {
    if ((byte(i) & 0xc0U) != 0x80U) return {};
    point = (point << 6U) | (byte(i) & 0x3fU);
  }
  const bool overlong = (bytes == 3 && point < 0x800) || (bytes == 4 && point < 0x10000);
  const bool surrogate = point >= 0xd800 && point < 0xe000;
  if (overlong || surrogate || point > 0x10ffff) return {};
  return {bytes, point, true};
}

/// Returns true for characters that move the cursor, change the writing direction, or are
/// invisible: categories Cc, Zl, Zp and Cf, noncharacters, and Default_Ignorable_Code_Point of
/// Unicode. The 16-bit variation selectors, which emoji contain, are allowed.
bool isHidden(char32_t point) {
  constexpr std::array<std::pair<char32_t, char32_t>, 27> kHidden{
      {{0x00, 0x1f},       {0x7f, 0x9f},       {0xad, 0xad},       {0x34f, 0x34f},
       {0x600, 0x605},     {0x61c, 0x61c},     {0x6dd, 0x6dd},     {0x70f, 0x70f},
       {0x890, 0x891},     {0x8e2, 0x8e2},     {0x115f, 0x1160},   {0x17b4, 0x17b5},
       {0x180e, 0x180e},   {0x200b, 0x200f},   {0x2028, 0x202e},   {0x2060, 0x206f},
       {0x3164, 0x3164},   {0xfdd0, 0xfdef},   {0xfeff, 0xfeff},   {0xffa0, 0xffa0},
       {0xfff0, 0xfffb},   {0x110bd, 0x110bd}, {0x110cd, 0x110cd}, {0x13430, 0x1343f},
       {0x1bca0, 0x1bca3}, {0x1d173, 0x1d17a}, {0xe0000, 0xe0fff}}};
  return (point & 0xfffeU) == 0xfffe ||
         std::any_of(kHidden.begin(), kHidden.end(), [&](const auto& range) {
           return range.first <= point && point <= range.second;
         });
}

std::string escaped(const Character& character, unsigned char byte) {
  if (!character.valid) return fmt::format("\\x{:02x}", byte);
  switch (character.point) {
    case U'\n':
      return "\\n";
    case U'\r':
      return "\\r";
    case U'\t':
      return "\\t";
    default:
      break;
  }
  const auto point = static_cast<unsigned>(character.point);
  if (point < 0x80) return fmt::format("\\x{:02x}", point);
  return point < 0x10000 ? fmt::format("\\u{:04x}", point) : fmt::format("\\U{:08x}", point);
}

bool beginsCharacter(char byte) {
  return (static_cast<unsigned char>(byte) & 0xc0U) != 0x80U;
}

/// Shortens valid UTF-8 text to `most` characters by cutting out its middle.
std::string cut(std::string text, std::size_t most) {
  if (text.size() <= most) return text;
  const auto length =
      static_cast<std::size_t>(std::count_if(text.begin(), text.end(), beginsCharacter));
  if (length <= most) return text;
  const std::string gap = fmt::format("...({} characters)...", length);
  const std::size_t kept = most - std::min(most, gap.size());
  const std::size_t behind = kept / 3;
  const auto place = [&](std::size_t character) {
    for (std::size_t i = 0;; ++i) {
      if (i == text.size() || (beginsCharacter(text[i]) && character-- == 0)) return i;
    }
  };
  return text.substr(0, place(kept - behind)) + gap + text.substr(place(length - behind));
}

}  // namespace

Legible::Legible(std::string_view text, std::size_t most) {
  text_.reserve(text.size());
  while (!text.empty()) {
    const Character character = firstOf(text);
    if (character.valid && !isHidden(character.point)) {
      text_ += text.substr(0, character.bytes);
    } else {
      text_ += escaped(character, static_cast<unsigned char>(text[0]));
    }
    text.remove_prefix(character.bytes);
  }
  text_ = cut(std::move(text_), most);
}

std::string dump(const OrderedJson& json, int indent) {
  const std::string plain = json.dump(indent, ' ', false, OrderedJson::error_handler_t::replace);
  // In JSON, characters beyond ASCII occur only in strings, where escapes are allowed.
  std::string out;
  out.reserve(plain.size());
  for (std::string_view rest = plain; !rest.empty();) {
    const Character character = firstOf(rest);
    if (character.point >= 0x7f && isHidden(character.point)) {
      const auto point = static_cast<unsigned>(character.point);
      // JSON escapes a character beyond 16 bits as two surrogates.
      out += point < 0x10000 ? fmt::format("\\u{:04x}", point)
                             : fmt::format("\\u{:04x}\\u{:04x}", 0xd7c0U + (point >> 10U),
                                           0xdc00U + (point & 0x3ffU));
    } else {
      out += rest.substr(0, character.bytes);
    }
    rest.remove_prefix(character.bytes);
  }
  return out;
}

void sayRaw(std::string_view data) {
  fmt::print(stdout, "{}", fmt::string_view(data.data(), data.size()));
}

void sayJson(const OrderedJson& json, int indent) {
  sayRaw(dump(json, indent) + "\n");
}

void flushOutput() {
  if (std::fflush(stdout) == 0 && std::ferror(stdout) == 0) return;
  throw Error("standard output", "it cannot be written", "check the disk or the pipe");
}

void complain(std::string_view line) {
  sayAside("palpate: {}\n", sentence(line));
}

}  // namespace palpate::cli
