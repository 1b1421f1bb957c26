/// Reads or writes an image with ITK, as an oracle for palpate-import:
///
///   itk_oracle read FILE|FOLDER    prints x,y,z,value [mm, right anterior superior] at voxels and
///                                  between them; a folder holds one DICOM series (read by GDCM)
///   itk_oracle write FILE|FOLDER   writes a rotated image, in the format of FILE's name
#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <itkGDCMImageIO.h>
#include <itkGDCMSeriesFileNames.h>
#include <itkImage.h>
#include <itkImageFileReader.h>
#include <itkImageFileWriter.h>
#include <itkImageSeriesReader.h>
#include <itkImageSeriesWriter.h>
#include <itkLinearInterpolateImageFunction.h>
#include <itkMetaDataObject.h>
#include <itkNumericSeriesFileNames.h>
#include <random>
#include <string>

namespace {

using Read = itk::Image<double, 3>;
using Written = itk::Image<short, 3>;
using Slice = itk::Image<short, 2>;

Read::Pointer read(const std::string& path) {
  if (!std::filesystem::is_directory(path)) return itk::ReadImage<Read>(path);
  const auto names = itk::GDCMSeriesFileNames::New();
  names->SetDirectory(path);
  const auto reader = itk::ImageSeriesReader<Read>::New();
  reader->SetImageIO(itk::GDCMImageIO::New());
  reader->SetFileNames(names->GetInputFileNames());
  reader->Update();
  return reader->GetOutput();
}

/// Prints RAS coordinates; ITK's are LPS.
void print(const itk::Point<double, 3>& place, double value) {
  std::printf("%.9g,%.9g,%.9g,%.9g\n", -place[0], -place[1], place[2], value);
}

void printValues(const std::string& path) {
  constexpr int kPlaces = 2000;
  const Read::Pointer image = read(path);
  const auto between = itk::LinearInterpolateImageFunction<Read>::New();
  between->SetInputImage(image);
  const auto size = image->GetLargestPossibleRegion().GetSize();
  std::mt19937 random(1);
  std::puts("x,y,z,value");
  for (int i = 0; i < kPlaces; ++i) {
    itk::ContinuousIndex<double, 3> index;
    for (unsigned d = 0; d < 3; ++d) {
      index[d] = std::uniform_real_distribution<double>(0.0, double(size[d] - 1))(random);
      if (i % 2 == 0) index[d] = std::round(index[d]);
    }
    itk::Point<double, 3> place;
    image->TransformContinuousIndexToPhysicalPoint(index, place);
    print(place, between->EvaluateAtContinuousIndex(index));
  }
}

Written::Pointer turned() {
  const auto image = Written::New();
  image->SetRegions(Written::SizeType{{9, 8, 7}});
  image->SetSpacing(std::array{0.7, 0.9, 1.3}.data());
  image->SetOrigin(std::array{-31.0, 12.5, 104.0}.data());
  // Rotated by 0.4 rad about (1, 2, 3): all axes change and stay right-handed.
  const double c = std::cos(0.4);
  const double s = std::sin(0.4);
  const double n[3] = {1 / std::sqrt(14.0), 2 / std::sqrt(14.0), 3 / std::sqrt(14.0)};
  const double cross[3][3] = {{0, -n[2], n[1]}, {n[2], 0, -n[0]}, {-n[1], n[0], 0}};
  Written::DirectionType direction;
  for (unsigned i = 0; i < 3; ++i) {
    for (unsigned j = 0; j < 3; ++j) {
      direction[i][j] = (i == j ? c : 0.0) + (1 - c) * n[i] * n[j] + s * cross[i][j];
    }
  }
  image->SetDirection(direction);
  image->Allocate();
  for (long k = 0; k < 7; ++k) {
    for (long j = 0; j < 8; ++j) {
      for (long i = 0; i < 9; ++i) {
        image->SetPixel({{i, j, k}}, static_cast<short>(3 * i * i - 7 * j * k + 40 * k - 100));
      }
    }
  }
  return image;
}

void writeDicom(const std::string& folder) {
  std::filesystem::create_directory(folder);
  const Written::Pointer image = turned();
  const auto io = itk::GDCMImageIO::New();
  itk::EncapsulateMetaData<std::string>(io->GetMetaDataDictionary(), "0008|0060", "MR");
  const auto names = itk::NumericSeriesFileNames::New();
  names->SetSeriesFormat(folder + "/%d.dcm");
  names->SetStartIndex(1);
  names->SetEndIndex(image->GetLargestPossibleRegion().GetSize()[2]);
  const auto writer = itk::ImageSeriesWriter<Written, Slice>::New();
  writer->SetInput(image);
  writer->SetImageIO(io);
  writer->SetFileNames(names->GetFileNames());
  writer->Update();
}

}  // namespace

int main(int argc, char** argv) try {
  if (argc != 3) return 2;
  const std::string path = argv[2];
  if (std::string(argv[1]) == "read") {
    printValues(path);
  } else if (std::filesystem::path(path).has_extension()) {
    itk::WriteImage(turned(), path);
  } else {
    writeDicom(path);
  }
  return 0;
} catch (const std::exception& error) {
  std::fprintf(stderr, "itk_oracle: %s\n", error.what());
  return 1;
}
