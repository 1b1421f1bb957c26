/// Volumes larger than memory: bricks of 64^3 values in levels of halving resolution, an object a
/// brick, fetched one by one. docs/bricks.md has the format.
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
#include "palpate/samplers/half.h"
#include "palpate/samplers/volume.h"

namespace palpate {

inline constexpr int kBrickSide = 64;  ///< Voxels along an edge that are a brick's own.
inline constexpr int kBrickApron = 2;  ///< Voxels of its neighbours about them, on each side.
inline constexpr int kBrickEdge = kBrickSide + 2 * kBrickApron;  ///< Voxels along an edge, in all.
inline constexpr std::size_t kBrickVoxels =
    std::size_t{kBrickEdge} * kBrickEdge * kBrickEdge;              ///< Of a brick, in all.
inline constexpr std::size_t kBrickActiveBytes = kBrickVoxels / 8;  ///< A bit a voxel.

/// A voxel in index space, of a level.
using VoxelAt = std::array<std::int32_t, 3>;

/// How the bricks of a volume are laid out in memory: kBrickVoxels values, the last axis fastest, a
/// vector's components side by side; then a bit a voxel, lowest first, set where it is active; then
/// nothing, to a whole number of slabs (values of one place along the first axis); in the last
/// bytes whose brick it is.
struct BrickFormat {
  bool vector = false;  ///< Three components a value, else one.
  bool half = false;    ///< A component in 16 bits, else in 32.

  [[nodiscard]] std::size_t components() const noexcept { return vector ? 3 : 1; }  ///< A value's.
  [[nodiscard]] std::size_t componentBytes() const noexcept { return half ? 2 : 4; }  ///< Of one.
  /// Where the bits begin [bytes].
  [[nodiscard]] std::size_t activeBegin() const noexcept {
    return kBrickVoxels * components() * componentBytes();
  }
  /// Of the values of one place along the first axis.
  [[nodiscard]] std::size_t slabBytes() const noexcept { return activeBegin() / kBrickEdge; }
  [[nodiscard]] std::size_t slabs() const noexcept;  ///< With those for the bits: 69 to 73.
  /// Of a brick in memory.
  [[nodiscard]] std::size_t bytes() const noexcept { return slabs() * slabBytes(); }
  [[nodiscard]] bool operator==(const BrickFormat&) const = default;  ///< For the same layout.
};

/// A brick as it lies in memory, wherever that is.
class BrickView {
 public:
  /// @param slot  BrickFormat::bytes() of them, filled by a BrickSource.
  BrickView(const BrickFormat& format, const std::byte* slot) noexcept
      : format_(format), slot_(slot) {}

  /// The number of a voxel of the brick, each of i, j and k from -2 to 65; (0, 0, 0) is the first
  /// that is its own.
  [[nodiscard]] static std::size_t numberOf(int i, int j, int k) noexcept {
    return (static_cast<std::size_t>(i + kBrickApron) * kBrickEdge +
            static_cast<std::size_t>(j + kBrickApron)) *
               kBrickEdge +
           static_cast<std::size_t>(k + kBrickApron);
  }
  /// RT: no allocation.
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
  /// RT: no allocation.
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
  std::int32_t level = 0;  ///< 0: as fine as the volume was given.
  VoxelAt at{};            ///< From 0, along the three axes of its level's array.

  [[nodiscard]] bool operator==(const BrickId&) const = default;  ///< For the same place.
  /// Level by level, in the order of arrays.
  [[nodiscard]] bool operator<(const BrickId& other) const noexcept {
    return level != other.level ? level < other.level : at < other.at;
  }
};

/// One level of a pyramid. Its voxel I lies about the voxels 2 I and 2 I + 1 of the level before,
/// whose mean it is.
struct BrickLevel {
  Mat3 linear = Mat3::Identity();  ///< file = linear * index + origin, of this level's index.
  Vec3 origin = Vec3::Zero();      ///< Of index (0, 0, 0), file.
  VoxelAt first{};  ///< Of the brick (0, 0, 0): its own voxels begin at 64 times this.
  std::array<std::int32_t, 3> count{};  ///< Bricks along each axis.

