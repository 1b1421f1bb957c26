/// Replaces read_nrrd.cpp if teem is missing.
#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

std::unique_ptr<Reader> openNrrd(const Request& request) {
  throw VolumeError(request.file.string(), "this palpate was built without teem",
                    "install libteem-dev and build again");
}

}  // namespace palpate::importer
