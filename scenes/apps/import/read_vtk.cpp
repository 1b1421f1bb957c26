/// Reads VTK's legacy, XML and HDF5 formats, and ParaView's lists of files with times.
#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <map>
#include <regex>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <vtkGenericDataObjectReader.h>
#include <vtkHDFReader.h>
#include <vtkMultiBlockDataSet.h>
#include <vtkNew.h>
#include <vtkSmartPointer.h>
#include <vtkXMLDataElement.h>
#include <vtkXMLGenericDataObjectReader.h>
#include <vtkXMLUtilities.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/header_checks.h"
#include "palpate/scenes/apps/import/read_netcdf.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/vtk_pieces.h"
#include "palpate/scenes/apps/import/vtk_run.h"
#include "palpate/scenes/library/text_file.h"

namespace palpate::importer {
namespace {

vtkSmartPointer<vtkGenericDataObjectReader> readLegacyData(const std::filesystem::path& file,
                                                           const Progress& progress) {
  auto reader = vtkSmartPointer<vtkGenericDataObjectReader>::New();
  reader->SetFileName(file.c_str());
  reader->ReadAllScalarsOn();
  reader->ReadAllVectorsOn();
  reader->ReadAllNormalsOn();
  reader->ReadAllTensorsOn();
  reader->ReadAllFieldsOn();
  run(reader, file.string(), progress);
  return reader;
}

Content readLegacy(const Request& request) {
  const auto reader = readLegacyData(request.file, request.progress);
  Content content;
  content.pieces = piecesOf(reader->GetOutput(), request.file.string(), content.notes);
  if (reader->GetHeader() != nullptr) content.description = reader->GetHeader();
  return content;
}

double cellsOf(const std::string& extent) {
  std::array<int, 6> e{};
  if (std::sscanf(extent.c_str(), "%d %d %d %d %d %d", &e[0], &e[1], &e[2], &e[3], &e[4], &e[5]) !=
      6) {
    return 0.0;
  }
  return (static_cast<double>(e[1]) - e[0]) * (static_cast<double>(e[3]) - e[2]) *
         (static_cast<double>(e[5]) - e[4]);
}

/// Throws VolumeError if the pieces of a file have fewer cells than its extent: VTK would leave the
/// other values uninitialized.
void checkPieces(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  const std::regex whole_extent("WholeExtent=\"([^\"]*)\"");
  const std::regex piece_extent("<Piece[^>]*[ \t]Extent=\"([^\"]*)\"");
  double whole = 0.0;
  double pieces = 0.0;
  // Reads each tag up to ">" and skips the content between tags, which can be long.
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
                      fmt::format("the pieces cover {:.0f} of {:.0f} cells", pieces, whole),
                      "export all pieces");
  }
}

vtkSmartPointer<vtkDataObject> readXmlData(const std::filesystem::path& file,
                                           const Progress& progress) {
  checkPieces(file);
  vtkNew<vtkXMLGenericDataObjectReader> reader;
  reader->SetFileName(file.c_str());
  run(reader, file.string(), progress);
  return reader->GetOutput();
}

Content readXml(const Request& request) {
  Content content;
  content.pieces =
      piecesOf(readXmlData(request.file, request.progress), request.file.string(), content.notes);
  return content;
}

bool isCollection(const std::filesystem::path& file) {
  const std::string text = firstBytesOf(file);
  const auto at = text.find("<VTKFile");
  if (at == std::string::npos) return false;
  const std::string tag = text.substr(at, text.find('>', at) - at);
  return tag.find("\"Collection\"") != std::string::npos ||
         tag.find("'Collection'") != std::string::npos;
}

/// The files of each time step, by time.
using TimedFiles = std::map<double, std::vector<std::filesystem::path>>;

/// Returns the path of a file that `request.file` lists. Throws VolumeError as sizeOfData() does.
std::filesystem::path listedFile(const Request& request, const std::string& name) {
  std::filesystem::path file = request.file.parent_path() / name;
  (void)sizeOfData(request.file, file, request.follow);
  return file;
}

/// Returns the files that a collection (.pvd) lists. Files with the same time are parts of one
/// step.
TimedFiles filesOfCollection(const Request& request) {
  const auto refuse = [&](const std::string& why, const std::string& remedy) {
    throw VolumeError(request.file.string(), why, remedy);
  };
  vtkSmartPointer<vtkXMLDataElement> root;
  runQuietly(
      [&] { root.TakeReference(vtkXMLUtilities::ReadElementFromFile(request.file.c_str())); });
  if (root == nullptr) refuse("the collection is not valid XML", "copy or export it again");
  TimedFiles files;
  vtkXMLDataElement* all = root->FindNestedElementWithName("Collection");
  for (int i = 0; all != nullptr && i < all->GetNumberOfNestedElements(); ++i) {
    vtkXMLDataElement& element = *all->GetNestedElement(i);
    if (element.GetName() == nullptr || std::string(element.GetName()) != "DataSet") continue;
    const char* name = element.GetAttribute("file");
    if (name == nullptr || *name == '\0') {
      refuse("a data set of the collection names no file", "export the collection again");
    }
    double time = 0.0;
    const char* given = element.GetAttribute("timestep");
    if (given != nullptr &&
        (element.GetScalarAttribute("timestep", time) == 0 || !std::isfinite(time))) {
      refuse(fmt::format("the time of {} is not a number", name), "export the collection again");
    }
    files[time].push_back(listedFile(request, name));
  }
  if (files.empty()) {
    refuse("the collection has no data set", "export it again, with its data sets");
  }
  return files;
}

