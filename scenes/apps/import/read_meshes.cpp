/// Reads files of simulation programs through VTK: Exodus II, CGNS, OpenFOAM and PLOT3D.
#include <algorithm>
#include <array>
#include <filesystem>
#include <map>

#include <fmt/format.h>
#include <vtkCGNSReader.h>
#include <vtkExodusIIReader.h>
#include <vtkInformation.h>
#include <vtkMultiBlockDataSet.h>
#include <vtkMultiBlockPLOT3DReader.h>
#include <vtkNew.h>
#include <vtkOpenFOAMReader.h>
#include <vtkSmartPointer.h>
#include <vtkStreamingDemandDrivenPipeline.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/netcdf_size.h"
#include "palpate/scenes/apps/import/read_netcdf.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/vtk_pieces.h"
#include "palpate/scenes/apps/import/vtk_run.h"

namespace palpate::importer {
namespace {

namespace fs = std::filesystem;

std::vector<double> timesOf(vtkAlgorithm* reader) {
  vtkInformation* information = reader->GetOutputInformation(0);
  auto* key = vtkStreamingDemandDrivenPipeline::TIME_STEPS();
  if (information == nullptr || information->Has(key) == 0) return {};
  const double* times = information->Get(key);
  return {times, times + information->Length(key)};
}

class ExodusReader final : public Reader {
 public:
  explicit ExodusReader(const Request& request) : request_(request) {
    reader_->SetFileName(request.file.c_str());
    reader_->GenerateObjectIdCellArrayOff();
    reader_->GenerateGlobalElementIdArrayOff();
    reader_->GenerateGlobalNodeIdArrayOff();
    reader_->ApplyDisplacementsOff();
    reader_->UpdateInformation();
    times_ = timesOf(reader_);
    // Reads only the arrays that --field names. If the file has none of them, reads all, so that
    // the error can list them.
    constexpr std::array kTypes{vtkExodusIIReader::NODAL, vtkExodusIIReader::ELEM_BLOCK};
    bool any = false;
    for (const int type : kTypes) {
      for (int a = 0; a < reader_->GetNumberOfObjectArrays(type); ++a) {
        any = any || isAsked(reader_->GetObjectArrayName(type, a));
      }
    }
    for (const int type : kTypes) {
      for (int a = 0; a < reader_->GetNumberOfObjectArrays(type); ++a) {
        const bool asked = !any || isAsked(reader_->GetObjectArrayName(type, a));
        reader_->SetObjectArrayStatus(type, a, asked ? 1 : 0);
      }
    }
  }

  std::vector<double> times() const override {
    return times_.size() > 1 ? times_ : std::vector<double>();
  }

  Content read(std::size_t step) override {
    if (step < times_.size()) {
      reader_->GetOutputInformation(0)->Set(vtkStreamingDemandDrivenPipeline::UPDATE_TIME_STEP(),
                                            times_[step]);
    }
    run(reader_, request_.file.string(), request_.progress);
    Content content;
    content.pieces = piecesOf(reader_->GetOutput(), request_.file.string(), content.notes);
    if (reader_->GetTitle() != nullptr) content.description = reader_->GetTitle();
    return content;
  }

 private:
  [[nodiscard]] bool isAsked(const std::string& name) const {
    const auto& fields = request_.fields;
    return fields.empty() || std::find(fields.begin(), fields.end(), name) != fields.end();
  }

  Request request_;
  vtkNew<vtkExodusIIReader> reader_;
  std::vector<double> times_;
};

/// Reads the cell values of an OpenFOAM case. Ignores values on boundary patches.
class FoamReader final : public Reader {
 public:
  explicit FoamReader(const Request& request) : request_(request) {
    std::error_code error;
    const bool is_folder = fs::is_directory(request.file, error);
    const fs::path folder = is_folder                        ? request.file
                            : request.file.has_parent_path() ? request.file.parent_path()
                                                             : fs::path(".");
    const fs::path control = folder / "system" / "controlDict";
    if (!fs::is_regular_file(control, error)) {
      throw VolumeError(request.file.string(), fmt::format("{} is missing", control.string()),
                        "give the folder of an OpenFOAM case");
    }
    if (!fs::is_directory(folder / "constant" / "polyMesh", error) &&
        fs::is_directory(folder / "processor0", error)) {
      throw VolumeError(request.file.string(), "the case is decomposed into one part per processor",
                        "run reconstructPar");
    }
    // Skips time 0, the simulation's input, if there is another time.
    for (const bool skip_zero : {true, false}) {
      reader_ = vtkSmartPointer<vtkOpenFOAMReader>::New();
      reader_->SetFileName(control.c_str());
      reader_->CreateCellToPointOff();
      reader_->AddDimensionsToArrayNamesOn();
      reader_->CacheMeshOff();
      reader_->SetSkipZeroTime(skip_zero);
      reader_->UpdateInformation();
      times_ = timesOf(reader_);
      if (reader_->GetNumberOfCellArrays() > 0) break;
    }
    if (times_.empty()) {
      throw VolumeError(request.file.string(), "the case has no time with readable fields",
                        "run a solver, or copy the time folders as well");
    }
  }

  std::optional<double> timeUnit() const override { return 1.0; }
  std::vector<double> times() const override {
    return times_.size() > 1 ? times_ : std::vector<double>();
  }

  Content read(std::size_t step) override {
    reader_->GetOutputInformation(0)->Set(vtkStreamingDemandDrivenPipeline::UPDATE_TIME_STEP(),
                                          times_.at(step));
    run(reader_, request_.file.string(), request_.progress);
    Content content;
    content.pieces = piecesOf(reader_->GetOutput(), request_.file.string(), content.notes);
    content.length_unit = "m";
    for (Piece& piece : content.pieces) {
      for (Array& array : piece.arrays) array.name = withoutUnit(array.name, content.value_unit);
    }
    for (std::string& note : content.notes) note = withoutUnits(note);
    return content;
  }

