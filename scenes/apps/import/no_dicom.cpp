/// Replaces read_dicom.cpp if vtk-dicom is missing, as in the program without VTK.
#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

std::unique_ptr<Reader> openDicom(const Request& request) {
  throw VolumeError(request.file.string(), "this importer is one without vtk-dicom, which reads it",
                    "install the package palpate-import, or libvtk-dicom-dev and build again");
}

}  // namespace palpate::importer
