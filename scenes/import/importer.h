/// From an open file to grids that can be felt, a step of it at a time.
#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "palpate/samplers/crew.h"
#include "palpate/scenes/import/grids.h"
#include "palpate/scenes/import/level_set.h"
#include "palpate/scenes/import/reader.h"
#include "palpate/scenes/import/resample.h"

namespace palpate::importer {

/// What the user asked for.
struct Options {
  Request request;
  std::filesystem::path out;
  double voxel = 0.0;               ///< In the file's unit; 0: the image's own, or a suggested one.
  double smooth = 0.0;              ///< Standard deviation, in the file's unit; 0: none.
  std::optional<double> tolerance;  ///< In the values' unit, >= 0; else chosen.
  std::optional<double> iso;        ///< Make a level set of the surface of this value.
  std::string time;                 ///< "", a step's number, or "all".
  std::filesystem::path scene;      ///< Empty: none; -: standard output.
  bool json = false;                ///< Report as JSON.
  bool bricks = false;              ///< Write a folder of bricks, not a .vdb.
};

/// A grid and how it came about.
struct Imported {
  Gridded made;
  std::string unit;    ///< Of the values; empty: not known.
  bool axial = false;  ///< Vectors whose sign means nothing.
  std::optional<ResamplingError> resampling;
  double voxel = 0.0;      ///< Of the resampling.
  double smoothing = 0.0;  ///< Rms change of the values.
  std::optional<LevelSet> level_set;
  /// An image's voxels, by which a scene knows where it is cut; empty if it was resampled. Not set
  /// for a mesh, whose inactive voxels are no data.
  std::optional<openvdb::CoordBBox> image;
  /// Of a crew: the grid is a part alone, that in these bricks (BrickInput::share).
  std::optional<Share> share;
};

/// One step of a file, imported.
struct Step {
  std::optional<double> time;
  Modality modality = Modality::kUnknown;
  std::vector<Imported> grids;
  std::vector<std::string> notes;  ///< What was assumed or lost, a line each.
};

/// Told what is being done, and how far that is.
struct Telling {
  std::function<void(const std::string& what)> stage;
  Progress progress;
};

/// Opens the file. Of a crew a rank will read what it needs, where the format has it by itself.
[[nodiscard]] std::unique_ptr<Reader> openFor(const Options& options, const Telling& telling,
                                              Crew& crew);

/// Reads a step and makes its grids, with their metadata. A step without anything to feel has no
/// grids, and its notes say why. Throws Error.
/// @param crew  Whose ranks have parts of an image's grid each, by Imported::share; of what comes
/// of
///              a mesh, of cubes and of --iso each has all.
[[nodiscard]] Step importStep(const Options& options, Reader& reader, std::size_t step,
                              const Telling& telling, Crew& crew);

/// Writes the grids with Blosc, lets go of them, and reads them back as whoever feels them will.
/// Throws Error where that refuses one, and leaves what there is of the file.
/// @param in  What they were imported from, for errors.
void writeVdb(const std::filesystem::path& file, Step& step, const std::string& in);

/// Writes the one grid as bricks (samplers/write_bricks.h), and lets go of it. Throws Error where
/// there are several. All of the crew together.
void writeAsBricks(const std::filesystem::path& folder, Step& step, const Progress& progress,
                   Crew& crew);

/// A first scene for a .vdb with these grids; `vdb` as the scene shall say it. Throws VolumeError
/// if nothing in it varies.
[[nodiscard]] std::string sceneFor(const std::string& vdb, const Step& step);

}  // namespace palpate::importer
