/// All text for the terminal goes through these functions. Names from files, scenes, devices and
/// the command line may contain any character. The functions make sure that a name cannot move the
/// cursor, change the writing direction, begin a new line or fill the screen.
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

/// Longest name in a message, in characters as shown.
inline constexpr std::size_t kLongestName = 200;
/// Longest sentence with several names, in characters as shown.
inline constexpr std::size_t kLongestLine = 1000;

class Legible;
/// Type to which words() converts an argument of type T.
template <class T>
using Formatted = std::conditional_t<std::is_arithmetic_v<T>, T, std::string>;
/// Formats like fmt::format, but converts text arguments to Legible first and shortens them like
/// names. The format itself is not converted, because it is the program's own text and may contain
/// line ends.
template <class... Args>
[[nodiscard]] Legible words(fmt::format_string<Formatted<Args>...> format, const Args&... args);

/// Text that is safe for a terminal.
class Legible {
 public:
  /// Converts `text` to one line of printable UTF-8 with at most `most` characters (>= 40).
  /// A line end becomes \n. An invalid byte or a control character becomes an escape such as \x1b.
  /// An invisible character beyond ASCII (controls, marks of the writing direction, characters
  /// without width) becomes an escape such as \u202e or \U000e0041. If the text is too long, its
  /// middle is replaced by a note with the text's length. Legible text stays unchanged. Needs about
  /// four times the memory of `text`.
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

/// Returns JSON as text in valid UTF-8, even if names contain invalid bytes. Characters that
/// Legible would escape become JSON escapes.
[[nodiscard]] std::string dump(const OrderedJson& json, int indent = -1);

/// Writes data to standard output without conversion: CSV, or JSON from dump(). Throws
/// std::system_error if writing fails.
void sayRaw(std::string_view data);
/// Writes JSON and a line end to standard output.
void sayJson(const OrderedJson& json, int indent = 2);
/// Writes the line `palpate: ...` to standard error.
void complain(std::string_view line);

/// Converts an argument of words() to a value that fmt can format safely.
template <class T>
[[nodiscard]] Formatted<T> legible(const T& value) {
  if constexpr (std::is_same_v<T, Legible>) {
    return value.text();
  } else if constexpr (std::is_convertible_v<const T&, std::string_view>) {
    return Legible(value).text();
  } else {
    static_assert(std::is_arithmetic_v<T>, "text has to be seen as such");
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
