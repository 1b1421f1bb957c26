#include "palpate/samplers/grid/volume.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cctype>
#include <exception>
#include <fcntl.h>
#include <map>
#include <mutex>
#include <optional>
#include <string_view>
#include <tuple>
#include <unistd.h>
#include <unordered_map>
#include <unordered_set>
#include <utility>

#include <openvdb/io/DelayedLoadMetadata.h>
#include <openvdb/io/File.h>
#include <tbb/task_arena.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/available_memory.h"
#include "palpate/samplers/grid/make_volume.h"
#include "palpate/samplers/grid/no_data_error.h"
#include "palpate/samplers/grid/prepare.h"
#include "palpate/samplers/grid/vdb_check.h"
#include "palpate/samplers/grid/vdb_reader.h"
#include "palpate/samplers/grid/volume_grid.h"
#include "palpate/samplers/leased_file.h"
#include "palpate/samplers/parallel.h"

namespace palpate {
namespace {

void initialise() {
  static std::once_flag once;
  std::call_once(once, [] {
    openvdb::initialize();
    // OpenVDB would trust the table of leaf sizes in this metadata. VdbCheck checks the sizes
    // before each leaf.
    openvdb::io::DelayedLoadMetadata::unregisterType();
  });
}

std::array<std::string, 3> componentsOf(const std::string& name) {
  return {name + ".x", name + ".y", name + ".z"};
}

std::shared_ptr<const Volume> feltFrom(Prepared prepared, const std::string& name) {
  const std::string& why = prepared.info.refusal;
  if (!why.empty()) {
    const auto colon = why.find(": ");
    const std::string reason = why.substr(0, colon);
    const std::string remedy = why.substr(colon + 2);
    if (why != kNoActiveVoxel) throw VolumeError(name, reason, remedy);
    if (prepared.info.filled == 0) throw NoDataError(name, reason, remedy);
    throw VolumeError(name,
                      "it has no active voxel after the filling of " +
                          std::to_string(prepared.info.filled) +
                          " values that were NaN, infinite or above 1e100 in size",
                      "write the grid with finite values in its active voxels");
  }
  return std::make_shared<Volume>(std::move(prepared.info), std::move(prepared.grid));
}

/// Returns the remedy for a file that is not a .vdb file: mostly the command that converts it.
/// Users can copy the command from a message.
std::string importOf(const std::filesystem::path& path) {
  if (path.extension() == ".vdb")
    return "write it again with OpenVDB: it may be damaged or of another format";
  if (path.extension() == ".json") return "give a .vdb file; palpate check describes a scene";
  std::filesystem::path stem = path.filename();
  if (stem.extension() == ".gz") stem.replace_extension();
  const std::string out = stem.replace_extension(".vdb").string();
  const auto is_plain = [](unsigned char c) {
    return std::isalnum(c) != 0 ||
           std::string_view("._-/+").find(static_cast<char>(c)) != std::string_view::npos;
  };
  const std::string in = path.string();
  if (!std::all_of(in.begin(), in.end(), is_plain)) {
    return "import it first: palpate import FILE OUT.vdb";
  }
  return "import it first: palpate import " + in + " " + out;
}

/// An open, checked .vdb file. Converts OpenVDB's errors to VolumeError. Const functions are
/// thread-safe, except leastMemory().
class VdbFile {
 public:
  explicit VdbFile(const std::filesystem::path& path) : path_(path) {
    initialise();
    std::error_code error;
    const auto status = std::filesystem::status(path, error);
    if (!std::filesystem::exists(status)) throwAbsent(path, "no such file", error);
    if (!std::filesystem::is_regular_file(status)) {
      throw VolumeError(path.string(), "it is not a file",
                        std::filesystem::is_directory(status)
                            ? "give a .vdb file; import DICOM, slices, Zarr and OpenFOAM first: "
                              "palpate import FOLDER OUT.vdb"
                            : "give a .vdb file");
    }
    steady_.emplace(path);
    if (!isVdb(steady_->place())) {
      throw VolumeError(path.string(), "it is not a .vdb file", importOf(path));
    }
    // Path of the file in /proc/self/maps. The path of a private copy ends with "(deleted)".
    canonical_ = std::filesystem::read_symlink(steady_->place(), error).string();
    guarded([&] {
      check_.emplace(steady_->place(), path_.string());
      reader_.emplace(steady_->place());
      file_.emplace(steady_->place().string());
      // Keeps OpenVDB from copying the file: steady_ already keeps it unchanged.
      file_->setCopyMaxBytes(0);
      file_->open();
      for (auto name = file_->beginName(); name != file_->endName(); ++name) {
        names_.push_back(*name);
      }
      known_.insert(names_.begin(), names_.end());
      findVectors();
    });
  }

