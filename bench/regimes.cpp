/// Prints a table of cases in which other methods fail, with the engine's results.
///
///     palpate_bench_regimes
///
/// Exits with 1 if a result differs from the documented one.
#include <cstdio>

#include "tests/support/regime_rows.h"

using palpate::bench::Finding;
using palpate::bench::Regime;

int main(int argc, char** argv) {
  if (argc > 1) {
    std::fprintf(stderr, "palpate_bench_regimes: %s: the program takes no arguments: remove it\n",
                 argv[1]);
    return 2;
  }
  bool all = true;
  std::puts("| where | method | what | found | asked |\n|---|---|---|---|---|");
  for (const Regime& row : palpate::bench::allRegimes()) {
    const char* where = row.where.c_str();
    const auto show = [&](const Finding& f, bool fails) {
      const bool as_said = fails ? f.fails() : f.holds();
      all = all && as_said;
      std::printf("| %s | %s | %s | %.3g | %s %.3g%s |\n", where, f.who.c_str(), f.what.c_str(),
                  f.value, fails ? "at least" : "at most", f.bound, as_said ? "" : ": **NOT SO**");
      where = "";
    };
    for (const Finding& f : row.fails) show(f, true);
    for (const Finding& f : row.holds) show(f, false);
    std::fflush(stdout);
  }
  return all ? 0 : 1;
}
