#include "samplers/volume.h"

#include <algorithm>
#include <array>
#include <cinttypes>
#include <cstdio>
#include <exception>
#include <fstream>
#include <mutex>
#include <numeric>
#include <optional>
#include <sys/mman.h>
#include <unordered_map>
#include <unordered_set>
#include <utility>

#include <openvdb/io/DelayedLoadMetadata.h>
#include <openvdb/io/File.h>

#include "engine/error.h"
#include "samplers/parallel.h"
#include "samplers/prepare.h"
#include "samplers/steady_file.h"
#include "samplers/vdb_check.h"
#include "samplers/volume_grid.h"

namespace palpate {
namespace {

void initialise() {
  static std::once_flag once;
  std::call_once(once, [] {
    openvdb::initialize();
    // A table of the leaves' sizes that OpenVDB would believe. It is not needed: they stand before
    // the leaves as well, where VdbCheck looks.
    openvdb::io::DelayedLoadMetadata::unregisterType();
  });
}

/// The three grids of a vector kept by component, as vel.x, vel.y, vel.z.
std::array<std::string, 3> componentsOf(const std::string& name) {
  return {name + ".x", name + ".y", name + ".z"};
}

/// Gives back what has been read of a file in memory maps, OpenVDB's: else a load would hold the
/// file beside the grid. The system has the pages in its cache still. Maps that somebody could have
/// written to are left alone. By MADV_PAGEOUT, not MADV_DONTNEED: another thread may end its map of
/// the same file after we have read the list and before we act on it, and what is then at that
/// address must not be lost. Where the system has no such advice nothing happens.
/// @param path  Absolute; empty does nothing.
void dropMapped(const std::string& path) {
  if (path.empty()) return;
  std::ifstream maps("/proc/self/maps");
  for (std::string line; std::getline(maps, line);) {
    // begin-end permissions offset device inode path
    const std::size_t slash = line.find('/');
    if (slash == std::string::npos || line.compare(slash, std::string::npos, path) != 0) continue;
    std::uintptr_t begin = 0;
    std::uintptr_t end = 0;
    std::array<char, 5> permissions{};
    if (std::sscanf(line.c_str(), "%" SCNxPTR "-%" SCNxPTR " %4s", &begin, &end,
                    permissions.data()) != 3 ||
        permissions[1] == 'w') {
      continue;
    }
#ifdef MADV_PAGEOUT
    madvise(reinterpret_cast<void*>(begin), end - begin, MADV_PAGEOUT);  // NOLINT: an address
#endif
  }
}

/// Reads grids through a stream, from front to back and by where they stand, for OpenVDB's own
/// reader looks for each among all of its name. A file that ends too early is an exception, where a
/// map of it would end the program. For files with a table of contents.
class GridReader : private openvdb::io::Archive {
 public:
  explicit GridReader(const std::filesystem::path& file) {
    stream_.exceptions(std::ios::failbit | std::ios::badbit | std::ios::eofbit);
    stream_.open(file, std::ios::binary);
    readHeader(stream_);
    setFormatVersion(stream_);
    setLibraryVersion(stream_);
    setDataCompression(stream_);
    openvdb::MetaMap().readMeta(stream_);
    const std::int32_t count = inputHasGridOffsets() ? readGridCount(stream_) : 0;
    for (std::int32_t i = 0; i < count; ++i) {
      openvdb::io::GridDescriptor d;
      (void)d.read(stream_);
      const auto& [name, kept] = *grids_.emplace(d.uniqueName(), d).first;
      by_name_.emplace(openvdb::io::GridDescriptor::nameAsString(name), &kept);
      d.seekToEnd(stream_);
    }
  }

  [[nodiscard]] bool has(const std::string& name) const { return by_name_.count(name) != 0; }
  /// OpenVDB's name of the tree.
  [[nodiscard]] const std::string& type(const std::string& name) const {
    return by_name_.at(name)->gridType();
  }

  openvdb::GridBase::Ptr read(const std::string& name) {
    const openvdb::io::GridDescriptor& d = *by_name_.at(name);
    openvdb::GridBase::Ptr grid = readOwn(d);
    // Whose tree it is has none of another's: VdbCheck has seen to it, by the same names.
    if (d.isInstance()) {
      grid->setTree(readOwn(grids_.at(d.instanceParentName()))->baseTreePtr());
    }
    return grid;
  }

