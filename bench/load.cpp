/// Measures time and peak memory of loading a grid. Compares loadVolume, which also checks the
/// data, with OpenVDB's File::readGrid, in turns. Each load has its own process and a cached file.
///
///     palpate_bench_load [FILE.vdb...] [--grid NAME] [--runs N]
///
/// Without a file, the benchmark makes the level set of a large ball and a dense fog, each with
/// Blosc and uncompressed. It also makes the fog with zip, as a grid of unknown class, because
/// OpenVDB does not use zip for level sets and fog.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>
#include <sys/resource.h>
#include <sys/wait.h>
#include <type_traits>
#include <unistd.h>
#include <vector>

#include <CLI/CLI.hpp>
#include <openvdb/io/Compression.h>
#include <openvdb/tools/LevelSetSphere.h>
#include <tbb/global_control.h>

#include "bench/machine.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/volume.h"
#include "tests/support/percentiles.h"
#include "tests/support/vdb_files.h"

namespace {

using namespace palpate;
using bench::Clock;
using openvdb::FloatGrid;
using std::filesystem::path;

constexpr double kMegabyte = 1024.0 * 1024.0;

struct Options {
  std::vector<std::string> files;
  std::string grid;  // empty: the first grid of each file
  std::size_t runs = 9;
  std::size_t threads = 2;
};

struct Said {
  double ms = 0.0;
  double memory = 0.0;  ///< Memory that the grid occupies [MB].
  double peak = 0.0;    ///< Peak memory of the process [MB].
  std::array<char, 64> text{};
};
static_assert(std::is_trivially_copyable_v<Said>);

double peakOfProcess() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024.0;  // Linux counts in kB
}

/// Runs `work` in a new process, so that runs do not affect each other. Throws if `work` throws.
template <class Work>
Said inChild(const Options& options, Work work) {
  std::fflush(nullptr);
  std::array<int, 2> ends{};
  if (pipe(ends.data()) != 0) throw std::runtime_error("a pipe cannot be opened");
  const pid_t child = fork();
  if (child < 0) throw std::runtime_error("a process cannot start");
  if (child == 0) {
    try {
      const tbb::global_control threads(tbb::global_control::max_allowed_parallelism,
                                        options.threads);
      openvdb::initialize();
      Said said;
      work(said);
      said.peak = peakOfProcess();
      _exit(write(ends[1], &said, sizeof said) == sizeof said ? 0 : 1);
    } catch (const std::exception& e) {
      std::fprintf(stderr, "%s\n", e.what());
      _exit(1);
    }
  }
  close(ends[1]);
  Said said;
  const ssize_t got = read(ends[0], &said, sizeof said);
  close(ends[0]);
  int status = 0;
  waitpid(child, &status, 0);
  if (got != sizeof said || status != 0) throw std::runtime_error("a measurement failed");
  return said;
}