  [[nodiscard]] const std::vector<std::string>& names() const noexcept { return names_; }
  /// Returns the vectors that the file stores as three scalars of one type: NAME.x, .y and .z.
  [[nodiscard]] const std::vector<std::string>& vectors() const noexcept { return vectors_; }
  /// Returns all names. A vector of three grids appears once, in place of its first component.
  [[nodiscard]] std::vector<std::string> listed() const {
    // Name to list in place of each component; empty: none.
    std::unordered_map<std::string, std::string> instead;
    for (const std::string& vector : vectors_) {
      const auto parts = componentsOf(vector);
      instead[parts[0]] = vector;
      instead[parts[1]] = instead[parts[2]] = "";
    }
    std::vector<std::string> names;
    for (const std::string& name : names_) {
      const auto other = instead.find(name);
      const std::string& one = other == instead.end() ? name : other->second;
      if (other == instead.end() || !one.empty()) names.push_back(one);
    }
    return names;
  }

  [[nodiscard]] std::shared_ptr<const Volume> load(const std::string& grid,
                                                   const LoadOptions& options) const {
    const std::string wanted = orOnly(grid);
    const bool there = known_.count(wanted) != 0 ||
                       std::find(vectors_.begin(), vectors_.end(), wanted) != vectors_.end();
    if (!there || (wanted.empty() && names_.size() > 1)) throwNoGrid(wanted);
    return feltFrom(prepared(wanted, options), path_.string() + ": grid \"" + wanted + "\"");
  }

  /// Returns the memory that a grid takes at least [bytes], by the file's metadata; 0 if the
  /// metadata do not state it, and for unknown names. Not thread-safe.
  [[nodiscard]] std::uint64_t leastMemory(const std::string& grid) const {
    std::uint64_t sum = 0;
    guarded([&] {
      const std::string wanted = orOnly(grid);
      const auto parts = componentsOf(wanted);
      for (const std::string& name : known_.count(wanted) != 0
                                         ? std::vector{wanted}
                                         : std::vector(parts.begin(), parts.end())) {
        if (known_.count(name) == 0 || !isNumberType(typeOf(name))) continue;
        const openvdb::GridBase::Ptr header =
            reader_->has(name) ? reader_->readMetadata(name) : file_->readGridMetadata(name);
        sum += leastMemoryOf(*header);
      }
    });
    return sum;
  }

