/// Where a volume in bricks is: a folder, or an address.
#pragma once

#include <filesystem>
#include <memory>

#include "palpate/samplers/bricks.h"

namespace palpate {

/// True for what a server has, http://host/folder or rados://pool/folder, whatever is there. No
/// file has such a name in a scene.
[[nodiscard]] bool isRemote(const std::filesystem::path& place) noexcept;

/// A path from the root; an address as it is.
[[nodiscard]] std::filesystem::path absolutePlace(const std::filesystem::path& place);

/// True for a folder that bricks have been written into, and for an address.
[[nodiscard]] bool isBrickPlace(const std::filesystem::path& place) noexcept;

/// The bricks that are there. Throws VolumeError as PosixBricks, FarBricks and the stores do; of a
/// store that this build does not know.
[[nodiscard]] std::unique_ptr<BrickSource> openBricks(const std::filesystem::path& place);

}  // namespace palpate