/// Returns the files that a series (JSON) lists, one for each time.
TimedFiles filesOfSeries(const Request& request) {
  using Json = nlohmann::json;
  constexpr const char* kCorrect = "correct the series file, or export it again";
  const auto refuse = [&](const std::string& why, const std::string& remedy) {
    throw VolumeError(request.file.string(), why, remedy);
  };
  Json list;
  try {
    list = Json::parse(readText<VolumeError>(request.file, "check the path and its permissions"));
  } catch (const Json::parse_error& e) {
    refuse(fmt::format("the series is not valid JSON (byte {})", e.byte), kCorrect);
  } catch (const Json::out_of_range&) {
    refuse("a number in the series is too large for a double", kCorrect);
  }
  if (!list.is_object() || !list.contains("files") || !list["files"].is_array()) {
    refuse("the series has no list \"files\"", kCorrect);
  }
  TimedFiles files;
  for (const Json& entry : list["files"]) {
    if (!entry.is_object() || !entry.contains("name") || !entry["name"].is_string() ||
        entry["name"].get_ref<const std::string&>().empty()) {
      refuse("an entry of the series names no file", kCorrect);
    }
    const auto& name = entry["name"].get_ref<const std::string&>();
    if (!entry.contains("time") || !entry["time"].is_number()) {
      refuse(fmt::format("the time of {} is missing, or is not a number", name), kCorrect);
    }
    const double time = entry["time"].get<double>();
    if (files.contains(time)) {
      refuse(fmt::format("{} has the time {} of another file of the series", name, time), kCorrect);
    }
    files[time].push_back(listedFile(request, name));
  }
  if (files.empty()) refuse("the list \"files\" of the series is empty", kCorrect);
  return files;
}

/// Reads the files of a list. A file that begins like VTK's legacy format is read as such; all
/// others are read as XML.
class ListReader final : public Reader {
 public:
  ListReader(Request request, TimedFiles files)
      : request_(std::move(request)), files_(std::move(files)) {}

  std::vector<double> times() const override {
    std::vector<double> times;
    for (const auto& [time, files] : files_) times.push_back(time);
    return times.size() > 1 ? times : std::vector<double>();
  }

  Content read(std::size_t step) override {
    const auto& parts = std::next(files_.begin(), static_cast<std::ptrdiff_t>(step))->second;
    vtkSmartPointer<vtkDataObject> data;
    if (parts.size() == 1) {
      data = readData(parts.front());
    } else {
      auto blocks = vtkSmartPointer<vtkMultiBlockDataSet>::New();
      for (std::size_t p = 0; p < parts.size(); ++p) {
        blocks->SetBlock(static_cast<unsigned>(p), readData(parts[p]));
      }
      data = blocks;
    }
    Content content;
    content.pieces = piecesOf(data, parts.front().string(), content.notes);
    return content;
  }

 private:
  vtkSmartPointer<vtkDataObject> readData(const std::filesystem::path& file) const {
    if (firstBytesOf(file).starts_with("# vtk DataFile")) {
      return readLegacyData(file, request_.progress)->GetOutput();
    }
    return readXmlData(file, request_.progress);
  }

  Request request_;
  TimedFiles files_;
};

Content readHdf(const Request& request) {
  vtkNew<vtkHDFReader> reader;
  reader->SetFileName(request.file.c_str());
  run(reader, request.file.string(), request.progress,
      "export it as .vti or .vtu, or with an older version of VTK's format");
  Content content;
  content.pieces = piecesOf(reader->GetOutputDataObject(0), request.file.string(), content.notes);
  return content;
}

}  // namespace

std::unique_ptr<Reader> openVtkLegacy(const Request& request) {
  return oneStep(request, readLegacy);
}

std::unique_ptr<Reader> openVtkHdf(const Request& request) {
  bool is_vtk = false;
  runQuietly([&] {
    vtkNew<vtkHDFReader> reader;
    is_vtk = reader->CanReadFile(request.file.c_str()) != 0;
  });
  return is_vtk ? oneStep(request, readHdf) : nullptr;
}

std::unique_ptr<Reader> openVtkSeries(const Request& request) {
  return std::make_unique<ListReader>(request, filesOfSeries(request));
}

std::unique_ptr<Reader> openVtkXml(const Request& request) {
  if (isCollection(request.file)) {
    return std::make_unique<ListReader>(request, filesOfCollection(request));
  }
  return oneStep(request, readXml);
}

}  // namespace palpate::importer
