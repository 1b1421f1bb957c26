/// Private to scenes: reading text that somebody wrote.
#pragma once

#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <system_error>

namespace palpate {

/// Throws E unless there is a file of this name: a pipe may keep one waiting for ever, and a device
/// never ends.
template <class E>
void checkRegular(const std::filesystem::path& file, const std::string& remedy) {
  std::error_code error;
  const auto status = std::filesystem::status(file, error);
  if (!std::filesystem::exists(status)) {
    throw E(file.string(), "it cannot be read (" + error.message() + ")", remedy);
  }
  if (!std::filesystem::is_regular_file(status)) {
    throw E(file.string(), "it is no file, but a folder, a pipe or a device", remedy);
  }
}

/// All of a file. Throws E where it is none, or cannot be read.
template <class E>
[[nodiscard]] std::string readText(const std::filesystem::path& file, const std::string& remedy) {
  checkRegular<E>(file, remedy);
  std::ifstream in(file, std::ios::binary);
  std::ostringstream text;
  // Of an empty file nothing is put into it, which is a failure of the latter.
  if (in && in.peek() != std::ifstream::traits_type::eof()) text << in.rdbuf();
  if (in.bad() || !in.is_open() || !text) throw E(file.string(), "it cannot be read", remedy);
  return text.str();
}

}  // namespace palpate
