/// Reads the legacy and the XML formats of VTK.
#include <array>
#include <cstdio>
#include <fstream>
#include <limits>
#include <regex>
#include <string>

#include <fmt/format.h>
#include <vtkGenericDataObjectReader.h>
#include <vtkNew.h>
#include <vtkXMLGenericDataObjectReader.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/vtk_pieces.h"
#include "palpate/scenes/apps/import/vtk_run.h"

namespace palpate::importer {
namespace {

Content readLegacy(const Request& request) {
  vtkNew<vtkGenericDataObjectReader> reader;
  reader->SetFileName(request.file.c_str());
  reader->ReadAllScalarsOn();
  reader->ReadAllVectorsOn();
  reader->ReadAllNormalsOn();
  reader->ReadAllTensorsOn();
  reader->ReadAllFieldsOn();
  run(reader, request.file.string(), request.progress);
  Content content;
  content.pieces = piecesOf(reader->GetOutput(), request.file.string(), content.notes);
  if (reader->GetHeader() != nullptr) content.description = reader->GetHeader();
  return content;
}

/// Returns the number of cells in an extent "x0 x1 y0 y1 z0 z1".
double cellsOf(const std::string& extent) {
  std::array<int, 6> e{};
  if (std::sscanf(extent.c_str(), "%d %d %d %d %d %d", &e[0], &e[1], &e[2], &e[3], &e[4], &e[5]) !=
      6) {
    return 0.0;
  }
  return (static_cast<double>(e[1]) - e[0]) * (static_cast<double>(e[3]) - e[2]) *
         (static_cast<double>(e[5]) - e[4]);
}

/// Throws VolumeError if the pieces of a structured file do not cover its whole extent. VTK would
/// leave the remaining memory uninitialized.
void checkPieces(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  const std::regex whole_extent("WholeExtent=\"([^\"]*)\"");
  const std::regex piece_extent("<Piece[^>]*[ \t]Extent=\"([^\"]*)\"");
  double whole = 0.0;
  double pieces = 0.0;
  // Reads up to each ">": tags are short, but the content between tags can be long.
  std::string tag;
  while (in.ignore(std::numeric_limits<std::streamsize>::max(), '<') && in.good()) {
    if (in.peek() == '_') break;
    constexpr std::size_t kLongest = 4096;
    tag = "<";
    for (int c = in.get(); c >= 0 && c != '>' && tag.size() < kLongest; c = in.get()) {
      tag += static_cast<char>(c);
    }
    if (tag.rfind("<AppendedData", 0) == 0) break;
    std::smatch match;
    if (std::regex_search(tag, match, whole_extent)) whole = cellsOf(match[1]);
    if (std::regex_search(tag, match, piece_extent)) pieces += cellsOf(match[1]);
  }
  if (whole > 0.0 && pieces < whole) {
    throw VolumeError(file.string(),
                      fmt::format("the pieces cover {:.3g} of {:.3g} cells", pieces, whole),
                      "export all pieces");
  }
}

Content readXml(const Request& request) {
  checkPieces(request.file);
  vtkNew<vtkXMLGenericDataObjectReader> reader;
  reader->SetFileName(request.file.c_str());
  run(reader, request.file.string(), request.progress);
  Content content;
  content.pieces = piecesOf(reader->GetOutput(), request.file.string(), content.notes);
  return content;
}

}  // namespace

std::unique_ptr<Reader> openVtkLegacy(const Request& request) {
  return oneStep(request, readLegacy);
}

std::unique_ptr<Reader> openVtkXml(const Request& request) {
  return oneStep(request, readXml);
}

}  // namespace palpate::importer
