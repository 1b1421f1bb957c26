#include "palpate/samplers/bricks/bricks.h"

#include <algorithm>
#include <cstring>
#include <fstream>
#include <system_error>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/brick_facts.h"
#include "palpate/samplers/leased_file.h"

namespace palpate {

VoxelAt BrickLevel::voxelOf(const VoxelAt& at) const noexcept {
  VoxelAt voxel{};
  for (std::size_t a = 0; a < 3; ++a) voxel[a] = (first[a] + at[a]) * kBrickSide;
  return voxel;
}

std::uint64_t BrickLevel::bricks() const noexcept {
  std::uint64_t all = 1;
  for (const std::int32_t along : count) all *= static_cast<std::uint64_t>(along);
  return all;
}

BrickManifest BrickManifest::parse(std::span<const std::byte> bytes, const std::string& called) {
  return BrickFacts::parse(bytes, called);
}

BrickManifest BrickManifest::read(const std::filesystem::path& folder) {
  std::error_code error;
  const auto status = std::filesystem::status(folder, error);
  if (!std::filesystem::exists(status)) throwAbsent(folder, "no such folder", error);
  const std::filesystem::path file = folder / kBrickManifestFile;
  (void)std::filesystem::exists(file, error);
  if (error) {
    throw VolumeError(folder.string(), "it cannot be read (" + error.message() + ")",
                      "check its permissions");
  }
  if (!std::filesystem::is_directory(status) || !isBricks(folder)) {
    throw VolumeError(folder.string(), "it is not a volume in bricks",
                      "give the folder that palpate brick has written, or write one: palpate brick "
                      "FILE.vdb NEW_FOLDER");
  }
  if (!std::filesystem::exists(file, error)) {
    throw VolumeError(folder.string(), "it is unfinished: it has no manifest",
                      "repeat the command that wrote the folder (it continues where it stopped), "
                      "or finish the copy");
  }
  std::vector<std::byte> bytes;
  std::ifstream stream;
  if (std::filesystem::is_regular_file(file, error)) stream.open(file, std::ios::binary);
  const auto size = std::filesystem::file_size(file, error);
  if (stream && !error) {
    bytes.resize(size);
    stream.read(reinterpret_cast<char*>(bytes.data()),  // NOLINT: a stream's
                static_cast<std::streamsize>(size));
    bytes.resize(static_cast<std::size_t>(stream.gcount()));
  } else {
    throw VolumeError(file.string(), "it cannot be read, or is not a file",
                      "check the file and its permissions");
  }
  return parse(bytes, file.string());
}

std::span<const BrickEntry> BrickManifest::entries(std::int32_t level) const noexcept {
  if (level < 0 || static_cast<std::size_t>(level) >= entries_.size()) return {};
  return entries_[static_cast<std::size_t>(level)];
}

bool BrickManifest::has(const BrickId& id) const noexcept {
  if (id.level < 0 || static_cast<std::size_t>(id.level) >= levels_.size()) return false;
  const BrickLevel& level = levels_[static_cast<std::size_t>(id.level)];
  for (std::size_t a = 0; a < 3; ++a) {
    if (id.at[a] < 0 || id.at[a] >= level.count[a]) return false;
  }
  return true;
}

BrickEntry BrickManifest::entry(const BrickId& id) const noexcept {
  const auto all = entries(id.level);
  const auto found =
      std::lower_bound(all.begin(), all.end(), id.at,
                       [](const BrickEntry& entry, const VoxelAt& at) { return entry.at < at; });
  if (found != all.end() && found->at == id.at) return *found;
  BrickEntry nothing;
  nothing.at = id.at;
  nothing.value = background_;
  return nothing;
}

std::optional<BrickId> BrickManifest::holding(std::int32_t level,
                                              const VoxelAt& voxel) const noexcept {
  if (level < 0 || static_cast<std::size_t>(level) >= levels_.size()) return std::nullopt;
  BrickId id{level, {}};
  for (std::size_t a = 0; a < 3; ++a) {
    id.at[a] = (voxel[a] >> 6) - levels_[static_cast<std::size_t>(level)].first[a];
  }
  if (!has(id)) return std::nullopt;
  return id;
}

std::uint64_t BrickManifest::storedBytes() const noexcept {
  std::uint64_t sum = 0;
  for (const auto& level : entries_) {
    for (const BrickEntry& entry : level) sum += entry.bytes;
  }
  return sum;
}

std::string brickObject(const BrickId& id, const BrickFormat& format) {
  return std::to_string(id.level) + "/" + std::to_string(id.at[0]) + "." +
         std::to_string(id.at[1]) + "." + std::to_string(id.at[2]) +
         (format.vector ? ".0.0.0.0" : ".0.0.0");
}

const char* wordFor(BrickStatus status) noexcept {
  switch (status) {
    case BrickStatus::kArrived:
      return "arrived";
    case BrickStatus::kUnknown:
      return "unknown";
    case BrickStatus::kMissing:
      return "missing";
    case BrickStatus::kCut:
      return "cut";
    case BrickStatus::kDamaged:
      return "damaged";
    case BrickStatus::kOthers:
      return "another's";
    case BrickStatus::kGone:
      return "gone";
    case BrickStatus::kUnreadable:
      return "unreadable";
  }
  return "unknown";
}

std::filesystem::path brickManifestFile(const std::filesystem::path& folder) {
  return folder / kBrickManifestFile;
}

bool isBricks(const std::filesystem::path& folder) noexcept {
  std::error_code error;
  if (std::filesystem::exists(folder / kBrickManifestFile, error)) return true;
  try {
    std::ifstream stream(folder / kBrickAttributesFile, std::ios::binary);
    const std::string text{std::istreambuf_iterator<char>(stream), {}};
    return BrickFacts::identityIn(text) != 0;
  } catch (const std::exception&) {
    return false;
  }
}

}  // namespace palpate
