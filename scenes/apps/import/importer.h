#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "palpate/samplers/bricks/brick_grid.h"
#include "palpate/samplers/grid/volume.h"
#include "palpate/samplers/process_group.h"
#include "palpate/scenes/apps/import/displacement.h"
#include "palpate/scenes/apps/import/grids.h"
#include "palpate/scenes/apps/import/level_set.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/resample.h"
#include "palpate/scenes/apps/import/slab_group.h"

namespace palpate::importer {

struct Options {
  Request request;
  std::filesystem::path out;
  /// Edge of cubic voxels [unit of the file]; 0: the image's voxels, or a suggestion for a mesh.
  double voxel = 0.0;
  SmoothWidth smooth;  ///< Standard deviation of the smoothing filter; 0: no smoothing.
  /// Tolerance of the background [unit of the values], >= 0; unset: 0, or 1e-3 of the range after
  /// smoothing.
  std::optional<double> tolerance;
  std::optional<double> iso;  ///< If set, makes a level set of the surface at this value.
  /// Direction of a displacement field: "backward" or "forward"; empty: backward.
  std::string direction;
  std::string time;             ///< Empty, the number of a step, or "all".
  std::filesystem::path scene;  ///< File for the scene guess; empty: none; "-": standard output.
  bool json = false;
  bool bricks = false;
};

struct Imported {
  Gridded made;
  std::string unit;    ///< Unit of the values; empty: unknown.
  bool axial = false;  ///< True if vectors v and -v mean the same.
  /// Whole number that was subtracted from the values (Array::value_offset).
  double value_offset = 0.0;
  std::optional<ResamplingError> resampling;
  double voxel = 0.0;         ///< Edge of the cubes after resampling; 0: not resampled to cubes.
  double smoothing = 0.0;     ///< RMS of the changes by smoothing, in `unit`.
  std::vector<Label> labels;  ///< For a segmentation: its labels.
  std::optional<LevelSet> level_set;
  /// Box of the image's voxels, where the image cuts objects off. Empty if the image was resampled
  /// to cubes. No value for a mesh.
  std::optional<openvdb::CoordBBox> image;
  /// For --bricks with the image's own voxels: the grid in parts. `made.grid` then has no voxels.
  /// The function `open` of the parts uses the reader and the group.
  std::optional<GridParts> parts;
};

/// Returns true if --as states that the file is the displacement field of a registration.
[[nodiscard]] inline bool isDisplacement(const Options& options) {
  return options.request.as == "displacement";
}

struct Step {
  std::optional<double> time;
  Modality modality = Modality::kUnknown;
  std::vector<Imported> grids;
  std::vector<std::string> notes;  ///< Assumptions and losses, one line each.
};

struct Telling {
  std::function<void(const std::string& what)> stage;
  Progress progress;
};

/// Opens the file. For bricks in a process group, a rank reads only its part, if the format allows
/// this. For bricks of a large image, a single process divides the group into slabs if the reader
/// can go to any slice. All arguments must outlive the reader.
[[nodiscard]] std::unique_ptr<Reader> openFor(const Options& options, const Telling& telling,
                                              SlabGroup& group);

/// Data that a step of a series needs from earlier steps. The keys of maps and the elements of sets
/// are names of arrays.
struct EarlierSteps {
  /// Background of the last step whose scalars vary. A step without any data gets this value, so
  /// that the sequence has all frames.
  std::map<std::string, double> backgrounds;
  std::map<std::string, std::optional<double>> value_offsets;  ///< Array::value_offset.
  /// True after an empty level set. Only the first empty level set gets a note.
  bool has_empty = false;
  /// Images whose region of the largest body is a volume of the scene (addBodies).
  std::set<std::string> bodies;
};

/// Returns true if a grid of the step has values (for vectors, lengths) that vary, or is a level
/// set that is not empty.
[[nodiscard]] bool hasContrast(const Step& step);

/// Reads a step, makes its grids and sets their metadata. Leaves out arrays of an image that have
/// no data, or whose values all count as background, and notes the reason. Without --iso, keeps
/// such vectors, and with --time all also such scalars. With --iso and --time all, a step without
/// the surface gets an empty level set, except with --bricks. Throws Error, also if --bricks would
/// get several arrays. In a process group, each rank gets its parts of an image's grid
/// (Imported::parts), and other grids completely. In a divided group, reads the image once more for
/// each value that all slabs share.
[[nodiscard]] Step importStep(const Options& options, Reader& reader, std::size_t step,
                              const Telling& telling, SlabGroup& group, EarlierSteps& earlier);

/// Writes the grids with Blosc compression, frees them, and reads them back as a scene does.
/// Without grids, writes an empty frame. Throws Error, which names `file`, if it cannot be written.
/// Throws Error, which names `in`, if a scene would reject a grid; the file then remains. Does not
/// read back a file without grids, or with an empty level set.
void writeVdb(const std::filesystem::path& file, Step& step, const std::string& in);

/// Writes the only grid as bricks and frees it. All ranks must call this function.
void writeAsBricks(const std::filesystem::path& folder, Step& step, const Progress& progress,
                   ProcessGroup& processes);

/// Adds the region of the largest body (guess/body.h) of each CT that has several bodies. An image
/// in `earlier` gets a region in any case: if it has a single body, the whole image.
void addBodies(Step& step, EarlierSteps& earlier);

/// Returns the scene guess for a .vdb at `vdb`, which may be a pattern of several files. Throws
/// VolumeError if no grid is usable, as when all are constant.
[[nodiscard]] std::string sceneFor(const std::string& vdb, const Step& step);

}  // namespace palpate::importer
