/// What every reader of the importer gives: arrays, and where they are.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <vtkDataObject.h>
#include <vtkSmartPointer.h>

#include "palpate/engine/types.h"

namespace palpate::importer {

/// file = linear * (i, j, k) + origin.
struct Affine {
  Mat3 linear = Mat3::Identity();
  Vec3 origin = Vec3::Zero();
};

/// How a patient's image was taken: what its values mean.
enum class Modality : std::uint8_t { kUnknown, kCt, kMr };

/// One step of a file. The file's own space is kept; where a format names a patient's axes, it is
/// turned to +x right, +y front, +z up (RAS), so that volumes of one patient lie on each other.
struct Content {
  /// A vtkDataSet or a vtkMultiBlockDataSet of them. An image's arrays are point data; vectors have
  /// 3 components, in the file's space; tensors 9, or 6 in VTK's order: xx yy zz xy yz xz.
  vtkSmartPointer<vtkDataObject> data;
  /// If set, this places an image's first voxel (of index 0, 0, 0) and its neighbours, and not the
  /// image's own origin, spacing and direction.
  std::optional<Affine> file_from_index;
  Modality modality = Modality::kUnknown;
  std::string description;
  std::string length_unit;                        ///< "mm"; empty: the file does not say.
  std::map<std::string, std::string> value_unit;  ///< By array.
  std::vector<std::string> notes;                 ///< What was assumed or lost, a line each.
};

/// Told how far work is, from 0 to 1.
using Progress = std::function<void(double done)>;

/// What the user asked for.
struct Request {
  std::filesystem::path file;       ///< Or a folder of them.
  std::vector<std::string> fields;  ///< Arrays; empty: all.
  std::filesystem::path solution;   ///< PLOT3D's, beside its grid.
  std::string raw;                  ///< Layout of a raw file: JSON, or a file of it.
  std::string series;               ///< DICOM: number or identity of one of several.
  std::string as;                   ///< "", "vector" or "tensor": what a series of 3 or 6 steps is.
  Progress progress;
};

/// An open file.
class Reader {
 public:
  Reader() = default;
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;
  virtual ~Reader() = default;

  /// Of the steps of a series; empty where there is but one.
  [[nodiscard]] virtual std::vector<double> times() const { return {}; }
  /// Throws VolumeError.
  [[nodiscard]] virtual Content read(std::size_t step) = 0;
};

/// A reader of a format that has no series: all its work is `read`.
[[nodiscard]] std::unique_ptr<Reader> oneStep(const Request& request,
                                              Content (*read)(const Request&));

/// Finds what a file is, by its first bytes and else by its name, and opens it. Throws VolumeError,
/// with what the file looks like where it cannot be imported.
[[nodiscard]] std::unique_ptr<Reader> openAny(const Request& request);

/// One format each. Throw VolumeError where the file does not fit.
/// A file of a series, or a folder of them.
[[nodiscard]] std::unique_ptr<Reader> openDicom(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openExodus(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openMetaImage(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openNifti(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openNrrd(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openPlot3d(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openRaw(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openVtkLegacy(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openVtkXml(const Request& request);

}  // namespace palpate::importer
