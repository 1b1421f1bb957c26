/// Private to the importer: opens formats in netCDF or HDF5, except Exodus II and CGNS.
#pragma once

#include <memory>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Opens a file with CF conventions. Throws VolumeError.
[[nodiscard]] std::unique_ptr<Reader> openCf(const Request& request);

/// Opens an image in MINC 1. Returns null for other files.
[[nodiscard]] std::unique_ptr<Reader> openMinc(const Request& request);

/// Opens a file in VTK's HDF5 format (.vtkhdf). Returns null for other files.
[[nodiscard]] std::unique_ptr<Reader> openVtkHdf(const Request& request);

}  // namespace palpate::importer