  /// All but the tree.
  openvdb::GridBase::Ptr readMetadata(const std::string& name) {
    openvdb::GridBase::Ptr grid = begin(*by_name_.at(name));
    readGridCompression(stream_);
    grid->readMeta(stream_);
    grid->readTransform(stream_);
    return grid;
  }

 private:
  openvdb::GridBase::Ptr readOwn(const openvdb::io::GridDescriptor& d) {
    openvdb::GridBase::Ptr grid = begin(d);
    readGrid(grid, d, stream_);
    return grid;
  }

  openvdb::GridBase::Ptr begin(const openvdb::io::GridDescriptor& d) {
    d.seekToGrid(stream_);
    openvdb::GridBase::Ptr grid = openvdb::GridBase::createGrid(d.gridType());
    grid->setSaveFloatAsHalf(d.saveFloatAsHalf());
    return grid;
  }

  std::ifstream stream_;
  std::unordered_map<std::string, openvdb::io::GridDescriptor> grids_;  ///< By unique names.
  std::unordered_map<std::string, const openvdb::io::GridDescriptor*> by_name_;  ///< As users call
                                                                                 ///< them.
};

/// An OpenVDB file, checked; its errors turned into ours.
class VdbFile {
 public:
  explicit VdbFile(const std::filesystem::path& path) : path_(path) {
    initialise();
    std::error_code error;
    const auto status = std::filesystem::status(path, error);
    if (!std::filesystem::exists(status)) {
      throw VolumeError(path.string(), "no such file", "check the path");
    }
    if (!std::filesystem::is_regular_file(status)) {
      throw VolumeError(path.string(), "it is not a file", "give a .vdb file");
    }
    steady_.emplace(path);
    if (!isVdb(steady_->place())) {
      throw VolumeError(path.string(), "it is not a .vdb file",
                        "convert it, e.g. with palpate import");
    }
    // As the list of maps has it; "(deleted)" stands behind a copy, which has no name, there too.
    canonical_ = std::filesystem::read_symlink(steady_->place(), error).string();
    guarded([&] {
      check_.emplace(steady_->place(), path_.string());
      reader_.emplace(steady_->place());
      if (!steady_->trouble().empty() && !check_->hasTable()) {
        throw VolumeError(path.string(), steady_->trouble(),
                          "make room there, or name another folder in TMPDIR");
      }
      file_.emplace(steady_->place().string());
      // OpenVDB need not copy it: it stays as it is, and the leaves are read before this ends.
      file_->setCopyMaxBytes(0);
      file_->open(/*delayLoad=*/steady_->trouble().empty());
    });
    for (auto name = file_->beginName(); name != file_->endName(); ++name) names_.push_back(*name);
    known_.insert(names_.begin(), names_.end());
  }

  [[nodiscard]] const std::vector<std::string>& names() const noexcept { return names_; }

  /// The grid, the leaves of a large one still on disk, to be read in parallel; of a type that
  /// cannot be felt, all but its tree.
  openvdb::GridBase::Ptr read(const std::string& name) {
    openvdb::GridBase::Ptr grid;
    guarded([&] {
      if (!isFeltType(typeOf(name))) {
        grid = reader_->has(name) ? reader_->readMetadata(name) : file_->readGridMetadata(name);
        return;
      }
      const std::uint64_t bytes = check_->tree(name);
      if (reader_->has(name) && (bytes < kSmallGrid || !steady_->trouble().empty())) {
        grid = reader_->read(name);
        return;
      }
      mapped_ += bytes;
      grid = file_->readGrid(name);
    });
    if (!grid) throw VolumeError(path_.string(), "it is damaged", "copy or write it again");
    return grid;
  }

  /// The vectors that the file keeps by component: NAME.x, NAME.y and NAME.z, scalars of one type.
  [[nodiscard]] std::vector<std::string> joinedNames() {
    const auto has = [&](const std::string& name) { return known_.count(name) != 0; };
    std::vector<std::string> joined;
    guarded([&] {
      for (const std::string& name : names_) {
        if (name.size() < 3 || !name.ends_with(".x")) continue;
        const std::string stem = name.substr(0, name.size() - 2);
        const auto parts = componentsOf(stem);
        if (!has(parts[1]) || !has(parts[2]) || has(stem)) continue;
        const auto type = [&](std::size_t c) { return typeOf(parts[c]); };
        const bool scalar =
            type(0) == openvdb::FloatGrid::gridType() || type(0) == openvdb::DoubleGrid::gridType();
        if (scalar && type(1) == type(0) && type(2) == type(0)) joined.push_back(stem);
      }
    });
    return joined;
  }

