/// Measures the cost of a volume in bricks: bytes, time to write, time to fetch a brick.
///
///     palpate_bench_bricks FILE.vdb [--grid NAME] [--compression N]... [--folder FOLDER]
///
///     palpate_bench_bricks --formula N [--folder FOLDER]
///
/// Prints a row for each given level of zstd (default 1, 3 and 9), with 32 and with 16 bits. One
/// thread fetches, decompresses and checks the bricks in random order, from the system's cache and
/// then from disk. With --formula, writes N^3 computed bricks and prints the peak memory. Only some
/// of these bricks are in memory at the same time.
#include "palpate/samplers/bricks/bricks.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <fcntl.h>
#include <filesystem>
#include <random>
#include <string>
#include <sys/resource.h>
#include <system_error>
#include <unistd.h>
#include <vector>

#include <CLI/CLI.hpp>

#include "bench/machine.h"
#include "palpate/samplers/bricks/write_bricks.h"
#include "tests/support/percentiles.h"

namespace {

using namespace palpate;
using bench::Clock;
namespace fs = std::filesystem;

double millisecondsSince(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

/// Asks the system to drop a file from its cache, so that the next read comes from the disk.
void letGo(const fs::path& file) {
  const int opened = open(file.c_str(), O_RDONLY | O_CLOEXEC);
  if (opened < 0) return;
  (void)posix_fadvise(opened, 0, 0, POSIX_FADV_DONTNEED);
  close(opened);
}

/// Returns the time to fetch each of the bricks `ids` [ms].
std::vector<double> fetched(BrickSource& source, const std::vector<BrickId>& ids) {
  std::vector<std::byte> slot(source.manifest().format().bytes());
  std::vector<double> times;
  times.reserve(ids.size());
  for (const BrickId& id : ids) {
    const auto start = Clock::now();
    const BrickArrival arrival = source.read(id, slot);
    times.push_back(millisecondsSince(start));
    if (arrival.status != BrickStatus::kArrived) throw std::runtime_error(arrival.why);
  }
  return times;
}

void row(const std::shared_ptr<const Volume>& volume, bool half, int compression,
         const fs::path& folder) {
  const BrickInput input = brickInput(volume, half);
  fs::remove_all(folder);
  const auto start = Clock::now();
  BrickOptions options;
  options.compression = compression;
  const BrickManifest manifest = writeBricks(folder, input, options).manifest;
  const double seconds = millisecondsSince(start) / 1e3;

  std::vector<BrickId> ids;
  for (std::int32_t l = 0; l < static_cast<std::int32_t>(manifest.levels().size()); ++l) {
    for (const BrickEntry& entry : manifest.entries(l)) {
      if (entry.kind == BrickKind::kStored) ids.push_back({l, entry.at});
    }
  }
  const std::size_t stored = ids.size();
  std::mt19937_64 random(1);
  std::vector<BrickId> asked;
  while (asked.size() < 2000) {
    std::shuffle(ids.begin(), ids.end(), random);
    asked.insert(asked.end(), ids.begin(), ids.end());
  }
  PosixBricks source(folder);
  (void)fetched(source, ids);
  const std::vector<double> warm = fetched(source, asked);
  for (const BrickId& id : ids) letGo(folder / brickObject(id, manifest.format()));
  const std::vector<double> cold = fetched(source, ids);

  const auto unpacked = static_cast<double>(stored * manifest.format().bytes());
  const auto bytes = static_cast<double>(manifest.storedBytes());
  std::printf("| %s | %d | %zu | %.1f | %.2f | %.2f | %.0f | %.2f | %.2f | %.2f | %.2f | %.2f |\n",
              half ? "16 bits" : "32 bits", compression, stored, bytes / 1e6, unpacked / bytes,
              bytes / static_cast<double>(volume->info().active_voxels), unpacked / 1e6 / seconds,
              bench::percentile(warm, 0.5), bench::percentile(warm, 0.99),
              bench::percentile(warm, 1.0), bench::percentile(cold, 0.5),
              bench::percentile(cold, 0.99));
  std::fflush(stdout);
}

void writeFormula(int bricks, const fs::path& folder) {
  const int side = kBrickSide * bricks;
  BrickInput input;
  input.name = "waves";
  input.grid_class = GridClass::kFog;
  input.upper = {side - 1, side - 1, side - 1};
  input.identity = "waves";
  std::vector<float> wave(static_cast<std::size_t>(side) + 4);
  for (std::size_t n = 0; n < wave.size(); ++n) {
    wave[n] = 1.0F + std::sin(0.03F * static_cast<float>(n));
  }
  input.fill = [&](const BrickBox& box) {
    const auto at = [&](std::size_t a, int n) {
      return wave[static_cast<std::size_t>(std::max(0, box.lower[a] + n))];
    };
    std::size_t n = 0;
    for (int i = 0; i < kBrickEdge; ++i) {
      for (int j = 0; j < kBrickEdge; ++j) {
        for (int k = 0; k < kBrickEdge; ++k, ++n) {
          // Values of 12 bits, as in a CT scan.
          box.values[n] = std::round(512.0F * at(0, i) * at(1, j) * at(2, k));
        }
      }
    }
    std::fill(box.active.begin(), box.active.end(), std::uint8_t{0xFF});
    return BoxFilled::kEach;
  };
  fs::remove_all(folder);
  const auto start = Clock::now();
  const BrickManifest manifest = writeBricks(folder, input).manifest;
  const double seconds = millisecondsSince(start) / 1e3;
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const double whole = 4.0 * std::pow(static_cast<double>(side), 3);
  std::printf(
      "%d^3 values, %.1f GB: %zu levels of %.1f GB written in %.0f s, %.0f MB/s, with %.0f MB of "
      "memory at most\n",
      side, whole / 1e9, manifest.levels().size(),
      static_cast<double>(manifest.storedBytes()) / 1e9, seconds, whole / 1e6 / seconds,
      static_cast<double>(usage.ru_maxrss) / 1024.0);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"What does a volume in bricks cost?"};
  std::string file;
  std::string grid;
  int formula = 0;
  std::vector<int> compressions{1, 3, 9};
  std::string folder =
      (fs::temp_directory_path() / ("bricks-" + std::to_string(getpid()))).string();
  app.add_option("FILE", file, "The .vdb");
  app.add_option("--grid", grid, "Which grid; not needed where there is one");
  app.add_option("--compression", compressions, "zstd's level; again for more");
  app.add_option("--formula", formula, "Write so many bricks along each edge, without a file");
  app.add_option("--folder", folder, "Where to write; removed at the end");
  CLI11_PARSE(app, argc, argv);
  try {
    std::printf("%s\n", bench::describe(bench::takeMachine(/*pin=*/false)).c_str());
    if (formula > 0) {
      writeFormula(formula, folder);
      fs::remove_all(folder);
      return 0;
    }
    const auto volume = loadVolume(file, grid);
    std::printf("%s: %llu active voxels, %.1f MB in memory\n\n", volume->info().name.c_str(),
                static_cast<unsigned long long>(volume->info().active_voxels),
                static_cast<double>(volume->info().memory) / 1e6);
    std::puts(
        "| stored as | zstd | bricks | MB | ratio | bytes an active voxel | written MB/s | fetched "
        "ms p50 | p99 | max | from disk ms p50 | p99 |\n"
        "|---|---|---|---|---|---|---|---|---|---|---|---|");
    for (const bool half : {false, true}) {
      for (const int compression : compressions) row(volume, half, compression, folder);
    }
  } catch (const std::exception& e) {
    std::fprintf(stderr, "palpate_bench_bricks: %s\n", e.what());
    return 2;
  }
  std::error_code error;
  fs::remove_all(folder, error);
  return 0;
}
