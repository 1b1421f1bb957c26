/// Private to the importer: what a netCDF file is that is neither Exodus II nor CGNS.
#pragma once

#include <memory>

#include "palpate/scenes/import/reader.h"

namespace palpate::importer {

/// By the CF conventions. Throws VolumeError.
[[nodiscard]] std::unique_ptr<Reader> openCf(const Request& request);

}  // namespace palpate::importer
