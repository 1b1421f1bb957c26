/// Loads truncated and corrupted copies of .vdb files and samples their volumes. Each case must end
/// with finite, bounded values or with one line of error. A case may take at most 10 s of processor
/// time, and four times the memory of the file's grids plus 256 MB (not checked with sanitizers).
///
/// palpate_hostile_files [--data] [--cases N] [FILE.vdb...]
///   Truncates each file at ten positions. Makes N copies in total, and flips one bit in each.
///   Default of N: 1000. PALPATE_CASES replaces or scales N. N is at most 100,000, or 10,000 with
///   sanitizers. Small files get more copies than large ones. --data: uses the files of
///   PALPATE_DATA/vdb. Without files: uses volumes that the program makes. Each case runs in a
///   separate process.
/// palpate_hostile_files --only FILE BYTE BIT
///   Repeats one case. BIT "cut" truncates FILE before BYTE. FILE may be one that the program
///   makes.
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <map>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <openvdb/io/Stream.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume.h"
#include "palpate/samplers/grid/volume_grid.h"
#include "tests/support/random.h"
#include "tests/support/vdb_grids.h"

#ifdef __SANITIZE_ADDRESS__
#include <sanitizer/lsan_interface.h>
constexpr bool kSanitized = true;
// An allocation above 1 GB ends the process as a failure, instead of throwing.
extern "C" const char* __asan_default_options() {
  return "max_allocation_size_mb=1024:allocator_may_return_null=0";
}
// OpenVDB of Debian 13 logs through liblog4cplus. The threads of that library do not exist in a
// child process, so LeakSanitizer does not find the pointers on their stacks.
extern "C" const char* __lsan_default_suppressions() {
  return "leak:liblog4cplus";
}
#else
constexpr bool kSanitized = false;
#endif

namespace palpate::test {
namespace {

namespace fs = std::filesystem;
using openvdb::Vec3d;
using openvdb::math::Transform;

constexpr int kSeconds = 10;
constexpr std::uint64_t kLarge = 300'000;  ///< [bytes]
constexpr std::size_t kTurns = kSanitized ? 64 : 8;
constexpr std::size_t kAll = std::numeric_limits<std::size_t>::max();
constexpr std::uint64_t kSlack = std::uint64_t{256} << 20U;

// The code below runs in a child process, which loads and samples one file.

/// The result that a child process reports for its file.
struct Outcome {
  enum Kind : int { kRead, kRefused, kFailed } kind = kFailed;
  std::uint64_t digest = 0;  ///< Hash of all descriptions, and of samples without splines.
  std::uint64_t memory = 0;  ///< Memory of the grids [bytes].
  std::array<char, 400> text{};

  void say(const std::string& line) { std::strncpy(text.data(), line.c_str(), text.size() - 1); }
};

class Digest {
 public:
  void add(double v) {
    std::uint64_t bits = 0;
    std::memcpy(&bits, &v, sizeof bits);
    sum_ = (sum_ ^ bits) * 0x9e3779b97f4a7c15U;
    sum_ ^= sum_ >> 29U;
  }
  void add(const std::string& text) {
    for (const char c : text) add(static_cast<double>(c));
  }
  [[nodiscard]] std::uint64_t value() const { return sum_; }

