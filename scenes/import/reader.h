/// What every reader of the importer gives: arrays, and where they are.
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
#include "palpate/scenes/import/values.h"
#include "palpate/scenes/modality.h"

namespace palpate::importer {

/// file = linear * (i, j, k) + origin.
struct Affine {
  Mat3 linear = Mat3::Identity();
  Vec3 origin = Vec3::Zero();
};

/// Slices of an image that lie on each other: points with neighbouring k.
struct Slab {
  int first = 0;
  int count = 0;

  [[nodiscard]] int end() const { return first + count; }
  [[nodiscard]] bool operator==(const Slab&) const = default;
};

/// One value, vector or tensor a point.
struct Array {
  std::string name;
  Values values;
  std::string unit;    ///< Of the values; empty: not known.
  std::string given;   ///< Its name in the file, where others share it.
  bool axial = false;  ///< Vectors whose sign means nothing, as a fibre's direction.
};

/// Told how far work is, from 0 to 1.
using Progress = std::function<void(double done)>;

struct Resampled;

/// Edges of cubes to resample a mesh to, in the file's unit.
struct SuggestedVoxel {
  /// `by_cell`, or the least that makes at most kVoxelsPerPoint voxels for each of the mesh's
  /// points, or 33 x 33 x 33.
  double edge = 0.0;
  /// Half the edge of the median cell: the cube of as much volume. Not more than 512 voxels along
  /// the longest side of the mesh, and not less than 32; a 64th of that side where no cell has
  /// volume.
  double by_cell = 0.0;
  double voxels_by_cell = 0.0;  ///< How many these would be, about.
};

/// Half the edge of cells that are all alike makes 8. Where most cells are small ones at a wall, it
/// makes hundreds, which the large cells have no use for.
inline constexpr double kVoxelsPerPoint = 16.0;

/// Cells with volume, as a library of meshes holds them.
class Mesh {
 public:
  Mesh() = default;
  Mesh(const Mesh&) = delete;
  Mesh& operator=(const Mesh&) = delete;
  virtual ~Mesh() = default;

  [[nodiscard]] virtual SuggestedVoxel suggestVoxel() const = 0;

  /// All arrays of its points at once, on the same voxels: the first at the lowest corner of its
  /// bounds, each with the interpolation of the mesh's own cell that holds it. Works leaf by leaf
  /// in parallel. Throws VolumeError for a voxel that would make too many of them.
  [[nodiscard]] virtual std::vector<Resampled> resample(const std::vector<Array>& arrays,
                                                        double voxel, const std::string& file,
                                                        const Progress& progress) const = 0;
};

/// Points with arrays on them: an image's or a mesh's.
struct Piece {
  std::shared_ptr<const Mesh> mesh;  ///< Null for an image.
  std::array<int, 3> size{};         ///< An image's points along i, j and k; i fastest.
  std::optional<Slab> held;          ///< An image's, of which alone values are here; none: all.
  Affine file_from_index;            ///< An image's: of the point with index 0, 0, 0, and the rest.
  Values hidden;                     ///< An image's points, kUint8: not 0 is no data; or none.
  bool by_cell = false;              ///< An image whose points are the cells of another.
  std::vector<Array> arrays;

  [[nodiscard]] bool isImage() const { return mesh == nullptr; }
  /// Of an image: whose values are here.
  [[nodiscard]] Slab slices() const { return held.value_or(Slab{0, size[2]}); }
};

/// One step of a file. The file's own space is kept; where a format names a patient's axes, it is
/// turned to +x right, +y front, +z up (RAS), so that volumes of one patient lie on each other.
struct Content {
  /// Arrays as the file has them. Vectors have 3 components, in the file's space; tensors 9, or 6
  /// in VTK's order: xx yy zz xy yz xz.
  std::vector<Piece> pieces;
  Modality modality = Modality::kUnknown;
  std::string description;
  std::string length_unit;                        ///< "mm"; empty: the file does not say.
  bool patient = false;                           ///< The file names a patient's axes.
  std::map<std::string, std::string> value_unit;  ///< By array.
  std::vector<std::string> notes;                 ///< What was assumed or lost, a line each.
};

/// What the user asked for.
struct Request {
  std::filesystem::path file;       ///< Or a folder of them.
  std::vector<std::string> fields;  ///< Arrays; empty: all.
  std::filesystem::path solution;   ///< PLOT3D's, beside its grid.
  std::string raw;                  ///< Layout of a raw file: JSON, or a file of it.
  std::string series;               ///< DICOM: number or identity of one of several.
  std::string as;                   ///< "", "vector" or "tensor": what a series of 3 or 6 steps is.
  bool follow = false;              ///< Headers may name data files in other folders.
  Progress progress;
  /// Where not all slices of an image are wanted: which, of one of that size and place. A reader
  /// that can takes these alone (Piece::held).
  std::function<Slab(const std::array<int, 3>& size, const Affine& file_from_index)> slices;
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

/// What a reader that can read a part of an image reads of this one: all of it, if nobody asks for
/// less. Says in `image` what it is, once its size and place are there.
[[nodiscard]] Slab slicesToRead(const Request& request, Piece& image);

/// A reader of a format that has no series: all its work is `read`.
[[nodiscard]] std::unique_ptr<Reader> oneStep(const Request& request,
                                              Content (*read)(const Request&));

/// Finds what a file is, by its first bytes and else by its name, and opens it. Throws VolumeError,
/// with what the file looks like where it cannot be imported.
[[nodiscard]] std::unique_ptr<Reader> openAny(const Request& request);

/// One format each. Throw VolumeError where the file does not fit.
/// A file of a series, or a folder of them.
[[nodiscard]] std::unique_ptr<Reader> openDicom(const Request& request);
/// CGNS's older form, ADF.
[[nodiscard]] std::unique_ptr<Reader> openCgns(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openGrib(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openMetaImage(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openNifti(const Request& request);
/// NetCDF or HDF5: CF conventions, Exodus II, CGNS.
[[nodiscard]] std::unique_ptr<Reader> openNetcdf(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openNrrd(const Request& request);
/// A case: its folder, or a file in it by which ParaView opens it.
[[nodiscard]] std::unique_ptr<Reader> openFoam(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openPlot3d(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openRaw(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openVtkLegacy(const Request& request);
[[nodiscard]] std::unique_ptr<Reader> openVtkXml(const Request& request);

}  // namespace palpate::importer
