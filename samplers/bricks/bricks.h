/// Volumes larger than memory: bricks of 64^3 values in levels of halving resolution. Each brick is
/// an object and is fetched by itself. docs/bricks.md has the format.
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

inline constexpr int kBrickSide = 64;  ///< A brick's own voxels along an edge.
inline constexpr int kBrickApron = 2;  ///< Voxels of its neighbours around them, on each side.
inline constexpr int kBrickEdge = kBrickSide + 2 * kBrickApron;  ///< Voxels along an edge, in all.
inline constexpr std::size_t kBrickVoxels =
    std::size_t{kBrickEdge} * kBrickEdge * kBrickEdge;              ///< Voxels of a brick, in all.
inline constexpr std::size_t kBrickActiveBytes = kBrickVoxels / 8;  ///< One bit a voxel.

/// A voxel in the index space of a level.
using VoxelAt = std::array<std::int32_t, 3>;

/// Memory layout of the bricks of a volume. First come kBrickVoxels values, the last axis fastest,
/// with the components of a vector side by side. Then comes one bit a voxel, lowest first, set if
/// the voxel is active. Padding follows up to a whole number of slabs; a slab is the values of one
/// place along the first axis. The last bytes identify the brick.
struct BrickFormat {
  bool vector = false;  ///< Three components a value, else one.
  bool half = false;    ///< A component has 16 bits, else 32.

  /// Returns the number of components of a value.
  [[nodiscard]] std::size_t components() const noexcept { return vector ? 3 : 1; }
  /// Returns the size of a component [bytes].
  [[nodiscard]] std::size_t componentBytes() const noexcept { return half ? 2 : 4; }
  /// Returns where the bits begin [bytes].
  [[nodiscard]] std::size_t activeBegin() const noexcept {
    return kBrickVoxels * components() * componentBytes();
  }
  /// Returns the size of the values of one place along the first axis.
  [[nodiscard]] std::size_t slabBytes() const noexcept { return activeBegin() / kBrickEdge; }
  [[nodiscard]] std::size_t slabs() const noexcept;  ///< Including those for the bits: 69 to 73.
  /// Returns the size of a brick in memory.
  [[nodiscard]] std::size_t bytes() const noexcept { return slabs() * slabBytes(); }
  [[nodiscard]] bool operator==(const BrickFormat&) const = default;  ///< Same layout.
};

/// Reads a brick in memory.
class BrickView {
 public:
  /// @param slot  BrickFormat::bytes(), filled by a BrickSource.
  BrickView(const BrickFormat& format, const std::byte* slot) noexcept
      : format_(format), slot_(slot) {}

  /// Returns the number of a voxel of the brick. i, j and k are from -2 to 65; (0, 0, 0) is the
  /// brick's first own voxel.
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

/// A brick's place in the pyramid.
struct BrickId {
  std::int32_t level = 0;  ///< 0: the resolution of the given volume.
  VoxelAt at{};            ///< From 0, along the three axes of the level's array.

  [[nodiscard]] bool operator==(const BrickId&) const = default;  ///< Same place.
  /// Orders by level, then in the order of arrays.
  [[nodiscard]] bool operator<(const BrickId& other) const noexcept {
    return level != other.level ? level < other.level : at < other.at;
  }
};

/// One level of a pyramid. Its voxel I is the mean of the voxels 2 I and 2 I + 1 of the level
/// before, and lies between them.
struct BrickLevel {
  Mat3 linear = Mat3::Identity();  ///< file = linear * index + origin, with this level's index.
  Vec3 origin = Vec3::Zero();      ///< Position of index (0, 0, 0), file.
  VoxelAt first{};                 ///< Brick (0, 0, 0): its own voxels begin at 64 times this.
  std::array<std::int32_t, 3> count{};  ///< Bricks along each axis.

