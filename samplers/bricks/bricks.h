/// Volumes larger than memory, as bricks of 64^3 values in levels; each level halves the
/// resolution. Each brick is one stored object. docs/bricks.md has the format.
#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "palpate/engine/types.h"
#include "palpate/samplers/bricks/half.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate {

inline constexpr int kBrickSide = 64;  ///< Number of a brick's own voxels along an edge.
/// Width of a brick's apron, which repeats voxels of its neighbours on each side [voxels].
inline constexpr int kBrickApron = 2;
/// Number of voxels along an edge, apron included.
inline constexpr int kBrickEdge = kBrickSide + 2 * kBrickApron;
inline constexpr std::size_t kBrickVoxels =
    std::size_t{kBrickEdge} * kBrickEdge * kBrickEdge;  ///< Voxels of a brick and its apron.
/// Size of a brick's active bits, one for each voxel [bytes].
inline constexpr std::size_t kBrickActiveBytes = kBrickVoxels / 8;

/// Index of a voxel in the index space of a level, or of a brick in a level.
using VoxelAt = std::array<std::int32_t, 3>;

/// Memory layout of a brick: the values (last axis fastest, components side by side), one active
/// bit for each voxel (lowest bit first), padding, and the brick's identity in the last bytes (0 if
/// the brick has no object). The size is a whole number of slabs. A slab holds the values of one
/// index along the first axis.
struct BrickFormat {
  bool vector = false;  ///< True for vectors of three components, false for scalars.
  bool half = false;    ///< True if a component has 16 bits, false if it has 32 bits.

  /// Returns the number of components of a value.
  [[nodiscard]] std::size_t components() const noexcept { return vector ? 3 : 1; }
  /// Returns the size of a component [bytes].
  [[nodiscard]] std::size_t componentBytes() const noexcept { return half ? 2 : 4; }
  /// Returns the offset of the active bits in a brick [bytes].
  [[nodiscard]] std::size_t activeBegin() const noexcept {
    return kBrickVoxels * components() * componentBytes();
  }
  /// Returns the size of a slab [bytes].
  [[nodiscard]] std::size_t slabBytes() const noexcept { return activeBegin() / kBrickEdge; }
  /// Returns the number of slabs of a brick, 69 to 73, with those for the bits and the identity.
  [[nodiscard]] std::size_t slabs() const noexcept;
  /// Returns the size of a brick in memory [bytes].
  [[nodiscard]] std::size_t bytes() const noexcept { return slabs() * slabBytes(); }
  /// Returns true if the layouts are equal.
  [[nodiscard]] bool operator==(const BrickFormat&) const = default;
};

/// Provides the voxels of a brick in memory.
class BrickView {
 public:
  /// @param slot  Brick of BrickFormat::bytes() bytes, filled by a BrickSource.
  BrickView(const BrickFormat& format, const std::byte* slot) noexcept
      : format_(format), slot_(slot) {}

  /// Returns the number of voxel (i, j, k); indices are from -2 to 65. (0, 0, 0) is the brick's
  /// first own voxel. Indices below 0 and above 63 are in the apron.
  [[nodiscard]] static std::size_t numberOf(int i, int j, int k) noexcept {
    return (static_cast<std::size_t>(i + kBrickApron) * kBrickEdge +
            static_cast<std::size_t>(j + kBrickApron)) *
               kBrickEdge +
           static_cast<std::size_t>(k + kBrickApron);
  }
  /// Returns the value of a voxel. RT: no allocation.
  [[nodiscard]] float value(std::size_t number, std::size_t component = 0) const noexcept {
    const std::size_t n = number * format_.components() + component;
    if (format_.half) {
      std::uint16_t half = 0;
      std::memcpy(&half, slot_ + 2 * n, sizeof half);
      return floatOfHalf(half);
    }
    float value = 0.0F;
    std::memcpy(&value, slot_ + 4 * n, sizeof value);
    return value;
  }
  /// Returns true if a voxel is active. RT: no allocation.
  [[nodiscard]] bool active(std::size_t number) const noexcept {
    const auto byte = std::to_integer<unsigned>(slot_[format_.activeBegin() + number / 8]);
    return ((byte >> (number % 8)) & 1U) != 0;
  }

