/// Makes the grids of an open file, one time step after another.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "palpate/samplers/process_group.h"
#include "palpate/scenes/apps/import/grids.h"
#include "palpate/scenes/apps/import/level_set.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/resample.h"

namespace palpate::importer {

/// Options of the command line.
struct Options {
  Request request;
  std::filesystem::path out;
  /// Edge of cubic voxels, in the file's unit; 0: the voxels of the image, or a suggested edge for
  /// a mesh.
  double voxel = 0.0;
  /// Standard deviation of the smoothing filter, in the file's unit; 0: no smoothing.
  double smooth = 0.0;
  /// Tolerance about the background, in the values' unit, >= 0; unset: default.
  std::optional<double> tolerance;
  std::optional<double> iso;    ///< If set, makes a level set of the isosurface of this value.
  std::string time;             ///< Empty, the number of a step, or "all".
  std::filesystem::path scene;  ///< File for the scene guess; empty: none; "-": standard output.
  bool json = false;            ///< Report as JSON.
  bool bricks = false;          ///< Write a folder of bricks instead of a .vdb.
};

/// A grid, and data about its conversion.
struct Imported {
  Gridded made;
  std::string unit;    ///< Unit of the values; empty: unknown.
  bool axial = false;  ///< The sign of the vectors has no meaning.
  std::optional<ResamplingError> resampling;
  double voxel = 0.0;      ///< Edge of the voxels after resampling; 0: not resampled.
  double smoothing = 0.0;  ///< Root mean square of the changes by smoothing.
  std::optional<LevelSet> level_set;
  /// Box of the image's voxels; a scene guess uses it to find where the image cuts off objects.
  /// Empty if the image was resampled. No value for a mesh, whose inactive voxels have no data.
  std::optional<openvdb::CoordBBox> image;
  /// In a process group: the grid contains only these bricks (BrickInput::share).
  std::optional<Share> share;
};

/// Result of importing one time step.
struct Step {
  std::optional<double> time;
  Modality modality = Modality::kUnknown;
  std::vector<Imported> grids;
  std::vector<std::string> notes;  ///< Assumptions and losses, one line each.
};

/// Receives the name of the present stage and its progress.
struct Telling {
  std::function<void(const std::string& what)> stage;
  Progress progress;
};

/// Opens the file. In a process group, each rank reads only its own part if the format allows this.
[[nodiscard]] std::unique_ptr<Reader> openFor(const Options& options, const Telling& telling,
                                              ProcessGroup& group);

/// Background of each scalar array at the last step that had data, by the array's name. A step of a
/// series without data gets this value, so that the sequence has all its frames.
using Backgrounds = std::map<std::string, double>;

/// Returns true if the values of a grid of the step vary.
[[nodiscard]] bool hasContrast(const Step& step);

/// Reads a step, makes its grids and sets their metadata. Leaves out scalars that are constant,
/// unless --time all makes the frames of a sequence. If no grid is left, the notes state the
/// reason. Throws Error.
/// @param group  Process group. Each rank gets its part of an image's grid (Imported::share). A
///               grid from a mesh, from cubes or from --iso is whole on every rank.
[[nodiscard]] Step importStep(const Options& options, Reader& reader, std::size_t step,
                              const Telling& telling, ProcessGroup& group,
                              Backgrounds& backgrounds);

/// Writes the grids with Blosc compression, frees them, and reads them back as a scene does. Throws
/// Error if a grid is then rejected; the file remains.
/// @param in  File that the grids were imported from, for errors.
void writeVdb(const std::filesystem::path& file, Step& step, const std::string& in);

/// Writes the only grid as bricks (samplers/bricks/write_bricks.h), and frees it. Throws Error if
/// there are several grids. All ranks of the process group must call this function.
void writeAsBricks(const std::filesystem::path& folder, Step& step, const Progress& progress,
                   ProcessGroup& group);

/// Adds to the grids of a step, for each CT with more than one body, the region of its largest body
/// (guess/body.h), so that a scene can leave out the table below a patient.
void addBodies(Step& step);

/// Returns the scene guess for a .vdb with these grids; `vdb` is its path in the scene. Throws
/// VolumeError if all grids are constant.
[[nodiscard]] std::string sceneFor(const std::string& vdb, const Step& step);

}  // namespace palpate::importer
