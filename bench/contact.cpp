/// Prints the cost and the precision of contact on concave or rough surfaces, and for comparison on
/// balls and solid cubes.
///
///     palpate_bench_contact [--frames N] [--only ROW] [--substeps N] [--seed N] [--surface]
///     [--times]
#include <cstdio>
#include <exception>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include <CLI/CLI.hpp>

#include "tests/support/contact_problems.h"
#include "tests/support/percentiles.h"
#include "tests/support/theorem.h"

using namespace palpate;
using namespace palpate::bench;

namespace {

struct Row {
  std::string name;
  std::function<ContactResult(const ContactRuns&)> run;
};

std::vector<Row> rows() {
  std::vector<Row> all;
  for (const int radius : {20, 4}) {
    all.push_back({"ball " + std::to_string(radius),
                   [=](const ContactRuns& runs) { return feelBalls(radius, runs); }});
  }
  for (const int opening : {12, 20, 25, 30, 35, 45, 60, 88, 120}) {
    all.push_back({"groove " + std::to_string(opening),
                   [=](const ContactRuns& runs) { return feelGrooves(opening, runs); }});
  }
  all.push_back({"hollow cube", [](const ContactRuns& runs) { return feelCubes(true, runs); }});
  all.push_back({"solid cube", [](const ContactRuns& runs) { return feelCubes(false, runs); }});
  for (const auto& [word, length] : {std::pair{"12", 12.0}, {"7", 7.0}, {"4.5", 4.5}}) {
    all.push_back({std::string("noise ") + word,
                   [length = length](const ContactRuns& runs) { return feelNoise(length, runs); }});
  }
  for (const int grain : {1, 2, 4}) {
    all.push_back({"press " + std::to_string(grain),
                   [=](const ContactRuns& runs) { return pressNoise(grain, runs); }});
  }
  return all;
}

void print(const std::string& name, const ContactResult& r) {
  std::printf(
      "%-12s %5ld %8ld %9.3f %9.3f %8.2f %7ld %8.4f %8.4f %8.3f %6ld %5ld/%-5ld %7.3f %6ld\n",
      name.c_str(), r.runs, r.held, 100.0 * r.cappedShare(), r.readingsPerTick(), r.cellsPerTick(),
      r.off, r.offRms(), r.off_most, r.deepest, r.leaked, r.unfinished, r.holds, r.hardest, r.over);
  if (!r.times.empty()) {
    std::printf("%-12s a tick: p50 %.0f ns, p99 %.0f, p99.9 %.0f\n", "", percentile(r.times, 0.5),
                percentile(r.times, 0.99), percentile(r.times, 0.999));
  }
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Contact in concave and rough places: one line a row");
  ContactRuns runs;
  std::string only;
  bool surface = false;
  bool times = false;
  app.add_option("--frames", runs.frames, "Runs of a row")->check(CLI::PositiveNumber);
  app.add_option("--only", only, "Rows whose name has this in it");
  app.add_option("--substeps", runs.step.max_substeps, "Readings")->check(CLI::Range(1, 64));
  app.add_option("--seed", runs.seed, "Of frames and hands");
  app.add_flag("--surface", surface, "The mode surface instead of isosurface");
  app.add_flag("--times", times, "Time ticks, and prove none");
  CLI11_PARSE(app, argc, argv);
  proving() = !times;
  if (surface) runs.kind = ModeKind::kSurface;
  try {
    std::printf(
        "off, deepest [voxel]; unfinished: holds of 150 ms that stand at the limit; hardest: "
        "force by strength, over 1.05 in so many ticks\n");
    std::printf("%-12s %5s %8s %9s %9s %8s %7s %8s %8s %8s %6s %11s %7s %6s\n", "row", "runs",
                "ticks", "capped %", "readings", "cells", "off", "rms", "most", "deepest", "leaked",
                "unfinished", "hardest", "over");
    for (const Row& row : rows()) {
      if (row.name.find(only) != std::string::npos) print(row.name, row.run(runs));
    }
  } catch (const std::exception& error) {
    std::fprintf(stderr, "palpate_bench_contact: %s\n", error.what());
    return 1;
  }
}
