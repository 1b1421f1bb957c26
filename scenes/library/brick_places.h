/// Places of brick volumes: a folder or a network address.
#pragma once

#include <filesystem>
#include <memory>

#include "palpate/samplers/bricks/bricks.h"

namespace palpate {

/// Returns true for a server's address, such as http://host/folder or rados://pool/folder. The
/// address need not exist. A scene cannot use a file with a name of this form.
[[nodiscard]] bool isRemote(const std::filesystem::path& place) noexcept;

/// Returns an absolute path; returns an address unchanged.
[[nodiscard]] std::filesystem::path absolutePlace(const std::filesystem::path& place);

/// Returns true for a folder that holds bricks, and for every address.
[[nodiscard]] bool isBrickPlace(const std::filesystem::path& place) noexcept;

/// Opens the bricks of a folder or an address. Throws VolumeError as PosixBricks, FarBricks and the
/// stores do, and if this build does not support the store.
[[nodiscard]] std::unique_ptr<BrickSource> openBricks(const std::filesystem::path& place);

}  // namespace palpate