  /// Of a place in index space.
  [[nodiscard]] Vec3 toFile(const Vec3& p_I) const { return linear * p_I + origin; }
  /// The first voxel that is a brick's own.
  [[nodiscard]] VoxelAt voxelOf(const VoxelAt& at) const noexcept;
  [[nodiscard]] std::uint64_t bricks() const noexcept;  ///< In all.
};

/// What is where a brick would be.
enum class BrickKind : std::uint32_t {
  kInactive = 0,  ///< All of one value and inactive, apron and all: there is no object.
  kActive = 1,    ///< Likewise, and active.
  kStored = 2,    ///< An object.
};

/// One brick, as the manifest names it.
struct BrickEntry {
  VoxelAt at{};                           ///< As BrickId.
  BrickKind kind = BrickKind::kInactive;  ///< What is there.
  std::uint32_t bytes = 0;                ///< Of its object.
  std::uint32_t checksum = 0;             ///< Of its object, CRC-32 as zlib has it.
  std::array<float, 3> value{};           ///< Where there is no object: its one value.
};

/// All that is known of a volume in bricks without its values: some hundred bytes, and 36 for each
/// brick that is not the background.
class BrickManifest {
 public:
  /// Reads what a finished folder says of itself. Throws VolumeError: no such folder, unfinished,
  /// none of ours, of a newer version, cut off, damaged.
  [[nodiscard]] static BrickManifest read(const std::filesystem::path& folder);
  /// The same out of memory, wherever it came from.
  /// @param called  What it is called in errors.
  [[nodiscard]] static BrickManifest parse(std::span<const std::byte> bytes,
                                           const std::string& called);

  [[nodiscard]] const GridInfo& info() const noexcept { return info_; }  ///< Of level 0.
  /// Of every brick.
  [[nodiscard]] const BrickFormat& format() const noexcept { return format_; }
  /// Where there is neither an entry nor a brick; inactive.
  [[nodiscard]] const std::array<float, 3>& background() const noexcept { return background_; }
  /// From the finest to the coarsest, which has 8 bricks at most.
  [[nodiscard]] const std::vector<BrickLevel>& levels() const noexcept { return levels_; }
  /// Of a level, in the order of BrickId; the others are background.
  [[nodiscard]] std::span<const BrickEntry> entries(std::int32_t level) const noexcept;
  /// Is there such a place in the pyramid?
  [[nodiscard]] bool has(const BrickId& id) const noexcept;
  /// What is there; where nothing is named, and beyond the pyramid, the background. RT: no
  /// allocation. Cost: logarithm of the level's entries.
  [[nodiscard]] BrickEntry entry(const BrickId& id) const noexcept;
  /// The brick whose own a voxel is; none beyond the level.
  [[nodiscard]] std::optional<BrickId> holding(std::int32_t level,
                                               const VoxelAt& voxel) const noexcept;
  /// The same for all bricks of the same values, written with the same options.
  [[nodiscard]] std::uint64_t identity() const noexcept { return identity_; }
  /// The first and the last voxel of level 0 that may be other than the background.
  [[nodiscard]] const std::array<VoxelAt, 2>& extent() const noexcept { return extent_; }
  /// What the volume's file said beside its values, as units: a JSON object.
  [[nodiscard]] const std::string& metadata() const noexcept { return metadata_; }
  /// Of all objects [bytes].
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

/// The object of a stored brick, below its folder: "0/1.2.3.0.0.0".
[[nodiscard]] std::string brickObject(const BrickId& id, const BrickFormat& format);

/// How the fetch of a brick ended. Whatever it is, the volume's other bricks can be fetched.
enum class BrickStatus : std::uint8_t {
  kArrived,     ///< The slot holds it.
  kUnknown,     ///< There is no such place in the pyramid: a mistake of the caller's.
  kMissing,     ///< Its object is not there: the volume has to be copied or written again.
  kCut,         ///< It is shorter or longer than the manifest says: likewise.
  kDamaged,     ///< Its checksum or what is in it is wrong: likewise.
  kOthers,      ///< It is a brick of another place or of another volume: likewise.
  kGone,        ///< The whole volume is not there any more: give up.
  kUnreadable,  ///< The system says so; it may be worth another try.
};

/// "arrived", "missing", "cut", ...
[[nodiscard]] const char* wordFor(BrickStatus status) noexcept;

/// A brick that is wanted.
struct BrickWish {
  BrickId id;             ///< Which.
  double priority = 0.0;  ///< The highest is fetched first; of equal ones the first.
};

/// A brick that has been fetched, or not.
struct BrickArrival {
  BrickId id;                                  ///< Which.
  BrickStatus status = BrickStatus::kUnknown;  ///< Whether the slot holds it.
  std::string why;  ///< One line, "what: why: remedy"; empty where it has arrived.
};

/// Where bricks come from: files, and whatever can give an object by its name.
///
/// One thread says what is wanted, the same or others take what arrives:
///
///     source.want(wishes);                                 // whenever the hand has moved on
///     while (auto arrival = source.next(slot, patience))   // in a thread of its own
///       if (arrival->status == BrickStatus::kArrived) ...
///
/// What is wanted is said as a whole: each list stands in place of the one before, so that nothing
/// has to be called off. A brick whose fetch has begun arrives all the same, once, whatever lists
/// came since; it is not begun again meanwhile. Who lists what has arrived gets it anew. All may be
/// called by any thread at any time.
class BrickSource {
 public:
  BrickSource() = default;
  BrickSource(const BrickSource&) = delete;
  BrickSource& operator=(const BrickSource&) = delete;
  virtual ~BrickSource() = default;