  /// Prepares a grid, or a vector of three grids. The result may contain a refusal.
  [[nodiscard]] Prepared prepared(const std::string& name, const LoadOptions& options) const {
    Prepared out;
    double begun = 0.0;  // share of the work that is finished; 1 is the whole
    double share = 1.0;
    LoadOptions watched = options;
    watched.progress = [&](double done) {
      // After the last part, a lost lease does no harm. The call of kept() then only updates its
      // time stamp.
      if (!steady_->kept() && done < 1.0) throwTaken();
      // Drops the pages only after kMappedBytes, because the system scans the whole mapped file in
      // each call.
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
  /// Returns `grid`; if it is empty, the only grid of the file, or its only vector in three grids.
  [[nodiscard]] std::string orOnly(const std::string& grid) const {
    if (grid.empty() && names_.size() == 1) return names_.front();
    if (grid.empty() && names_.size() == 3 && vectors_.size() == 1) return vectors_.front();
    return grid;
  }

  [[noreturn]] void throwTaken() const {
    throw VolumeError(path_.string(),
                      "another program waited to change the file, so palpate ended the load",
                      "load the file when no program writes to it");
  }

  /// Reads a grid; without its tree if the type is unsupported. The leaves of a large grid stay on
  /// disk, and are later read in parallel. Only one thread reads at a time.
  [[nodiscard]] openvdb::GridBase::Ptr read(const std::string& name) const {
    openvdb::GridBase::Ptr grid;
    // Without isolation, a thread that waits for OpenVDB's loops might begin to read another grid.
    tbb::this_task_arena::isolate([&] {
      const std::lock_guard lock(reading_);
      const std::string type = typeOf(name);
      if (!isReadType(type)) {
        grid = reader_->has(name) ? reader_->readMetadata(name) : file_->readGridMetadata(name);
        return;
      }
      const std::uint64_t bytes = check_->tree(name);
      if (reader_->has(name) &&
          (bytes < kSmallGrid || !reader_->plain(name) || !isNumberType(type))) {
        grid = reader_->read(name);
        return;
      }
      mapped_ += bytes;
      if (!steady_->kept()) throwTaken();
      grid = file_->readGrid(name);
    });
    if (!grid) throw VolumeError(path_.string(), "grid " + name + " has no data", "write it again");
    return grid;
  }

  [[nodiscard]] std::string typeOf(const std::string& name) const {
    return reader_->has(name) ? reader_->type(name) : file_->readGridMetadata(name)->type();
  }

  /// Returns true if fields can read grids of this type.
  [[nodiscard]] static bool isNumberType(const std::string& type) {
    return type == openvdb::FloatGrid::gridType() || type == openvdb::DoubleGrid::gridType() ||
           type == openvdb::Vec3SGrid::gridType() || type == openvdb::Vec3DGrid::gridType();
  }

  void findVectors() {
    const auto has = [&](const std::string& name) { return known_.count(name) != 0; };
    for (const std::string& name : names_) {
      if (name.size() < 3 || !name.ends_with(".x")) continue;
      const std::string stem = name.substr(0, name.size() - 2);
      const auto parts = componentsOf(stem);
      if (!has(parts[1]) || !has(parts[2]) || has(stem)) continue;
      const auto type = [&](std::size_t c) { return typeOf(parts[c]); };
      const bool scalar =
          type(0) == openvdb::FloatGrid::gridType() || type(0) == openvdb::DoubleGrid::gridType();
      if (scalar && type(1) == type(0) && type(2) == type(0)) vectors_.push_back(stem);
    }
  }

  [[noreturn]] void throwNoGrid(const std::string& wanted) const {
    if (names_.empty()) {
      throw NoDataError(path_.string(), "it does not have a grid", "write a grid into it");
    }
    std::vector<std::string> names = vectors_;
    names.insert(names.end(), names_.begin(), names_.end());
    std::string all;
    for (const std::string& name : names) all += (all.empty() ? "" : ", ") + name;
    if (wanted.empty() && names_.size() > 1) {
      throw VolumeError(path_.string(), "it has more than one grid", "name one of " + all);
    }
    const std::string near = nearestName(wanted, names);
    throw NoDataError(path_.string(), "there is no grid \"" + wanted + "\"",
                      near.empty() ? "name one of " + all : "did you mean \"" + near + "\"?");
  }

  /// Calls `body`, and converts its exceptions, except Error and std::bad_alloc, to VolumeError
  /// with a message of one line.
  template <class Body>
  void guarded(Body body) const {
    try {
      body();
    } catch (const Error&) {
      throw;
    } catch (const std::bad_alloc&) {
      throw;                                   // the file is not the cause of this error
    } catch (const std::ios_base::failure&) {  // thrown by VdbReader
      throw VolumeError(path_.string(), "it is truncated, or reading it failed",
                        "copy or write it again, or check the disk");
    } catch (const std::exception& e) {
      std::string why = e.what();
      std::replace(why.begin(), why.end(), '\n', ' ');
      throw VolumeError(path_.string(), "it cannot be read (" + why + ")",
                        "write it again: it may be damaged or of a newer format");
    }
  }

  /// Size below which a grid is read through the stream [bytes]: parallel reading would not save
  /// time.
  static constexpr std::uint64_t kSmallGrid = std::uint64_t{1} << 20U;
  /// Size of the mapped grids from which a load drops their pages while it reads them [bytes].
  static constexpr std::uint64_t kMappedBytes = std::uint64_t{1} << 24U;

  std::filesystem::path path_;
  std::string canonical_;  ///< Path in the system's list of maps; empty if unknown.
  std::optional<LeasedFile> steady_;
  mutable std::mutex reading_;  ///< Guards the next three members.
  mutable std::optional<VdbCheck> check_;
  mutable std::optional<openvdb::io::File> file_;
  /// Reads grids by position. It contains no grids if the file has no table of contents.
  mutable std::optional<VdbReader> reader_;
  std::vector<std::string> names_;
  std::vector<std::string> vectors_;
  std::unordered_set<std::string> known_;
  mutable std::atomic<std::uint64_t> mapped_{0};
};

/// Combines the progress of several loads, and reports it from one thread at a time.
class Together {
 public:
  Together(std::size_t count, const std::function<void(double)>& told)
      : done_(count, 0.0), told_(told) {}
  void tell(std::size_t i, double done) {
    if (!told_) return;
    const std::lock_guard lock(mutex_);
    if (done >= 1.0 && done_[i] < 1.0) ++whole_;
    sum_ += done - done_[i];
    done_[i] = done;
    told_(whole_ == done_.size() ? 1.0 : sum_ / static_cast<double>(done_.size()));
  }

 private:
  std::mutex mutex_;
  std::vector<double> done_;
  double sum_ = 0.0;
  std::size_t whole_ = 0;
  const std::function<void(double)>& told_;
};

LoadResult tryLoad(const VdbFile& file, const std::string& grid, const LoadOptions& options) {
  LoadResult result;
  try {
    result.volume = file.load(grid, options);
  } catch (...) {
    result.error = std::current_exception();
  }
  return result;
}

/// Throws VolumeError if grids need more memory than is available, as far as metadata state it.
/// @param files  Files with the names of grids; without a name: all grids.
void checkFits(
    const std::vector<std::pair<std::filesystem::path, std::vector<std::string>>>& files) {
  // Assumes that each grid in memory takes at most this many times the size of its file. If all
  // grids fit by this assumption, this function does not open the files.
  constexpr double kMostCompressed = 20.0;
  double stored = 0.0;
  for (const auto& [path, grids] : files) {
    std::error_code error;
    const auto size = std::filesystem::file_size(path, error);
    const auto loads = static_cast<double>(std::max<std::size_t>(grids.size(), 1));
    if (!error) stored += loads * static_cast<double>(size);
  }
  if (kMostCompressed * stored <= availableMemory()) return;
  std::vector<MemoryNeed> needs;
  for (const auto& [path, grids] : files) {
    try {
      const VdbFile file(path);
      for (const std::string& grid : grids.empty() ? file.listed() : grids) {
        const std::string name = grid.empty() ? "" : ": grid \"" + grid + "\"";
        needs.push_back({path.string() + name, file.leastMemory(grid)});
      }
    } catch (const VolumeError&) {
      continue;  // the load reports this error
    }
  }
  checkMemory(needs);
}

/// Runs inParallel isolated from other tasks, so that each thread has at most one open file.
template <class Body>
void inParallelAlone(std::size_t count, Body body) {
  tbb::this_task_arena::isolate([&] { inParallel(count, body); });
}

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
  // Uses a descriptor, because a stream would allocate memory.
  const int descriptor = ::open(file.c_str(), O_RDONLY | O_CLOEXEC);
  if (descriptor < 0) return false;
  std::uint32_t magic = 0;
  const ssize_t got = ::read(descriptor, &magic, sizeof magic);
  ::close(descriptor);
  return got == sizeof magic && magic == openvdb::OPENVDB_MAGIC;
}

std::vector<std::string> gridNames(const std::filesystem::path& file) {
  return VdbFile(file).listed();
}

std::vector<GridInfo> describeGrids(const std::filesystem::path& file) {
  const VdbFile vdb(file);
  std::vector<std::string> names = vdb.names();
  if (names.empty())
    throw VolumeError(file.string(), "it does not have a grid", "write a grid into it");
  names.insert(names.end(), vdb.vectors().begin(), vdb.vectors().end());
  std::vector<GridInfo> infos;
  infos.reserve(names.size());
  for (const std::string& name : names) infos.push_back(vdb.prepared(name, {}).info);
  return infos;
}

std::shared_ptr<const Volume> loadVolume(const std::filesystem::path& file, const std::string& grid,
                                         const LoadOptions& options) {
  return VdbFile(file).load(grid, options);
}

std::shared_ptr<const Volume> preparedVolume(const std::string& name,
                                             const openvdb::GridBase::Ptr& grid,
                                             const std::string& called,
                                             const LoadOptions& options) {
  initialise();
  return feltFrom(prepare(name, grid, options), called);
}

std::shared_ptr<const Volume> makeVolume(const openvdb::GridBase& grid,
                                         const LoadOptions& options) {
  initialise();
  const std::string name = "grid \"" + grid.getName() + "\"";
  try {
    return preparedVolume(grid.getName(), grid.deepCopyGrid(), name, options);
  } catch (const openvdb::Exception& e) {
    throw VolumeError(name, std::string("it cannot be read (") + e.what() + ")",
                      "correct the code that makes the grid");
  }
}

std::vector<LoadResult> loadVolumes(const std::vector<VolumeRequest>& requests,
                                    const std::function<void(double)>& progress) {
  // The load opens each file once, and loads equal requests once.
  using What = std::tuple<std::string, NonFinite, double, bool>;
  struct File {
    std::map<What, std::size_t> known;
    std::vector<std::size_t> wanted;
  };
  std::map<std::filesystem::path, File> by_path;
  std::vector<std::size_t> first(requests.size());
  for (std::size_t i = 0; i < requests.size(); ++i) {
    const VolumeRequest& request = requests[i];
    File& file = by_path[request.file];
    const What what{request.grid, request.non_finite, request.smooth.sigma,
                    request.smooth.in_file_units};
    first[i] = file.known.emplace(what, i).first->second;
    if (first[i] == i) file.wanted.push_back(i);
  }
  std::vector<std::pair<const std::filesystem::path*, const std::vector<std::size_t>*>> files;
  files.reserve(by_path.size());
  std::vector<std::pair<std::filesystem::path, std::vector<std::string>>> grids;
  for (const auto& [path, file] : by_path) {
    files.emplace_back(&path, &file.wanted);
    std::vector<std::string>& names = grids.emplace_back(path, std::vector<std::string>()).second;
    for (const std::size_t i : file.wanted) names.push_back(requests[i].grid);
  }
  checkFits(grids);

  std::vector<LoadResult> results(requests.size());
  Together together(requests.size(), progress);
  inParallel(files.size(), [&](std::size_t f) {
    const std::vector<std::size_t>& wanted = *files[f].second;
    std::optional<VdbFile> file;
    std::exception_ptr error;
    try {
      file.emplace(*files[f].first);
    } catch (...) {
      error = std::current_exception();
    }
    inParallelAlone(wanted.size(), [&](std::size_t j) {
      const std::size_t i = wanted[j];
      const auto tell = [&](double done) { together.tell(i, done); };
      results[i] = error ? LoadResult{nullptr, error}
                         : tryLoad(*file, requests[i].grid,
                                   {requests[i].non_finite, requests[i].smooth, tell});
      tell(1.0);
    });
  });
  for (std::size_t i = 0; i < requests.size(); ++i) {
    if (first[i] == i) continue;
    results[i] = results[first[i]];
    together.tell(i, 1.0);
  }
  return results;
}

std::vector<FileResult> loadFiles(const std::vector<std::filesystem::path>& files,
                                  const std::function<void(double)>& progress) {
  std::vector<FileResult> results(files.size());
  std::vector<std::pair<std::filesystem::path, std::vector<std::string>>> grids;
  grids.reserve(files.size());
  for (const std::filesystem::path& file : files) grids.push_back({file, {}});
  checkFits(grids);
  Together together(files.size(), progress);
  inParallel(files.size(), [&](std::size_t f) {
    FileResult& result = results[f];
    try {
      const VdbFile file(files[f]);
      result.names = file.listed();
      result.volumes.resize(result.names.size());
      const std::function<void(double)> tell = [&](double done) { together.tell(f, done); };
      Together within(result.names.size(), tell);
      inParallelAlone(result.names.size(), [&](std::size_t i) {
        LoadOptions options;
        options.progress = [&](double done) { within.tell(i, done); };
        result.volumes[i] = tryLoad(file, result.names[i], options);
        options.progress(1.0);
      });
    } catch (const VolumeError&) {
      result.error = std::current_exception();
    }
    together.tell(f, 1.0);
  });
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
