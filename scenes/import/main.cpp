/// `palpate-import`: an image that VTK reads (here NIfTI) becomes a .vdb that can be felt.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <new>
#include <string>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <openvdb/openvdb.h>
#include <openvdb/tools/Dense.h>
#include <vtkCallbackCommand.h>
#include <vtkImageCast.h>
#include <vtkImageData.h>
#include <vtkImageGaussianSmooth.h>
#include <vtkMatrix4x4.h>
#include <vtkNIFTIImageHeader.h>
#include <vtkNIFTIImageReader.h>
#include <vtkNew.h>
#include <vtkObject.h>
#include <vtkPointData.h>
#include <vtkSmartPointer.h>

#include "engine/error.h"
#include "scenes/cli/version.h"

namespace {

using palpate::Error;

struct Options {
  std::string in;
  std::string out;
  double smooth = 0.0;
};

/// An image and where its voxels are.
struct Image {
  vtkSmartPointer<vtkImageData> data;  ///< One float a voxel, spacing set, origin 0.
  openvdb::Mat4R file_from_index;      ///< OpenVDB's convention: row vectors.
  std::string description;
};

bool endsWith(const std::string& text, const std::string& end) {
  return text.size() >= end.size() && text.compare(text.size() - end.size(), end.size(), end) == 0;
}

/// NIfTI through VTK. World space: millimetres (or the file's unit), +x right, +y front, +z up.
Image readNifti(const std::string& file) {
  if (!std::filesystem::is_regular_file(file)) {
    throw Error(file, "no such file", "check the path");
  }
  if (!endsWith(file, ".nii") && !endsWith(file, ".nii.gz") && !endsWith(file, ".img") &&
      !endsWith(file, ".hdr")) {
    throw Error(file, "it is of a kind that this version does not import",
                "give NIfTI (.nii, .nii.gz, .img with .hdr)");
  }
  vtkNew<vtkNIFTIImageReader> reader;
  if (reader->CanReadFile(file.c_str()) == 0) {
    throw Error(file, "it is not a NIfTI file", "check what wrote it");
  }
  // VTK speaks of trouble by events; the first is ours to tell.
  std::string trouble;
  vtkNew<vtkCallbackCommand> listen;
  listen->SetClientData(&trouble);
  listen->SetCallback([](vtkObject*, unsigned long, void* client, void* text) {
    auto& first = *static_cast<std::string*>(client);
    if (first.empty()) first = text == nullptr ? "unknown" : static_cast<const char*>(text);
  });
  reader->AddObserver(vtkCommand::ErrorEvent, listen);
  reader->SetFileName(file.c_str());
  reader->Update();
  if (!trouble.empty() || reader->GetErrorCode() != 0) {
    throw Error(file, "VTK cannot read it to the end", "it may be truncated: copy it again");
  }

  vtkImageData* data = reader->GetOutput();
  if (data->GetNumberOfPoints() == 0) throw Error(file, "it has no voxel", "give an image");
  if (data->GetNumberOfScalarComponents() != 1) {
    throw Error(file, fmt::format("it has {} values a voxel", data->GetNumberOfScalarComponents()),
                "give an image of one scalar");
  }
  vtkNew<vtkImageCast> cast;
  cast->SetInputData(data);
  cast->SetOutputScalarTypeToFloat();
  cast->Update();

  Image image;
  image.data = cast->GetOutput();
  const double slope = reader->GetRescaleSlope();
  const double offset = reader->GetRescaleIntercept();
  if (slope != 0.0 && (slope != 1.0 || offset != 0.0)) {
    auto* values = static_cast<float*>(image.data->GetScalarPointer());
    for (vtkIdType i = 0; i < image.data->GetNumberOfPoints(); ++i) {
      values[i] = static_cast<float>(slope * values[i] + offset);
    }
  }

  // The file's own space: sform, else qform, else the spacing alone.
  vtkMatrix4x4* matrix = reader->GetSFormMatrix();
  if (matrix == nullptr) matrix = reader->GetQFormMatrix();
  std::array<double, 3> spacing{};
  image.data->GetSpacing(spacing.data());
  image.file_from_index.setIdentity();
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      const double m =
          matrix == nullptr ? static_cast<double>(row == column) : matrix->GetElement(row, column);
      image.file_from_index(column, row) = m * spacing[static_cast<std::size_t>(column)];
    }
    image.file_from_index(3, row) = matrix == nullptr ? 0.0 : matrix->GetElement(row, 3);
  }
  image.description = reader->GetNIFTIHeader()->GetDescrip();
  return image;
}

/// Gaussian of standard deviation `width`, in the file's units. Returns the rms change.
double smooth(Image& image, double width) {
  std::array<double, 3> spacing{};
  image.data->GetSpacing(spacing.data());
  vtkNew<vtkImageGaussianSmooth> gauss;
  gauss->SetInputData(image.data);
  gauss->SetDimensionality(3);
  gauss->SetStandardDeviations(width / spacing[0], width / spacing[1], width / spacing[2]);
  gauss->SetRadiusFactors(3.0, 3.0, 3.0);
  gauss->Update();
  const auto* before = static_cast<const float*>(image.data->GetScalarPointer());
  const auto* after = static_cast<const float*>(gauss->GetOutput()->GetScalarPointer());
  double sum = 0.0;
  const vtkIdType count = image.data->GetNumberOfPoints();
  for (vtkIdType i = 0; i < count; ++i) {
    const double change = static_cast<double>(after[i]) - static_cast<double>(before[i]);
    sum += change * change;
  }
  image.data = gauss->GetOutput();
  return std::sqrt(sum / static_cast<double>(count));
}