double millisecondsSince(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

void loadOurs(const path& file, const std::string& grid, Said& said) {
  const auto start = Clock::now();
  const auto volume = loadVolume(file, grid);
  said.ms = millisecondsSince(start);
  said.memory = static_cast<double>(volume->info().memory) / kMegabyte;
}

void loadPlain(const path& file, const std::string& grid, Said& said) {
  const auto start = Clock::now();
  openvdb::io::File source(file.string());
  source.open(false);
  const auto loaded = source.readGrid(grid);
  source.close();
  said.ms = millisecondsSince(start);
  said.memory = static_cast<double>(loaded->memUsage()) / kMegabyte;
}

/// Returns the name of the grid to load; without a given name, that of the first grid in the file.
std::string nameOf(const path& file, const Options& options) {
  if (!options.grid.empty()) return options.grid;
  const Said said = inChild(options, [&](Said& out) {
    const std::string name = gridNames(file).at(0);
    if (name.size() >= out.text.size()) throw std::runtime_error(name + ": too long a name");
    std::copy(name.begin(), name.end(), out.text.begin());
  });
  return said.text.data();
}

std::string compressionOf(const path& file, const std::string& grid, const Options& options) {
  const Said said = inChild(options, [&](Said& out) {
    openvdb::io::File source(file.string());
    source.open(false);
    const auto metadata = source.readGridMetadata(grid);
    source.close();
    const auto codec =
        metadata->getMetadata<openvdb::StringMetadata>(openvdb::GridBase::META_FILE_COMPRESSION);
    const std::string said_so = codec == nullptr ? "" : codec->value();
    const auto says = [&](const char* name) { return said_so.find(name) != std::string::npos; };
    const std::string word = codec == nullptr ? "unknown"
                             : says("blosc")  ? "blosc"
                             : says("zip")    ? "zip"
                                              : "none";
    std::copy(word.begin(), word.end(), out.text.begin());
  });
  return said.text.data();
}

void warm(const path& file) {
  std::ifstream in(file, std::ios::binary);
  std::vector<char> buffer(std::size_t{1} << 20U);
  while (in.read(buffer.data(), static_cast<std::streamsize>(buffer.size()))) {
  }
}

struct Runs {
  std::vector<double> ms;
  std::vector<double> peak;  ///< Peak memory minus that of an idle process [MB].
};

void measure(const path& file, const Options& options) {
  const std::string grid = nameOf(file, options);
  const std::string compression = compressionOf(file, grid, options);
  warm(file);
  const double idle = inChild(options, [](Said&) {}).peak;

  std::array<Runs, 2> runs;
  double memory = 0.0;
  for (std::size_t run = 0; run < options.runs; ++run) {
    for (std::size_t turn = 0; turn < runs.size(); ++turn) {
      const std::size_t who = (run + turn) % runs.size();
      const Said said =
          inChild(options, [&](Said& out) { (who == 0 ? loadOurs : loadPlain)(file, grid, out); });
      runs[who].ms.push_back(said.ms);
      runs[who].peak.push_back(said.peak - idle);
      if (who == 1) memory = said.memory;
    }
  }

  const auto median = [](const std::vector<double>& x) { return bench::percentile(x, 0.5); };
  const auto times = [&](const Runs& r) {
    std::printf(" | %.0f (%.0f to %.0f)", median(r.ms), bench::percentile(r.ms, 0.0),
                bench::percentile(r.ms, 1.0));
  };
  std::printf("| %s, %s | %s | %.0f | %.0f", file.filename().c_str(), grid.c_str(),
              compression.c_str(), static_cast<double>(file_size(file)) / kMegabyte, memory);
  times(runs[0]);
  times(runs[1]);
  std::printf(" | %.2f | %.2f | %.2f |\n", median(runs[0].ms) / median(runs[1].ms),
              median(runs[0].peak) / memory, median(runs[1].peak) / memory);
  std::fflush(stdout);
}

/// Makes a dense block of smooth values, without tiles.
FloatGrid::Ptr makeFog(int edge) {
  auto fog = FloatGrid::create(0.0F);
  fog->setName("density");
  fog->setGridClass(openvdb::GRID_FOG_VOLUME);
  fog->tree().denseFill(openvdb::CoordBBox::createCube(openvdb::Coord(0), edge), 1.0F);
  fog->tree().voxelizeActiveTiles();
  std::vector<float> wave(static_cast<std::size_t>(edge));
  for (std::size_t i = 0; i < wave.size(); ++i) wave[i] = std::sin(0.07F * static_cast<float>(i));
  const auto at = [&](int i) { return wave[static_cast<std::size_t>(i)]; };
  for (auto leaf = fog->tree().beginLeaf(); leaf; ++leaf) {
    for (auto it = leaf->beginValueOn(); it; ++it) {
      const openvdb::Coord c = it.getCoord();
      it.setValue(0.5F + 0.4F * at(c.x()) * at(c.y()) * at(c.z()));
    }
  }
  return fog;
}

FloatGrid::Ptr makeBall(float radius) {
  auto ball = openvdb::tools::createLevelSetSphere<FloatGrid>(radius, openvdb::Vec3f(0.0F), 1.0F);
  ball->setName("ball");
  return ball;
}

/// Makes the files in a separate process, because making them starts threads.
std::vector<std::string> makeFiles(const path& folder, const Options& options) {
  constexpr float kRadius = 500.0F;
  constexpr int kEdge = 320;
  using openvdb::io::COMPRESS_ACTIVE_MASK;
  const auto write = [&](const FloatGrid::Ptr& grid, const char* name, std::uint32_t flags) {
    openvdb::io::File out((folder / name).string());
    out.setCompression(flags | COMPRESS_ACTIVE_MASK);
    out.write({grid});
    out.close();
  };
  inChild(options, [&](Said&) {
    const auto ball = makeBall(kRadius);
    write(ball, "ball-blosc.vdb", openvdb::io::COMPRESS_BLOSC);
    write(ball, "ball-plain.vdb", openvdb::io::COMPRESS_NONE);
    const auto fog = makeFog(kEdge);
    write(fog, "fog-blosc.vdb", openvdb::io::COMPRESS_BLOSC);
    write(fog, "fog-plain.vdb", openvdb::io::COMPRESS_NONE);
    fog->setGridClass(openvdb::GRID_UNKNOWN);  // OpenVDB does not use zip for level sets and fog
    write(fog, "fog-zip.vdb", openvdb::io::COMPRESS_ZIP);
  });
  std::vector<std::string> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  return files;
}

void run(const Options& options) {
  const test::TemporaryFolder folder;
  const std::vector<std::string> files =
      options.files.empty() ? makeFiles(folder.path(), options) : options.files;
  std::printf("%s; %zu runs, %zu threads each\n\n",
              bench::describe(bench::takeMachine(/*pin=*/false)).c_str(), options.runs,
              options.threads);
  std::printf(
      "Median (least to most); peaks: above an idle process, by the grid's memory.\n\n"
      "| file, grid | compression | file MB | grid MB | ours ms | OpenVDB ms | ours / OpenVDB "
      "| our peak | OpenVDB's peak |\n|---|---|---|---|---|---|---|---|---|\n");
  for (const std::string& file : files) measure(file, options);
}

}  // namespace

int main(int argc, char** argv) {
  try {
    Options options;
    CLI::App app{"Time and peak memory of loading a grid, ours against OpenVDB's own."};
    app.add_option("FILE", options.files, "of .vdb; without one it makes its own")
        ->check(CLI::ExistingFile);
    app.add_option("--grid", options.grid, "its name, instead of the first of each file");
    app.add_option("--runs", options.runs, "of each loader")
        ->check(CLI::Range(1, 10000))
        ->capture_default_str();
    app.add_option("--threads", options.threads, "that each may use")
        ->check(CLI::Range(1, 1024))
        ->capture_default_str();
    CLI11_PARSE(app, argc, argv);
    run(options);
    return 0;
  } catch (const std::exception& e) {
    std::fprintf(stderr, "palpate_bench_load: %s\n", e.what());
    return 2;
  }
}
