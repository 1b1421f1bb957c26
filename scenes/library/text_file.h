/// Private to scenes: reads text files that the user has named.
#pragma once

#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <system_error>

namespace palpate {

/// Throws E unless the path leads to a regular file: reading a pipe or a device could block
/// forever.
template <class E>
void checkRegular(const std::filesystem::path& file, const std::string& remedy) {
  std::error_code error;
  const auto status = std::filesystem::status(file, error);
  if (!std::filesystem::exists(status)) {
    throw E(file.string(), "it cannot be read (" + error.message() + ")", remedy);
  }
  if (!std::filesystem::is_regular_file(status)) {
    throw E(file.string(), "it is a folder, a pipe or a device", remedy);
  }
}

/// Returns the content of a file. Throws E if the file is not a regular file, or if it cannot be
/// read.
template <class E>
[[nodiscard]] std::string readText(const std::filesystem::path& file, const std::string& remedy) {
  checkRegular<E>(file, remedy);
  std::ifstream in(file, std::ios::binary);
  std::ostringstream text;
  // `text << in.rdbuf()` would report an error for an empty file.
  if (in && in.peek() != std::ifstream::traits_type::eof()) text << in.rdbuf();
  if (in.bad() || !in.is_open() || !text) throw E(file.string(), "it cannot be read", remedy);
  return text.str();
}

}  // namespace palpate
