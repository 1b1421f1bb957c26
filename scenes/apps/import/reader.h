/// The result of all readers of the importer: arrays, and the positions of their values.
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
#include "palpate/samplers/grid/volume.h"
#include "palpate/scenes/apps/import/values.h"
#include "palpate/scenes/guess/modality.h"

namespace palpate::importer {

struct Affine {
  Mat3 linear = Mat3::Identity();
  Vec3 origin = Vec3::Zero();
};

/// A range of consecutive slices of an image. A slice is all points with the same k.
struct Slab {
  int first = 0;
  int count = 0;

  [[nodiscard]] int end() const { return first + count; }
  [[nodiscard]] bool operator==(const Slab&) const = default;
};

/// A scalar, a vector or a tensor at each point.
struct Array {
  std::string name;
  Values values;
  std::string unit;    ///< Unit of the values; empty: not known.
  std::string given;   ///< `name` without the number that makes it unique; set by makeReady().
  bool axial = false;  ///< True if vectors v and -v mean the same, as for fibres.
  /// True if a scalar's doubles are whole numbers in the file.
  bool whole = false;
  /// Whole number that was subtracted from a scalar: value in the file = value + value_offset.
  double value_offset = 0.0;
  /// For a segmentation: its labels. Its values must not be blended, and 0 is its background.
  std::optional<std::vector<Label>> labels = std::nullopt;
};

/// Receives the progress of a task, 0 to 1.
using Progress = std::function<void(double done)>;

struct Resampled;

/// Suggested edges of cubic voxels for a mesh, in the file's unit. If the mesh has cells, they are
/// rounded to two digits.
struct SuggestedVoxel {
  /// `by_cell`, or the larger edge that limits the voxels to kVoxelsPerPoint per point of the mesh.
  /// 33 x 33 x 33 voxels are always allowed.
  double edge = 0.0;
  /// Half the edge of a cube with the median volume of the cells' bounding boxes, limited to 32 to
  /// 512 voxels along the mesh's longest side. For a mesh without cells: the edge for 64 voxels
  /// along this side.
  double by_cell = 0.0;
  double voxels_by_cell = 0.0;  ///< Estimated number of voxels in the mesh with `by_cell`.
};

/// Largest number of voxels per point of a mesh. With half the cells' edge, a mesh of equal cells
/// needs about 8. A mesh whose cells are mostly small cells at a wall would need hundreds, which
/// are useless in its large cells.
inline constexpr double kVoxelsPerPoint = 16.0;

class Mesh {
 public:
  Mesh() = default;
  Mesh(const Mesh&) = delete;
  Mesh& operator=(const Mesh&) = delete;
  virtual ~Mesh() = default;

  [[nodiscard]] virtual SuggestedVoxel suggestVoxel() const = 0;

  /// Resamples arrays of the mesh's points to the same voxels. The centre of the first voxel is at
  /// the lowest corner of the mesh's bounds. Interpolates in the cell that contains a voxel's
  /// centre. Works in parallel. Throws VolumeError as countCubes and cubes (grids.h) do, or if no
  /// voxel gets data.
  [[nodiscard]] virtual std::vector<Resampled> resample(const std::vector<Array>& arrays,
                                                        double voxel, const std::string& file,
                                                        const Progress& progress) const = 0;
};

struct Piece {
  std::shared_ptr<const Mesh> mesh;  ///< Null for an image.
  std::array<int, 3> size{};  ///< For an image: number of points along i, j and k; i fastest.
  std::optional<Slab> held;   ///< For an image: slices in memory; no value: all slices.
  /// For an image: transform from indices to positions. The first point has the indices 0, 0, 0.
  Affine file_from_index;
  /// For an image with uneven slices: index k of each slice on the even lattice of file_from_index.
  /// Begins with 0, increases strictly, and ends with a whole number; `size` still counts the
  /// file's slices. Empty: the slices are at 0, 1, 2, ...
  std::vector<double> depths;
  /// For an image: kUint8 array that is not 0 at points without data; may be empty.
  Values hidden;
  /// True if the points of this image are the centres of another image's cells.
  bool by_cell = false;
  std::vector<Array> arrays;

