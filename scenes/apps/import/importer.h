/// Makes grids from an open file, step by step.
#pragma once

#include <filesystem>
#include <functional>
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

/// The user's options.
struct Options {
  Request request;
  std::filesystem::path out;
  double voxel = 0.0;   ///< In the file's unit; 0: the image's own, or a suggested edge.
  double smooth = 0.0;  ///< Standard deviation, in the file's unit; 0: no smoothing.
  std::optional<double> tolerance;  ///< In the values' unit, >= 0; unset: default.
  std::optional<double> iso;        ///< Make a level set of the surface of this value.
  std::string time;                 ///< "", a step's number, or "all".
  std::filesystem::path scene;      ///< Empty: no scene; -: standard output.
  bool json = false;                ///< Report as JSON.
  bool bricks = false;              ///< Write a folder of bricks, not a .vdb.
};

/// A grid and how it was made.
struct Imported {
  Gridded made;
  std::string unit;    ///< Unit of the values; empty: not known.
  bool axial = false;  ///< The sign of the vectors has no meaning.
  std::optional<ResamplingError> resampling;
  double voxel = 0.0;      ///< Edge of the resampling.
  double smoothing = 0.0;  ///< Rms change of the values.
  std::optional<LevelSet> level_set;
  /// Box of an image's voxels, from which a scene knows where the image is cut; empty if resampled.
  /// Not set for a mesh, whose inactive voxels have no data.
  std::optional<openvdb::CoordBBox> image;
  /// In a process group: the grid is only the part in these bricks (BrickInput::share).
  std::optional<Share> share;
};

/// One step of a file, imported.
struct Step {
  std::optional<double> time;
  Modality modality = Modality::kUnknown;
  std::vector<Imported> grids;
  std::vector<std::string> notes;  ///< Assumptions and losses, a line each.
};

/// Receives the current stage and its progress.
struct Telling {
  std::function<void(const std::string& what)> stage;
  Progress progress;
};

/// Opens the file. In a process group, a rank reads only its own part if the format stores it
/// separately.
[[nodiscard]] std::unique_ptr<Reader> openFor(const Options& options, const Telling& telling,
                                              ProcessGroup& group);

/// Reads a step and makes its grids, with their metadata. If no array varies, the step has no
/// grids and its notes give the reason. Throws Error.
/// @param group  Process group. Each rank gets its part of an image's grid (Imported::share). Every
///               rank gets the whole grid that comes from a mesh, from cubes or from --iso.
[[nodiscard]] Step importStep(const Options& options, Reader& reader, std::size_t step,
                              const Telling& telling, ProcessGroup& group);

/// Writes the grids with Blosc, frees them, and reads them back as a scene would. Throws Error if a
/// grid is rejected; the file then stays.
/// @param in  Source file of the grids, for errors.
void writeVdb(const std::filesystem::path& file, Step& step, const std::string& in);

/// Writes the one grid as bricks (samplers/bricks/write_bricks.h), and frees it. Throws Error if
/// there are several grids. All ranks of the process group have to call it.
void writeAsBricks(const std::filesystem::path& folder, Step& step, const Progress& progress,
                   ProcessGroup& group);

/// Returns a first scene for a .vdb with these grids; `vdb` is its path in the scene. Throws
/// VolumeError if no grid varies.
[[nodiscard]] std::string sceneFor(const std::string& vdb, const Step& step);

}  // namespace palpate::importer
