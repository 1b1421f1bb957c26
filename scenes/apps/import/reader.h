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

/// An affine transform: linear * (i, j, k) + origin.
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
};

/// Receives the progress of a task, from 0 to 1.
using Progress = std::function<void(double done)>;

struct Resampled;

/// Suggested edges of the cubic voxels with which a mesh is resampled, in the file's unit.
struct SuggestedVoxel {
  /// The larger of `by_cell` and a limit. With the limit, there are at most kVoxelsPerPoint voxels
  /// for each point of the mesh; 33 x 33 x 33 voxels are always allowed.
  double edge = 0.0;
  /// Half the edge of a cube that has the median volume of the cells' bounding boxes. There are 32
  /// to 512 voxels along the mesh's longest side. If no cell has a volume, this is a 64th of that
  /// side.
  double by_cell = 0.0;
  double voxels_by_cell = 0.0;  ///< Approximate number of voxels for the edge `by_cell`.
};

/// Limit of the voxels for each point of a mesh. A mesh of equal cells needs 8 voxels for each
/// point. If most cells are small cells at a wall, half their edge would make hundreds of voxels
/// for each point, which the large cells do not need.
inline constexpr double kVoxelsPerPoint = 16.0;

/// The cells of a mesh that have a volume.
class Mesh {
 public:
  Mesh() = default;
  Mesh(const Mesh&) = delete;
  Mesh& operator=(const Mesh&) = delete;
  virtual ~Mesh() = default;

  [[nodiscard]] virtual SuggestedVoxel suggestVoxel() const = 0;

  /// Resamples several arrays of the mesh's points on the same voxels. The first voxel is at the
  /// lowest corner of the mesh's bounds. A value is interpolated by the mesh in the cell that
  /// contains the voxel's centre. Works in parallel, leaf by leaf. Throws VolumeError if there
  /// would be too many voxels.
  [[nodiscard]] virtual std::vector<Resampled> resample(const std::vector<Array>& arrays,
                                                        double voxel, const std::string& file,
                                                        const Progress& progress) const = 0;
};

/// The points of an image or a mesh, with the arrays on them.
struct Piece {
  std::shared_ptr<const Mesh> mesh;  ///< Null for an image.
  std::array<int, 3> size{};  ///< For an image: number of points along i, j and k; i is fastest.
  std::optional<Slab> held;   ///< For an image: slices whose values are in memory; no value: all.
  /// For an image: transform from indices to positions; the first point is 0, 0, 0.
  Affine file_from_index;
  /// For an image with changing distances between its slices: the index k of each slice on the even
  /// lattice of file_from_index. Begins with 0, increases strictly, and ends with a whole number.
  /// Empty: the slices are at 0, 1, 2, ... If not empty, `size` counts the slices of the file.
  std::vector<double> depths;
  /// For an image: a kUint8 array that is not 0 at points without data; may be empty.
  Values hidden;
  /// True if the points of this image are the centres of another image's cells.
  bool by_cell = false;
  std::vector<Array> arrays;

  [[nodiscard]] bool isImage() const { return mesh == nullptr; }
  /// Returns the slices of an image whose values are in memory.
  [[nodiscard]] Slab slices() const { return held.value_or(Slab{0, size[2]}); }
};

/// Content of a file at one time step, in the file's own space. If the format names the axes of a
/// patient, the space is converted to RAS (+x right, +y front, +z up), so that volumes of the same
/// patient are aligned.
struct Content {
  /// The arrays of the file. Vectors have 3 components in the file's space. Tensors have 9
  /// components, or 6 in VTK's order: xx yy zz xy yz xz.
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
  std::filesystem::path file;       ///< A file, or a folder with files.
  std::vector<std::string> fields;  ///< Names of the arrays to import; empty: all.
  std::filesystem::path solution;  ///< For PLOT3D: the solution file that belongs to the grid file.
  std::string raw;  ///< Layout of a file without a header: JSON, or the path of a file with JSON.
  std::string series;  ///< For DICOM: number, UID or description of the series.
  /// Meaning of a series of 3 or 6 steps: "vector" or "tensor"; empty: time steps.
  std::string as;
  bool follow = false;  ///< If true, a header may name data files outside its folder.
  Progress progress;
  /// Returns the slices that are needed of an image with this size and transform. Empty: all slices
  /// are needed. Readers that can read a part of a file read only these slices (Piece::held).
  std::function<Slab(const std::array<int, 3>& size, const Affine& file_from_index)> slices;
};

/// A file that is open for import.
class Reader {
 public:
  Reader() = default;
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;
  virtual ~Reader() = default;

  /// Returns the times of the steps of a series; empty if there is only one step.
  [[nodiscard]] virtual std::vector<double> times() const { return {}; }
  /// Reads one step. Throws VolumeError.
  [[nodiscard]] virtual Content read(std::size_t step) = 0;
};

/// Returns the slices of an image that must be read: all, unless the request selects fewer. Sets
/// `image.held`. The size and the transform of `image` must be set. For readers that can read a
/// part of a file.
[[nodiscard]] Slab slicesToRead(const Request& request, Piece& image);

/// Returns a reader for a format without series, which calls `read`.
[[nodiscard]] std::unique_ptr<Reader> oneStep(const Request& request,
                                              Content (*read)(const Request&));

/// Detects the format of a file by its first bytes, otherwise by its name, and opens the file.
/// Throws VolumeError if the file cannot be imported; the error names the detected format.
[[nodiscard]] std::unique_ptr<Reader> openAny(const Request& request);

// Each of these functions opens the files of some formats. Each throws VolumeError if the file is
// not valid.

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
