#include "palpate/samplers/grid/volume.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <ctime>
#include <fcntl.h>
#include <fstream>
#include <limits>
#include <optional>
#include <set>
#include <sys/resource.h>
#include <thread>
#include <type_traits>
#include <unistd.h>

#include <catch2/catch.hpp>
#include <openvdb/points/PointDataGrid.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/make_volume.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/leased_file.h"
#include "palpate/samplers/parallel.h"
#include "tests/support/random.h"
#include "tests/support/thinned.h"
#include "tests/support/vdb_grids.h"

namespace palpate::volume_test {
using namespace palpate::test;
using Catch::Contains;
using openvdb::Coord;
using openvdb::Vec3d;
using openvdb::math::Transform;

namespace {

openvdb::FloatGrid::Ptr block(int n = 10, const std::string& name = "density") {
  return makeGrid<openvdb::FloatGrid>(
      n, Transform::createLinearTransform(0.5),
      [](const Vec3d& p) { return static_cast<float>(p.x()); }, name);
}

std::string refusal(const std::filesystem::path& file, const std::string& grid = "") {
  try {
    (void)loadVolume(file, grid);
  } catch (const VolumeError& e) {
    return e.what();
  }
  return "no error";
}

/// If `room` is false, makes the folder for temporary files unusable during the object's lifetime.
class NoRoom {
 public:
  explicit NoRoom(bool room) {
    const char* place = std::getenv("TMPDIR");
    if (place != nullptr) was_ = place;
    if (!room) setenv("TMPDIR", "/proc/no/such/place", 1);
  }
  NoRoom(const NoRoom&) = delete;
  NoRoom& operator=(const NoRoom&) = delete;
  ~NoRoom() {
    if (was_) setenv("TMPDIR", was_->c_str(), 1);
    if (!was_) unsetenv("TMPDIR");
  }

