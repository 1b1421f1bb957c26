#include "palpate/scenes/apps/import/nrrd_header.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstring>
#include <fstream>
#include <sstream>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"

namespace palpate::importer {
namespace {

namespace fs = std::filesystem;

/// Returns "name.007" for "name.%03d" and 7. printf would be unsafe: the pattern is from a file.
std::string numbered(const std::string& pattern, int number, const std::string& file) {
  const auto at = pattern.find('%');
  std::size_t end = at == std::string::npos ? at : at + 1;
  std::size_t width = 0;
  const bool zeros = end < pattern.size() && pattern[end] == '0';
  while (end < pattern.size() && std::isdigit(static_cast<unsigned char>(pattern[end])) != 0) {
    width = std::min<std::size_t>(10 * width + static_cast<std::size_t>(pattern[end++] - '0'), 99);
  }
  const bool known = end < pattern.size() && std::strchr("diu", pattern[end]) != nullptr;
  if (!known || width > 20 || pattern.find('%', end) != std::string::npos) {
    throw VolumeError(file, fmt::format("the pattern of data files \"{}\" is invalid", pattern),
                      "write one %d, as in slice%03d.raw");
  }
  std::string digits = std::to_string(number);
  if (digits.size() < width) digits.insert(0, width - digits.size(), zeros ? '0' : ' ');
  return pattern.substr(0, at) + digits + pattern.substr(end + 1);
}

std::vector<NrrdPart> partsOf(const std::string& field, std::istream& rest, const fs::path& file) {
  constexpr int kMost = 1000000;
  const auto besides = [&](const std::string& name) {
    if (name == "-") {
      throw VolumeError(file.string(), "the header gives \"-\", a pipe, as the data file",
                        "give the name of a file");
    }
    return file.parent_path() / name;  // an absolute name stays unchanged
  };
  std::vector<NrrdPart> parts;
  std::istringstream words(field);
  std::string first;
  words >> first;
  if (first == "LIST" || first == "SKIPLIST") {
    std::string line;
    while (std::getline(rest, line) && static_cast<int>(parts.size()) < kMost) {
      while (!line.empty() && std::isspace(static_cast<unsigned char>(line.back())) != 0) {
        line.pop_back();
      }
      if (line.empty()) continue;
      NrrdPart part;
      if (first == "SKIPLIST") {
        std::istringstream pair(line);
        long skip = 0;
        pair >> skip >> std::ws;
        if (!pair) {
          throw VolumeError(
              file.string(),
              fmt::format("entry {} of the SKIPLIST does not begin with a number and a file name",
                          parts.size() + 1),
              kCorrectNrrdHeader);
        }
        std::getline(pair, line);
        part.skip = skip;
      }
      part.file = besides(line);
      parts.push_back(part);
    }
  } else if (int lowest = 0, highest = 0, step = 0;
             first.find('%') != std::string::npos && words >> lowest >> highest >> step) {
    if (step == 0 || (highest - static_cast<double>(lowest)) / step > kMost) {
      throw VolumeError(file.string(),
                        step == 0 ? "the step between the numbers of the data files is 0"
                                  : "the header numbers more than 1000000 data files",
                        kCorrectNrrdHeader);
    }
    for (long n = lowest; step > 0 ? n <= highest : n >= highest; n += step) {
      parts.push_back({besides(numbered(first, static_cast<int>(n), file.string())), 0, {}});
    }
  } else {
    parts.push_back({besides(field), 0, {}});
  }
  if (parts.empty())
    throw VolumeError(file.string(), "the header names no data file", kCorrectNrrdHeader);
  return parts;
}

/// Stores a line of the header: a field for teem, or a key/value pair. Leaves out comments and
/// fields that locate the data.
void takeLine(NrrdHeader& header, std::string line, const fs::path& file) {
  if (line[0] == '#') return;
  if (const auto pair = line.find(":="); pair < line.find(": ")) {
    header.pairs[line.substr(0, pair)] = line.substr(pair + 2);
    return;
  }
  std::string key = lowered(line.substr(0, line.find(':')));
  std::erase(key, ' ');
  if (key != "lineskip" && key != "byteskip") {
    // teem quotes the line in messages, which it writes into a buffer of 1024 characters.
    constexpr std::size_t kLongest = 800;
    if (line.size() > kLongest && key == "content") line.resize(kLongest);
    if (line.size() > kLongest) {
      throw VolumeError(file.string(), "the header has a line of more than 800 characters",
                        kCorrectNrrdHeader);
    }
    header.lines.push_back(std::move(line));
    // Debian's teem accepts the kind "3-gradient", but treats its number of components as unknown.
    std::string& taken = header.lines.back();
    const auto gradient = key == "kinds" ? taken.find("3-gradient") : std::string::npos;
    if (gradient != std::string::npos) taken.replace(gradient, 10, "3-vector");
    return;
  }
  std::istringstream value(line.substr(line.find(':') + 1));
  long count = 0;
  value >> count;
  if (!value || (key == "lineskip" && (count < 0 || count > 1000000))) {
    throw VolumeError(file.string(),
                      fmt::format("the field {} is not a whole number{}", key,
                                  key == "lineskip" ? " from 0 to 1000000" : ""),
                      kCorrectNrrdHeader);
  }
  if (key == "lineskip") {
    header.line_skip = static_cast<unsigned>(count);
  } else {
    header.byte_skip = count;
  }
}

}  // namespace

std::string lowered(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return text;
}

std::optional<std::vector<double>> indexValuesOf(const NrrdHeader& header, int axis,
                                                 std::size_t count) {
  const auto pair = header.pairs.find(fmt::format("axis {} index values", axis));
  if (pair == header.pairs.end()) return std::nullopt;
  std::istringstream words(pair->second);
  std::vector<double> values;
  for (double value = 0.0; values.size() < count && words >> value;) {
    if (!std::isfinite(value)) return std::nullopt;
    values.push_back(value);
  }
  const bool complete = values.size() == count && (words >> std::ws).eof();
  return complete ? std::optional(std::move(values)) : std::nullopt;
}

NrrdHeader readNrrdHeader(const fs::path& file) {
  constexpr std::size_t kLongest = 1U << 20U;
  std::ifstream in(file, std::ios::binary);
  NrrdHeader header;
  std::string line;
  std::size_t length = 0;
  while (std::getline(in, line)) {
    length += line.size();
    if (length > kLongest)
      throw VolumeError(file.string(), "the header is longer than 1 MiB", kNrrdDamaged);
    if (!line.empty() && line.back() == '\r') line.pop_back();
    if (line.empty()) {
      header.parts.push_back({file, static_cast<long>(in.tellg()), {}});
      return header;
    }
    const auto colon = line.find(':');
    const std::string key = lowered(line.substr(0, colon));
    if (colon != std::string::npos && (key == "data file" || key == "datafile")) {
      const auto value = line.find_first_not_of(" \t", colon + 1);
      const std::string field = value == std::string::npos ? "" : line.substr(value);
      header.parts = partsOf(field, in, file);
      if (field.rfind("LIST", 0) == 0 || field.rfind("SKIPLIST", 0) == 0) return header;
      // The next lines belong to the header, up to an empty line or the end of the file.
      while (std::getline(in, line)) {
        if (!line.empty() && line.back() == '\r') line.pop_back();
        if (line.empty() || header.lines.size() > 10000) break;
        takeLine(header, line, file);
      }
      return header;
    }
    takeLine(header, line, file);
  }
  throw VolumeError(
      file.string(),
      "the file ends within its header: an empty line or the field \"data file\" is missing",
      kNrrdDamaged);
}

}  // namespace palpate::importer
