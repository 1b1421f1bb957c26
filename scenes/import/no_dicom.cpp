/// In place of read_dicom.cpp where vtk-dicom is missing.
#include "palpate/engine/error.h"
#include "palpate/scenes/import/reader.h"

namespace palpate::importer {

std::unique_ptr<Reader> openDicom(const Request& request) {
  throw VolumeError(request.file.string(), "this palpate was built without vtk-dicom",
                    "install libvtk-dicom-dev and build again");
}

}  // namespace palpate::importer
