/// Places at which brick volumes are stored: folders and network addresses.
#pragma once

#include <filesystem>
#include <memory>

#include "palpate/samplers/bricks/bricks.h"

namespace palpate {

/// Returns true if `place` is the address of a server, such as http://host/folder or
/// rados://pool/folder. The server need not exist.
[[nodiscard]] bool isRemote(const std::filesystem::path& place) noexcept;

/// Returns the absolute path of a folder or file, or an address unchanged.
[[nodiscard]] std::filesystem::path absolutePlace(const std::filesystem::path& place);

/// Returns true for a folder that contains bricks, and for every address.
[[nodiscard]] bool isBrickPlace(const std::filesystem::path& place) noexcept;

/// Opens the bricks at a place. Throws VolumeError as PosixBricks, FarBricks and the stores do, and
/// if this build lacks the store that the address needs.
[[nodiscard]] std::unique_ptr<BrickSource> openBricks(const std::filesystem::path& place);

}  // namespace palpate