 private:
  std::optional<std::string> was_;
};

/// Writes grids of n^3 random values. Files of equal n and names differ only in their values.
void writeRough(const std::filesystem::path& file, const std::vector<std::string>& names, int n,
                std::uint64_t seed) {
  Random random(seed);
  openvdb::GridPtrVec grids;
  for (const std::string& name : names) {
    grids.push_back(makeGrid<openvdb::FloatGrid>(
        n, Transform::createLinearTransform(1.0),
        [&](const Vec3d&) { return static_cast<float>(random.uniform(0.0, 1.0)); }, name));
  }
  openvdb::io::File out(file.string());
  out.setCompression(openvdb::io::COMPRESS_NONE);
  out.write(grids);
}

std::string bytesOf(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

/// Returns the number of bytes that this process has read so far.
double readSoFar() {
  std::ifstream io("/proc/self/io");
  std::string word;
  double bytes = 0.0;
  io >> word >> bytes;
  REQUIRE(word == "rchar:");
  return bytes;
}

}  // namespace

TEST_CASE("the description of a VDB file states the class, extent and range of values of each grid",
          "[volume]") {
  const TemporaryFolder folder;
  openvdb::initialize();
  const auto sphere = makeBall(2.0, 0.1);
  auto velocity = makeGrid<openvdb::Vec3SGrid>(
      8, Transform::createLinearTransform(1.0),
      [](const Vec3d&) { return openvdb::Vec3s(3, 4, 0); }, "velocity");
  writeVdb(folder / "a.vdb", {sphere, velocity});
  const auto infos = describeGrids(folder / "a.vdb");
  REQUIRE(infos.size() == 2);
  CHECK(infos[0].name == "ball");
  CHECK(infos[0].grid_class == GridClass::kLevelSet);
  CHECK(infos[0].active_voxels == sphere->activeVoxelCount());
  CHECK(infos[0].bounds.lower.x() == Approx(-2.3).margin(0.11));
  CHECK(infos[0].highest == Approx(0.3).margin(0.1));
  CHECK(infos[0].background == Approx(0.3));
  CHECK(infos[1].vector);
  CHECK(infos[1].lowest == Approx(5.0));
  CHECK(infos[1].highest == Approx(5.0));
  CHECK(infos[1].refusal.empty());
}

TEST_CASE("active tiles count in a grid's range of values and number of voxels", "[volume]") {
  const TemporaryFolder folder;
  auto grid = block();
  grid->tree().addTile(1, openvdb::Coord(64, 0, 0), 7.0F, true);
  writeVdb(folder / "a.vdb", {grid});
  const GridInfo info = describeGrids(folder / "a.vdb").front();
  CHECK(info.active_voxels == 1512);
  CHECK(info.highest == 7.0);
}

TEST_CASE("a volume that cannot be fitted is refused with its name and the reason", "[volume]") {
  GridInfo info;
  info.name = "stone";
  info.bounds = {Vec3::Zero(), Vec3(2.0, 4.0, 1.0)};
  CHECK(fitInto(info, 0.1).scale == Approx(0.025));
  info.bounds = {Vec3::Ones(), Vec3::Ones()};
  CHECK_THROWS_WITH(fitInto(info, 0.1), Contains("\"stone\"") && Contains("a single voxel"));
  info.bounds = Box{};
  CHECK_THROWS_WITH(fitInto(info, 0.1), Contains("\"stone\"") && Contains("no voxel"));
  info.bounds = {Vec3::Zero(), Vec3(1.0, std::numeric_limits<double>::infinity(), 1.0)};
  CHECK_THROWS_WITH(fitInto(info, 0.1), Contains("\"stone\"") && Contains("not finite"));
}

TEST_CASE("a missing file, a folder or a file of another format is refused in one line",
          "[volume]") {
  const TemporaryFolder folder;
  std::ofstream(folder / "text.vdb") << "this is no volume at all, just text\n";
  std::ofstream(folder / "empty.vdb");
  CHECK_THAT(refusal(folder / "none.vdb"), Contains("no such file"));
  CHECK_THAT(refusal(folder.path()), Contains("not a file") && Contains("slices, Zarr"));
  CHECK_THAT(refusal(folder / "text.vdb"), Contains("not a .vdb file"));
  CHECK_THAT(refusal(folder / "empty.vdb"), Contains("not a .vdb file"));
  CHECK(refusal(folder / "text.vdb").find('\n') == std::string::npos);
}

TEST_CASE("a VDB file that is cut off anywhere is refused", "[volume]") {
  const TemporaryFolder folder;
  auto rough = block(24);
  writeVdb(folder / "whole.vdb", {rough, block(9, "second")});
  std::ifstream in(folder / "whole.vdb", std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
  REQUIRE(bytes.size() > 2000);
  REQUIRE(refusal(folder / "whole.vdb", "density") == "no error");
  const std::size_t step = std::max<std::size_t>(1, bytes.size() / 400);
  for (std::size_t length = 0; length < bytes.size(); length += step) {
    std::ofstream(folder / "cut.vdb", std::ios::binary) << bytes.substr(0, length);
    CAPTURE(length, bytes.size());
    const std::string why = refusal(folder / "cut.vdb", "density");
    REQUIRE(why != "no error");
    REQUIRE(why.find('\n') == std::string::npos);
  }
  std::ofstream(folder / "cut.vdb", std::ios::binary) << bytes.substr(0, bytes.size() - 1);
  CHECK_THAT(refusal(folder / "cut.vdb", "second"), Contains("truncated"));
}

TEST_CASE("the time to describe grids grows linearly with their number", "[volume][release]") {
  const TemporaryFolder folder;
  openvdb::initialize();
  const auto cost = [&](int count, bool one_name) {  // [s], processor time
    openvdb::GridPtrVec grids;
    for (int i = 0; i < count; ++i) {
      auto grid = openvdb::FloatGrid::create();
      grid->tree().setValue({0, 0, 0}, static_cast<float>(i));
      grid->setName(one_name ? "density" : "v" + std::to_string(i / 3) + "." + "xyz"[i % 3]);
      grids.push_back(grid);
    }
    const auto file = folder / "many.vdb";
    writeVdb(file, grids);
    const std::clock_t begin = std::clock();
    const std::vector<GridInfo> infos = describeGrids(file);
    const double spent = static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC;
    REQUIRE(infos.size() >= static_cast<std::size_t>(count));
    std::set<double> values;
    for (const GridInfo& info : infos) {
      if (!info.vector) values.insert(info.highest);
    }
    CHECK(values.size() == static_cast<std::size_t>(count));
    CHECK(gridNames(file).size() == static_cast<std::size_t>(one_name ? count : count / 3));
    return spent;
  };
  const int some = test::kSanitized ? 42 : 150;
  for (const bool one_name : {true, false}) {
    const double few = cost(some, one_name);
    const double many = cost(8 * some, one_name);
    CAPTURE(one_name, few, many);
    CHECK(many < 2.0 * 8.0 * few);
  }
}

TEST_CASE("a VDB file that is cut off while it is read does not crash the loader", "[volume]") {
  // A thread truncates the file, as another program would. The thread must wait for the lease, or
  // already has the file open. The latter case runs with and without disk space for a copy.
  const TemporaryFolder folder;
  Random values(3);
  openvdb::initialize();
  writeVdb(folder / "whole.vdb", {makeGrid<openvdb::FloatGrid>(
                                     96, Transform::createLinearTransform(1.0), [&](const Vec3d&) {
                                       return static_cast<float>(values.uniform(0.0, 1.0));
                                     })});
  const std::filesystem::path file = folder / "a.vdb";
  const auto size = std::filesystem::file_size(folder / "whole.vdb");
  REQUIRE(size > 3000000);
  using Clock = std::chrono::steady_clock;
  const auto begin = Clock::now();
  (void)loadVolume(folder / "whole.vdb", "");
  const std::chrono::duration<double> usual = Clock::now() - begin;
  Random random(4);
  struct Case {
    bool open_already;
    bool room;
  };
  for (const auto& [open_already, room] :
       {Case{false, true}, Case{true, true}, Case{true, false}}) {
    const NoRoom none(room);
    long read = 0;
    for (int i = 0; i < 30; ++i) {
      std::filesystem::copy_file(folder / "whole.vdb", file,
                                 std::filesystem::copy_options::overwrite_existing);
      const int ours = open_already ? open(file.c_str(), O_RDWR | O_CLOEXEC) : -1;
      const std::chrono::duration<double> wait(random.uniform(0.0, 1.0) * usual.count());
      std::atomic<bool> go{false};
      std::thread cutter([&] {
        while (!go) std::this_thread::yield();
        std::this_thread::sleep_for(wait);
        const auto left = static_cast<off_t>(size / 3);
        if (ours >= 0) {
          (void)!ftruncate(ours, left);
        } else {
          std::filesystem::resize_file(file, static_cast<std::uintmax_t>(left));
        }
      });
      go = true;
      const std::string why = refusal(file);
      cutter.join();
      if (ours >= 0) close(ours);
      read += why == "no error" ? 1 : 0;
      if (why != "no error") CHECK_THAT(why, Contains(file.string() + ": it is "));
      CHECK(std::filesystem::file_size(file) == size / 3);
    }
    INFO("open already: " << open_already << ", room: " << room << ", read " << read);
    CHECK(read > 0);
  }
}

TEST_CASE("a load of a VDB file ends before the system lets a waiting writer change the file",
          "[volume]") {
  const TemporaryFolder folder;
  openvdb::initialize();
  // More than 10,000 leaves, so the file is read in parts.
  writeVdb(folder / "a.vdb", {makeGrid<openvdb::FloatGrid>(
                                 176, Transform::createLinearTransform(1.0),
                                 [](const Vec3d& p) { return static_cast<float>(p.x()); })});
  const std::filesystem::path file = folder / "a.vdb";
  double longest = 45.0;
  std::ifstream("/proc/sys/fs/lease-break-time") >> longest;
  const auto let_writer_wait = [&] {
    // A real writer would try again. One attempt is enough to make the system end the lease.
    CHECK(open(file.c_str(), O_WRONLY | O_NONBLOCK | O_CLOEXEC) < 0);
    CHECK(errno == EWOULDBLOCK);
  };
  SECTION("a waiting writer ends the lease after half of the longest wait") {
    const LeasedFile steady(file);
    // Without a lease, the loader uses a copy.
    if (!std::filesystem::equivalent(steady.place(), file)) return;
    const auto after = [&, begin = LeasedFile::Clock::now()](double seconds) {
      return begin + std::chrono::duration_cast<LeasedFile::Clock::duration>(
                         std::chrono::duration<double>(seconds));
    };
    CHECK(steady.keptAt(after(10.0 * longest)));
    let_writer_wait();
    CHECK(steady.keptAt(after(10.4 * longest)));
    CHECK_FALSE(steady.keptAt(after(10.6 * longest)));
  }
  SECTION("a file that is open for writing is copied, and the copy has no other writer") {
    const int ours = open(file.c_str(), O_RDWR | O_CLOEXEC);
    const LeasedFile steady(file);
    close(ours);
    CHECK_FALSE(std::filesystem::equivalent(steady.place(), file));
    CHECK(steady.keptAt(LeasedFile::Clock::now() + std::chrono::hours(1)));
  }
  SECTION("a load ends between two parts of a file if another program waits to write") {
    // This section takes half of the longest wait, so it runs only if all cases run.
    if (share(10) < 10) return;
    LoadOptions options;
    int parts = 0;
    options.progress = [&](double) {
      if (++parts > 1) return;
      let_writer_wait();
      std::this_thread::sleep_for(std::chrono::duration<double>(0.51 * longest));
    };
    std::string why = "no error";
    try {
      (void)loadVolume(file, "", options);
    } catch (const VolumeError& e) {
      why = e.what();
    }
    CHECK(why ==
          file.string() +
              ": another program waited to change the file, so palpate ended the load: load the "
              "file when no program writes to it");
    CHECK(parts == 1);
  }
}

TEST_CASE("a load uses the values that it has checked while another process writes the file",
          "[volume]") {
  // The test has the file open, as another program would. After the loader has read the first
  // component, the test overwrites the file with another vector.
  const TemporaryFolder folder;
  const std::vector<std::string> names{"vel.x", "vel.y", "vel.z"};
  writeRough(folder / "a.vdb", names, 24, 1);
  writeRough(folder / "b.vdb", names, 24, 2);
  const std::string other = bytesOf(folder / "b.vdb");
  const GridInfo whole = loadVolume(folder / "a.vdb", "vel")->info();
  REQUIRE(whole.mean != loadVolume(folder / "b.vdb", "vel")->info().mean);
  for (const bool room : {true, false}) {
    CAPTURE(room);
    const NoRoom none(room);
    const auto file = folder / "felt.vdb";
    std::filesystem::copy_file(folder / "a.vdb", file,
                               std::filesystem::copy_options::overwrite_existing);
    REQUIRE(std::filesystem::file_size(file) == other.size());
    const int ours = open(file.c_str(), O_RDWR | O_CLOEXEC);
    LoadOptions options;
    options.progress = [&](double) {
      REQUIRE(pwrite(ours, other.data(), other.size(), 0) == static_cast<ssize_t>(other.size()));
    };
    const GridInfo info = loadVolume(file, "vel", options)->info();
    close(ours);
    CHECK(bytesOf(file) == other);
    CHECK(info.mean == whole.mean);
    CHECK(info.highest == whole.highest);
  }
}

TEST_CASE("a VDB file that another program may change and that cannot be copied is refused",
          "[volume]") {
  const TemporaryFolder folder;
  writeRough(folder / "a.vdb", {"density"}, 12, 1);
  const NoRoom none(false);
  const int ours = open((folder / "a.vdb").c_str(), O_RDWR | O_CLOEXEC);
  rlimit was{};
  getrlimit(RLIMIT_FSIZE, &was);
  auto* const handled = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit small{1000, was.rlim_max};
  setrlimit(RLIMIT_FSIZE, &small);
  const std::string why = refusal(folder / "a.vdb");
  setrlimit(RLIMIT_FSIZE, &was);
  (void)std::signal(SIGXFSZ, handled);
  CHECK_THAT(
      why,
      Contains("may change it during the load, and it cannot be copied (File too large): raise"));
  CHECK(refusal(folder / "a.vdb") == "no error");
  close(ours);
}

TEST_CASE("a load of many grids reads their file at most three times, and once more to copy it",
          "[volume]") {
  const TemporaryFolder folder;
  std::vector<std::string> names;
  for (int i = 10; i < 50; ++i) names.push_back("grid" + std::to_string(i));
  const auto file = folder / "many.vdb";
  writeRough(file, names, 20, 1);
  const auto size = static_cast<double>(std::filesystem::file_size(file));
  std::vector<VolumeRequest> requests;
  for (const std::string& name : names) requests.push_back({file, name});
  const auto times = [&](const auto& load) {
    const double before = readSoFar();
    load();
    return (readSoFar() - before) / size;
  };
  for (const bool others : {false, true}) {
    const int ours = others ? open(file.c_str(), O_RDWR | O_CLOEXEC) : -1;
    const double asked = times([&] {
      for (const LoadResult& result : loadVolumes(requests)) {
        REQUIRE(result.volume->info().active_voxels == 8000);
      }
    });
    const double all = times([&] {
      const std::vector<FileResult> results = loadFiles({file});
      REQUIRE(results[0].names == names);
      for (const LoadResult& result : results[0].volumes) {
        REQUIRE(result.volume->info().active_voxels == 8000);
      }
    });
    if (ours >= 0) close(ours);
    WARN("read " << asked << " and " << all << " times" << (others ? ", copied" : ""));
    // The loader reads a file up to three times: to check it, to load it, and to describe its
    // grids. It may also copy the file.
    CHECK(asked < (others ? 4.0 : 3.0));
    CHECK(all < (others ? 4.0 : 3.0));
  }
}

TEST_CASE("a grid in memory gives the same volume as a grid from a file", "[volume]") {
  const TemporaryFolder folder;
  openvdb::initialize();
  const auto grid = block(20, "rock");
  grid->setGridClass(openvdb::GRID_FOG_VOLUME);
  const auto velocity = makeGrid<openvdb::Vec3SGrid>(
      8, Transform::createLinearTransform(0.5),
      [](const Vec3d& p) { return openvdb::Vec3s(p.y(), -p.x(), 1.0); }, "velocity");
  velocity->setGridClass(openvdb::GRID_STAGGERED);
  writeVdb(folder / "a.vdb", {grid, velocity});
  for (const openvdb::GridBase::Ptr& one :
       {openvdb::GridBase::Ptr(grid), openvdb::GridBase::Ptr(velocity)}) {
    CAPTURE(one->getName());
    const auto there = loadVolume(folder / "a.vdb", one->getName());
    const auto here = makeVolume(*one);
    const GridInfo& a = there->info();
    const GridInfo& b = here->info();
    CHECK(a.name == b.name);
    CHECK(a.type == b.type);
    CHECK(a.grid_class == b.grid_class);
    CHECK(a.active_voxels == b.active_voxels);
    CHECK(a.voxel == b.voxel);
    CHECK(a.bounds.lower == b.bounds.lower);
    CHECK(a.bounds.upper == b.bounds.upper);
    CHECK(a.lowest == b.lowest);
    CHECK(a.highest == b.highest);
    CHECK(a.mean == b.mean);
  }
  // The volume copies the values, so the load must leave the grid unchanged.
  const auto before = block(20, "rock");
  LoadOptions fill;
  fill.non_finite = NonFinite::kFill;
  before->tree().setValue({1, 1, 1}, std::numeric_limits<float>::quiet_NaN());
  CHECK(makeVolume(*before, fill)->info().filled == 1);
  CHECK(std::isnan(before->tree().getValue({1, 1, 1})));
  CHECK_THROWS_WITH(makeVolume(*before), Contains("grid \"rock\": "));
  CHECK_THROWS_AS(makeVolume(*openvdb::BoolGrid::create(true)), VolumeError);
  CHECK_THROWS_AS(makeVolume(*openvdb::FloatGrid::create()), VolumeError);
}

TEST_CASE("each file loads with all its grids, despite errors in other files", "[volume]") {
  const TemporaryFolder folder;
  writeRough(folder / "a.vdb", {"vel.x", "density", "vel.y", "vel.z"}, 6, 1);
  auto bad = block();
  bad->tree().setValue(openvdb::Coord(3, 3, 3), std::numeric_limits<float>::infinity());
  writeVdb(folder / "b.vdb", {block(8, "good"), bad});
  std::ofstream(folder / "c.vdb") << "this is no volume at all, just text\n";
  std::vector<double> told;
  const auto results =
      loadFiles({folder / "a.vdb", folder / "c.vdb", folder / "b.vdb", folder / "none.vdb"},
                [&](double done) { told.push_back(done); });
  REQUIRE(results.size() == 4);
  CHECK(results[0].names == gridNames(folder / "a.vdb"));
  CHECK(results[0].names == std::vector<std::string>{"density", "vel"});
  CHECK(results[0].volumes[1].volume->info().vector);
  CHECK(results[2].names == gridNames(folder / "b.vdb"));
  for (std::size_t i = 0; i < 2; ++i) {
    CHECK((results[2].volumes[i].volume != nullptr) == (results[2].names[i] == "good"));
    CHECK((results[2].volumes[i].error != nullptr) == (results[2].names[i] != "good"));
  }
  CHECK_THROWS_WITH(std::rethrow_exception(results[1].error), Contains("not a .vdb file"));
  CHECK_THROWS_WITH(std::rethrow_exception(results[3].error), Contains("no such file"));
  CHECK(std::is_sorted(told.begin(), told.end()));
  CHECK(told.back() == 1.0);
}

TEST_CASE("a grid of an unsupported type is described from its header but its tree is not read",
          "[volume]") {
  const TemporaryFolder folder;
  auto labels = makeGrid<openvdb::Vec3IGrid>(
      9, Transform::createLinearTransform(0.5), [](const Vec3d&) { return openvdb::Vec3i(3); },
      "labels");
  writeVdb(folder / "a.vdb", {labels, block()});
  std::fstream file(folder / "a.vdb", std::ios::in | std::ios::out | std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
  // Overwrites the whole tree, which begins after the transform: 15 characters and 15 numbers.
  const auto transform = bytes.find("UniformScaleMap");
  const auto next = bytes.find("density", transform);
  REQUIRE(next < bytes.size());
  const std::size_t begin = transform + 15 + 15 * sizeof(double);
  file.seekp(static_cast<std::streamoff>(begin));
  file << std::string(next - 4 - begin, '\xff');
  file.close();
  const auto infos = describeGrids(folder / "a.vdb");
  REQUIRE(infos.size() == 2);
  for (const GridInfo& info : infos) {
    if (info.name != "labels") continue;
    CHECK(info.type == "vec3i");
    CHECK(info.active_voxels == 729);
    CHECK(info.bounds.upper.x() == Approx(4.0));
    CHECK_THAT(info.refusal, Contains("convert it"));
  }
  CHECK(refusal(folder / "a.vdb", "density") == "no error");
}

TEST_CASE("older and newer VDB file formats are refused with their version number", "[volume]") {
  const TemporaryFolder folder;
  writeVdb(folder / "a.vdb", {block()});
  for (const char version : {'\x20', '\xdd', '\xe1'}) {
    std::fstream file(folder / "a.vdb", std::ios::in | std::ios::out | std::ios::binary);
    file.seekp(8);
    file.put(version);
    file.close();
    const std::string number = std::to_string(static_cast<unsigned char>(version));
    CHECK_THAT(refusal(folder / "a.vdb"), Contains("format (" + number + ")") && Contains("again"));
  }
}

TEST_CASE("a voxel value of 1e200 is refused", "[volume]") {
  const TemporaryFolder folder;
  auto grid = makeGrid<openvdb::DoubleGrid>(4, Transform::createLinearTransform(0.5),
                                            [](const Vec3d& p) { return p.x(); });
  grid->tree().setValue(openvdb::Coord(1, 1, 1), 1e200);
  writeVdb(folder / "a.vdb", {grid});
  CHECK_THAT(refusal(folder / "a.vdb"), Contains("1 of its values"));
}

TEST_CASE("the error for a wrong grid name suggests the nearest name or lists all names",
          "[volume]") {
  const TemporaryFolder folder;
  writeVdb(folder / "a.vdb", {block(8, "density"), block(8, "heat")});
  CHECK_THAT(refusal(folder / "a.vdb", "denisty"), Contains("did you mean \"density\"?"));
  CHECK_THAT(refusal(folder / "a.vdb", "velocity"), Contains("name one of density, heat"));
  CHECK_THAT(refusal(folder / "a.vdb"), Contains("more than one grid"));
}

TEST_CASE("grids with equal names are listed with an index", "[volume]") {
  const TemporaryFolder folder;
  writeVdb(folder / "a.vdb", {block(8), block(9)});
  CHECK(gridNames(folder / "a.vdb") == std::vector<std::string>{"density[0]", "density[1]"});
  CHECK(loadVolume(folder / "a.vdb", "density[1]")->info().active_voxels == 729);
}

TEST_CASE("a grid that shares a tree with another grid reads the right tree, even if names clash",
          "[volume]") {
  const TemporaryFolder folder;
  Random random(5);
  for (const int n : {8, 80}) {  // read as a whole, and through a memory map
    CAPTURE(n);
    const auto rough = [&](double least, const char* name) {
      return makeGrid<openvdb::FloatGrid>(
          n, Transform::createLinearTransform(1.0),
          [&](const Vec3d&) { return static_cast<float>(random.uniform(least, least + 1.0)); },
          name);
    };
    const auto shared = [](const openvdb::FloatGrid::Ptr& grid, const char* name) {
      auto twin = openvdb::FloatGrid::create(grid->treePtr());
      twin->setName(name);
      return twin;
    };
    const auto lowest = [&](const std::string& name) {
      return std::floor(loadVolume(folder / "a.vdb", name)->info().lowest);
    };
    // The second of two grids with equal names has the tree that "twin" uses.
    const auto first = rough(1.0, "density");
    const auto second = rough(2.0, "density");
    writeVdb(folder / "a.vdb", {first, second, shared(second, "twin")});
    CHECK(lowest("density[0]") == 1.0);
    CHECK(lowest("density[1]") == 2.0);
    CHECK(lowest("twin") == 2.0);
    // A grid's own name is "density[0]", which is also the indexed name of another grid. Both grids
    // use one tree, which either of them owns.
    const auto literal = rough(3.0, "density[0]");
    const auto twin = shared(literal, "density");
    for (const bool lends : {true, false}) {
      CAPTURE(lends);
      openvdb::GridPtrVec grids{literal, twin, first};
      if (!lends) std::swap(grids[0], grids[1]);
      writeVdb(folder / "a.vdb", grids);
      CHECK(lowest("density[0]") == 3.0);
      CHECK(lowest("density[1]") == 1.0);
      for (const GridInfo& info : describeGrids(folder / "a.vdb")) CHECK(info.refusal.empty());
    }
  }
}

TEST_CASE("an unusable grid is refused with the reason", "[volume]") {
  const TemporaryFolder folder;
  openvdb::initialize();

  writeVdb(folder / "empty.vdb", {openvdb::FloatGrid::create()});
  CHECK_THAT(refusal(folder / "empty.vdb"), Contains("no active voxel"));

  auto frustum = block();
  frustum->setTransform(Transform::createFrustumTransform(
      openvdb::BBoxd(Vec3d(0, 0, 0), Vec3d(10, 10, 10)), 0.5, 5.0));
  writeVdb(folder / "frustum.vdb", {frustum});
  CHECK_THAT(refusal(folder / "frustum.vdb"),
             Contains("frustum transform: resample it to an affine grid"));

  auto labels = openvdb::Int32Grid::create();
  labels->tree().setValue(openvdb::Coord(0, 0, 0), 1);
  writeVdb(folder / "labels.vdb", {labels});
  CHECK_THAT(refusal(folder / "labels.vdb"), Contains("type int32"));

  auto points = openvdb::points::PointDataGrid::create();
  points->tree().touchLeaf(openvdb::Coord(0, 0, 0));
  writeVdb(folder / "points.vdb", {points});
  CHECK_THAT(refusal(folder / "points.vdb"), Contains("points: rasterise them"));

  for (const float bad :
       {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()}) {
    auto grid = block();
    grid->tree().setValue(openvdb::Coord(3, 3, 3), bad);
    grid->tree().setValueOff(openvdb::Coord(4, 3, 3), bad);  // inactive values are checked, too
    writeVdb(folder / "bad.vdb", {grid});
    CHECK_THAT(refusal(folder / "bad.vdb"), Contains("2 of its values are NaN, infinite"));
  }
  auto background = openvdb::FloatGrid::create(std::numeric_limits<float>::quiet_NaN());
  background->tree().setValue(openvdb::Coord(0, 0, 0), 1.0F);
  writeVdb(folder / "background.vdb", {background});
  CHECK_THAT(refusal(folder / "background.vdb"), Contains("NaN, infinite"));
}

TEST_CASE("volumes of one file can be loaded in parallel and repeatedly", "[volume]") {
  // A load that drops its pages must not drop pages that another load uses.
  const TemporaryFolder folder;
  openvdb::initialize();
  const std::vector<std::string> names{"a", "b", "c"};
  openvdb::GridPtrVec grids;
  for (const std::string& name : names) grids.push_back(block(40, name));
  openvdb::io::File((folder / "many.vdb").string()).write(grids);
  std::vector<VolumeRequest> requests;
  for (const std::string& name : names) requests.push_back({folder / "many.vdb", name});
  for (int i = 0; i < 40; ++i) {
    for (const LoadResult& result : loadVolumes(requests, nullptr)) {
      REQUIRE(result.volume != nullptr);
      REQUIRE(result.volume->info().active_voxels == 64000);
    }
  }
}

TEST_CASE(
    "a cancelled parallel loop completes the tasks that have begun, with their inner loops, and "
    "starts "
    "no others",
    "[volume]") {
  using std::chrono::milliseconds;
  constexpr std::size_t kMany = 10000;
  std::atomic<bool> working{false};
  std::atomic<bool> given_up{false};
  std::atomic<std::size_t> done{0};
  std::atomic<int> begun{0};
  const auto wait_for = [](const std::atomic<bool>& that) {
    for (int i = 0; i < 60000 && !that; ++i) std::this_thread::sleep_for(milliseconds(1));
  };
  // One task fails while the other is about to start a loop of its own.
  CHECK_THROWS_WITH(inParallel(2,
                               [&](std::size_t i) {
                                 ++begun;
                                 if (i == 0) {
                                   wait_for(working);
                                   given_up = true;
                                   throw VolumeError("test", "cancelled", "none");
                                 }
                                 working = true;
                                 wait_for(given_up);
                                 std::this_thread::sleep_for(milliseconds(20));
                                 tbb::parallel_for(std::size_t{0}, kMany,
                                                   [&](std::size_t) { ++done; });
                               }),
                    Contains("cancelled"));
  // With two processors, the inner loop must run to its end. With one processor, the second task
  // does not start.
  CHECK(done == (begun == 2 ? kMany : 0));

  // Tasks that have not started do not run.
  begun = 0;
  CHECK_THROWS_AS(inParallel(1000000,
                             [&](std::size_t) {
                               ++begun;
                               throw VolumeError("test", "cancelled", "none");
                             }),
                  VolumeError);
  CHECK(begun < 1000);
}

TEST_CASE("grids of whole numbers, bools and masks are described by their values", "[samplers]") {
  openvdb::initialize();
  const TemporaryFolder folder;
  // OpenVDB's registry creates the grids, because only OpenVDB's library contains their types.
  const auto made = [](auto* type, const char* name) {
    using GridT = std::remove_pointer_t<decltype(type)>;
    auto grid = openvdb::gridPtrCast<GridT>(openvdb::GridBase::createGrid(GridT::gridType()));
    grid->setName(name);
    grid->tree().fill(openvdb::CoordBBox(Coord(0), Coord(20)), typename GridT::ValueType(1), true);
    return grid;
  };
  auto labels = made(static_cast<openvdb::Int32Grid*>(nullptr), "labels");
  auto large = made(static_cast<openvdb::Int64Grid*>(nullptr), "large");
  for (int i = 0; i < 21; ++i) {
    const openvdb::CoordBBox slice(Coord(i, 0, 0), Coord(i, 20, 20));
    labels->tree().fill(slice, i + 1, true);
    large->tree().fill(slice, -1000 * std::int64_t{i}, true);
  }
  openvdb::GridPtrVec grids{labels, large, made(static_cast<openvdb::BoolGrid*>(nullptr), "bools"),
                            made(static_cast<openvdb::MaskGrid*>(nullptr), "mask")};
  grids[2]->setSaveFloatAsHalf(true);  // has no effect on a bool grid
  grids[0]->setSaveFloatAsHalf(true);
  for (const std::uint32_t compression : {0U, 1U, 2U, 3U, 6U}) {
    CAPTURE(compression);
    openvdb::io::File file((folder / "whole.vdb").string());
    file.setCompression(compression);
    file.write(grids);
    file.close();
    const std::vector<GridInfo> infos = describeGrids(folder / "whole.vdb");
    const auto range = [&](const std::string& name) {
      const auto info = std::find_if(infos.begin(), infos.end(),
                                     [&](const GridInfo& one) { return one.name == name; });
      REQUIRE(info != infos.end());
      CHECK(info->active_voxels == 21 * 21 * 21);
      return std::array{info->lowest, info->highest, info->mean, info->background};
    };
    CHECK(range("labels") == std::array{1.0, 21.0, 11.0, 0.0});
    CHECK(range("large") == std::array{-20000.0, 0.0, -10000.0, 0.0});
    CHECK(range("bools") == std::array{1.0, 1.0, 1.0, 0.0});
    CHECK(range("mask") == std::array{1.0, 1.0, 1.0, 0.0});
    for (const GridInfo& info : infos) CHECK(info.refusal.find("its type") != std::string::npos);
  }
}

}  // namespace palpate::volume_test
