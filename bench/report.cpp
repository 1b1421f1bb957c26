#include "bench/report.h"

#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <stdexcept>
#include <unistd.h>

namespace palpate::bench {
namespace {

void write(const nlohmann::ordered_json& result, std::ostream& out) {
  const char* separator = "{\n";
  for (const auto& [key, value] : result.items()) {
    out << separator << '"' << key << "\": ";
    separator = ",\n";
    if (!value.is_array()) {
      out << value.dump();
      continue;
    }
    const char* between = "[\n  ";
    for (const auto& element : value) {
      out << between << element.dump();
      between = ",\n  ";
    }
    out << (value.empty() ? "[]" : "]");
  }
  out << "\n}\n";
}

}  // namespace

void tell(const std::string& what) {
  if (isatty(STDERR_FILENO) != 0) std::fprintf(stderr, "\r\033[K%s", what.c_str());
}

double rounded(double x) {
  char text[32];
  std::snprintf(text, sizeof text, "%.4g", x);
  return std::strtod(text, nullptr);
}

nlohmann::ordered_json asJson(const Machine& machine) {
  return {{"processor", machine.processor},
          {"compiler", machine.compiler},
          {"flags", machine.flags},
          {"commit", machine.commit},
          {"clock_step_ns", rounded(machine.clock_step)},
          {"pinned", machine.pinned}};
}

void writeResult(const nlohmann::ordered_json& result, const std::string& file) {
  if (file.empty()) {
    write(result, std::cout);
    if (!std::cout.flush()) throw std::runtime_error("standard output: cannot be written");
    return;
  }
  std::ofstream out(file);
  write(result, out);
  if (!out.flush()) throw std::runtime_error(file + ": cannot be written");
}

}  // namespace palpate::bench