 private:
  BrickFormat format_;
  const std::byte* slot_;
};

/// Index of a brick in the pyramid of levels.
struct BrickId {
  std::int32_t level = 0;  ///< Level; 0 has the resolution of the given volume.
  VoxelAt at{};            ///< Index of the brick along each axis of the level, from 0.

  [[nodiscard]] bool operator==(const BrickId&) const = default;  ///< True for the same brick.
  /// Orders bricks by level, then by their indices, with the last axis varying fastest.
  [[nodiscard]] bool operator<(const BrickId& other) const noexcept {
    return level != other.level ? level < other.level : at < other.at;
  }
};

/// One level of a pyramid. In levels above 0, voxel I is the mean of the voxels 2 I and 2 I + 1,
/// along each axis, of the next finer level. Its centre lies in the middle of their centres.
struct BrickLevel {
  /// Linear part of file = linear * index + origin, with index in this level's index space.
  Mat3 linear = Mat3::Identity();
  Vec3 origin = Vec3::Zero();  ///< Position of index (0, 0, 0) in the file's world space.
  /// Offset of the level [bricks]: the first own voxel of brick (0, 0, 0) is at 64 * first.
  VoxelAt first{};
  std::array<std::int32_t, 3> count{};  ///< Number of bricks along each axis.

  /// Maps a point from this level's index space to the file's world space.
  [[nodiscard]] Vec3 toFile(const Vec3& p_I) const { return linear * p_I + origin; }
  /// Returns the index of a brick's first own voxel.
  [[nodiscard]] VoxelAt voxelOf(const VoxelAt& at) const noexcept;
  /// Returns the number of bricks of the level.
  [[nodiscard]] std::uint64_t bricks() const noexcept;
};

/// Content of a brick.
enum class BrickKind : std::uint32_t {
  /// All voxels, apron included, are inactive and have one value. The brick has no object.
  kInactive = 0,
  /// All voxels, apron included, are active and have one value. The brick has no object.
  kActive = 1,
  kStored = 2,  ///< The brick has an object.
};

/// One brick, as listed in the manifest.
struct BrickEntry {
  VoxelAt at{};                           ///< Indices of the brick (BrickId::at).
  BrickKind kind = BrickKind::kInactive;  ///< Content of the brick.
  std::uint32_t bytes = 0;                ///< Size of the brick's object [bytes].
  std::uint32_t checksum = 0;             ///< CRC-32 of the brick's object, as in zlib.
  std::array<float, 3> value{};           ///< Value of all voxels, if `kind` is not kStored.
};

/// Description of a volume in bricks, without the values of its stored bricks. Memory: less than
/// 100 kB, and 36 bytes for each entry.
class BrickManifest {
 public:
  /// Reads the manifest of a finished folder. Throws VolumeError if the folder is missing, is
  /// unfinished, cannot be read or has no bricks. Also throws VolumeError as parse() does.
  [[nodiscard]] static BrickManifest read(const std::filesystem::path& folder);
  /// Parses a manifest in memory. Throws VolumeError if it is truncated, damaged, or of another
  /// version, or if the system has too little memory to parse its text.
  /// @param called  Name of the manifest in error messages.
  [[nodiscard]] static BrickManifest parse(std::span<const std::byte> bytes,
                                           const std::string& called);

