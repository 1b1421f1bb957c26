/// The only path for text to the terminal. Names from files, scenes, devices and the command line
/// may hold any character. Text printed here cannot move the cursor, reverse the line, begin a line
/// of its own or fill the screen.
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

inline constexpr std::size_t kLongestName = 200;   ///< Characters, as shown.
inline constexpr std::size_t kLongestLine = 1000;  ///< For a sentence with several names.

class Legible;
/// Type to which words() converts an argument.
template <class T>
using Formatted = std::conditional_t<std::is_arithmetic_v<T>, T, std::string>;
/// Formats like fmt::format, but makes each text among the arguments legible: a text is cut like a
/// name, unless it is Legible already. A format is the program's own text and may hold line ends.
template <class... Args>
[[nodiscard]] Legible words(fmt::format_string<Formatted<Args>...> format, const Args&... args);

/// Text that is safe for a terminal.
class Legible {
 public:
  /// Converts `text` to printable UTF-8 in one line of at most `most` characters (>= 40). A line
  /// end becomes \n. A byte that is not UTF-8, or a control, becomes an escape like \x1b. An
  /// invisible character beyond ASCII (controls, marks that turn the direction of writing,
  /// characters of no width) becomes an escape like \u202e or \U000e0041. If the text is too long,
  /// its length replaces its middle. Legible text stays unchanged. Takes some four times the memory
  /// of `text`.
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

/// Returns a sentence composed of names.
[[nodiscard]] inline Legible sentence(std::string_view text) {
  return Legible(text, kLongestLine);
}

/// Returns JSON as text. Any bytes in names become UTF-8; characters that Legible escapes become
/// JSON escapes.
[[nodiscard]] std::string dump(const OrderedJson& json, int indent = -1);

/// Writes data to standard output unchanged: CSV, or JSON by dump(). Throws std::system_error if
/// the write fails.
void sayRaw(std::string_view data);
/// Writes JSON to standard output, with a line end.
void sayJson(const OrderedJson& json, int indent = 2);
/// Writes one line to stderr: `palpate: ...`.
void complain(std::string_view line);

/// Returns an argument of words() as it is formatted.
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