  [[nodiscard]] virtual const BrickManifest& manifest() const noexcept = 0;  ///< Of its volume.

  /// Wants these, and no others any more. Never waits for a fetch.
  virtual void want(std::vector<BrickWish> wishes) = 0;

  /// The most urgent of what is wanted, in a slot of the caller's; bricks of one value likewise.
  /// Several threads may wait at a time, each with its own slot. Takes the time of one brick where
  /// there is something to do, else as long as nothing is wanted, `patience` at most.
  /// @param slot  BrickFormat::bytes() of the caller's; unspecified where it has not arrived.
  /// @return      None: nothing was wanted, or, of a source that is far away, nothing has come yet.
  [[nodiscard]] virtual std::optional<BrickArrival> next(std::span<std::byte> slot,
                                                         std::chrono::milliseconds patience) = 0;

  /// Whether the volume is there: what is at its place is finished, and the same. Where it has come
  /// back it is read from there from now on. Takes as long as a small file.
  [[nodiscard]] virtual bool isThere() = 0;

  /// One brick, now, beside all that is wanted.
  [[nodiscard]] virtual BrickArrival read(const BrickId& id, std::span<std::byte> slot) = 0;

  /// How long a brick takes from the begin of its fetch on, lately: who looks ahead looks farther
  /// by some of these. 0: no time that counts.
  [[nodiscard]] virtual std::chrono::duration<double> delay() const { return {}; }
};

/// Bricks in a folder. No thread of its own: who calls next() reads, decompresses and checks, with
/// memory that is kept from brick to brick, one set for each thread that ever was in it at once.
class PosixBricks final : public BrickSource {
 public:
  /// Throws VolumeError as BrickManifest::read.
  explicit PosixBricks(const std::filesystem::path& folder);
  /// With a manifest that the folder need not have (yet).
  PosixBricks(const std::filesystem::path& folder, BrickManifest manifest);
  ~PosixBricks() override;

  [[nodiscard]] const BrickManifest& manifest() const noexcept override;
  void want(std::vector<BrickWish> wishes) override;
  [[nodiscard]] std::optional<BrickArrival> next(std::span<std::byte> slot,
                                                 std::chrono::milliseconds patience) override;
  /// By its folder's path and the manifest in there.
  [[nodiscard]] bool isThere() override;
  [[nodiscard]] BrickArrival read(const BrickId& id, std::span<std::byte> slot) override;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// True for a folder that bricks have been written into, finished or not.
[[nodiscard]] bool isBricks(const std::filesystem::path& folder) noexcept;

/// A level of a volume in bricks as one grid in memory, to be compared with and looked at: the
/// values, and which are active, as they were written, to the last bit. Throws VolumeError for
/// what BrickManifest::read refuses, for a level that is not there and for a brick that does not
/// arrive.
[[nodiscard]] std::shared_ptr<const Volume> loadBricks(const std::filesystem::path& folder,
                                                       std::int32_t level = 0);
/// The same from wherever bricks come.
[[nodiscard]] std::shared_ptr<const Volume> loadBricks(BrickSource& source, std::int32_t level,
                                                       const std::string& called);

/// The file of a folder of bricks that is written last, and by whose identity the whole is known.
[[nodiscard]] std::filesystem::path brickManifestFile(const std::filesystem::path& folder);

}  // namespace palpate
