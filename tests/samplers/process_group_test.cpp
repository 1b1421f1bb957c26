/// Tests bricks that several ranks write. In these tests the ranks are threads. The bytes must
/// equal those of a single rank. If a rank fails, all ranks must end.
#include "palpate/samplers/process_group.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <map>
#include <mutex>
#include <set>
#include <string>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/brick_grid.h"
#include "palpate/samplers/bricks/write_bricks.h"
#include "palpate/samplers/grid/make_volume.h"
#include "tests/support/random.h"
#include "tests/support/thinned.h"
#include "tests/support/thread_group.h"
#include "tests/support/vdb_grids.h"

namespace palpate::process_group_test {
using namespace palpate::test;
using Catch::Contains;
using openvdb::Coord;

namespace {

namespace fs = std::filesystem;

std::map<std::string, std::string> allIn(const fs::path& folder) {
  std::map<std::string, std::string> all;
  for (const auto& one : fs::recursive_directory_iterator(folder)) {
    if (!one.is_regular_file()) continue;
    std::ifstream file(one.path(), std::ios::binary);
    all[one.path().lexically_relative(folder).string()] = {std::istreambuf_iterator<char>(file),
                                                           {}};
  }
  return all;
}

/// Returns a hollow ellipsoid about (0, 0, 30), as a level set from a formula. The ellipsoid covers
/// several layers of bricks.
BrickInput ball() {
  BrickInput input;
  input.name = "ball";
  input.grid_class = GridClass::kLevelSet;
  input.background = {3.0F, 0.0F, 0.0F};
  input.lower = {-70, -70, -90};
  input.upper = {70, 70, 150};
  input.identity = "ball";
  input.fill = [](const BrickBox& box) {
    std::size_t n = 0;
    for (int i = 0; i < kBrickEdge; ++i) {
      for (int j = 0; j < kBrickEdge; ++j) {
        for (int k = 0; k < kBrickEdge; ++k, ++n) {
          const Vec3 p(box.lower[0] + i, box.lower[1] + j, 0.6 * (box.lower[2] + k - 30));
          const double d = std::abs(p.norm() - 55.0) - 4.0;
          box.values[n] = static_cast<float>(std::clamp(d, -3.0, 3.0));
          if (std::abs(d) < 3.0) box.active[n / 8] |= static_cast<std::uint8_t>(1U << (n % 8));
        }
      }
    }
    return BoxFilled::kEach;
  };
  return input;
}

/// Returns scattered voxels with coordinates of both signs.
openvdb::FloatGrid::Ptr scattered() {
  openvdb::initialize();
  Random random(5);
  auto grid = openvdb::FloatGrid::create(0.5F);
  for (int n = 0; n < 4000; ++n) {
    const auto at = [&](double low, double high) {
      return static_cast<int>(random.uniform(low, high));
    };
    // Every second voxel is moved along y, so that the tree's root has children far apart.
    const int y = at(-20.0, 100.0) + n % 2 * 4080;
    const Coord c(at(-90.0, 200.0), y, at(-150.0, 250.0));
    grid->tree().setValueOn(c, static_cast<float>(random.uniform(-1.0, 1.0)));
  }
  grid->setName("scattered");
  return grid;
}

/// Returns the parts of a grid with these shares. A box that is not in the open part is empty.
GridParts partsOf(const openvdb::FloatGrid::ConstPtr& grid, const std::vector<Share>& shares) {
  GridParts parts;
  parts.grid = openvdb::FloatGrid::create(grid->background());
  parts.grid->setName(grid->getName());
  parts.box = grid->evalActiveVoxelBoundingBox();
  parts.shares = shares;
  parts.open = [=](std::size_t part) -> GridBox {
    return [grid, first = shares[part].first * kBrickSide - kBrickApron,
            end = shares[part].end * kBrickSide + kBrickApron](const openvdb::CoordBBox& box) {
      auto out = openvdb::FloatGrid::create(grid->background());
      if (box.min().z() < first || box.max().z() >= end) return openvdb::GridBase::Ptr(out);
      using Leaf = openvdb::FloatTree::LeafNodeType;
      const openvdb::CoordBBox leaves(box.min() >> Leaf::LOG2DIM, box.max() >> Leaf::LOG2DIM);
      for (auto at = leaves.begin(); at; ++at) {
        const Leaf* leaf = grid->tree().probeConstLeaf(*at << Leaf::LOG2DIM);
        if (leaf != nullptr) out->tree().addLeaf(new Leaf(*leaf));
      }
      return openvdb::GridBase::Ptr(out);
    };
  };
  return parts;
}

std::string errorOf(const std::function<void()>& call) {
  try {
    call();
  } catch (const Error& e) {
    return e.what();
  }
  return "no error";
}

}  // namespace

TEST_CASE("the shares of the ranks of a process group together cover the whole range in order",
          "[process_group]") {
  for (const int size : {1, 2, 3, 7}) {
    for (const int count : {0, 1, 5, 64}) {
      std::mutex mutex;
      std::map<int, Share> shares;
      CHECK(byThreads(size, [&](ProcessGroup& group) {
              const std::lock_guard lock(mutex);
              shares[group.rank()] = shareOf(group, count);
            }) == 0);
      std::int64_t end = 0;
      for (const auto& [rank, share] : shares) {
        CHECK(share.first == end);
        CHECK(share.end - share.first <= count / size + 1);
        CHECK(share.end - share.first >= count / size);
        end = share.end;
      }
      CHECK(end == count);
    }
  }
}

TEST_CASE("a process group gathers values and lists in the order of its ranks", "[process_group]") {
  CHECK(byThreads(3, [](ProcessGroup& group) {
          const std::vector<int> own(static_cast<std::size_t>(2 * group.rank()), group.rank());
          const bool right = gatherAll(group, own) == std::vector<int>{1, 1, 2, 2, 2, 2} &&
                             gatherOne(group, 10 * group.rank()) == std::vector<int>{0, 10, 20};
          if (!right) throw Error("the test", "it gathers something else", "mend it");
        }) == 0);
}

TEST_CASE("bricks written by 2, 3 or 8 ranks equal those of a single process",
          "[bricks][process_group][release]") {
  const TemporaryFolder folder;
  const BrickReport alone = writeBricks(folder / "alone", ball());
  const auto whole = allIn(folder / "alone");
  CHECK(whole.count("palpate.bricks") == 1);
  for (const int size : {2, 3, 8}) {
    const fs::path out = folder / std::to_string(size);
    std::mutex mutex;
    std::set<std::uint64_t> written;
    CHECK(byThreads(size, [&](ProcessGroup& group) {
            BrickOptions options;
            options.group = &group;
            const BrickReport report = writeBricks(out, ball(), options);
            const std::lock_guard lock(mutex);
            written.insert(report.written);
          }) == 0);
    CHECK(written == std::set{alone.written});
    CHECK(allIn(out) == whole);
  }
}

TEST_CASE("a grid that is split among ranks gives the same bricks as the whole grid",
          "[bricks][process_group]") {
  const TemporaryFolder folder;
  const auto grid = scattered();
  (void)writeBricks(folder / "alone", brickInput(makeVolume(*grid)));
  const auto whole = allIn(folder / "alone");
  test::Thinned sizes(3);
  for (const int size : {9, 2, 5}) {
    if (!sizes.runs()) continue;
    const fs::path out = folder / std::to_string(size);
    CHECK(byThreads(size, [&](ProcessGroup& group) {
            // There are three layers of bricks below 0 and four above. Of nine ranks, two get no
            // layer.
            const Share of_seven = shareOf(group, 7);
            const Share share{of_seven.first - 3, of_seven.end - 3};
            BrickOptions options;
            options.group = &group;
            (void)writeBricks(out, brickInput(partsOf(grid, {share}), group), options);
          }) == 0);
    CHECK(allIn(out) == whole);
  }
}

TEST_CASE("a grid that is made part by part gives the same bricks as the whole grid",
          "[bricks][process_group]") {
  const TemporaryFolder folder;
  const auto grid = scattered();
  (void)writeBricks(folder / "alone", brickInput(makeVolume(*grid)));
  SingleProcess alone;
  // The last part has no voxel.
  const GridParts parts = partsOf(grid, {{-3, -2}, {-2, 2}, {2, 4}, {4, 6}});
  (void)writeBricks(folder / "parts", brickInput(parts, alone));
  CHECK(allIn(folder / "parts") == allIn(folder / "alone"));
}

TEST_CASE("a failing rank ends all ranks with one message, and the next process group resumes",
          "[bricks][process_group]") {
  const TemporaryFolder folder;
  (void)writeBricks(folder / "alone", ball());
  const fs::path out = folder / "out";
  const auto by = [&](int size,
                      const std::function<void(ProcessGroup&, BrickInput&, BrickOptions&)>& but) {
    std::uint64_t kept = 0;
    const std::string why = errorOf([&] {
      const int told = byThreads(size, [&](ProcessGroup& group) {
        BrickInput input = ball();
        BrickOptions options;
        options.group = &group;
        but(group, input, options);
        const BrickReport report = writeBricks(out, input, options);
        if (group.rank() == 0) kept = report.kept;
      });
      CHECK(told == 0);
    });
    return std::pair(why, kept);
  };

  // Either only the last rank fails or all ranks fail at once, early or late in the export.
  for (const bool all : {false, true}) {
    for (const double when : {0.1, 0.95}) {
      const std::string why =
          by(3, [&](ProcessGroup& group, BrickInput&, BrickOptions& options) {
            if (!all && group.rank() != 2) return;
            options.progress = [=, &group](double done) {
              if (done < when) return;
              throw Error("rank " + std::to_string(group.rank()), "it ends", "go on");
            };
          }).first;
      CHECK(why == (all ? "rank 0: it ends: go on" : "rank 2: it ends: go on"));
      CHECK_FALSE(fs::exists(out / "palpate.bricks"));
    }
  }
  // Two ranks have different inputs.
  CHECK_THAT(by(2,
                [](ProcessGroup& group, BrickInput& input, BrickOptions&) {
                  if (group.rank() == 1) input.identity = "another";
                })
                 .first,
             Contains("differ from those of rank 0"));
  CHECK_FALSE(fs::exists(out / "palpate.bricks"));
  const auto [why, kept] = by(4, [](ProcessGroup&, BrickInput&, BrickOptions&) {});
  CHECK(why == "no error");
  CHECK(kept > 5);
  CHECK(allIn(out) == allIn(folder / "alone"));
  // All ranks leave a complete folder unchanged.
  CHECK(by(2, [](ProcessGroup&, BrickInput&, BrickOptions&) {}) ==
        std::pair(why, std::uint64_t{0}));
}

}  // namespace palpate::process_group_test