 private:
  std::uint64_t sum_ = 1;
};

struct Broken {
  std::string why;
};

/// Throws Broken unless an error is one line of at least 20 characters.
void checkLine(const std::string& line) {
  if (line.size() < 20) throw Broken{"an error that says nothing: \"" + line + "\""};
  for (const char c : line) {
    if (c == '\n' || c == '\r') throw Broken{"an error of more than one line: \"" + line + "\""};
  }
}

void checkFinite(bool finite, const char* what) {
  if (!finite) throw Broken{std::string("not finite: ") + what};
}

template <class T>
double magnitude(const T& v) {
  if constexpr (std::is_arithmetic_v<T>) {
    return std::abs(static_cast<double>(v));
  } else {
    return Vec3d(v).length();
  }
}

/// Returns the largest magnitude in a grid, including tiles, background and inactive values.
template <class GridT>
double largestIn(const GridT& grid) {
  double largest = magnitude(grid.background());
  for (auto leaf = grid.tree().cbeginLeaf(); leaf; ++leaf) {
    const auto* data = leaf->buffer().data();
    for (openvdb::Index i = 0; i < leaf->SIZE; ++i) largest = std::max(largest, magnitude(data[i]));
  }
  auto tile = grid.cbeginValueAll();
  tile.setMaxDepth(GridT::TreeType::ValueAllCIter::LEAF_DEPTH - 1);
  for (; tile; ++tile) largest = std::max(largest, magnitude(*tile));
  return largest;
}

/// Returns positions in the volume, around it, at some leaves, and far away.
std::vector<Vec3> probes(const Volume& volume, const Placement& placement) {
  Random random(7);
  std::vector<Vec3> points;
  const Box& box = volume.info().bounds;
  const Vec3 size = box.size() + volume.info().voxel;
  for (int i = 0; i < 100; ++i) {
    const Vec3 at(random.uniform(-0.1, 1.1), random.uniform(-0.1, 1.1), random.uniform(-0.1, 1.1));
    points.push_back(placement(box.lower + at.cwiseProduct(size)));
  }
  const Volume::Grid::Part& part = volume.grid().parts.front();
  std::visit(
      [&](const auto& grid) {
        const std::uint64_t step = grid->tree().leafCount() / 30 + 1;
        std::uint64_t n = 0;
        for (auto leaf = grid->tree().cbeginLeaf(); leaf; ++leaf) {
          if (n++ % step != 0) continue;
          const openvdb::Coord o = leaf->origin();
          for (int i = 0; i < 7; ++i) {
            const Vec3 p_I = Vec3(o.x(), o.y(), o.z()) + 4 * Vec3::Ones() + random.inCube(5.0);
            points.push_back(placement(part.linear * p_I + part.origin));
          }
        }
      },
      part.data);
  for (const double far : {1e3, 1e9, 1e300}) points.push_back({far, -far, far});
  return points;
}

/// Samples a volume. Splines of large volumes take seconds, so only one of kTurns cases computes
/// them, chosen by `turn`.
void sample(const std::shared_ptr<const Volume>& volume, std::size_t turn, Digest& digest) {
  double largest = 0.0;
  double per_index = 0.0;
  for (const Volume::Grid::Part& part : volume->grid().parts) {
    largest =
        std::max(largest, std::visit([](const auto& grid) { return largestIn(*grid); }, part.data));
    per_index = std::max(per_index, part.linear.inverse().norm());
  }
  if (volume->grid().parts.size() == 3) largest *= std::sqrt(3.0);  // length of a vector
  digest.add(largest);
  Placement placement;
  if (volume->info().bounds.size().maxCoeff() > 0.0) {
    placement = fitInto(volume->info(), 0.1);
  }
  const std::vector<Vec3> points = probes(*volume, placement);
  for (const Interpolation kind : {Interpolation::kTrilinear, Interpolation::kNearest,
                                   Interpolation::kQuadratic, Interpolation::kCubic}) {
    const bool spline = kind == Interpolation::kQuadratic || kind == Interpolation::kCubic;
    if (spline && turn != kAll && volume->info().memory > kLarge &&
        turn % kTurns != static_cast<std::size_t>(kind) % kTurns) {
      continue;
    }
    const FieldPtr field = makeVdbField(volume, placement, {kind});
    // The coefficients of a B-spline exceed the values by a factor of at most 2^3 (quadratic) or
    // 3^3 (cubic).
    const double over = kind == Interpolation::kCubic       ? 27.0
                        : kind == Interpolation::kQuadratic ? 8.0
                                                            : 1.0;
    const double highest = 1.001 * over * largest;
    const double steepest = 1.001 * over * largest * 2.0 * std::sqrt(3.0) * per_index;
    FieldCache cache{};
    const auto check = [&](double value, double slope, double more) {
      checkFinite(std::isfinite(value), wordFor(kind));
      checkFinite(std::isfinite(slope) && std::isfinite(more), wordFor(kind));
      if (!(value <= highest)) throw Broken{std::string("unbounded value: ") + wordFor(kind)};
      if (!(std::max(slope, more) <= steepest)) {
        throw Broken{std::string("unbounded derivative: ") + wordFor(kind)};
      }
      if (spline) return;
      digest.add(value);
      digest.add(slope);
    };
    if (const auto* scalar = std::get_if<0>(&field)) {
      (*scalar)->reset(cache);
      for (const Vec3& p : points) {
        const ScalarSample s = (*scalar)->sample(p, cache);
        check(std::abs(s.value), s.gradient.stableNorm(),
              (*scalar)->cellGradient(p, cache).stableNorm());
      }
    } else {
      const auto& vector = std::get<1>(field);
      vector->reset(cache);
      for (const Vec3& p : points) {
        const VectorSample s = vector->sample(p, cache);
        checkFinite(s.jacobian.allFinite(), wordFor(kind));
        check(s.value.stableNorm(), s.jacobian.cwiseAbs().maxCoeff(), 0.0);
      }
    }
  }
}

/// Describes, loads and samples all grids of a file.
Outcome feel(const fs::path& file, std::size_t turn) {
  Outcome outcome;
  Digest digest;
  try {
    int felt = 0;
    std::string why;
    for (const GridInfo& info : describeGrids(file)) {
      outcome.memory += info.memory;
      digest.add(info.name + info.type + info.refusal);
      for (const double v : {info.lowest, info.highest, info.mean, info.background}) {
        if (info.refusal.empty()) checkFinite(std::isfinite(v), "description");
        digest.add(v);
      }
      for (const Vec3& v : {info.voxel, info.bounds.lower, info.bounds.upper}) {
        if (info.refusal.empty()) checkFinite(v.allFinite(), "bounds");
        digest.add(v.x() + v.y() + v.z());
      }
      digest.add(static_cast<double>(info.active_voxels));
      std::shared_ptr<const Volume> volume;
      LoadOptions options;
      if (turn != kAll && turn % 4 == 0) options = {NonFinite::kFill, {1.0}, nullptr};
      try {
        volume = loadVolume(file, info.name, options);
      } catch (const VolumeError& e) {
        checkLine(e.what());
        if (info.refusal.empty() && options.smooth.sigma == 0.0) {
          throw Broken{std::string("described, then: ") + e.what()};
        }
        why = e.what();
        continue;
      }
      if (!info.refusal.empty() && info.non_finite == 0) {
        throw Broken{"loaded, though refused: " + info.refusal};
      }
      sample(volume, turn, digest);
      ++felt;
    }
    outcome.kind = felt > 0 ? Outcome::kRead : Outcome::kRefused;
    outcome.say(why);
  } catch (const VolumeError& e) {
    outcome.kind = Outcome::kRefused;
    outcome.say(e.what());
    try {
      checkLine(e.what());
    } catch (const Broken& broken) {
      outcome.kind = Outcome::kFailed;
      outcome.say(broken.why);
    }
  } catch (const Broken& broken) {
    outcome.kind = Outcome::kFailed;
    outcome.say(broken.why);
  } catch (const std::exception& e) {
    outcome.kind = Outcome::kFailed;
    outcome.say(std::string("an exception other than VolumeError: ") + e.what());
  }
  outcome.digest = digest.value();
  return outcome;
}

// The code below runs in the parent process, which starts and judges child processes.

/// The result and the resources of a child process that has ended.
struct Ended {
  Outcome outcome;
  double seconds = 0.0;
  std::uint64_t memory = 0;  ///< Largest resident memory [bytes].
};

struct Child {
  pid_t pid = 0;
  int pipe = -1;
  std::FILE* complaints = nullptr;  ///< The child's output on stderr.
  std::chrono::steady_clock::time_point start;
};

bool leaks() {
#ifdef __SANITIZE_ADDRESS__
  return __lsan_do_recoverable_leak_check() != 0;
#else
  return false;
#endif
}

template <class Body>
Child start(Body body) {
  std::array<int, 2> ends{};
  if (pipe(ends.data()) != 0) std::abort();
  std::fflush(nullptr);
  Child child;
  child.complaints = std::tmpfile();
  if (child.complaints == nullptr) std::abort();
  child.start = std::chrono::steady_clock::now();
  child.pid = fork();
  if (child.pid == 0) {
    close(ends[0]);
    dup2(fileno(child.complaints), STDERR_FILENO);
    // Limits the processor time, because other programs may use the processor. The alarm limits the
    // clock time of a child that waits.
    const rlimit processor{kSeconds, kSeconds + 1};
    setrlimit(RLIMIT_CPU, &processor);
    const rlimit core{0, 0};
    setrlimit(RLIMIT_CORE, &core);
    alarm(30 * kSeconds);
    const Outcome outcome = body();
    const bool told = write(ends[1], &outcome, sizeof outcome) == sizeof outcome;
    // exit() would hang: log4cplus would wait for a thread that exists only in the parent.
    _exit(told && !leaks() ? 0 : 1);
  }
  if (child.pid < 0) std::abort();
  close(ends[1]);
  child.pipe = ends[0];
  return child;
}

/// Returns the result of a child that has ended. If it failed, prints its stderr.
Ended conclude(const Child& child, int status, const rusage& usage) {
  Ended ended;
  ended.seconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - child.start).count();
  ended.memory = static_cast<std::uint64_t>(usage.ru_maxrss) * 1024;
  const bool told = read(child.pipe, &ended.outcome, sizeof ended.outcome) == sizeof ended.outcome;
  close(child.pipe);
  std::array<char, 4000> complaints{};
  std::rewind(child.complaints);
  (void)std::fread(complaints.data(), 1, complaints.size() - 1, child.complaints);
  std::fclose(child.complaints);
  if (status != 0) std::printf("%s\n", complaints.data());
  if (WIFSIGNALED(status)) {
    ended.outcome.kind = Outcome::kFailed;
    ended.outcome.say(WTERMSIG(status) == SIGALRM || WTERMSIG(status) == SIGXCPU
                          ? "it took too long: more than " + std::to_string(kSeconds) +
                                " s of processor time, or 30 times as long in all"
                          : std::string("signal ") + strsignal(WTERMSIG(status)));
  } else if (!told || WEXITSTATUS(status) != 0) {
    ended.outcome.kind = Outcome::kFailed;
    ended.outcome.say("exit status " + std::to_string(WEXITSTATUS(status)) + ", see above");
  }
  return ended;
}

template <class Body>
Ended runAlone(Body body) {
  const Child child = start(body);
  int status = 0;
  rusage usage{};
  wait4(child.pid, &status, 0, &usage);
  return conclude(child, status, usage);
}

// The code below chooses files and ways to damage them.

struct Damage {
  std::uint64_t byte = 0;
  int bit = -1;  ///< -1: truncates before the byte.
};

struct Victim {
  fs::path path;
  std::string bytes;
  std::vector<std::uint64_t> structure;  ///< Positions of nodes' masks and of headers of values
                                         ///< [bytes].
  std::vector<std::uint64_t> borders;    ///< Positions between the file's parts [bytes].
  Ended whole;
};

template <class T>
T at(const std::string& bytes, std::uint64_t place) {
  T value{};
  if (place + sizeof value <= bytes.size()) std::memcpy(&value, bytes.data() + place, sizeof value);
  return value;
}

/// Finds the positions of nodes, values and compressed leaves in a file. If this search fails, the
/// test runs with fewer chosen positions.
void dissect(Victim& victim) {
  const std::string& bytes = victim.bytes;
  for (std::uint64_t i = 57; i + 32 < std::min<std::uint64_t>(bytes.size(), 4096); ++i) {
    const auto grid = at<std::uint64_t>(bytes, i);
    const auto block = at<std::uint64_t>(bytes, i + 8);
    const auto end = at<std::uint64_t>(bytes, i + 16);
    if (grid != i + 24 || block <= grid || end <= block || end > bytes.size()) continue;
    victim.borders = {i, grid + 40, (grid + block) / 2, block - 1, block + 1, (block + end) / 2};
    for (std::uint64_t n = 0; n < 4000; ++n) {
      victim.structure.push_back(grid + n * (block - grid) / 4000);
    }
    for (std::uint64_t j = grid; j + 24 < end; ++j) {
      const auto size = at<std::int64_t>(bytes, j);
      const bool blosc = size >= 16 && size < 1 << 20 &&
                         at<std::uint32_t>(bytes, j + 20) == static_cast<std::uint64_t>(size);
      const bool zip = size > 8 && size < 1 << 20 && at<std::uint16_t>(bytes, j + 8) == 0x9c78;
      const bool raw = size < 0 && size > -(1 << 20);
      if (!blosc && !zip && !raw) continue;
      for (std::uint64_t n = 0; n < 28; ++n) victim.structure.push_back(j - 1 + n);
      j += 8;
    }
    return;
  }
  victim.borders = {10, 30, 70, 200, bytes.size() / 3, bytes.size() / 2};
}

std::vector<Damage> cutsOf(const Victim& victim) {
  std::vector<std::uint64_t> places = victim.borders;
  const std::uint64_t size = victim.bytes.size();
  places.insert(places.end(), {15, 59, size - size / 10, size - 1});
  std::vector<Damage> cuts;
  for (const std::uint64_t place : places) cuts.push_back({std::min(place, size - 1), -1});
  return cuts;
}

Damage flipOf(const Victim& victim, Random& random) {
  const std::uint64_t size = victim.bytes.size();
  const auto below = [&](std::uint64_t n) {
    return std::min(n - 1, static_cast<std::uint64_t>(random.uniform() * static_cast<double>(n)));
  };
  Damage damage;
  const int where = random.integer(4);
  if (where < 2) {
    damage.byte = below(size);
  } else if (where == 2 || victim.structure.empty()) {
    damage.byte = below(std::min<std::uint64_t>(size, 4096));
  } else {
    damage.byte = victim.structure[below(victim.structure.size())];
  }
  damage.byte = std::min(damage.byte, size - 1);
  damage.bit = random.integer(8);
  return damage;
}

void writeDamaged(const Victim& victim, const Damage& damage, const fs::path& to) {
  std::ofstream out(to, std::ios::binary | std::ios::trunc);
  if (damage.bit < 0) {
    out.write(victim.bytes.data(), static_cast<std::streamsize>(damage.byte));
    return;
  }
  const char flipped = static_cast<char>(victim.bytes[damage.byte] ^ (1 << damage.bit));
  out.write(victim.bytes.data(), static_cast<std::streamsize>(victim.bytes.size()));
  out.seekp(static_cast<std::streamoff>(damage.byte));
  out.write(&flipped, 1);
}

// The code below makes volumes, one for each kind of storage.

void writeOwn(const fs::path& folder) {
  openvdb::initialize();
  const auto write = [&](const std::string& name, const openvdb::GridPtrVec& grids,
                         std::uint32_t compression) {
    openvdb::io::File file((folder / name).string());
    file.setCompression(compression);
    file.write(grids);
    file.close();
  };
  using namespace openvdb::io;
  const std::uint32_t usual = COMPRESS_BLOSC | COMPRESS_ACTIVE_MASK;
  const auto ball = makeBall(1.0, 0.1);
  write("ball.vdb", {ball}, usual);

  const auto linear = Transform::createLinearTransform(0.5);
  const auto rough = [](const Vec3d& p) {
    return static_cast<float>(std::sin(7.0 * p.x()) + std::cos(5.0 * p.y() * p.z()));
  };
  auto fog = makeGrid<openvdb::FloatGrid>(12, linear, rough, "fog");
  fog->tree().addTile(1, openvdb::Coord(64, 0, 0), 7.0F, true);
  fog->tree().addTile(2, openvdb::Coord(256, 0, 0), 3.0F, true);
  fog->tree().addTile(3, openvdb::Coord(4096, 0, 0), 2.0F, true);
  fog->tree().addTile(3, openvdb::Coord(-8192, 0, 0), -2.0F, false);
  write("zip.vdb", {fog}, COMPRESS_ZIP | COMPRESS_ACTIVE_MASK);
  write("raw.vdb", {fog}, COMPRESS_NONE);

  auto half = fog->deepCopy();
  half->setSaveFloatAsHalf(true);
  half->setName("half");
  auto precise = makeGrid<openvdb::DoubleGrid>(12, linear, rough, "precise");
  write("half_double.vdb", {half, precise}, usual);

  auto velocity = makeGrid<openvdb::Vec3SGrid>(
      10, linear, [](const Vec3d& p) { return openvdb::Vec3s(Vec3d(-p.y(), p.x(), 3 * p.z())); },
      "velocity");
  auto flow = makeGrid<openvdb::Vec3DGrid>(
      10,
      Transform::createLinearTransform(openvdb::Mat4d(1.0, 0.2, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.1,
                                                      0.0, 2.0, 0.0, 5.0, 6.0, 7.0, 1.0)),
      [](const Vec3d& p) { return Vec3d(p.y(), -p.x(), 1.0); }, "flow");
  flow->setSaveFloatAsHalf(true);
  auto labels = makeGrid<openvdb::Int32Grid>(
      9, linear, [](const Vec3d&) { return 3; }, "labels");
  write("vectors.vdb", {velocity, flow, labels}, COMPRESS_ZIP);

  // Flow solvers store vectors on faces, in one grid per component, or in index space.
  auto staggered = velocity->deepCopy();
  staggered->setName("staggered");
  staggered->setGridClass(openvdb::GRID_STAGGERED);
  auto local = velocity->deepCopy();
  local->setName("local");
  local->setVectorType(openvdb::VEC_COVARIANT);
  local->setIsInWorldSpace(false);
  openvdb::GridPtrVec kept{staggered, local};
  for (const char* name : {"vel.x", "vel.y", "vel.z"}) {
    kept.push_back(makeGrid<openvdb::FloatGrid>(10, linear, rough, name));
  }
  write("kept.vdb", kept, usual);

  // These files have grids that share a tree, and a stream without a table of contents.
  auto twin = openvdb::FloatGrid::create(ball->treePtr());
  twin->setName("twin");
  write("twins.vdb", {ball, twin, ball}, usual);
  // One grid's own name, "density[0]", is also the indexed name of another grid. The two grids
  // share a tree, in either order.
  auto literal = ball->deepCopy();
  literal->setName("density[0]");
  auto alike = openvdb::FloatGrid::create(literal->treePtr());
  alike->setName("density");
  auto second = fog->deepCopy();
  second->setName("density");
  write("lends.vdb", {literal, alike, second}, usual);
  write("borrows.vdb", {alike, literal, second}, usual);
  std::ofstream stream(folder / "stream.vdb", std::ios::binary);
  openvdb::io::Stream out(stream);
  out.setCompression(usual);
  out.write(openvdb::GridPtrVec{fog, velocity});
}

std::vector<fs::path> vdbsOf(const fs::path& folder) {
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(folder)) {
    if (entry.path().extension() == ".vdb") files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  return files;
}

struct Counts {
  long refused_cuts = 0, refused = 0, other = 0, identical = 0, passed = 0, failed = 0;
  std::uint64_t memory = 0;
  double seconds = 0.0;
  std::map<std::string, long> reasons;
};

class Run {
 public:
  Run()
      : idle_(runAlone([] {
                openvdb::initialize();
                return Outcome{};
              }).memory) {}