struct Range {
  float low = 0.0F;
  float high = 0.0F;
};

Range rangeOf(const Image& image, const std::string& file) {
  const auto* values = static_cast<const float*>(image.data->GetScalarPointer());
  const vtkIdType count = image.data->GetNumberOfPoints();
  const auto bad = std::count_if(values, values + count, [](float v) { return !std::isfinite(v); });
  if (bad > 0) {
    throw Error(file, fmt::format("{} of its voxels are NaN or infinite", bad),
                "replace them before importing");
  }
  const auto [low, high] = std::minmax_element(values, values + count);
  return {*low, *high};
}

int import(const Options& options) {
  if (!endsWith(options.out, ".vdb")) {
    throw Error(options.out, "the output is not named .vdb", "name it so");
  }
  if (!(options.smooth >= 0.0 && options.smooth <= 1000.0)) {
    throw Error("--smooth", fmt::format("{} is not 0 to 1000", options.smooth),
                "give a width in the file's units, as 1");
  }
  Image image = readNifti(options.in);
  std::array<int, 3> size{};
  image.data->GetDimensions(size.data());
  (void)rangeOf(image, options.in);
  const double change = options.smooth > 0.0 ? smooth(image, options.smooth) : 0.0;

  // Sparse: what is within a thousandth of the range of the lowest value is background.
  const Range range = rangeOf(image, options.in);
  const float tolerance = 1e-3F * (range.high - range.low);
  openvdb::initialize();
  auto grid = openvdb::FloatGrid::create(range.low);
  const openvdb::tools::Dense<float, openvdb::tools::LayoutXYZ> dense(
      openvdb::CoordBBox(0, 0, 0, size[0] - 1, size[1] - 1, size[2] - 1),
      static_cast<float*>(image.data->GetScalarPointer()));
  openvdb::tools::copyFromDense(dense, *grid, tolerance);
  if (grid->activeVoxelCount() == 0) {
    throw Error(options.in, "all its voxels have one value", "there is nothing to feel in it");
  }
  grid->setTransform(openvdb::math::Transform::createLinearTransform(image.file_from_index));
  grid->setName("density");
  grid->setGridClass(openvdb::GRID_FOG_VOLUME);
  const std::string source = std::filesystem::path(options.in).filename().string();
  grid->insertMeta("source", openvdb::StringMetadata(source));
  grid->insertMeta("imported_by",
                   openvdb::StringMetadata(std::string("palpate ") + palpate::cli::kVersion));
  if (!image.description.empty()) {
    grid->insertMeta("description", openvdb::StringMetadata(image.description));
  }
  if (options.smooth > 0.0) grid->insertMeta("smooth", openvdb::DoubleMetadata(options.smooth));

  // Whole or not at all.
  const std::string partial = fmt::format("{}.partial-{}", options.out, getpid());
  std::error_code error;
  try {
    openvdb::io::File file(partial);
    file.setCompression(openvdb::io::COMPRESS_BLOSC | openvdb::io::COMPRESS_ACTIVE_MASK);
    file.write({grid});
    file.close();
    std::filesystem::rename(partial, options.out);
  } catch (const std::exception&) {
    std::filesystem::remove(partial, error);
    throw Error(options.out, "it cannot be written", "choose another place, or make room");
  }

  const auto total = static_cast<double>(size[0]) * size[1] * size[2];
  fmt::print("{}: {} x {} x {} voxels, {:.1f} % active, values {:.4g} .. {:.4g}", options.out,
             size[0], size[1], size[2],
             100.0 * static_cast<double>(grid->activeVoxelCount()) / total, range.low, range.high);
  fmt::print("; values within {:.3g} of {:.3g} became background", tolerance, range.low);
  if (options.smooth > 0.0) fmt::print("; smoothing changed them by {:.3g} rms", change);
  fmt::print("\n");
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{
      "palpate import: turns an image into a .vdb with a grid named density, in the "
      "image's own space"};
  app.name("palpate import");
  Options options;
  app.add_option("IN", options.in, "NIfTI (.nii, .nii.gz, .img with .hdr)")->required();
  app.add_option("OUT", options.out, "The .vdb to write")->required();
  app.add_option("--smooth", options.smooth,
                 "Standard deviation of a Gaussian, in the file's units (usually mm)");
  app.footer("Example:\n  palpate import head.nii.gz head.vdb --smooth 1");
  vtkObject::GlobalWarningDisplayOff();
  try {
    app.parse(argc, argv);
    return import(options);
  } catch (const CLI::CallForHelp& e) {
    return app.exit(e);
  } catch (const CLI::ParseError& e) {
    fmt::print(stderr, "palpate: usage: {}: see palpate import --help\n", e.what());
  } catch (const Error& e) {
    fmt::print(stderr, "palpate: {}\n", e.what());
  } catch (const std::bad_alloc&) {
    fmt::print(stderr, "palpate: {}: there is not enough memory: use a smaller image\n",
               options.in);
    return 1;
  } catch (const std::exception& e) {
    fmt::print(stderr, "palpate: internal error: {}: please report it with the command\n",
               e.what());
    return 3;
  }
  return 2;
}
