#include "palpate/samplers/bricks/write_bricks.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <fstream>
#include <iterator>
#include <limits>
#include <mutex>
#include <optional>
#include <system_error>
#include <utility>
#include <vector>

#include <tbb/enumerable_thread_specific.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/brick_codec.h"
#include "palpate/samplers/bricks/brick_facts.h"
#include "palpate/samplers/bricks/brick_folder.h"
#include "palpate/samplers/bricks/brick_pyramid.h"
#include "palpate/samplers/parallel.h"

namespace palpate {
namespace {

namespace fs = std::filesystem;

enum class Found { kNothing, kUnfinished, kFinished };

std::string contentsOf(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

/// Returns the state of the folder, and makes the folder if it is missing. Throws Error if the
/// folder contains anything but bricks of this identity, or cannot be made.
Found lookInto(const fs::path& folder, std::uint64_t identity) {
  std::error_code error;
  if (!fs::exists(fs::symlink_status(folder, error))) {
    fs::create_directory(folder, error);
    if (error) {
      throw Error(folder.string(), "the folder cannot be created (" + error.message() + ")",
                  error == std::errc::no_such_file_or_directory
                      ? "create the folder that contains it, or choose another place"
                      : "choose another place");
    }
    return Found::kNothing;
  }
  if (!fs::is_directory(folder, error)) {
    throw Error(folder.string(), "it exists already and is not a folder", "name another place");
  }
  const std::string remedy = "remove the folder, or name another one";
  if (fs::exists(folder / kBrickManifestFile, error)) {
    if (BrickManifest::read(folder).identity() == identity) return Found::kFinished;
    throw Error(folder.string(),
                "it contains bricks of another input, of other options, or of another version of "
                "palpate or zstd",
                remedy);
  }
  if (fs::exists(folder / kBrickAttributesFile, error)) {
    const std::uint64_t there = BrickFacts::identityIn(contentsOf(folder / kBrickAttributesFile));
    if (there == identity) return Found::kUnfinished;
    if (there == 0) {
      throw Error(folder.string(),
                  std::string("it contains data of another program (its ") + kBrickAttributesFile +
                      " is not palpate's)",
                  "name another folder");
    }
    throw Error(folder.string(),
                "it contains unfinished bricks of another input, other options or another version "
                "of palpate or zstd",
                remedy);
  }
  // A terminated run may have left .partial and .zgroup.
  for (const auto& one : fs::directory_iterator(folder, error)) {
    const std::string name = one.path().filename().string();
    if (name != ".partial" && name != ".zgroup") {
      throw Error(folder.string(), "it exists already and contains \"" + name + "\"",
                  "name another folder");
    }
  }
  return Found::kNothing;
}

struct Space {
  Space(const BrickFormat& format, std::uint64_t identity)
      : values(kBrickVoxels * format.components()),
        active(kBrickActiveBytes),
        slot(format.bytes()),
        codec(format, identity) {}

  std::vector<float> values;
  std::vector<std::uint8_t> active;
  std::vector<std::byte> slot;
  BrickCodec codec;
  CoarserSpace coarser;
};

BrickStatistics statisticsOf(const Space& space, std::size_t components, const VoxelAt& voxel) {
  BrickStatistics s;
  for (int i = 0; i < kBrickSide; ++i) {
    for (int j = 0; j < kBrickSide; ++j) {
      // Adds up each row separately for speed.
      const std::size_t begin = BrickView::numberOf(i, j, 0);
      const VoxelAt lower{voxel[0] + i, voxel[1] + j, voxel[2] + kBrickSide};
      const VoxelAt upper{lower[0], lower[1], voxel[2]};
      constexpr double kEndless = std::numeric_limits<double>::infinity();
      BrickStatistics row{0, lower, upper, kEndless, -kEndless, 0.0};
      for (int k = 0; k < kBrickSide; ++k) {
        const std::size_t n = begin + static_cast<std::size_t>(k);
        if (((space.active[n / 8] >> (n % 8)) & 1) == 0) continue;
        const float* v = space.values.data() + n * components;
        const double size =
            components == 1 ? static_cast<double>(v[0]) : Vec3(v[0], v[1], v[2]).norm();
        ++row.active;
        row.lower[2] = std::min(row.lower[2], voxel[2] + k);
        row.upper[2] = voxel[2] + k;
        row.lowest = std::min(row.lowest, size);
        row.highest = std::max(row.highest, size);
        row.sum += size;
      }
      s.join(row);
    }
  }
  return s;
}

void spreadFirst(Space& space, std::size_t components) {
  for (std::size_t n = components; n < space.values.size(); ++n) {
    space.values[n] = space.values[n - components];
  }
  const bool on = (space.active[0] & 1) != 0;
  std::fill(space.active.begin(), space.active.end(), static_cast<std::uint8_t>(on ? 0xFF : 0));
}

bool isOneValue(const Space& space, std::size_t components) {
  const auto& bits = space.active;
  return (bits[0] == 0 || bits[0] == 0xFF) &&
         std::memcmp(bits.data(), bits.data() + 1, bits.size() - 1) == 0 &&
         std::memcmp(space.values.data(), space.values.data() + components,
                     (space.values.size() - components) * sizeof(float)) == 0;
}

class Writer {
 public:
  Writer(BrickFolder& folder, const BrickInput& input, const BrickOptions& options,
         BrickFacts& facts, ProcessGroup& group, bool resumes)
      : folder_(folder),
        input_(input),
        options_(options),
        facts_(facts),
        group_(group),
        resumes_(resumes),
        components_(input.format.components()),
        spaces_([&] { return Space(input.format, facts.manifest().identity()); }) {
    for (const BrickLevel& level : facts.manifest().levels()) {
      all_ += static_cast<double>(level.bricks());
    }
    bricks_ = static_cast<double>(level(0).bricks());
  }

  BrickReport write() {
    const auto levels = static_cast<std::int32_t>(facts_.manifest().levels().size());
    if (group_.rank() == 0) makeFolders(levels);
    (void)group_.gather({});
    for (std::int32_t l = 0; l < levels; ++l) {
      l == 0 ? writeFinest() : writeCoarser(l);
      finish(l);
    }
    // The bricks of every rank must be on the disk before the manifest that lists them is written.
    folder_.sync();
    const std::vector<std::byte> manifest = facts_.file();
    BrickReport report{BrickFacts::parse(manifest, (folder_.path() / kBrickManifestFile).string())};
    for (const auto& [written, kept] :
         gatherOne(group_, std::array{written_.load(), kept_.load()})) {
      report.written += written;
      report.kept += kept;
    }
    if (group_.rank() != 0) return report;
    folder_.write(kBrickAttributesFile, facts_.attributes());
    folder_.sync();
    folder_.write(kBrickManifestFile, manifest);
    folder_.removePartial();
    folder_.sync();
    return report;
  }

 private:
  /// An entry for the manifest, and the statistics of its brick.
  struct Row {
    BrickEntry entry;
    BrickStatistics statistics;
  };

  void makeFolders(std::int32_t levels) {
    folder_.removePartial();
    folder_.makeFolder(".partial");
    folder_.write(".zgroup", std::string("{\n  \"zarr_format\": 2\n}\n"));
    folder_.write(kBrickAttributesFile, facts_.attributes());
    for (std::int32_t l = 0; l < levels; ++l) {
      folder_.makeFolder(std::to_string(l));
      folder_.write(std::to_string(l) + "/.zarray", facts_.array(l, options_.compression));
    }
  }

  [[nodiscard]] const BrickLevel& level(std::int32_t l) const {
    return facts_.manifest().levels()[static_cast<std::size_t>(l)];
  }

  /// Writes level 0. Each rank writes the bricks of one range along the last axis, which varies
  /// slowest in image files.
  void writeFinest() {
    const auto& first = level(0).first;
    const auto& count = level(0).count;
    const Share all{first[2], first[2] + count[2]};
    Share own = input_.share.value_or(all);
    if (!input_.share) {
      own = shareOf(group_, count[2]);
      own = {own.first + first[2], own.end + first[2]};
    }
    const auto along = [&](std::size_t a) { return static_cast<std::size_t>(count[a]); };
    const auto layers = [&](const Share& of) {
      return static_cast<std::size_t>(std::clamp(of.end, all.first, all.end) -
                                      std::clamp(of.first, all.first, all.end));
    };
    const auto write_part = [&](const Share& part) {
      const std::int64_t low = std::clamp(part.first, all.first, all.end) - first[2];
      const std::size_t deep = layers(part);
      forEach(along(0) * along(1) * deep, along(0) * along(1) * layers(own), [&](std::size_t n) {
        const VoxelAt at{static_cast<std::int32_t>(n / (along(1) * deep)),
                         static_cast<std::int32_t>(n / deep % along(1)),
                         static_cast<std::int32_t>(n % deep) + static_cast<std::int32_t>(low)};
        make({0, at}, [&](Space& space) { return fill(at, space); });
      });
    };
    for (std::size_t p = 0; p < input_.parts.size(); ++p) {
      // A part may be outside of the extent, where all bricks are background.
      if (layers(input_.parts[p]) == 0) continue;
      input_.open(p);
      write_part(input_.parts[p]);
    }
    if (input_.parts.empty()) write_part(own);
  }

  void writeCoarser(std::int32_t l) {
    PosixBricks source(folder_.path(), facts_.manifest());
    HalvedBricks finer(source, l - 1);
    const bool level_set = input_.grid_class == GridClass::kLevelSet && !input_.format.vector;
    const std::vector<VoxelAt> places = coarserPlaces(facts_.manifest(), l - 1);
    const Share own = shareOf(group_, static_cast<std::int64_t>(places.size()));
    const auto count = static_cast<std::size_t>(own.end - own.first);
    forEach(count, count, [&](std::size_t n) {
      const VoxelAt& at = places[static_cast<std::size_t>(own.first) + n];
      make({l, at}, [&](Space& space) {
        return coarserBrick(finer, at, level_set, space.coarser, space.values, space.active);
      });
    });
  }

  /// Calls body(0) to body(count - 1) in parallel.
  /// @param all  Number of calls in the level, for the progress.
  template <class Body>
  void forEach(std::size_t count, std::size_t all, Body body) {
    inParallel(count, [&](std::size_t n) {
      body(n);
      told(static_cast<double>(++done_) / static_cast<double>(all));
    });
  }

  /// Keeps the brick of an earlier run, or makes and stores it. `fill` returns true if all voxels
  /// have one value and state, and it set only the first voxel.
  template <class Fill>
  void make(const BrickId& id, Fill fill) {
    Space& space = spaces_.local();
    if (!resumes_ || !keep(id, space)) {
      bool one = fill(space);
      if (!one) {
        one = isOneValue(space, components_);
      } else if (!isBackground(space)) {
        spreadFirst(space, components_);
      }
      if (!one) {
        store(id, space);
      } else if (!isBackground(space)) {
        BrickEntry entry;
        entry.kind = (space.active[0] & 1) != 0 ? BrickKind::kActive : BrickKind::kInactive;
        std::copy_n(space.values.begin(), components_, entry.value.begin());
        add(id, entry, space);
      }
    }
  }

  [[nodiscard]] bool isBackground(const Space& space) const {
    return (space.active[0] & 1) == 0 &&
           std::memcmp(space.values.data(), facts_.manifest().background().data(),
                       components_ * sizeof(float)) == 0;
  }

  bool fill(const VoxelAt& at, Space& space) {
    std::fill(space.active.begin(), space.active.end(), std::uint8_t{0});
    VoxelAt lower = level(0).voxelOf(at);
    for (std::int32_t& v : lower) v -= kBrickApron;
    const bool one = input_.fill({lower, space.values, space.active}) == BoxFilled::kOneValue;
    const std::size_t count = one ? components_ : space.values.size();
    for (std::size_t n = 0; n < count; ++n) {
      float& v = space.values[n];
      if (input_.format.half) v = floatOfHalf(halfOfFloat(v));
      if (!std::isfinite(v)) refuse(lower, n / components_);
    }
    return clip(lower, one, space);
  }

  [[noreturn]] void refuse(const VoxelAt& lower, std::size_t n) const {
    const auto edge = static_cast<std::size_t>(kBrickEdge);
    const std::array<std::size_t, 3> step{n / (edge * edge), n / edge % edge, n % edge};
    std::string voxel;
    for (std::size_t a = 0; a < 3; ++a) {
      voxel += (a == 0 ? "" : ", ") + std::to_string(lower[a] + static_cast<std::int32_t>(step[a]));
    }
    throw VolumeError(
        "\"" + input_.name + "\"",
        "its value at voxel (" + voxel + ") is not a finite number" +
            (input_.format.half ? ", or is too large for 16 bits" : ""),
        input_.format.half ? "replace it, or store 32 bits (omit --half)" : "replace it");
  }

  /// Makes all voxels outside of the extent inactive background, even if the input has set them.
  /// Returns true if all voxels still have one value, of which only the first voxel is set.
  bool clip(const VoxelAt& lower, bool one, Space& space) {
    std::array<int, 3> begin{};
    std::array<int, 3> end{};
    bool within = true;
    for (std::size_t a = 0; a < 3; ++a) {
      begin[a] = std::max(0, input_.lower[a] - lower[a]);
      end[a] = std::min<int>(kBrickEdge, input_.upper[a] - lower[a] + 1);
      within = within && begin[a] == 0 && end[a] == kBrickEdge;
    }
    if (within || (one && isBackground(space))) return one;
    if (one) spreadFirst(space, components_);
    const auto is_in = [&](std::size_t a, int i) { return i >= begin[a] && i < end[a]; };
    std::size_t n = 0;
    for (int i = 0; i < kBrickEdge; ++i) {
      for (int j = 0; j < kBrickEdge; ++j) {
        for (int k = 0; k < kBrickEdge; ++k, ++n) {
          if (is_in(0, i) && is_in(1, j) && is_in(2, k)) continue;
          std::copy_n(facts_.manifest().background().begin(), components_,
                      space.values.begin() + static_cast<std::ptrdiff_t>(n * components_));
          space.active[n / 8] &= static_cast<std::uint8_t>(~(1U << (n % 8)));
        }
      }
    }
    return false;
  }

  /// Keeps an earlier run's object if its voxels, compressed again, give the same bytes.
  /// Decompression alone is not sufficient, because zstd may decompress a damaged object.
  bool keep(const BrickId& id, Space& space) {
    std::size_t got = 0;
    const std::string name = brickObject(id, input_.format);
    if (folder_.read(name, space.codec.object(), got) != 0 ||
        space.codec.decode(id, got, nullptr, space.slot).status != BrickStatus::kArrived) {
      return false;
    }
    const std::uint32_t checksum = brickChecksum(space.codec.object().first(got));
    unpackBrick(input_.format, space.slot, space.values, space.active);
    const auto object = space.codec.encode(id, space.values, space.active, options_.compression);
    if (object.size() != got || brickChecksum(object) != checksum) return false;
    add(id, stored(object), space);
    ++kept_;
    return true;
  }

  static BrickEntry stored(std::span<const std::byte> object) {
    BrickEntry entry;
    entry.kind = BrickKind::kStored;
    entry.bytes = static_cast<std::uint32_t>(object.size());
    entry.checksum = brickChecksum(object);
    return entry;
  }

  void store(const BrickId& id, Space& space) {
    const auto object = space.codec.encode(id, space.values, space.active, options_.compression);
    folder_.write(brickObject(id, input_.format), object);
    add(id, stored(object), space);
    ++written_;
  }

  void add(const BrickId& id, BrickEntry entry, const Space& space) {
    Row row{entry, {}};
    row.entry.at = id.at;
    if (id.level == 0) row.statistics = statisticsOf(space, components_, level(0).voxelOf(id.at));
    const std::lock_guard lock(mutex_);
    rows_.push_back(row);
  }

  /// Completes a level. Sorts the rows, so that the sums do not depend on the order of threads.
  void finish(std::int32_t l) {
    rows_ = gatherAll(group_, rows_);
    std::sort(rows_.begin(), rows_.end(),
              [](const Row& a, const Row& b) { return a.entry.at < b.entry.at; });
    BrickStatistics sum;
    std::vector<BrickEntry> entries;
    entries.reserve(rows_.size());
    for (const Row& row : rows_) {
      entries.push_back(row.entry);
      sum.join(row.statistics);
    }
    rows_.clear();
    facts_.setEntries(l, std::move(entries));
    if (l == 0) facts_.setStatistics(sum);
    before_ += bricks_;
    done_ = 0;
    bricks_ = l + 1 < static_cast<std::int32_t>(facts_.manifest().levels().size())
                  ? static_cast<double>(level(l + 1).bricks())
                  : 0.0;
    told(0.0);
  }

  /// Reports the finished share `part` of the level, unless another thread is reporting.
  void told(double part) {
    if (!options_.progress) return;
    const std::unique_lock lock(telling_, std::try_to_lock);
    if (lock) options_.progress((before_ + part * bricks_) / all_);
  }

  BrickFolder& folder_;
  const BrickInput& input_;
  const BrickOptions& options_;
  BrickFacts& facts_;
  ProcessGroup& group_;
  bool resumes_;
  std::size_t components_;
  tbb::enumerable_thread_specific<Space> spaces_;
  std::mutex mutex_;
  std::vector<Row> rows_;
  std::mutex telling_;
  double all_ = 0.0;
  double before_ = 0.0;  ///< Number of bricks of the levels that are complete.
  double bricks_ = 0.0;  ///< Number of bricks of the level that is being written.
  std::atomic<std::uint64_t> done_{0};
  std::atomic<std::uint64_t> written_{0};
  std::atomic<std::uint64_t> kept_{0};
};

}  // namespace

BrickReport writeBricks(const fs::path& folder, const BrickInput& input,
                        const BrickOptions& options) {
  SingleProcess alone;
  ProcessGroup& group = options.group == nullptr ? alone : *options.group;
  BrickFacts facts(input, options);
  const std::uint64_t identity = facts.manifest().identity();
  // Rank 0 checks the folder, and holds the lock as long as any rank writes.
  std::optional<BrickFolder> held;
  Found found = Found::kNothing;
  if (group.rank() == 0) {
    found = lookInto(folder, identity);
    held.emplace(folder);
    if (found != Found::kFinished) held->lock();
  }
  struct Begin {
    std::uint64_t identity;
    Found found;
  };
  const Begin first = gatherOne(group, Begin{identity, found}).front();
  found = first.found;
  if (first.identity != identity) {
    throw Error(folder.string(), "this rank's input or options differ from those of rank 0",
                "give all ranks the same file, the same options and the same version of palpate");
  }
  if (found == Found::kFinished) {
    if (held) held->removePartial();
    return {BrickManifest::read(folder), 0, 0};
  }
  if (!held) held.emplace(folder, group.rank());
  return Writer(*held, input, options, facts, group, found == Found::kUnfinished).write();
}

}  // namespace palpate