  /// A grid, or a vector of three, ready to be felt or with its refusal.
  Prepared prepared(const std::string& name, const LoadOptions& options) {
    Prepared out;
    double begun = 0.0;  // of the parts, all of them 1
    double share = 1.0;
    LoadOptions watched = options;
    watched.progress = [&](double done) {
      // Every small grid would have the system look through all of the file.
      if (mapped_ >= kMappedBytes) dropMapped(canonical_);
      if (done >= 1.0 && mapped_ >= kMappedBytes) mapped_ = 0;
      if (options.progress) options.progress(begun + share * done);
    };
    guarded([&] {
      if (known_.count(name) != 0) {
        out = prepare(name, read(name), watched);
      } else {
        std::array<Prepared, 3> parts;
        share = 1.0 / 3.0;
        for (std::size_t c = 0; c < 3; ++c) {
          begun = static_cast<double>(c) * share;
          const std::string part = componentsOf(name)[c];
          parts[c] = prepare(part, read(part), watched);
        }
        out = join(name, std::move(parts));
      }
    });
    return out;
  }

 private:
  /// OpenVDB's name of the tree.
  [[nodiscard]] std::string typeOf(const std::string& name) {
    return reader_->has(name) ? reader_->type(name) : file_->readGridMetadata(name)->type();
  }

  /// OpenVDB's message in one line.
  template <class Body>
  void guarded(Body body) const {
    try {
      body();
    } catch (const Error&) {
      throw;
    } catch (const std::ios_base::failure&) {  // GridReader's
      throw VolumeError(path_.string(), "it is truncated", "copy or write it again");
    } catch (const std::exception& e) {
      std::string why = e.what();
      std::replace(why.begin(), why.end(), '\n', ' ');
      throw VolumeError(path_.string(), "it cannot be read (" + why + ")",
                        "it may be damaged or of a newer format: write it again");
    }
  }

  /// Smaller grids are read through: they gain nothing by being read in parallel [bytes].
  static constexpr std::uint64_t kSmallGrid = std::uint64_t{1} << 20U;
  /// So much of the file may be in memory beside its grids [bytes].
  static constexpr std::uint64_t kMappedBytes = std::uint64_t{1} << 24U;

