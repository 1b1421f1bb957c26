/// Replaces read_vtk.cpp, read_meshes.cpp and read_slices.cpp in a build without VTK.
#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {
namespace {

[[noreturn]] void refuse(const Request& request) {
  throw VolumeError(
      request.file.string(),
      "this importer was built without VTK and the libraries that read this format",
      "install the package palpate-import, or install libvtk9-dev and build palpate again");
}

}  // namespace

std::unique_ptr<Reader> openCgns(const Request& request) {
  refuse(request);
}
std::unique_ptr<Reader> openFoam(const Request& request) {
  refuse(request);
}
std::unique_ptr<Reader> openNetcdf(const Request& request) {
  refuse(request);
}
std::unique_ptr<Reader> openPlot3d(const Request& request) {
  refuse(request);
}
std::unique_ptr<Reader> openSlices(const Request& request) {
  refuse(request);
}
std::unique_ptr<Reader> openVtkLegacy(const Request& request) {
  refuse(request);
}
std::unique_ptr<Reader> openVtkSeries(const Request& request) {
  refuse(request);
}
std::unique_ptr<Reader> openVtkXml(const Request& request) {
  refuse(request);
}

}  // namespace palpate::importer