  /// Returns the position of a point in index space.
  [[nodiscard]] Vec3 toFile(const Vec3& p_I) const { return linear * p_I + origin; }
  /// Returns the first own voxel of a brick.
  [[nodiscard]] VoxelAt voxelOf(const VoxelAt& at) const noexcept;
  [[nodiscard]] std::uint64_t bricks() const noexcept;  ///< Number of bricks.
};

/// Content of a brick's place.
enum class BrickKind : std::uint32_t {
  kInactive = 0,  ///< All voxels and the apron inactive, of one value: no object.
  kActive = 1,    ///< All voxels and the apron active, of one value: no object.
  kStored = 2,    ///< The place has an object.
};

/// One brick, as listed in the manifest.
struct BrickEntry {
  VoxelAt at{};                           ///< See BrickId.
  BrickKind kind = BrickKind::kInactive;  ///< Content of the place.
  std::uint32_t bytes = 0;                ///< Size of its object.
  std::uint32_t checksum = 0;             ///< CRC-32 of its object, as in zlib.
  std::array<float, 3> value{};           ///< The one value, if `kind` is not kStored.
};

/// The description of a volume in bricks, without its values. Memory: a few hundred bytes, and 36
/// for each brick that is not the background.
class BrickManifest {
 public:
  /// Reads the manifest of a finished folder. Throws VolumeError if the folder does not exist, is
  /// unfinished, does not hold bricks or is of another version, or if its manifest is cut off or
  /// damaged.
  [[nodiscard]] static BrickManifest read(const std::filesystem::path& folder);
  /// Reads a manifest from memory, with the same errors.
  /// @param called  Name of the manifest in errors.
  [[nodiscard]] static BrickManifest parse(std::span<const std::byte> bytes,
                                           const std::string& called);

  [[nodiscard]] const GridInfo& info() const noexcept { return info_; }  ///< Facts about level 0.
  /// Returns the format of every brick.
  [[nodiscard]] const BrickFormat& format() const noexcept { return format_; }
  /// Returns the value where there is neither an entry nor a brick; inactive.
  [[nodiscard]] const std::array<float, 3>& background() const noexcept { return background_; }
  /// Returns the levels from the finest to the coarsest, which has 8 bricks at most.
  [[nodiscard]] const std::vector<BrickLevel>& levels() const noexcept { return levels_; }
  /// Returns the entries of a level, in the order of BrickId; all other bricks are background.
  [[nodiscard]] std::span<const BrickEntry> entries(std::int32_t level) const noexcept;
  /// Returns true if the pyramid has this place.
  [[nodiscard]] bool has(const BrickId& id) const noexcept;
  /// Returns the entry of a brick. If the manifest does not list the brick, and beyond the pyramid,
  /// returns the background. RT: no allocation. Cost: logarithm of the level's entries.
  [[nodiscard]] BrickEntry entry(const BrickId& id) const noexcept;
  /// Returns the brick that owns a voxel; std::nullopt beyond the level.
  [[nodiscard]] std::optional<BrickId> holding(std::int32_t level,
                                               const VoxelAt& voxel) const noexcept;
  /// Returns a number that is the same for all bricks of the same values and the same options.
  [[nodiscard]] std::uint64_t identity() const noexcept { return identity_; }
  /// Returns the first and the last voxel of level 0 that may differ from the background.
  [[nodiscard]] const std::array<VoxelAt, 2>& extent() const noexcept { return extent_; }
  /// Returns the other facts of the volume's file, such as units: a JSON object.
  [[nodiscard]] const std::string& metadata() const noexcept { return metadata_; }
  /// Returns the size of all objects [bytes].
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
  std::string metadata_;
};

/// Returns the name of a stored brick's object, below its folder: "0/1.2.3.0.0.0".
[[nodiscard]] std::string brickObject(const BrickId& id, const BrickFormat& format);

/// The result of a brick's fetch. After each result, other bricks can be fetched.
enum class BrickStatus : std::uint8_t {
  kArrived,  ///< The slot holds the brick.
  kUnknown,  ///< The pyramid does not have this place: an error of the caller.
  kMissing,  ///< The object does not exist: copy or write the volume again.
  kCut,  ///< The object is shorter or longer than in the manifest: copy or write the volume again.
  kDamaged,     ///< The checksum or the content is wrong: copy or write the volume again.
  kOthers,      ///< The brick is of another place or volume: copy or write the volume again.
  kGone,        ///< The whole volume does not exist any more; do not retry.
  kUnreadable,  ///< The system reports an error; a retry may succeed.
};

/// Returns "arrived", "missing", "cut", ...
[[nodiscard]] const char* wordFor(BrickStatus status) noexcept;

/// A requested brick.
struct BrickWish {
  BrickId id;             ///< The brick.
  double priority = 0.0;  ///< The highest is fetched first; of equal ones the first.
};

/// The result of a brick's fetch.
struct BrickArrival {
  BrickId id;                                  ///< The brick.
  BrickStatus status = BrickStatus::kUnknown;  ///< Whether the slot holds the brick.
  std::string why;  ///< One line, "what: why: remedy"; empty if the brick has arrived.
};

/// A source of bricks: files, or a store that provides objects by name.
///
/// One thread requests bricks; the same thread or others take them as they arrive:
///
///     source.want(wishes);                                 // whenever the hand has moved on
///     while (auto arrival = source.next(slot, patience))   // in a thread of its own
///       if (arrival->status == BrickStatus::kArrived) ...
///
/// Each list of requests replaces the one before, so no request needs to be cancelled. If the fetch
/// of a brick has begun, the brick arrives once, even if later lists omit or repeat it. A brick
/// that has arrived and is listed again is fetched again. Any thread may call any function at any
/// time.
class BrickSource {
 public:
  BrickSource() = default;
  BrickSource(const BrickSource&) = delete;
  BrickSource& operator=(const BrickSource&) = delete;
  virtual ~BrickSource() = default;

