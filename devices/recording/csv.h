/// Reads small CSV tables of numbers from a file or standard input. Rejects all other content.
#pragma once

#include <cstddef>
#include <fstream>
#include <istream>
#include <string>
#include <vector>

namespace palpate {

/// Opens a file, or standard input for "-". Errors of standard input are visible only after
/// std::ios::sync_with_stdio(false). Throws Error if the file is a folder, a pipe or a device, or
/// cannot be opened. `holder` owns the file and must outlive the stream.
[[nodiscard]] std::istream& openInput(const std::string& file, std::ifstream& holder);

/// A row of a table read by readCsv.
struct CsvRow {
  std::size_t line = 0;        ///< Line number in the file, from 1.
  std::vector<double> values;  ///< One number per column, in the header's order; finite.
};

/// Reads a table with exactly the header `columns` and with finite numbers only. Skips blank lines;
/// accepts CRLF and blanks around a field. Throws DeviceError with `name`, and with the line if a
/// row is wrong.
[[nodiscard]] std::vector<CsvRow> readCsv(std::istream& in, const std::vector<std::string>& columns,
                                          const std::string& name);

}  // namespace palpate