  /// Reads the undamaged file, and samples its volumes in a child process. Prints why and returns
  /// false if the file has fewer than 100 bytes, or if its volumes cannot be read.
  bool open(const fs::path& path, Victim& victim) const {
    victim.path = path;
    std::ifstream in(path, std::ios::binary);
    victim.bytes.assign(std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>());
    if (victim.bytes.size() < 100) {
      std::printf("%s: it cannot be read\n", path.c_str());
      return false;
    }
    dissect(victim);
    victim.whole = runAlone([&] { return feel(path, kAll); });
    if (victim.whole.outcome.kind != Outcome::kRead) {
      std::printf("%s: %s\n", path.c_str(), victim.whole.outcome.text.data());
      return false;
    }
    return true;
  }

  /// Checks one case against the limits and counts its result.
  void judge(const Victim& victim, const Damage& damage, Ended ended, Counts& counts) const {
    Outcome& outcome = ended.outcome;
    const std::uint64_t grids = std::max(victim.whole.outcome.memory, outcome.memory);
    const std::uint64_t allowed = 4 * grids + kSlack;
    const std::uint64_t memory = ended.memory > idle_ ? ended.memory - idle_ : 0;
    if (outcome.kind != Outcome::kFailed && !kSanitized && memory > allowed) {
      outcome.kind = Outcome::kFailed;
      outcome.say("it took " + std::to_string(memory >> 20U) + " MB");
    }
    if (outcome.kind == Outcome::kRead && damage.bit < 0) {
      outcome.kind = Outcome::kFailed;
      outcome.say("a cut file was read");
    }
    counts.memory = std::max(counts.memory, memory);
    counts.seconds = std::max(counts.seconds, ended.seconds);
    if (outcome.kind == Outcome::kFailed) {
      ++counts.failed;
      std::printf("FAILED --only %s %llu %s: %s\n", victim.path.c_str(),
                  static_cast<unsigned long long>(damage.byte),
                  damage.bit < 0 ? "cut" : std::to_string(damage.bit).c_str(), outcome.text.data());
      return;
    }
    ++counts.passed;
    if (outcome.kind == Outcome::kRefused) {
      ++(damage.bit < 0 ? counts.refused_cuts : counts.refused);
      ++counts.reasons[reasonIn(outcome.text.data())];
    } else {
      ++(outcome.digest == victim.whole.outcome.digest ? counts.identical : counts.other);
    }
  }

