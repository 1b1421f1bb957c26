#include "palpate/scenes/guess/body.h"

#include <algorithm>
#include <cstddef>
#include <vector>

#include <openvdb/tools/Morphology.h>
#include <openvdb/tools/Prune.h>

#include "palpate/scenes/guess/candidate.h"
#include "palpate/scenes/guess/mode_rules.h"

namespace palpate::guess {
namespace {

/// A row of adjacent voxels along z with values above a limit.
struct Run {
  openvdb::Coord first;
  int end = 0;             ///< z after the last voxel.
  std::uint32_t next = 0;  ///< Index of a run of the same body.
};

/// Runs that are joined into bodies if they touch by their faces (union-find).
class Bodies {
 public:
  Bodies(const openvdb::FloatGrid& grid, double above)
      : box_(grid.evalActiveVoxelBoundingBox()), values_(grid.getConstAccessor()), above_(above) {
    std::vector<std::size_t> before(static_cast<std::size_t>(box_.dim().y()) + 1, 0);
    std::vector<std::size_t> now = before;
    for (int x = box_.min().x(); x <= box_.max().x(); ++x) {
      for (int y = box_.min().y(); y <= box_.max().y(); ++y) {
        const auto row = static_cast<std::size_t>(y - box_.min().y());
        now[row] = runs_.size();
        addRow(x, y);
        if (row > 0) join(now[row - 1], now[row], now[row]);
        if (x > box_.min().x()) join(before[row], before[row + 1], now[row]);
      }
      now.back() = runs_.size();
      before = now;
    }
  }

  [[nodiscard]] const std::vector<Run>& runs() const { return runs_; }
  [[nodiscard]] std::uint32_t bodyOf(std::uint32_t run) {
    while (runs_[run].next != run) {
      runs_[run].next = runs_[runs_[run].next].next;
      run = runs_[run].next;
    }
    return run;
  }

 private:
  void addRow(int x, int y) {
    bool within = false;
    for (int z = box_.min().z(); z <= box_.max().z(); ++z) {
      const bool solid = static_cast<double>(values_.getValue({x, y, z})) > above_;
      if (solid && !within) {
        runs_.push_back({{x, y, z}, z, static_cast<std::uint32_t>(runs_.size())});
      }
      if (solid) runs_.back().end = z + 1;
      within = solid;
    }
  }
  /// Joins the runs [from, to) of a row with the runs of the neighbouring row that starts at `row`.
  void join(std::size_t from, std::size_t to, std::size_t row) {
    while (from < to && row < runs_.size()) {
      const Run& a = runs_[from];
      const Run& b = runs_[row];
      if (a.first.z() < b.end && b.first.z() < a.end) {
        runs_[bodyOf(static_cast<std::uint32_t>(row))].next =
            bodyOf(static_cast<std::uint32_t>(from));
      }
      (a.end < b.end ? from : row) += 1;
    }
  }

  openvdb::CoordBBox box_;
  openvdb::FloatGrid::ConstAccessor values_;
  double above_;
  std::vector<Run> runs_;
};

struct Extent {
  std::uint64_t voxels = 0;
  openvdb::CoordBBox box;
};

/// Returns the voxels of the runs with keep(index) true, and all voxels up to `voxels` voxels from
/// them.
template <class Keep>
openvdb::MaskTree dilated(const std::vector<Run>& runs, int voxels, const Keep& keep) {
  openvdb::MaskTree mask;
  openvdb::tree::ValueAccessor<openvdb::MaskTree> at(mask);
  for (std::uint32_t i = 0; i < runs.size(); ++i) {
    if (!keep(i)) continue;
    openvdb::Coord c = runs[i].first;
    for (; c.z() < runs[i].end; ++c.z()) at.setValueOn(c);
  }
  if (voxels > 0) {
    openvdb::tools::dilateActiveValues(mask, voxels, openvdb::tools::NN_FACE_EDGE_VERTEX,
                                       openvdb::tools::IGNORE_TILES);
  }
  return mask;
}

}  // namespace

std::optional<LargestBody> findLargestBody(const SuggestInput& image) {
  // If the other bodies together have at most this fraction of the largest body's voxels, they are
  // noise.
  constexpr double kNoise = 1e-4;
  constexpr int kReach = 2;  // [voxels]: a proxy on the surface reads the cell around it
  if (!image.isScalar() || !image.grid->isType<openvdb::FloatGrid>()) return std::nullopt;
  Candidate candidate;
  candidate.input = &image;
  classify(candidate, GuessFor::kAnything);
  const auto& grid = static_cast<const openvdb::FloatGrid&>(*image.grid);
  if (candidate.kind != Kind::kHounsfield || grid.background() > kSkinHounsfield) {
    return std::nullopt;
  }
  Bodies bodies(grid, kSkinHounsfield);
  std::vector<Extent> extents(bodies.runs().size());
  for (std::uint32_t i = 0; i < extents.size(); ++i) {
    const Run& run = bodies.runs()[i];
    Extent& body = extents[bodies.bodyOf(i)];
    body.voxels += static_cast<std::uint64_t>(run.end - run.first.z());
    body.box.expand(run.first);
    body.box.expand(openvdb::Coord(run.first.x(), run.first.y(), run.end - 1));
  }
  const auto largest =
      std::max_element(extents.begin(), extents.end(),
                       [](const Extent& a, const Extent& b) { return a.voxels < b.voxels; });
  if (largest == extents.end()) return std::nullopt;
  const auto kept = [&](std::uint32_t run) {
    return largest->box.isInside(extents[bodies.bodyOf(run)].box);
  };
  LargestBody found;
  std::uint64_t left = 0;
  for (std::uint32_t i = 0; i < extents.size(); ++i) {
    if (extents[i].voxels == 0 || kept(i)) continue;
    left += extents[i].voxels;
    ++found.left;
  }
  if (static_cast<double>(left) <= kNoise * static_cast<double>(largest->voxels)) {
    return std::nullopt;
  }
  openvdb::MaskTree region = dilated(bodies.runs(), kReach, kept);
  region.topologyDifference(
      dilated(bodies.runs(), 1, [&](std::uint32_t run) { return !kept(run); }));
  region.topologyUnion(dilated(bodies.runs(), 0, kept));
  auto tree = std::make_shared<openvdb::FloatTree>(region, 0.0F, 1.0F, openvdb::TopologyCopy());
  openvdb::tools::prune(*tree);
  found.region = openvdb::FloatGrid::create(tree);
  found.region->setTransform(grid.transform().copy());
  found.region->setName(bodyNameOf(image.name()));
  found.region->insertMeta(kMetaBodyOf, openvdb::StringMetadata(image.name()));
  return found;
}

}  // namespace palpate::guess
