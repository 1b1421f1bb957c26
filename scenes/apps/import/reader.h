/// The common result of all readers of the importer: arrays, and the positions of their values.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "palpate/engine/types.h"
#include "palpate/scenes/apps/import/values.h"
#include "palpate/scenes/guess/modality.h"

namespace palpate::importer {

struct Affine {
  Mat3 linear = Mat3::Identity();
  Vec3 origin = Vec3::Zero();
};

/// A range of consecutive slices of an image. A slice has all points with the same k.
struct Slab {
  int first = 0;
  int count = 0;

  [[nodiscard]] int end() const { return first + count; }
  [[nodiscard]] bool operator==(const Slab&) const = default;
};

/// A scalar, a vector or a tensor for each point.
struct Array {
  std::string name;
  Values values;
  std::string unit;    ///< Unit of the values; empty: not known.
  std::string given;   ///< Name of the array in the file, if several arrays have this name.
  bool axial = false;  ///< True if the sign of the vectors has no meaning, as for fibres.
  /// True if doubles of a scalar hold whole numbers of the file.
  bool whole = false;
  /// Whole number that was subtracted from a scalar: value in the file = value + value_offset.
  double value_offset = 0.0;
};

/// Receives the progress of a task, from 0 to 1.
using Progress = std::function<void(double done)>;

struct Resampled;

/// Suggested edges of cubic voxels for a mesh, in the file's unit.
struct SuggestedVoxel {
  /// `by_cell`, or a larger edge that limits the voxels to kVoxelsPerPoint for each point of the
  /// mesh. 33 x 33 x 33 voxels are always allowed.
  double edge = 0.0;
  /// Half the edge of a cube with the median volume of the cells' bounding boxes, within 32 to 512
  /// voxels along the mesh's longest side. Without volumes, 64 voxels are along this side.
  double by_cell = 0.0;
  double voxels_by_cell = 0.0;
};

/// Limit of the voxels for each point of a mesh. Equal cells need 8. If most cells are small cells
/// at a wall, half their edge would make hundreds, which the large cells do not need.
inline constexpr double kVoxelsPerPoint = 16.0;

class Mesh {
 public:
  Mesh() = default;
  Mesh(const Mesh&) = delete;
  Mesh& operator=(const Mesh&) = delete;
  virtual ~Mesh() = default;

  [[nodiscard]] virtual SuggestedVoxel suggestVoxel() const = 0;

  /// Resamples arrays of the mesh's points on the same voxels. The first voxel is at the lowest
  /// corner of the mesh's bounds. The mesh interpolates in the cell that contains a voxel's centre.
  /// Works in parallel. Throws VolumeError if there would be too many voxels.
  [[nodiscard]] virtual std::vector<Resampled> resample(const std::vector<Array>& arrays,
                                                        double voxel, const std::string& file,
                                                        const Progress& progress) const = 0;
};

struct Piece {
  std::shared_ptr<const Mesh> mesh;  ///< Null for an image.
  std::array<int, 3> size{};  ///< For an image: number of points along i, j and k; i is fastest.
  std::optional<Slab> held;   ///< For an image: slices in memory; no value: all slices.
  /// For an image: transform from indices to positions; the first point is 0, 0, 0.
  Affine file_from_index;
  /// For an image with uneven slices: index k of each slice on the even lattice of file_from_index.
  /// Begins with 0, increases strictly, and ends with a whole number. `size` then counts the slices
  /// of the file. Empty: the slices are at 0, 1, 2, ...
  std::vector<double> depths;
  /// For an image: a kUint8 array that is not 0 at points without data; may be empty.
  Values hidden;
  /// True if the points of this image are the centres of another image's cells.
  bool by_cell = false;
  std::vector<Array> arrays;

  [[nodiscard]] bool isImage() const { return mesh == nullptr; }
  [[nodiscard]] Slab slices() const { return held.value_or(Slab{0, size[2]}); }
};

/// Content of a file at one time step, in the file's own space. If the format names the axes of a
/// patient, the space is RAS (+x right, +y front, +z up).
struct Content {
  /// Vectors have 3 components in the file's space. Tensors have 9 components, or 6 in VTK's order:
  /// xx yy zz xy yz xz.
  std::vector<Piece> pieces;
  Modality modality = Modality::kUnknown;
  std::string description;
  std::string length_unit;  ///< Unit of lengths, such as "mm"; empty: not stated in the file.
  bool patient = false;     ///< True if the file names the axes of a patient.
  /// Unit of each array's values, by the array's name.
  std::map<std::string, std::string> value_unit;
  std::vector<std::string> notes;  ///< Assumptions and losses, one line each.
};

/// Options of the user that concern the readers.
struct Request {
  std::filesystem::path file;  ///< A file, or a folder with files.
  std::vector<std::string> fields;
  std::filesystem::path solution;  ///< For PLOT3D: the solution file that belongs to the grid file.
  std::string raw;  ///< Layout of a file without a header: JSON, or the path of a file with JSON.
  std::string series;  ///< For DICOM: number, UID or description of the series.
  /// Meaning of a series of 3 or 6 steps: "vector" or "tensor"; empty: time steps.
  std::string as;
  bool follow = false;  ///< If true, a header may name data files outside its folder.
  Progress progress;
  /// Returns the slices that are needed of an image. Empty: all. Readers that can read a part of a
  /// file read only these slices (Piece::held).
  std::function<Slab(const std::array<int, 3>& size, const Affine& file_from_index)> slices;
};

class Reader {
 public:
  Reader() = default;
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;
  virtual ~Reader() = default;

  [[nodiscard]] virtual std::vector<double> times() const { return {}; }
  /// Reads one step. Throws VolumeError.
  [[nodiscard]] virtual Content read(std::size_t step) = 0;
};

/// Sets `image.held` to the slices that must be read (Request::slices), and returns these. The size
/// and the transform of `image` must be set. For readers that can read a part of a file.
[[nodiscard]] Slab slicesToRead(const Request& request, Piece& image);

[[nodiscard]] std::unique_ptr<Reader> oneStep(const Request& request,
                                              Content (*read)(const Request&));

/// Detects the format by the first bytes, otherwise by the name, and opens the file. Throws
/// VolumeError, which names the format, if the file cannot be imported.
[[nodiscard]] std::unique_ptr<Reader> openAny(const Request& request);

// Each function opens the files of some formats, and throws VolumeError for invalid files.

/// Opens a DICOM series, given by one of its files or by a folder.
[[nodiscard]] std::unique_ptr<Reader> openDicom(const Request& request);
/// Opens CGNS files in the older format ADF.
[[nodiscard]] std::unique_ptr<Reader> openCgns(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openMetaImage(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openNifti(const Request& request);
/// Opens netCDF and HDF5 files: CF conventions, WRF, Exodus II, CGNS or VTK's HDF5 format.
[[nodiscard]] std::unique_ptr<Reader> openNetcdf(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openNrrd(const Request& request);
/// Opens an OpenFOAM case, given by its folder or by its file .foam for ParaView.
[[nodiscard]] std::unique_ptr<Reader> openFoam(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openPlot3d(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openRaw(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openVtkLegacy(const Request& request);
/// Opens VTK's XML formats, and ParaView's collections of XML files (.pvd).
[[nodiscard]] std::unique_ptr<Reader> openVtkXml(const Request& request);

}  // namespace palpate::importer
