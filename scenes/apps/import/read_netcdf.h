/// Private to the importer: opens netCDF files that are neither Exodus II nor CGNS.
#pragma once

#include <memory>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Opens a file with CF conventions. Throws VolumeError.
[[nodiscard]] std::unique_ptr<Reader> openCf(const Request& request);

}  // namespace palpate::importer
