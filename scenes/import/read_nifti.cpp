/// NIfTI through VTK. The file's own space: sform, else qform, else the spacing; RAS by definition.
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <Eigen/LU>
#include <fmt/format.h>
#include <vtkDataArray.h>
#include <vtkImageData.h>
#include <vtkMatrix4x4.h>
#include <vtkNIFTIImageHeader.h>
#include <vtkNIFTIImageReader.h>
#include <vtkNew.h>
#include <vtkObjectFactory.h>
#include <vtkPointData.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/import/header_checks.h"
#include "palpate/scenes/import/reader.h"
#include "palpate/scenes/import/values.h"
#include "palpate/scenes/import/vtk_run.h"

namespace palpate::importer {
namespace {

namespace fs = std::filesystem;

/// VTK reads the first volume of a series, or all; here any.
class VolumeReader : public vtkNIFTIImageReader {
 public:
  static VolumeReader* New();
  // NOLINTBEGIN(modernize-use-override): VTK's macro
  vtkTypeMacro(VolumeReader, vtkNIFTIImageReader)
      // NOLINTEND(modernize-use-override)

      unsigned long volume = 0;

 protected:
  int RequestInformation(vtkInformation* request, vtkInformationVector** in,
                         vtkInformationVector* out) override {
    const int done = Superclass::RequestInformation(request, in, out);
    const auto points = static_cast<unsigned long>(this->Dim[1]) *
                        static_cast<unsigned long>(this->Dim[2]) *
                        static_cast<unsigned long>(this->Dim[3]);
    const auto bytes = static_cast<unsigned long>(this->GetNIFTIHeader()->GetBitPix() / 8);
    this->HeaderSize += this->volume * points * bytes;
    return done;
  }
};
vtkStandardNewMacro(VolumeReader);

/// What the values of a voxel are.
enum class Meaning : std::uint8_t { kScalar, kVector, kTensor };

class NiftiReader final : public Reader {
 public:
  explicit NiftiReader(const Request& request) : request_(request), file_(request.file.string()) {
    vtkNew<vtkNIFTIImageReader> reader;
    reader->SetFileName(request.file.c_str());
    if (reader->CanReadFile(request.file.c_str()) == 0) {
      refuse("its NIfTI header is damaged", "check what wrote it");
    }
    reader->UpdateInformation();
    if (reader->GetErrorCode() != 0) refuse("its NIfTI header is damaged", "check what wrote it");
    vtkNIFTIImageHeader* header = reader->GetNIFTIHeader();
    dims_ = static_cast<int>(header->GetDim(0));
    for (int i = 1; i < 8; ++i) {
      size_[static_cast<std::size_t>(i)] = i <= dims_ ? header->GetDim(i) : 1;
    }
    step_ = header->GetPixDim(4);
    start_ = header->GetTOffset();
    classify(header);
    weigh(header);
  }

  [[nodiscard]] std::vector<double> times() const override {
    std::vector<double> times;
    if (!series_) return times;
    const double step = std::isfinite(step_) && step_ > 0.0 ? step_ : 1.0;
    const double start = std::isfinite(start_) ? start_ : 0.0;
    for (vtkTypeInt64 i = 0; i < size_[4]; ++i) {
      times.push_back(start + step * static_cast<double>(i));
    }
    return times;
  }

  Content read(std::size_t step) override {
    vtkNew<VolumeReader> reader;
    reader->SetFileName(request_.file.c_str());
    reader->SetTimeAsVector(as_components_);
    reader->volume = series_ ? step : 0;
    run(reader, file_, request_.progress);

    Content content;
    content.notes = notes_;
    auto* image = reader->GetOutput();
    content.data = image;
    const Affine map = mapOf(reader);
    content.file_from_index = map;
    vtkSmartPointer<vtkDataArray> values = image->GetPointData()->GetScalars();
    if (values == nullptr) refuse("it has no values", "export it again");
    image->GetPointData()->Initialize();
    values = rescaled(values, reader->GetRescaleSlope(), reader->GetRescaleIntercept());
    if (meaning_ == Meaning::kTensor) {
      values = picked(values, as_components_ ? kUpperTriangle : kLowerTriangle);
    }
    if (as_components_) values = turned(values, fslFrame(map, reader->GetQFac() < 0.0));
    const char* names[] = {"density", "vector", "tensor"};
    values->SetName(names[static_cast<int>(meaning_)]);
    image->GetPointData()->AddArray(values);

    vtkNIFTIImageHeader* header = reader->GetNIFTIHeader();
    content.description = header->GetDescrip();
    switch (header->GetXYZTUnits() & 7) {
      case 1:
        content.length_unit = "m";
        break;
      case 2:
        content.length_unit = "mm";
        break;
      case 3:
        content.length_unit = "um";
        break;
      default:
        break;
    }
    return content;
  }

 private:
  [[noreturn]] void refuse(const std::string& why, const std::string& remedy) const {
    throw VolumeError(file_, why, remedy);
  }

