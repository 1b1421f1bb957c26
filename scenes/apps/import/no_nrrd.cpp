/// Replaces read_nrrd.cpp in a build without teem.
#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

std::unique_ptr<Reader> openNrrd(const Request& request) {
  throw VolumeError(request.file.string(), "this palpate was built without teem, which reads NRRD",
                    "install libteem-dev and build palpate again");
}

}  // namespace palpate::importer