  /// Returns the manifest of the volume.
  [[nodiscard]] virtual const BrickManifest& manifest() const noexcept = 0;

  /// Requests these bricks and drops all earlier requests. Never waits for a fetch.
  virtual void want(std::vector<BrickWish> wishes) = 0;

  /// Fetches the most urgent requested brick into a slot of the caller, also if it has one value.
  /// Several threads may wait at a time, each with its own slot. Takes the time of one brick if one
  /// is requested, else waits for a request, `patience` at most.
  /// @param slot  BrickFormat::bytes() of the caller; unspecified if the brick has not arrived.
  /// @return      std::nullopt if no brick was requested or, from a remote source, has arrived.
  [[nodiscard]] virtual std::optional<BrickArrival> next(std::span<std::byte> slot,
                                                         std::chrono::milliseconds patience) = 0;

  /// Returns true if the volume exists: a finished volume is at its place, and is the same. If the
  /// volume has come back, later fetches read it from there. Takes as long as a small file.
  [[nodiscard]] virtual bool isThere() = 0;

  /// Fetches one brick now, apart from all requests.
  [[nodiscard]] virtual BrickArrival read(const BrickId& id, std::span<std::byte> slot) = 0;

  /// Returns how long bricks have lately taken from the start of their fetch. The window looks
  /// ahead farther by a few times this. 0: negligible.
  [[nodiscard]] virtual std::chrono::duration<double> delay() const { return {}; }
};

/// Bricks in a folder, without a thread of its own. The caller of next() reads, decompresses and
/// checks. The memory for this is kept from brick to brick, one set for each thread that was ever
/// in it at once.
class PosixBricks final : public BrickSource {
 public:
  /// Throws VolumeError, see BrickManifest::read.
  explicit PosixBricks(const std::filesystem::path& folder);
  /// Uses a given manifest; the folder need not have one (yet).
  PosixBricks(const std::filesystem::path& folder, BrickManifest manifest);
  ~PosixBricks() override;

  [[nodiscard]] const BrickManifest& manifest() const noexcept override;
  void want(std::vector<BrickWish> wishes) override;
  [[nodiscard]] std::optional<BrickArrival> next(std::span<std::byte> slot,
                                                 std::chrono::milliseconds patience) override;
  /// Checks the folder's path and the manifest in it.
  [[nodiscard]] bool isThere() override;
  [[nodiscard]] BrickArrival read(const BrickId& id, std::span<std::byte> slot) override;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// Returns true for a folder of bricks, finished or not.
[[nodiscard]] bool isBricks(const std::filesystem::path& folder) noexcept;

/// Returns a level of a volume in bricks as one grid in memory, for comparison and display. Values
/// and active states are those written, to the last bit. Throws VolumeError like
/// BrickManifest::read, and if the level does not exist or a brick does not arrive.
[[nodiscard]] std::shared_ptr<const Volume> loadBricks(const std::filesystem::path& folder,
                                                       std::int32_t level = 0);
/// Returns the same from any source.
[[nodiscard]] std::shared_ptr<const Volume> loadBricks(BrickSource& source, std::int32_t level,
                                                       const std::string& called);

/// Returns the manifest's path. This file is written last; its identity is that of the volume.
[[nodiscard]] std::filesystem::path brickManifestFile(const std::filesystem::path& folder);

}  // namespace palpate
