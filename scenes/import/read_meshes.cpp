/// What solvers write: Exodus II and PLOT3D, through VTK.
#include <algorithm>
#include <array>

#include <fmt/format.h>
#include <vtkExodusIIReader.h>
#include <vtkInformation.h>
#include <vtkMultiBlockDataSet.h>
#include <vtkMultiBlockPLOT3DReader.h>
#include <vtkNew.h>
#include <vtkStreamingDemandDrivenPipeline.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/import/netcdf_size.h"
#include "palpate/scenes/import/reader.h"
#include "palpate/scenes/import/vtk_pieces.h"
#include "palpate/scenes/import/vtk_run.h"

namespace palpate::importer {
namespace {

/// The times that a reader has announced.
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
    // Only what was asked for is read; where none of it is there, all, to be listed.
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

  std::vector<double> times() const override { return times_; }

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

/// Leaves out what VTK derives from a file's energy where that cannot be: a pressure and a
/// temperature are not negative, but for a few points that a solver has not met.
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
          fmt::format("{}: left out: it follows from the energy, and is negative in {:.3g} % of "
                      "the points: the file has no energy, or one of another scale",
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
      "give a grid with --solution Q, both of one size and format");
  Content content;
  content.pieces = piecesOf(reader->GetOutput(), request.file.string(), content.notes);
  dropImpossible(content);
  return content;
}

}  // namespace

std::unique_ptr<Reader> openExodus(const Request& request) {
  std::error_code error;
  const std::uint64_t there = std::filesystem::file_size(request.file, error);
  if (const auto size = netcdfSize(request.file); size && !error && there < *size) {
    throw VolumeError(request.file.string(),
                      fmt::format("it is truncated: {} bytes of {}", there, *size),
                      "copy or export it again");
  }
  vtkNew<vtkExodusIIReader> reader;
  if (reader->CanReadFile(request.file.c_str()) == 0) {
    throw VolumeError(request.file.string(),
                      "it is netCDF or HDF5, but not Exodus II as far as it can be read",
                      "export it as Exodus II or VTK");
  }
  return std::make_unique<ExodusReader>(request);
}

std::unique_ptr<Reader> openPlot3d(const Request& request) {
  if (request.solution.empty()) {
    throw VolumeError(request.file.string(), "a PLOT3D grid has places, but no values",
                      "give its solution with --solution FILE.q");
  }
  std::error_code error;
  if (!std::filesystem::is_regular_file(request.solution, error)) {
    throw VolumeError(request.solution.string(), "no such file", "check the path of --solution");
  }
  return oneStep(request, readPlot3d);
}

}  // namespace palpate::importer
