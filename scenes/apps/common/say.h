/// Output to the terminal. Names from files, scenes, devices and the command line cannot move the
/// cursor, start a new line or fill the screen.
#pragma once

#include <cstddef>
#include <cstdio>
#include <string>
#include <string_view>
#include <type_traits>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace palpate::cli {

using OrderedJson = nlohmann::ordered_json;

/// Longest name in a message [characters as shown].
inline constexpr std::size_t kLongestName = 200;
/// Longest sentence with several names [characters as shown].
inline constexpr std::size_t kLongestLine = 1000;

class Legible;
template <class T>
using Formatted = std::conditional_t<std::is_arithmetic_v<T>, T, std::string>;
/// Formats like fmt::format, but converts text arguments to Legible first. The format is trusted
/// text: words() does not convert the format, which may contain line ends.
template <class... Args>
[[nodiscard]] Legible words(fmt::format_string<Formatted<Args>...> format, const Args&... args);

/// Text that is safe for a terminal.
class Legible {
 public:
  /// Converts `text` to one line of printable UTF-8 with at most `most` characters (>= 40). Line
  /// ends, control characters, invalid bytes and invisible characters become escapes, such as \n,
  /// \x1b, \u202e or \U000e0041. If the text is too long, a note with its length replaces the
  /// middle. Legible text of at most `most` characters stays unchanged.
  explicit Legible(std::string_view text, std::size_t most = kLongestName);

  [[nodiscard]] const std::string& text() const noexcept { return text_; }
  Legible& operator+=(const Legible& more) {
    text_ += more.text_;
    return *this;
  }

 private:
  template <class... Args>
  friend Legible words(fmt::format_string<Formatted<Args>...> format, const Args&... args);
  Legible() = default;

  std::string text_;
};

/// Converts a sentence that contains names, with the limit kLongestLine.
[[nodiscard]] inline Legible sentence(std::string_view text) {
  return Legible(text, kLongestLine);
}

/// Returns JSON as valid UTF-8, with escapes for the characters that Legible escapes.
[[nodiscard]] std::string dump(const OrderedJson& json, int indent = -1);

/// Writes data to standard output unchanged. Throws std::system_error.
void sayRaw(std::string_view data);
void sayJson(const OrderedJson& json, int indent = 2);
/// Flushes standard output. Throws Error if any output could not be written.
void flushOutput();
/// Writes the line `palpate: ...` to standard error.
void complain(std::string_view line);

template <class T>
[[nodiscard]] Formatted<T> legible(const T& value) {
  if constexpr (std::is_same_v<T, Legible>) {
    return value.text();
  } else if constexpr (std::is_convertible_v<const T&, std::string_view>) {
    return Legible(value).text();
  } else {
    static_assert(std::is_arithmetic_v<T>, "convert this argument to a string or a number");
    return value;
  }
}

template <class... Args>
Legible words(fmt::format_string<Formatted<Args>...> format, const Args&... args) {
  Legible out;
  out.text_ = fmt::format(fmt::runtime(fmt::string_view(format)), legible(args)...);
  return out;
}

/// Writes words() to standard output.
template <class... Args>
void say(fmt::format_string<Formatted<Args>...> format, const Args&... args) {
  sayRaw(words(format, args...).text());
}

/// Writes words() to standard error.
template <class... Args>
void sayAside(fmt::format_string<Formatted<Args>...> format, const Args&... args) {
  std::fputs(words(format, args...).text().c_str(), stderr);
}

}  // namespace palpate::cli
