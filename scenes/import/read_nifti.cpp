/// NIfTI through VTK. The file's own space: sform, else qform, else the spacing; RAS by definition.
#include <vtkDataArray.h>
#include <vtkFloatArray.h>
#include <vtkImageData.h>
#include <vtkMatrix4x4.h>
#include <vtkNIFTIImageHeader.h>
#include <vtkNIFTIImageReader.h>
#include <vtkNew.h>
#include <vtkPointData.h>

#include "engine/error.h"
#include "scenes/import/reader.h"
#include "scenes/import/vtk_run.h"

namespace palpate::importer {
namespace {

/// slope * value + offset, as floats.
vtkSmartPointer<vtkDataArray> rescaled(vtkDataArray* values, double slope, double offset) {
  auto out = vtkSmartPointer<vtkFloatArray>::New();
  out->SetNumberOfComponents(values->GetNumberOfComponents());
  out->SetNumberOfTuples(values->GetNumberOfTuples());
  const vtkIdType count = values->GetNumberOfValues();
  const int components = values->GetNumberOfComponents();
  for (vtkIdType i = 0; i < count; ++i) {
    const double value = values->GetComponent(i / components, static_cast<int>(i % components));
    out->SetValue(i, static_cast<float>(slope * value + offset));
  }
  return out;
}

class NiftiReader final : public Reader {
 public:
  explicit NiftiReader(Request request) : request_(std::move(request)) {}

  Content read(std::size_t /*step*/) override {
    vtkNew<vtkNIFTIImageReader> reader;
    reader->SetFileName(request_.file.c_str());
    run(reader, request_.file.string(), request_.progress);

    Content content;
    auto* image = reader->GetOutput();
    content.data = image;
    if (vtkDataArray* values = image->GetPointData()->GetScalars()) {
      const double slope = reader->GetRescaleSlope();
      const double offset = reader->GetRescaleIntercept();
      if (slope != 0.0 && (slope != 1.0 || offset != 0.0)) {
        image->GetPointData()->SetScalars(rescaled(values, slope, offset));
      }
      image->GetPointData()->GetScalars()->SetName("density");
    }
    vtkMatrix4x4* matrix = reader->GetSFormMatrix();
    if (matrix == nullptr) matrix = reader->GetQFormMatrix();
    if (matrix != nullptr) {
      Affine map;
      for (int row = 0; row < 3; ++row) {
        for (int column = 0; column < 3; ++column) {
          map.linear(row, column) = matrix->GetElement(row, column) * image->GetSpacing()[column];
        }
        map.origin[row] = matrix->GetElement(row, 3);
      }
      content.file_from_index = map;
    }
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
  Request request_;
};

}  // namespace

std::unique_ptr<Reader> openNifti(const Request& request) {
  vtkNew<vtkNIFTIImageReader> reader;
  if (reader->CanReadFile(request.file.c_str()) == 0) {
    throw VolumeError(request.file.string(), "its NIfTI header is damaged", "check what wrote it");
  }
  return std::make_unique<NiftiReader>(request);
}

}  // namespace palpate::importer
