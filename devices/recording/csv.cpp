#include "palpate/devices/recording/csv.h"

#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <iostream>
#include <system_error>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

std::vector<std::string> split(const std::string& line) {
  std::vector<std::string> fields(1);
  for (const char c : line) {
    if (c == ',') {
      fields.emplace_back();
    } else {
      fields.back() += c;
    }
  }
  for (std::string& field : fields) {
    const auto first = field.find_first_not_of(" \t\r");
    const auto last = field.find_last_not_of(" \t\r");
    field = first == std::string::npos ? "" : field.substr(first, last - first + 1);
  }
  return fields;
}

}  // namespace

std::istream& openInput(const std::string& file, std::ifstream& holder) {
  if (file == "-") return std::cin;
  std::error_code error;
  if (std::filesystem::is_directory(file, error)) {
    throw Error(file, "it is a folder", "give a file");
  }
  // Rejects devices and pipes, because opening or reading one could block forever.
  if (std::filesystem::exists(file, error) && !std::filesystem::is_regular_file(file, error)) {
    throw Error(file, "it is a pipe or a device", "give a file, or - for standard input");
  }
  holder.open(file, std::ios::binary);
  if (!holder) {
    throw Error(file, std::string("it cannot be read (") + std::strerror(errno) + ")",
                "check the path and its permissions");
  }
  return holder;
}

std::vector<CsvRow> readCsv(std::istream& in, const std::vector<std::string>& columns,
                            const std::string& name) {
  std::string header;
  for (const std::string& column : columns) header += (header.empty() ? "" : ",") + column;

  std::string line;
  std::size_t number = 0;
  bool headed = false;
  std::vector<CsvRow> rows;
  while (std::getline(in, line)) {
    ++number;
    if (number == 1 && line.rfind("\xEF\xBB\xBF", 0) == 0) line.erase(0, 3);  // a byte-order mark
    if (line.find_first_not_of(" \t\r") == std::string::npos) continue;
    const std::vector<std::string> fields = split(line);
    if (!headed) {
      if (fields != columns) {
        throw DeviceError(name, "its first line is not the header " + header,
                          "begin the file with this header, and give each row these fields");
      }
      headed = true;
      continue;
    }
    const std::string where = name + " line " + std::to_string(number);
    if (fields.size() != columns.size()) {
      throw DeviceError(where,
                        "it has " + std::to_string(fields.size()) + " fields instead of " +
                            std::to_string(columns.size()),
                        "give " + header);
    }
    std::vector<double> row;
    for (const std::string& field : fields) {
      double value = 0.0;
      const char* first = field.data() + (field.size() > 1 && field[0] == '+' ? 1 : 0);
      const auto [end, error] = std::from_chars(first, field.data() + field.size(), value);
      if (error != std::errc() || end != field.data() + field.size() || !std::isfinite(value)) {
        throw DeviceError(where, "\"" + field + "\" is not a finite number",
                          "correct this field of the row");
      }
      row.push_back(value);
    }
    rows.push_back({number, std::move(row)});
  }
  if (in.bad()) {
    throw DeviceError(name, "reading failed after line " + std::to_string(number),
                      "check the disk or the program that writes it");
  }
  if (!headed) throw DeviceError(name, "it is empty", "give the header " + header + " and rows");
  return rows;
}

}  // namespace palpate
