/// The one way for text to the terminal. Names come out of files, scenes, devices and the command
/// line as they please: what is printed here cannot move the cursor, turn the line around, begin a
/// line of its own or fill the screen.
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
inline constexpr std::size_t kLongestLine = 1000;  ///< Of a sentence with several names in it.

class Legible;
/// What an argument of words() is formatted as.
template <class T>
using Formatted = std::conditional_t<std::is_arithmetic_v<T>, T, std::string>;
/// fmt::format, each text among the arguments made legible: cut as a name is, unless it is Legible
/// already. A format is the program's own and may hold line ends.
template <class... Args>
[[nodiscard]] Legible words(fmt::format_string<Formatted<Args>...> format, const Args&... args);

/// Text as a terminal may have it.
class Legible {
 public:
  /// What `text` is shown as: printable UTF-8 in one line, of `most` characters at most (>= 40). A
  /// line's end is \n, a byte that is no UTF-8 or a control \x1b, what is not seen beyond ASCII
  /// (controls, marks that turn the direction of writing, characters of no width) \u202e or
  /// \U000e0041; of what is too long the middle is left out, and its length told. What is legible
  /// stays as it is. Takes some four times the memory of `text`.
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

/// A sentence that was put together out of names.
[[nodiscard]] inline Legible sentence(std::string_view text) {
  return Legible(text, kLongestLine);
}

/// JSON as text: any bytes in names made UTF-8, and what Legible escapes escaped as JSON has it.
[[nodiscard]] std::string dump(const OrderedJson& json, int indent = -1);

/// Data to standard output, as they are: CSV, or JSON by dump(). Throws std::system_error where it
/// cannot be written.
void sayRaw(std::string_view data);
/// JSON to standard output, with a line's end.
void sayJson(const OrderedJson& json, int indent = 2);
/// One line on stderr: `palpate: ...`.
void complain(std::string_view line);

/// An argument of words(), as it is formatted.
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

/// words() to standard output.
template <class... Args>
void say(fmt::format_string<Formatted<Args>...> format, const Args&... args) {
  sayRaw(words(format, args...).text());
}

/// words() to standard error.
template <class... Args>
void sayAside(fmt::format_string<Formatted<Args>...> format, const Args&... args) {
  std::fputs(words(format, args...).text().c_str(), stderr);
}

}  // namespace palpate::cli
