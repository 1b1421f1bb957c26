/// Common result of the importer's readers: arrays and their positions.
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

/// file = linear * (i, j, k) + origin.
struct Affine {
  Mat3 linear = Mat3::Identity();
  Vec3 origin = Vec3::Zero();
};

/// Adjacent slices of an image: points with neighbouring k.
struct Slab {
  int first = 0;
  int count = 0;

  [[nodiscard]] int end() const { return first + count; }
  [[nodiscard]] bool operator==(const Slab&) const = default;
};

/// One value, vector or tensor for each point.
struct Array {
  std::string name;
  Values values;
  std::string unit;    ///< Unit of the values; empty: not known.
  std::string given;   ///< Its name in the file, if several arrays share it.
  bool axial = false;  ///< The sign of the vectors has no meaning, as for fibres.
};

/// Receives the progress of work, from 0 to 1.
using Progress = std::function<void(double done)>;

struct Resampled;

/// Edges of cubes for resampling a mesh, in the file's unit.
struct SuggestedVoxel {
  /// `by_cell`, or the least edge that makes at most kVoxelsPerPoint voxels for each of the mesh's
  /// points, or 33 x 33 x 33.
  double edge = 0.0;
  /// Half the edge of a cube with the median volume of the cells' boxes. At most 512 and at least
  /// 32 voxels along the mesh's longest side. If no cell has volume, a 64th of this side.
  double by_cell = 0.0;
  double voxels_by_cell = 0.0;  ///< Approximate number of voxels with `by_cell`.
};

/// Equal cells make 8 voxels per point at half a cell's edge. If most cells are small ones at a
/// wall, half their edge makes hundreds, which the large cells do not need.
inline constexpr double kVoxelsPerPoint = 16.0;

/// Cells with volume, as a mesh library holds them.
class Mesh {
 public:
  Mesh() = default;
  Mesh(const Mesh&) = delete;
  Mesh& operator=(const Mesh&) = delete;
  virtual ~Mesh() = default;

  [[nodiscard]] virtual SuggestedVoxel suggestVoxel() const = 0;

  /// Resamples all arrays of the mesh's points at once, on the same voxels. The first voxel is at
  /// the lowest corner of the bounds. Each value is the mesh's own interpolation in the cell that
  /// holds the voxel. Works leaf by leaf in parallel. Throws VolumeError if `voxel` makes too many
  /// voxels.
  [[nodiscard]] virtual std::vector<Resampled> resample(const std::vector<Array>& arrays,
                                                        double voxel, const std::string& file,
                                                        const Progress& progress) const = 0;
};

/// Points with arrays on them: those of an image or of a mesh.
struct Piece {
  std::shared_ptr<const Mesh> mesh;  ///< Null for an image.
  std::array<int, 3> size{};         ///< An image's points along i, j and k; i fastest.
  std::optional<Slab> held;          ///< The slices of an image with values here; unset: all.
  Affine file_from_index;            ///< Maps an image's indices, first point 0, 0, 0.
  Values hidden;         ///< An image's points, kUint8: not 0 has no data; may be empty.
  bool by_cell = false;  ///< The points of this image are another's cells.
  std::vector<Array> arrays;

  [[nodiscard]] bool isImage() const { return mesh == nullptr; }
  /// Returns the slices of an image that have values here.
  [[nodiscard]] Slab slices() const { return held.value_or(Slab{0, size[2]}); }
};

/// One step of a file, in the file's own space. If the format names a patient's axes, the space is
/// turned to +x right, +y front, +z up (RAS), so that volumes of one patient align.
struct Content {
  /// Arrays as in the file. Vectors have 3 components, in the file's space; tensors have 9, or 6 in
  /// VTK's order: xx yy zz xy yz xz.
  std::vector<Piece> pieces;
  Modality modality = Modality::kUnknown;
  std::string description;
  std::string length_unit;                        ///< "mm"; empty: not stated in the file.
  bool patient = false;                           ///< The file names a patient's axes.
  std::map<std::string, std::string> value_unit;  ///< Unit of each array.
  std::vector<std::string> notes;                 ///< Assumptions and losses, a line each.
};

/// The user's request to a reader.
struct Request {
  std::filesystem::path file;       ///< Or a folder of files.
  std::vector<std::string> fields;  ///< Arrays; empty: all.
  std::filesystem::path solution;   ///< PLOT3D's solution, beside its grid.
  std::string raw;                  ///< Layout of a raw file: JSON, or a file with it.
  std::string series;               ///< DICOM: number or identity of one of several.
  std::string as;       ///< "", "vector" or "tensor": meaning of a series of 3 or 6 steps.
  bool follow = false;  ///< Headers may name data files in other folders.
  Progress progress;
  /// Selects slices of an image with this size and place; empty: all are wanted. Readers that can
  /// do so read only these (Piece::held).
  std::function<Slab(const std::array<int, 3>& size, const Affine& file_from_index)> slices;
};

/// An open file.
class Reader {
 public:
  Reader() = default;
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;
  virtual ~Reader() = default;

  /// Times of the steps of a series; empty if there is only one step.
  [[nodiscard]] virtual std::vector<double> times() const { return {}; }
  /// Throws VolumeError.
  [[nodiscard]] virtual Content read(std::size_t step) = 0;
};

/// Returns the slices of this image to read, for readers that can read a part: all, unless the
/// request selects fewer. Sets `image.held`; size and place of `image` have to be set.
[[nodiscard]] Slab slicesToRead(const Request& request, Piece& image);

/// Makes a reader of a format without series, from its `read` function.
[[nodiscard]] std::unique_ptr<Reader> oneStep(const Request& request,
                                              Content (*read)(const Request&));

/// Detects a file's format, by its first bytes and otherwise by its name, and opens it. Throws
/// VolumeError if the file cannot be imported, with the format that it resembles.
[[nodiscard]] std::unique_ptr<Reader> openAny(const Request& request);

// One function for each format. Each throws VolumeError if the file does not fit.

/// Opens a file of a series, or a folder of files.
[[nodiscard]] std::unique_ptr<Reader> openDicom(const Request& request);
/// Opens CGNS in its older form, ADF.
[[nodiscard]] std::unique_ptr<Reader> openCgns(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openMetaImage(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openNifti(const Request& request);
/// Opens netCDF or HDF5: CF conventions, Exodus II, CGNS.
[[nodiscard]] std::unique_ptr<Reader> openNetcdf(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openNrrd(const Request& request);
/// Opens a case, given by its folder or by the file in it that ParaView opens.
[[nodiscard]] std::unique_ptr<Reader> openFoam(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openPlot3d(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openRaw(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openVtkLegacy(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openVtkXml(const Request& request);

}  // namespace palpate::importer
