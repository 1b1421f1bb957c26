/// Private to samplers: the manifest of bricks, as it is made and written. Include it in .cpp files
/// only.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "palpate/samplers/bricks.h"
#include "palpate/samplers/write_bricks.h"

namespace palpate {

/// Names of the files of a folder of bricks.
inline constexpr const char* kBrickManifestFile = "palpate.bricks";  ///< Written last.
inline constexpr const char* kBrickAttributesFile = ".zattrs";       ///< For readers of Zarr.

/// What is known of active values, brick by brick; vectors by their magnitudes.
struct BrickStatistics {
  std::uint64_t active = 0;  ///< Voxels.
  VoxelAt lower{};           ///< The least coordinates of active ones.
  VoxelAt upper{};           ///< The largest.
  double lowest = 0.0;       ///< Of the values, if there are any.
  double highest = 0.0;      ///< Likewise.
  double sum = 0.0;          ///< Likewise.

  /// Of both together.
  void join(const BrickStatistics& other) noexcept;
};

/// A manifest in the making, beside the JSON that says the same.
class BrickFacts {
 public:
  /// Without entries. Throws VolumeError for an input that cannot be.
  BrickFacts(const BrickInput& input, const BrickOptions& options);

  /// As far as it is known.
  [[nodiscard]] const BrickManifest& manifest() const noexcept { return manifest_; }
  /// Of a level: all of them, in order.
  void setEntries(std::int32_t level, std::vector<BrickEntry> entries);
  void setStatistics(const BrickStatistics& statistics);  ///< Of level 0.

  [[nodiscard]] std::string attributes() const;                                ///< .zattrs
  [[nodiscard]] std::string array(std::int32_t level, int compression) const;  ///< .zarray
  [[nodiscard]] std::vector<std::byte> file() const;                           ///< The manifest's.

  /// The identity that attributes say; 0 where there is none.
  [[nodiscard]] static std::uint64_t identityIn(const std::string& attributes) noexcept;
  /// How much of a manifest's begin is what it says of the volume, before its table [bytes].
  [[nodiscard]] static std::size_t headOf(std::span<const std::byte> manifest) noexcept;
  /// As BrickManifest::parse.
  [[nodiscard]] static BrickManifest parse(std::span<const std::byte> bytes,
                                           const std::string& called);

 private:
  nlohmann::ordered_json facts_;
  BrickManifest manifest_;
};

}  // namespace palpate