  Counts all(const Victim& victim, const std::vector<Damage>& damages, const fs::path& folder) {
    Counts counts;
    struct Slot {
      Child child;
      Damage damage;
    };
    std::map<pid_t, Slot> running;
    const std::size_t slots = 2;
    std::vector<fs::path> free;
    for (std::size_t i = 0; i < slots; ++i) free.push_back(folder / ("copy" + std::to_string(i)));
    std::map<pid_t, fs::path> places;
    std::size_t next = 0;
    while (next < damages.size() || !running.empty()) {
      while (next < damages.size() && !free.empty()) {
        const fs::path copy = free.back();
        free.pop_back();
        writeDamaged(victim, damages[next], copy);
        const Child child = start([&] { return feel(copy, next); });
        running[child.pid] = {child, damages[next]};
        places[child.pid] = copy;
        ++next;
      }
      int status = 0;
      rusage usage{};
      const pid_t pid = wait4(-1, &status, 0, &usage);
      const auto slot = running.find(pid);
      if (slot == running.end()) std::abort();
      judge(victim, slot->second.damage, conclude(slot->second.child, status, usage), counts);
      free.push_back(places[pid]);
      running.erase(slot);
    }
    return counts;
  }

 private:
  /// Returns the reason in an error line: the part between the file's name and the remedy. Returns
  /// the whole line if it has no such part.
  static std::string reasonIn(const std::string& line) {
    if (line.find("NaN, infinite or") != std::string::npos) return "values are NaN or infinite";
    const auto begin = line.find(": it");
    const auto end = begin == std::string::npos ? begin : line.find(": ", begin + 2);
    return end == std::string::npos ? line : line.substr(begin + 2, end - begin - 2);
  }

