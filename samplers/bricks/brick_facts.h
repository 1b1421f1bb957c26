/// Private to samplers, for .cpp files only: makes, serialises and parses a manifest.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "palpate/samplers/bricks/bricks.h"
#include "palpate/samplers/bricks/write_bricks.h"

namespace palpate {

/// Names of the files in a folder of bricks.
inline constexpr const char* kBrickManifestFile = "palpate.bricks";  ///< Manifest; written last.
inline constexpr const char* kBrickAttributesFile = ".zattrs";  ///< Attributes for readers of Zarr.

/// Statistics of the active values of level 0; for vectors, of the magnitudes.
struct BrickStatistics {
  std::uint64_t active = 0;  ///< Number of active voxels.
  VoxelAt lower{};           ///< Least coordinates of active voxels.
  VoxelAt upper{};           ///< Largest coordinates of active voxels.
  double lowest = 0.0;       ///< Lowest active value; not used if `active` is 0.
  double highest = 0.0;      ///< Highest active value; not used if `active` is 0.
  double sum = 0.0;          ///< Sum of the active values; not used if `active` is 0.

  /// Adds other statistics to these.
  void join(const BrickStatistics& other) noexcept;
};

/// A manifest under construction, with its facts as JSON.
class BrickFacts {
 public:
  /// Makes a manifest without entries. Throws VolumeError for an invalid input or option.
  BrickFacts(const BrickInput& input, const BrickOptions& options);

  /// Returns the manifest with the entries that have been set so far.
  [[nodiscard]] const BrickManifest& manifest() const noexcept { return manifest_; }
  /// Sets all entries of a level. The entries must be in the order of BrickId.
  void setEntries(std::int32_t level, std::vector<BrickEntry> entries);
  void setStatistics(const BrickStatistics& statistics);  ///< Sets the statistics of level 0.

  /// Returns the content of the file .zattrs.
  [[nodiscard]] std::string attributes() const;
  /// Returns the content of the file .zarray of a level.
  [[nodiscard]] std::string array(std::int32_t level, int compression) const;
  /// Returns the content of the manifest's file.
  [[nodiscard]] std::vector<std::byte> file() const;

  /// Returns the identity in the text of .zattrs; 0 if the text has no identity.
  [[nodiscard]] static std::uint64_t identityIn(const std::string& attributes) noexcept;
  /// Returns the length of a manifest's head, the part before the table of entries [bytes]. If the
  /// manifest is truncated, the length may exceed the manifest's.
  [[nodiscard]] static std::size_t headOf(std::span<const std::byte> manifest) noexcept;
  /// See BrickManifest::parse.
  [[nodiscard]] static BrickManifest parse(std::span<const std::byte> bytes,
                                           const std::string& called);

 private:
  /// Reads all facts of a manifest except the tables of entries. Throws std::exception.
  static void readFacts(const nlohmann::ordered_json& json, BrickManifest& manifest);

  nlohmann::ordered_json facts_;
  BrickManifest manifest_;
};

}  // namespace palpate
