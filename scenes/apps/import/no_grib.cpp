/// Replaces read_grib.cpp if ecCodes is missing, as in the program without VTK.
#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

std::unique_ptr<Reader> openGrib(const Request& request) {
  throw VolumeError(request.file.string(), "this importer is one without ecCodes, which reads it",
                    "install the package palpate-import, or libeccodes-dev and build again; or "
                    "convert it to netCDF, as with cdo -f nc copy");
}

}  // namespace palpate::importer