  std::uint64_t idle_;
};

int only(const std::string& name, const std::string& byte, const std::string& bit,
         const TemporaryFolder& folder, const fs::path& own) {
  Run run;
  Victim victim;
  const fs::path path = fs::exists(name) ? fs::path(name) : own / fs::path(name).filename();
  if (!run.open(path, victim)) return 1;
  const Damage damage{std::stoull(byte), bit == "cut" ? -1 : std::stoi(bit)};
  const fs::path copy = folder / "copy";
  writeDamaged(victim, damage, copy);
  const Ended ended = runAlone([&] { return feel(copy, kAll); });
  std::printf("%s %s, %.2f s, %llu MB\n",
              std::array{"read", "refused", "FAILED"}[static_cast<std::size_t>(ended.outcome.kind)],
              ended.outcome.text.data(), ended.seconds,
              static_cast<unsigned long long>(ended.memory >> 20U));
  Counts counts;
  run.judge(victim, damage, ended, counts);
  return counts.failed > 0 ? 1 : 0;
}

int run(const std::vector<std::string>& arguments) {
  long wanted = 1000;
  std::vector<fs::path> files;
  const TemporaryFolder folder;
  const fs::path own = folder / "own";
  fs::create_directory(own);
  const auto made = runAlone([&] {
    writeOwn(own);
    return Outcome{Outcome::kRead, 0, 0, {}};
  });
  if (made.outcome.kind != Outcome::kRead) {
    std::printf("its own volumes cannot be written: %s\n", made.outcome.text.data());
    return 1;
  }
  for (std::size_t i = 0; i < arguments.size(); ++i) {
    const std::string& argument = arguments[i];
    if (argument == "--only" && i + 3 < arguments.size()) {
      return only(arguments[i + 1], arguments[i + 2], arguments[i + 3], folder, own);
    }
    if (argument == "--cases" && i + 1 < arguments.size()) {
      wanted = std::stol(arguments[++i]);
    } else if (argument == "--data") {
      const char* data = std::getenv("PALPATE_DATA");
      if (data == nullptr) {
        std::printf("PALPATE_DATA is not set\n");
        return 77;
      }
      for (const fs::path& file : vdbsOf(fs::path(data) / "vdb")) files.push_back(file);
    } else {
      files.emplace_back(argument);
    }
  }
  if (files.empty()) files = vdbsOf(own);
  const long count = std::min(cases(wanted), kSanitized ? 10000L : 100000L);
  std::printf("random cases: %ld of %ld: flipped bits\n", count, wanted);
  if (kSanitized) std::printf("with sanitizers: memory is not checked\n");

  Run all;
  long passed = 0;
  long failed = 0;
  std::map<std::string, long> reasons;
  // Large files take longer than small files but fail equally often, so large files get fewer
  // copies.
  const auto weight = [](const fs::path& file) {
    return 1.0 / std::sqrt(1.0 + static_cast<double>(fs::file_size(file)));
  };
  double weights = 0.0;
  for (const fs::path& file : files) weights += weight(file);
  long left = count;
  for (std::size_t i = 0; i < files.size(); ++i) {
    const long share =
        i + 1 == files.size()
            ? left
            : std::min(left, std::lround(static_cast<double>(count) * weight(files[i]) / weights));
    left -= share;
    Victim victim;
    if (!all.open(files[i], victim)) {
      ++failed;
      continue;
    }
    std::vector<Damage> damages = cutsOf(victim);
    Random random(1000 + i);
    for (long k = 0; k < share; ++k) damages.push_back(flipOf(victim, random));
    const Counts counts = all.all(victim, damages, folder.path());
    std::printf(
        "%-24s cuts refused %ld of 10; copies: refused %ld, other values %ld, identical %ld; "
        "failed "
        "%ld; grids %llu MB, at most %llu MB, %.2f s\n",
        files[i].filename().c_str(), counts.refused_cuts, counts.refused, counts.other,
        counts.identical, counts.failed,
        static_cast<unsigned long long>(victim.whole.outcome.memory >> 20U),
        static_cast<unsigned long long>(counts.memory >> 20U), counts.seconds);
    passed += counts.passed;
    failed += counts.failed;
    for (const auto& [reason, times] : counts.reasons) reasons[reason] += times;
  }
  std::printf("refused because\n");
  for (const auto& [reason, times] : reasons) std::printf("%8ld  %s\n", times, reason.c_str());
  std::printf("%ld passed, %ld failed\n", passed, failed);
  return failed > 0 ? 1 : 0;
}

}  // namespace
}  // namespace palpate::test

int main(int argc, char** argv) {
#ifdef __SANITIZE_THREAD__
  std::printf("ThreadSanitizer allows no threads in forked processes\n");
  return 77;
#endif
  return palpate::test::run({argv + 1, argv + argc});
}
