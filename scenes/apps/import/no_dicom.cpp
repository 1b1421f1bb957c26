/// Replaces read_dicom.cpp in a build without vtk-dicom.
#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

std::unique_ptr<Reader> openDicom(const Request& request) {
  throw VolumeError(
      request.file.string(), "this importer was built without vtk-dicom, which reads DICOM",
      "install the package palpate-import, or install libvtk-dicom-dev and build palpate again");
}

}  // namespace palpate::importer