  /// Returns the description of level 0.
  [[nodiscard]] const GridInfo& info() const noexcept { return info_; }
  /// Returns the format of every brick.
  [[nodiscard]] const BrickFormat& format() const noexcept { return format_; }
  /// Returns the value of inactive voxels in bricks without an entry.
  [[nodiscard]] const std::array<float, 3>& background() const noexcept { return background_; }
  /// Returns the levels from the finest to the coarsest. The coarsest level has at most 8 bricks.
  [[nodiscard]] const std::vector<BrickLevel>& levels() const noexcept { return levels_; }
  /// Returns the entries of a level in the order of BrickId; none if the level does not exist.
  /// Bricks without an entry are background.
  [[nodiscard]] std::span<const BrickEntry> entries(std::int32_t level) const noexcept;
  /// Returns true if the pyramid contains this brick.
  [[nodiscard]] bool has(const BrickId& id) const noexcept;
  /// Returns the entry of a brick; for a brick without an entry or outside of the pyramid, an entry
  /// of the background. RT: no allocation. Cost: logarithm of the number of entries.
  [[nodiscard]] BrickEntry entry(const BrickId& id) const noexcept;
  /// Returns the brick that owns the voxel; std::nullopt if no brick of the level does, or if the
  /// level does not exist.
  [[nodiscard]] std::optional<BrickId> holding(std::int32_t level,
                                               const VoxelAt& voxel) const noexcept;
  /// Returns the volume's identity: a hash of the description in BrickInput, of the compression
  /// level and of the version of zstd.
  [[nodiscard]] std::uint64_t identity() const noexcept { return identity_; }
  /// Returns the first and last voxel of the box in which level 0 may differ from background.
  [[nodiscard]] const std::array<VoxelAt, 2>& extent() const noexcept { return extent_; }
  /// Returns the first and the last voxel of the box of the active voxels of level 0. Both are
  /// (0, 0, 0) if no voxel is active.
  [[nodiscard]] const std::array<VoxelAt, 2>& activeBox() const noexcept { return active_box_; }
  /// Returns the meaning of inactive voxels in activeBox().
  [[nodiscard]] Inactive inactive() const noexcept { return inactive_; }
  /// Returns the metadata of the volume's file, such as units, as a JSON object.
  [[nodiscard]] const std::string& metadata() const noexcept { return metadata_; }
  /// Returns the sum of the sizes of all objects [bytes].
  [[nodiscard]] std::uint64_t storedBytes() const noexcept;

 private:
  friend class BrickFacts;
  BrickManifest() = default;

  GridInfo info_;
  BrickFormat format_;
  std::array<float, 3> background_{};
  std::vector<BrickLevel> levels_;
  std::vector<std::vector<BrickEntry>> entries_;
  std::uint64_t identity_ = 0;
  std::array<VoxelAt, 2> extent_{};
  std::array<VoxelAt, 2> active_box_{};
  Inactive inactive_ = Inactive::kBackground;
  std::string metadata_;
};

/// Returns the name of a brick's object, relative to the folder of the volume: "0/1.2.3.0.0.0" for
/// brick (1, 2, 3) of level 0. For vectors, ".0" is added.
[[nodiscard]] std::string brickObject(const BrickId& id, const BrickFormat& format);

/// Result of a brick's fetch. After all errors except kGone, other bricks can still be fetched. The
/// remedy for kMissing, kCut, kDamaged and kOthers is to copy or write the volume again.
enum class BrickStatus : std::uint8_t {
  kArrived,  ///< The slot contains the brick.
  kUnknown,  ///< The pyramid does not contain this brick. The caller made an error.
  kMissing,  ///< The object does not exist.
  /// The object is shorter or longer than the manifest states.
  kCut,
  kDamaged,  ///< The checksum or the content of the object is wrong.
  /// The object contains another brick, or a brick of another volume.
  kOthers,
  kGone,        ///< The whole volume no longer exists. Retries fail until isThere() is true.
  kUnreadable,  ///< The system or server reports an error or does not answer. A retry may succeed.
};

/// Returns the word for a status, such as "arrived", "missing" or "cut".
[[nodiscard]] const char* wordFor(BrickStatus status) noexcept;

/// A requested brick.
struct BrickWish {
  BrickId id;  ///< The brick.
  /// Priority. The source begins with the brick of the highest priority, and takes bricks of equal
  /// priorities in the order of the list. NaN is the lowest priority.
  double priority = 0.0;
};

/// The result of a brick's fetch.
struct BrickArrival {
  BrickId id;  ///< The brick.
  /// kArrived if the slot contains the brick, else the reason why it does not.
  BrickStatus status = BrickStatus::kUnknown;
  /// One line with the subject, the reason and the remedy; empty if the brick has arrived.
  std::string why;
};