  void classify(vtkNIFTIImageHeader* header) {
    int bits = 0;
    switch (header->GetDataType()) {
      case vtkNIFTIImageHeader::TypeUInt8:
      case vtkNIFTIImageHeader::TypeInt8:
        bits = 8;
        break;
      case vtkNIFTIImageHeader::TypeInt16:
      case vtkNIFTIImageHeader::TypeUInt16:
        bits = 16;
        break;
      case vtkNIFTIImageHeader::TypeInt32:
      case vtkNIFTIImageHeader::TypeUInt32:
      case vtkNIFTIImageHeader::TypeFloat32:
        bits = 32;
        break;
      case vtkNIFTIImageHeader::TypeInt64:
      case vtkNIFTIImageHeader::TypeUInt64:
      case vtkNIFTIImageHeader::TypeFloat64:
        bits = 64;
        break;
      case vtkNIFTIImageHeader::TypeRGB24:
      case vtkNIFTIImageHeader::TypeRGBA32:
        refuse("its values are colours, which cannot be felt", "export it in grey values");
      case vtkNIFTIImageHeader::TypeComplex64:
      case vtkNIFTIImageHeader::TypeComplex128:
      case vtkNIFTIImageHeader::TypeComplex256:
        refuse("its values are complex, which cannot be felt", "export their magnitude");
      default:
        refuse(
            fmt::format("its values are of a type, {}, that is not known", header->GetDataType()),
            "export it as short or float");
    }
    if (header->GetBitPix() != bits) {
      refuse(
          fmt::format("its values have {} bits, but {} by their type", header->GetBitPix(), bits),
          "check what wrote it");
    }
    if (size_[6] * size_[7] != 1) {
      refuse(fmt::format("it has {} dimensions", dims_), "export it with 3, 4 or 5");
    }
    series_ = size_[4] > 1;
    const int intent = header->GetIntentCode();
    if (size_[5] > 1) {
      if (size_[5] == 3) {
        meaning_ = Meaning::kVector;
      } else if (size_[5] == 6 &&
                 (intent == vtkNIFTIImageHeader::IntentSymMatrix || request_.as == "tensor")) {
        meaning_ = Meaning::kTensor;
      } else {
        refuse(fmt::format("it has {} values a voxel", size_[5]),
               "export one, three (a vector) or six (a symmetric matrix)");
      }
      notes_.emplace_back("components are taken along x (right), y (front) and z (up)");
      return;
    }
    if (request_.as.empty()) return;
    const int expected = request_.as == "vector" ? 3 : 6;
    if (size_[4] != expected) {
      refuse(fmt::format("it has {} volumes, not the {} of a {}", size_[4], expected, request_.as),
             "leave --as out");
    }
    as_components_ = true;
    series_ = false;
    meaning_ = request_.as == "vector" ? Meaning::kVector : Meaning::kTensor;
    notes_.emplace_back(
        "components are taken along the voxel axes, as FSL writes them (its x is mirrored where "
        "the "
        "axes are right-handed)");
  }

  /// Whether the file can hold what its header says, before memory is taken for it.
  void weigh(vtkNIFTIImageHeader* header) const {
    const std::vector<double> sizes(size_.begin() + 1, size_.end());
    const double bytes =
        bytesOf(request_.file, sizes, static_cast<double>(header->GetBitPix()) / 8.0);
    if (header->GetVoxOffset() < 0) refuse("its voxels begin nowhere", "check what wrote it");
    const fs::path data = dataFile();
    const double least = bytes + static_cast<double>(header->GetVoxOffset());
    checkHeld(request_.file, data, sizeOfData(request_.file, data),
              data.extension() == ".gz" ? leastDeflated(least) : least);
  }

  /// Of the pair name.hdr and name.img the second.
  [[nodiscard]] fs::path dataFile() const {
    fs::path data = request_.file;
    const bool packed = data.extension() == ".gz";
    if (packed) data.replace_extension();
    if (data.extension() != ".hdr") return request_.file;
    data.replace_extension(".img");
    if (fs::exists(data)) return data;
    fs::path gz = data;
    gz += ".gz";
    return packed || fs::exists(gz) ? gz : data;
  }

  static Affine mapOf(vtkNIFTIImageReader* reader) {
    Affine map;
    const double* spacing = reader->GetDataSpacing();
    vtkMatrix4x4* matrix = reader->GetSFormMatrix();
    if (matrix == nullptr) matrix = reader->GetQFormMatrix();
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < 3; ++column) {
        const double direction =
            matrix == nullptr ? (row == column ? 1.0 : 0.0) : matrix->GetElement(row, column);
        map.linear(row, column) = direction * spacing[column];
      }
      map.origin[row] = matrix == nullptr ? 0.0 : matrix->GetElement(row, 3);
    }
    return map;
  }

  /// FSL's components are along the file's voxel axes, of which it mirrors x where they are
  /// right-handed (fsl.fmrib.ox.ac.uk, "What conventions do the bvecs use?").
  static Mat3 fslFrame(const Affine& map, bool reversed) {
    Mat3 axes = map.linear;
    if (reversed) axes.col(2) = -axes.col(2);  // VTK turned the slices round
    if (axes.determinant() > 0.0) axes.col(0) = -axes.col(0);
    axes.colwise().normalize();
    return axes;
  }

  Request request_;
  std::string file_;
  int dims_ = 0;
  std::array<vtkTypeInt64, 8> size_{};
  double step_ = 1.0;
  double start_ = 0.0;
  Meaning meaning_ = Meaning::kScalar;
  bool series_ = false;
  bool as_components_ = false;  ///< The volumes of a 4-D file.
  std::vector<std::string> notes_;
};

}  // namespace

std::unique_ptr<Reader> openNifti(const Request& request) {
  return std::make_unique<NiftiReader>(request);
}

}  // namespace palpate::importer
