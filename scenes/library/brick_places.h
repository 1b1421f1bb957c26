/// Opens brick volumes in folders and at network addresses.
#pragma once

#include <filesystem>
#include <memory>

#include "palpate/samplers/bricks/bricks.h"

namespace palpate {

/// Returns true if `place` is a server's address, such as http://host/folder or
/// rados://pool/folder. The server need not exist.
[[nodiscard]] bool isRemote(const std::filesystem::path& place) noexcept;

/// Returns the absolute path of a folder or file, or an address unchanged.
[[nodiscard]] std::filesystem::path absolutePlace(const std::filesystem::path& place);

/// Returns true for a folder that contains bricks, and for every server's address.
[[nodiscard]] bool isBrickPlace(const std::filesystem::path& place) noexcept;

/// Opens the bricks at a place. Throws VolumeError as PosixBricks, FarBricks and the stores do, or
/// if this build lacks the store for the address.
[[nodiscard]] std::unique_ptr<BrickSource> openBricks(const std::filesystem::path& place);

}  // namespace palpate