/// A source of bricks: a folder, or a store that provides objects by name. Thread-safe. One thread
/// requests bricks, and any threads receive them:
///
///   source.want(wishes);                 // when the hand has moved
///   while (auto arrival = source.next(slot, patience))  // in another thread
///       if (arrival->status == BrickStatus::kArrived) ...
///
/// Each list of requests replaces the previous list. A brick in transfer arrives once, even if
/// later lists omit or repeat it. A new request for an arrived brick fetches it again.
class BrickSource {
 public:
  BrickSource() = default;
  BrickSource(const BrickSource&) = delete;
  BrickSource& operator=(const BrickSource&) = delete;
  virtual ~BrickSource() = default;

  /// Returns the manifest of the volume.
  [[nodiscard]] virtual const BrickManifest& manifest() const noexcept = 0;

  /// Requests these bricks and drops all earlier requests, except for fetches in progress. Never
  /// waits for a fetch.
  virtual void want(std::vector<BrickWish> wishes) = 0;

  /// Puts a requested brick into `slot`, also if all its voxels have one value. Several threads may
  /// call next(), each with its own slot. A folder waits for a request for at most `patience`, then
  /// fetches the brick of the highest priority. A store has several fetches in progress. It waits
  /// for the end of one for at most `patience`.
  /// @param slot  BrickFormat::bytes() bytes; unspecified if the brick has not arrived.
  /// @return      The result of one fetch; std::nullopt if `patience` has passed.
  [[nodiscard]] virtual std::optional<BrickArrival> next(std::span<std::byte> slot,
                                                         std::chrono::milliseconds patience) = 0;

  /// Returns true if the source still has this volume. If a lost volume returns, later fetches read
  /// it.
  [[nodiscard]] virtual bool isThere() = 0;

  /// Fetches one brick independently of all requests, and waits for it.
  [[nodiscard]] virtual BrickArrival read(const BrickId& id, std::span<std::byte> slot) = 0;

  /// Returns the recent mean duration of a fetch; 0 for a source that does not measure it, such as
  /// a folder. The window's look-ahead grows by four times this value.
  [[nodiscard]] virtual std::chrono::duration<double> delay() const { return {}; }
};

/// Bricks in a folder. Has no thread: the thread that calls next() or read() reads, decompresses
/// and checks the brick. Keeps working memory for the largest number of simultaneous calls so far.
class PosixBricks final : public BrickSource {
 public:
  /// Opens a finished folder. Throws VolumeError in the cases of BrickManifest::read.
  explicit PosixBricks(const std::filesystem::path& folder);
  /// Opens a folder with a given manifest. The folder need not contain a manifest yet. Throws
  /// VolumeError if the folder cannot be opened.
  PosixBricks(const std::filesystem::path& folder, BrickManifest manifest);
  ~PosixBricks() override;

  [[nodiscard]] const BrickManifest& manifest() const noexcept override;
  void want(std::vector<BrickWish> wishes) override;
  [[nodiscard]] std::optional<BrickArrival> next(std::span<std::byte> slot,
                                                 std::chrono::milliseconds patience) override;
  /// Returns true if the folder at the path contains a manifest with this volume's identity. Reads
  /// the manifest only if it or the folder has changed. If the folder had no manifest when it was
  /// opened, returns true if the folder has not been removed.
  [[nodiscard]] bool isThere() override;
  [[nodiscard]] BrickArrival read(const BrickId& id, std::span<std::byte> slot) override;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// Returns true if the folder contains a manifest, or the attributes (.zattrs) with which
/// writeBricks() begins a volume. Does not check the manifest.
[[nodiscard]] bool isBricks(const std::filesystem::path& folder) noexcept;

/// Loads a level as one grid in memory, equal to the written values and active states. Throws
/// VolumeError like BrickManifest::read, and if the level is missing, a brick does not arrive, or
/// the resulting grid is unusable (loadVolume).
[[nodiscard]] std::shared_ptr<const Volume> loadBricks(const std::filesystem::path& folder,
                                                       std::int32_t level = 0);
/// Loads a level from any source in the same way.
/// @param called  Name of the volume in error messages.
[[nodiscard]] std::shared_ptr<const Volume> loadBricks(BrickSource& source, std::int32_t level,
                                                       const std::string& called);

/// Returns the path of a folder's manifest, which the writer creates last.
[[nodiscard]] std::filesystem::path brickManifestFile(const std::filesystem::path& folder);

}  // namespace palpate
