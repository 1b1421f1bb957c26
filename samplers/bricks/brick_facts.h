/// Private to samplers: makes, writes and parses the manifest of bricks. Include it in .cpp files
/// only.
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
inline constexpr const char* kBrickManifestFile = "palpate.bricks";  ///< Written last.
inline constexpr const char* kBrickAttributesFile = ".zattrs";       ///< For readers of Zarr.

/// Statistics of the active values, collected brick by brick; vectors count with their magnitudes.
struct BrickStatistics {
  std::uint64_t active = 0;  ///< Number of active voxels.
  VoxelAt lower{};           ///< Least coordinates of active voxels.
  VoxelAt upper{};           ///< Largest coordinates of active voxels.
  double lowest = 0.0;       ///< Lowest value, if there are any.
  double highest = 0.0;      ///< Highest value, if there are any.
  double sum = 0.0;          ///< Sum of the values, if there are any.

  /// Adds other statistics to these.
  void join(const BrickStatistics& other) noexcept;
};

/// A manifest under construction, with the JSON of the same facts.
class BrickFacts {
 public:
  /// Makes a manifest without entries. Throws VolumeError for an invalid input.
  BrickFacts(const BrickInput& input, const BrickOptions& options);

  /// Returns the manifest as far as it is known.
  [[nodiscard]] const BrickManifest& manifest() const noexcept { return manifest_; }
  /// Sets all entries of a level, in order.
  void setEntries(std::int32_t level, std::vector<BrickEntry> entries);
  void setStatistics(const BrickStatistics& statistics);  ///< For level 0.

  /// Returns the content of .zattrs.
  [[nodiscard]] std::string attributes() const;
  /// Returns the content of .zarray.
  [[nodiscard]] std::string array(std::int32_t level, int compression) const;
  /// Returns the content of the manifest's file.
  [[nodiscard]] std::vector<std::byte> file() const;

  /// Returns the identity in the text of .zattrs; 0 if the text has no identity.
  [[nodiscard]] static std::uint64_t identityIn(const std::string& attributes) noexcept;
  /// Returns the length of a manifest's head, which describes the volume, before its table [bytes].
  [[nodiscard]] static std::size_t headOf(std::span<const std::byte> manifest) noexcept;
  /// See BrickManifest::parse.
  [[nodiscard]] static BrickManifest parse(std::span<const std::byte> bytes,
                                           const std::string& called);

 private:
  /// Reads all but the tables of a manifest. Throws std::exception.
  static void readFacts(const nlohmann::ordered_json& json, BrickManifest& manifest);

  nlohmann::ordered_json facts_;
  BrickManifest manifest_;
};

}  // namespace palpate