  [[nodiscard]] bool isImage() const { return mesh == nullptr; }
  [[nodiscard]] Slab slices() const { return held.value_or(Slab{0, size[2]}); }
};

/// Content of a file at one time step, in the file's own space. If the format names a patient's
/// axes, the space is RAS (+x right, +y front, +z up).
struct Content {
  /// Vectors have 3 components in the file's space, or 2 without z. Tensors have 9 components, or 6
  /// in VTK's order xx yy zz xy yz xz.
  std::vector<Piece> pieces;
  Modality modality = Modality::kUnknown;
  std::string description;
  std::string length_unit;  ///< Unit of lengths, such as "mm"; empty: not stated in the file.
  bool patient = false;     ///< True if the file names the axes of a patient.
  /// Units of values, by the name of the array. An array without an entry keeps Array::unit.
  std::map<std::string, std::string> value_unit;
  std::vector<std::string> notes;  ///< Assumptions and losses, one line each.
};

/// Edges of the voxels of an image along x, y and z.
struct Spacing {
  Vec3 edges = Vec3::Zero();
  std::string unit;  ///< "m", "cm", "mm" or "um"; empty: not stated.
};

/// The user's options for readers.
struct Request {
  std::filesystem::path file;  ///< A file, or a folder of files.
  std::vector<std::string> fields;
  std::filesystem::path solution;  ///< For PLOT3D: solution file of the grid file.
  std::string raw;                 ///< Layout of a file without header: JSON, or the path of JSON.
  std::optional<Spacing> spacing;  ///< For slices as pictures; no value: as the files state.
  std::string series;              ///< For DICOM: number, UID or description of the series.
  std::optional<std::size_t> level;  ///< For OME-Zarr: number of the level; 0 is the finest.
  /// Meaning of 3 or 6 steps or channels: "vector" or "tensor"; empty: steps are time steps.
  /// "displacement": vectors as ITK writes them, along LPS, which a reader converts like positions.
  std::string as;
  bool follow = false;  ///< True: a header may name data files outside its folder.
  bool timed = false;   ///< True if the user chose time steps: DICOM series may then be steps.
  Progress progress;
  /// Returns the slices of an image that are needed. If the function is empty, all slices are.
  /// Readers that can read a part of a file read only these slices (Piece::held). `is_packed`: the
  /// reader must unpack the file from its beginning each time it reads slices. `depth`: the number
  /// of consecutive slices that the reader decodes together.
  std::function<Slab(const std::array<int, 3>& size, const Affine& file_from_index, bool is_packed,
                     int depth)>
      slices;
};

class Reader {
 public:
  Reader() = default;
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;
  virtual ~Reader() = default;

  /// Returns the time of each step; empty for a file without steps. Most readers also return no
  /// time for a single step.
  [[nodiscard]] virtual std::vector<double> times() const { return {}; }
  /// Returns the unit of times() [s]; no value if the file does not state it, or if it is unknown.
  [[nodiscard]] virtual std::optional<double> timeUnit() const { return std::nullopt; }
  /// Reads one step. Throws VolumeError.
  [[nodiscard]] virtual Content read(std::size_t step) = 0;
};

/// Returns the length of a unit of time [s], such as "ms", "nanosecond" or "hours since
/// 2000-01-01"; no value if the unit is unknown.
[[nodiscard]] std::optional<double> secondsIn(const std::string& unit);

/// Sets `image.held` to the slices to read (Request::slices), and returns them. Size and transform
/// of `image` must be set. For readers that can read a part of a file.
[[nodiscard]] Slab slicesToRead(const Request& request, Piece& image, bool is_packed = false,
                                int depth = 1);

/// Returns the remedy if the values of an image with `slices` slices need more memory than is free.
/// @param first  What makes the file readable in parts, such as "unpack it with gunzip"; empty: it
///               is already.
[[nodiscard]] std::string remedyForMemory(const Request& request, int slices,
                                          const std::string& first = "");

[[nodiscard]] std::unique_ptr<Reader> oneStep(const Request& request,
                                              Content (*read)(const Request&));

/// Opens a file as raw values if Request::raw is set. Otherwise detects the format of a folder by
/// its files, and that of a file by the extension .foam, its first bytes or another extension. If
/// the input cannot be imported, throws VolumeError, which names the format if it is known. Throws
/// Error for an option that the format does not use.
[[nodiscard]] std::unique_ptr<Reader> openAny(const Request& request);

// Each function opens files of some formats, and throws VolumeError for an invalid file.

/// Opens a DICOM series, given by one of its files or by a folder.
[[nodiscard]] std::unique_ptr<Reader> openDicom(const Request& request);
/// Opens CGNS files in the older format ADF.
[[nodiscard]] std::unique_ptr<Reader> openCgns(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openMetaImage(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openNifti(const Request& request);
/// Opens netCDF and HDF5 files: CF conventions, WRF, MINC 1, Exodus II, CGNS or VTK's HDF5 format.
[[nodiscard]] std::unique_ptr<Reader> openNetcdf(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openNrrd(const Request& request);
/// Opens an OpenFOAM case by its folder, or by its file .foam for ParaView.
[[nodiscard]] std::unique_ptr<Reader> openFoam(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openPlot3d(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openRaw(const Request& request);
/// Opens a folder of slices as PNG or TIFF pictures, or a TIFF with several pages, as one volume.
[[nodiscard]] std::unique_ptr<Reader> openSlices(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openVtkLegacy(const Request& request);
/// Opens ParaView's JSON lists of VTK files and their times (.vtu.series, .vtk.series, ...).
[[nodiscard]] std::unique_ptr<Reader> openVtkSeries(const Request& request);
/// Opens VTK's XML formats, and ParaView's collections of XML files (.pvd).
[[nodiscard]] std::unique_ptr<Reader> openVtkXml(const Request& request);
/// Opens the folder of an OME-Zarr image, or of an array in Zarr version 2.
[[nodiscard]] std::unique_ptr<Reader> openZarr(const Request& request);

}  // namespace palpate::importer
