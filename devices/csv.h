/// Small CSV tables of numbers, strictly read, and where they come from.
#pragma once

#include <cstddef>
#include <fstream>
#include <istream>
#include <string>
#include <vector>

namespace palpate {

/// A file, or standard input for "-", of which a program hears of errors only where iostreams read
/// it by themselves (std::ios::sync_with_stdio(false)). Throws Error: it cannot be read.
///
/// @param holder  Has the file; lives as long as what is returned.
[[nodiscard]] std::istream& openInput(const std::string& file, std::ifstream& holder);

/// A row of a table that readCsv has read.
struct CsvRow {
  std::size_t line = 0;        ///< In the file, from 1.
  std::vector<double> values;  ///< One a column, in the header's order; finite.
};

/// Reads a table whose header is exactly `columns` and whose every field is a finite number. Blank
/// lines are skipped, CRLF and blanks around a field are fine. Throws DeviceError that names `name`
/// and the line.
[[nodiscard]] std::vector<CsvRow> readCsv(std::istream& in, const std::vector<std::string>& columns,
                                          const std::string& name);

}  // namespace palpate