 private:
  static std::string withoutUnit(const std::string& name,
                                 std::map<std::string, std::string>& units) {
    const auto at = name.find(" [");
    if (at == std::string::npos || name.back() != ']') return name;
    std::string plain = name.substr(0, at);
    units[plain] = name.substr(at + 2, name.size() - at - 3);
    return plain;
  }
  static std::string withoutUnits(std::string text) {
    for (auto at = text.find(" ["); at != std::string::npos; at = text.find(" [", at)) {
      const auto end = text.find(']', at);
      if (end == std::string::npos) break;
      text.erase(at, end + 1 - at);
    }
    return text;
  }

  Request request_;
  vtkSmartPointer<vtkOpenFOAMReader> reader_;
  std::vector<double> times_;
};

class CgnsReader final : public Reader {
 public:
  explicit CgnsReader(const Request& request) : request_(request) {
    reader_->SetFileName(request.file.c_str());
    reader_->UpdateInformation();
    times_ = timesOf(reader_);
    reader_->EnableAllBases();
    reader_->EnableAllFamilies();
    reader_->EnableAllPointArrays();
    reader_->EnableAllCellArrays();
    reader_->LoadBndPatchOff();
  }

  std::vector<double> times() const override {
    return times_.size() > 1 ? times_ : std::vector<double>();
  }

  Content read(std::size_t step) override {
    if (step < times_.size()) {
      reader_->GetOutputInformation(0)->Set(vtkStreamingDemandDrivenPipeline::UPDATE_TIME_STEP(),
                                            times_[step]);
    }
    run(reader_, request_.file.string(), request_.progress);
    Content content;
    content.pieces = piecesOf(reader_->GetOutput(), request_.file.string(), content.notes);
    return content;
  }

 private:
  Request request_;
  vtkNew<vtkCGNSReader> reader_;
  std::vector<double> times_;
};

bool isCgns(const Request& request) {
  vtkNew<vtkCGNSReader> reader;
  return reader->CanReadFile(request.file.c_str()) != 0;
}

/// Drops pressures and temperatures of which over 1 % are negative: VTK has derived them wrongly.
void dropImpossible(Content& content) {
  constexpr double kFew = 0.01;
  for (Piece& piece : content.pieces) {
    std::erase_if(piece.arrays, [&](const Array& array) {
      if (array.name != "Pressure" && array.name != "Temperature") return false;
      double points = 0.0;
      double negative = 0.0;
      for (std::size_t i = 0; i < array.values.tuples(); ++i) {
        if (!piece.hidden.none() && piece.hidden.at(i, 0) != 0.0) continue;
        points += 1.0;
        negative += array.values.at(i, 0) < 0.0 ? 1.0 : 0.0;
      }
      if (!(negative > kFew * points)) return false;
      content.notes.push_back(
          fmt::format("{}: skipped: the values, which VTK computes from the energy, are negative "
                      "at {:.3g} % of the points: the file has no energy, or scales it differently",
                      array.name, 100.0 * negative / points));
      return true;
    });
  }
}

Content readPlot3d(const Request& request) {
  vtkNew<vtkMultiBlockPLOT3DReader> reader;
  reader->SetXYZFileName(request.file.c_str());
  reader->SetQFileName(request.solution.c_str());
  reader->AutoDetectFormatOn();
  reader->SetScalarFunctionNumber(-1);
  reader->SetVectorFunctionNumber(-1);
  for (const int function : {100, 110, 120, 200}) reader->AddFunction(function);
  run(reader, request.file.string(), request.progress,
      "give a grid with --solution Q, both of the same size and format");
  Content content;
  content.pieces = piecesOf(reader->GetOutput(), request.file.string(), content.notes);
  dropImpossible(content);
  return content;
}

}  // namespace

std::unique_ptr<Reader> openNetcdf(const Request& request) {
  std::error_code error;
  const std::uint64_t there = std::filesystem::file_size(request.file, error);
  if (const auto size = netcdfSize(request.file); size && !error && there < *size) {
    throw VolumeError(request.file.string(),
                      fmt::format("the file is truncated: it has {} of {} bytes", there, *size),
                      "copy or export the file again");
  }
  if (auto hdf = openVtkHdf(request)) return hdf;
  if (isCgns(request)) return std::make_unique<CgnsReader>(request);
  vtkNew<vtkExodusIIReader> reader;
  if (reader->CanReadFile(request.file.c_str()) != 0) {
    return std::make_unique<ExodusReader>(request);
  }
  if (auto minc = openMinc(request)) return minc;
  return openCf(request);
}

std::unique_ptr<Reader> openCgns(const Request& request) {
  if (!isCgns(request)) {
    throw VolumeError(request.file.string(), "the CGNS file cannot be read",
                      "the file may be truncated or damaged: copy or export it again");
  }
  return std::make_unique<CgnsReader>(request);
}

std::unique_ptr<Reader> openFoam(const Request& request) {
  return std::make_unique<FoamReader>(request);
}

std::unique_ptr<Reader> openPlot3d(const Request& request) {
  if (request.solution.empty()) {
    throw VolumeError(request.file.string(), "a PLOT3D grid has positions, but no values",
                      "give the solution with --solution FILE.q");
  }
  std::error_code error;
  if (!std::filesystem::is_regular_file(request.solution, error)) {
    throw VolumeError(request.solution.string(),
                      error ? fmt::format("the file cannot be read ({})", error.message())
                            : "the path does not lead to a regular file",
                      "check the path of --solution");
  }
  return oneStep(request, readPlot3d);
}

}  // namespace palpate::importer