  std::filesystem::path path_;
  std::string canonical_;  ///< As the system's list of maps has it; empty if it cannot be known.
  std::optional<SteadyFile> steady_;
  std::optional<VdbCheck> check_;
  std::optional<openvdb::io::File> file_;
  std::optional<GridReader> reader_;  ///< Has no grid where there is no table of contents.
  std::vector<std::string> names_;    ///< As users call them.
  std::unordered_set<std::string> known_;
  std::uint64_t mapped_ = 0;  ///< Read since the system was last told to let go of it.
};

}  // namespace

Volume::Volume(GridInfo info, std::unique_ptr<const Grid> grid)
    : info_(std::move(info)), grid_(std::move(grid)) {}

Volume::~Volume() = default;

std::uint64_t Volume::memory() const {
  std::uint64_t sum = info_.memory;
  for (const Grid::Coefficients& made : grid_->coefficients) {
    const std::lock_guard lock(made.mutex);
    for (const GridData& part : made.parts) {
      sum += memoryOf(part);
    }
  }
  for (const Grid::FreeMaps& made : grid_->free_maps) {
    const std::lock_guard lock(made.mutex);
    for (const auto& map : made.parts) {
      if (map != nullptr) sum += map->memory();
    }
  }
  return sum;
}

bool isVdb(const std::filesystem::path& file) noexcept {
  std::ifstream stream(file, std::ios::binary);
  std::uint32_t magic = 0;
  stream.read(reinterpret_cast<char*>(&magic), sizeof magic);
  return stream && magic == openvdb::OPENVDB_MAGIC;
}

std::vector<std::string> gridNames(const std::filesystem::path& file) {
  VdbFile vdb(file);
  std::unordered_map<std::string, std::string> instead;  // of a component; empty: nothing
  for (const std::string& joined : vdb.joinedNames()) {
    const auto parts = componentsOf(joined);
    instead[parts[0]] = joined;
    instead[parts[1]] = instead[parts[2]] = "";
  }
  std::vector<std::string> names;
  for (const std::string& name : vdb.names()) {
    const auto other = instead.find(name);
    const std::string& listed = other == instead.end() ? name : other->second;
    if (other == instead.end() || !listed.empty()) names.push_back(listed);
  }
  return names;
}

std::vector<GridInfo> describeGrids(const std::filesystem::path& file) {
  VdbFile vdb(file);
  std::vector<std::string> names = vdb.names();
  if (names.empty()) throw VolumeError(file.string(), "it holds no grid", "write one into it");
  const std::vector<std::string> joined = vdb.joinedNames();
  names.insert(names.end(), joined.begin(), joined.end());
  std::vector<GridInfo> infos;
  infos.reserve(names.size());
  for (const std::string& name : names) infos.push_back(vdb.prepared(name, {}).info);
  return infos;
}

std::shared_ptr<const Volume> loadVolume(const std::filesystem::path& file, const std::string& grid,
                                         const LoadOptions& options) {
  VdbFile vdb(file);
  std::vector<std::string> names = vdb.names();
  if (names.empty()) throw VolumeError(file.string(), "it holds no grid", "write one into it");
  const std::vector<std::string> joined = vdb.joinedNames();

  std::string wanted = grid;
  if (wanted.empty() && names.size() == 1) wanted = names.front();
  if (wanted.empty() && names.size() == 3 && joined.size() == 1) wanted = joined.front();
  names.insert(names.begin(), joined.begin(), joined.end());
  std::string all;
  for (const std::string& name : names) all += (all.empty() ? "" : ", ") + name;
  if (wanted.empty() && names.size() > 1) {
    throw VolumeError(file.string(), "it holds more than one grid", "name one of " + all);
  }
  if (std::find(names.begin(), names.end(), wanted) == names.end()) {
    const std::string near = nearestName(wanted, names);
    throw VolumeError(file.string(), "there is no grid \"" + wanted + "\"",
                      near.empty() ? "there are: " + all : "did you mean \"" + near + "\"?");
  }

  auto [info, data] = vdb.prepared(wanted, options);
  if (!info.refusal.empty()) {
    const auto colon = info.refusal.find(": ");
    throw VolumeError(file.string() + ": grid \"" + wanted + "\"", info.refusal.substr(0, colon),
                      info.refusal.substr(colon + 2));
  }
  return std::make_shared<Volume>(std::move(info), std::move(data));
}

std::vector<LoadResult> loadVolumes(const std::vector<VolumeRequest>& requests,
                                    const std::function<void(double)>& progress) {
  std::vector<LoadResult> results(requests.size());
  std::vector<double> done(requests.size(), 0.0);
  std::mutex telling;
  // What is asked for twice is loaded once.
  const auto first_like = [&](std::size_t i) {
    return static_cast<std::size_t>(std::find(requests.begin(), requests.end(), requests[i]) -
                                    requests.begin());
  };
  inParallel(requests.size(), [&](std::size_t i) {
    const VolumeRequest& request = requests[i];
    const auto tell = [&](double part) {
      if (!progress) return;
      const std::lock_guard lock(telling);
      done[i] = part;
      progress(std::accumulate(done.begin(), done.end(), 0.0) /
               static_cast<double>(requests.size()));
    };
    try {
      if (first_like(i) == i) {
        results[i].volume =
            loadVolume(request.file, request.grid, {request.non_finite, request.smooth, tell});
      }
    } catch (...) {
      results[i].error = std::current_exception();
    }
    tell(1.0);
  });
  for (std::size_t i = 0; i < requests.size(); ++i) {
    if (first_like(i) != i) results[i] = results[first_like(i)];
  }
  return results;
}

const char* wordFor(GridClass grid_class) noexcept {
  switch (grid_class) {
    case GridClass::kUnknown:
      return "unknown";
    case GridClass::kLevelSet:
      return "level set";
    case GridClass::kFog:
      return "fog volume";
    case GridClass::kStaggered:
      return "staggered";
  }
  return "";
}

}  // namespace palpate
