/// `palpate-import`: converts files of scanners and simulation programs to .vdb.
#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <exception>
#include <filesystem>
#include <fstream>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/descriptor.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/apps/import/guard.h"
#include "palpate/scenes/apps/import/importer.h"
#include "palpate/scenes/apps/import/mpi_group.h"
#include "palpate/scenes/apps/import/play_scene.h"
#include "palpate/scenes/apps/import/report.h"
#include "palpate/scenes/apps/import/slice_spacing.h"
#include "palpate/scenes/library/new_file.h"

namespace palpate::importer {
namespace {

namespace fs = std::filesystem;

std::vector<std::size_t> stepsOf(const std::string& time, std::size_t count) {
  std::vector<std::size_t> steps;
  if (time == "all") {
    for (std::size_t s = 0; s < count; ++s) steps.push_back(s);
    return steps;
  }
  std::size_t step = 0;
  if (!time.empty()) {
    const char* end = time.data() + time.size();
    const auto parsed = std::from_chars(time.data(), end, step);
    if (parsed.ec != std::errc() || parsed.ptr != end || step >= count) {
      throw Error("--time", fmt::format("the file has no step \"{}\"", time),
                  count == 1 ? "omit this option, because the file has one step"
                             : fmt::format("give 0 to {}, or all", count - 1));
    }
  }
  return {step};
}

/// Returns true if the scene plays the steps: each step has its own .vdb.
bool playsSteps(const Options& options, std::size_t steps) {
  return options.time == "all" && steps > 1 && !options.scene.empty() && !options.bricks;
}

/// Returns the file or folder for a step. `number` is the step's number, or "%04d" for all steps.
fs::path outputOf(const Options& options, const std::string& number) {
  if (options.time != "all") return options.out;
  const fs::path stem = options.bricks ? options.out.filename() : options.out.stem();
  fs::path out = options.out;
  out.replace_filename(fmt::format("{}_{}{}", stem.string(), number, options.bricks ? "" : ".vdb"));
  return out;
}

fs::path outputOf(const Options& options, std::size_t number) {
  return outputOf(options, fmt::format("{:04}", number));
}

/// Returns the folder of the scene file.
fs::path sceneFolder(const Options& options) {
  const bool to_stdout = options.scene == "-";
  return fs::weakly_canonical(to_stdout ? fs::path(".")
                                        : fs::absolute(options.scene).parent_path());
}

/// Returns the path of a file, relative to the scene's folder.
std::string pathInScene(const Options& options, const fs::path& file) {
  return fs::weakly_canonical(fs::absolute(file)).lexically_relative(sceneFolder(options)).string();
}

/// Returns the scene guess for the volumes in `vdb`. If no grid varies enough, adds a note and
/// returns "".
std::string guessFirst(const Options& options, const fs::path& vdb, Step& step, Teller& teller) {
  teller.stage("scene");
  try {
    return sceneFor(pathInScene(options, vdb), step) + "\n";
  } catch (const VolumeError& e) {
    step.notes.push_back("no scene: " + e.reason() + ": " + e.remedy());
    return "";
  }
}

void writeScene(const Options& options, const std::string& scene, Teller& teller) {
  if (scene.empty() || options.scene == "-") return;
  const fs::path partial = partialOf(options.scene);
  teller.file(partial, options.scene);
  // Tries no second name, because the parent process renames only this partial file.
  const Descriptor descriptor(createNewFile(partial));
  if (descriptor.get() >= 0) {
    std::ofstream file(nameOfOpen(descriptor.get(), partial), std::ios::binary);
    file << scene << std::flush;
    if (file) return;
  }
  throw Error(options.scene.string(),
              fmt::format("the file cannot be written ({})", std::strerror(errno)),
              "choose another path, or free space on the disk");
}

/// Throws Error if the scene could not play the files of the steps, or would also play other files.
void checkPlayed(const Options& options, std::size_t steps) {
  if (options.out.stem().string().find('%') != std::string::npos) {
    throw Error(options.out.string(),
                "the name has a \"%\", which marks the number of a step in a scene",
                "choose another name, or omit --scene");
  }
  const fs::path next = outputOf(options, steps);
  std::error_code error;
  if (!fs::exists(next, error)) return;
  throw Error(next.string(),
              fmt::format("the scene would play this file too, but the import has {} steps", steps),
              "remove this file and those with higher numbers, or choose another name");
}

/// Returns the last lines of output. `first` is the file or folder that they name if there is no
/// scene, or empty. `played` is the number of steps that the scene plays, or 0.
std::string lastWords(const Options& options, const fs::path& first, const std::string& scene,
                      std::size_t played) {
  std::string text;
  if (!scene.empty()) {
    std::string modes;
    const cli::OrderedJson spec = cli::OrderedJson::parse(scene);
    for (const auto& mode : spec["modes"]) {
      modes += fmt::format("{}{} ({})", modes.empty() ? "" : ", ", mode["name"].get<std::string>(),
                           mode["mode"].get<std::string>());
    }
    const std::size_t count = spec["modes"].size();
    const std::string plays = played > 0 ? fmt::format(" that plays {} steps", played) : "";
    text += cli::words("{}: a scene of {} mode{}{}: {}\n", options.scene.string(), count,
                       count == 1 ? "" : "s", plays, cli::sentence(modes))
                .text();
  }
  if (first.empty()) return text;
  const std::string felt = scene.empty() ? first.string() : options.scene.string();
  // If the scene guess failed, the volume needs a scene before the hand can feel it.
  const bool none =
      options.bricks || isDisplacement(options) || (scene.empty() && !options.scene.empty());
  return text + cli::words("next: palpate {} {}{}\n", none ? "info" : "feel",
                           cli::sentence(cli::shellWord(felt)), none ? "" : " --seconds 10")
                    .text();
}

/// Writes the grids of a step, and frees them.
void writeStep(const Options& options, const fs::path& out, Step& step, Teller& teller,
               const Telling& telling, ProcessGroup& group) {
  telling.stage("writing");
  if (options.bricks) {
    if (step.grids.empty()) return;
    // An interrupted export of bricks can resume, so it needs no partial file.
    writeAsBricks(out, step, telling.progress, group);
    return;
  }
  const fs::path partial = partialOf(out);
  teller.file(partial, out);
  writeVdb(partial, step, options.request.file.string());
}

/// Adds a note to a step without grids. Throws Error if no other step is imported.
void noteSkipped(const Options& options, Step& step, std::size_t steps) {
  if (steps == 1) {
    throw Error(options.request.file.string(), step.notes.back(),
                options.tolerance.value_or(0.0) > 0.0
                    ? "give a smaller --tolerance, or import arrays that have data and vary"
                    : "import arrays that have data and vary");
  }
  step.notes.emplace_back(
      options.bricks ? "no folder for this step: all arrays were skipped"
                     : "all arrays were skipped: this step's file has no grid, and a scene plays "
                       "it as background");
}

int importAll(const Options& options, Teller& teller, ProcessGroup& group) {
  Telling telling{[](const std::string& /*what*/) {}, nullptr};
  if (group.rank() == 0) {
    telling = {[&](const std::string& what) { teller.stage(what); },
               [&](double done) { teller.progress(done); }};
  }
  SlabGroup slabs(group);
  const std::unique_ptr<Reader> reader = openFor(options, telling, slabs);
  const std::size_t count = std::max<std::size_t>(reader->times().size(), 1);
  const std::vector<std::size_t> steps = stepsOf(options.time, count);
  openvdb::initialize();

  const bool plays = playsSteps(options, steps.size());
  if (plays) checkPlayed(options, steps.size());

  std::string text;
  std::string scene;
  // Output of the first step with contrast, otherwise of the first step with a grid.
  fs::path first;
  bool has_contrast = false;
  EarlierSteps earlier;
  PlayedSteps played{reader->times(), reader->timeUnit(), 0, ""};
  cli::OrderedJson reports = cli::OrderedJson::array();
  for (const std::size_t number : steps) {
    Step step = importStep(options, *reader, number, telling, slabs, earlier);
    const fs::path out = outputOf(options, number);
    if (step.grids.empty()) {
      noteSkipped(options, step, steps.size());
    } else if (first.empty() || (!has_contrast && hasContrast(step))) {
      first = out;
      has_contrast = hasContrast(step);
      if (!options.scene.empty() && (has_contrast || steps.size() == 1)) {
        addBodies(step, earlier);
        scene = guessFirst(options, plays ? outputOf(options, "%04d") : out, step, teller);
        played.file_of_guess = pathInScene(options, out);
      }
    } else if (!earlier.bodies.empty()) {
      addBodies(step, earlier);
    }
    if (count > 1 && options.time.empty()) {
      step.notes.push_back(
          fmt::format("this is the first of {} steps (number 0): --time N imports step N, 0 to {}; "
                      "--time all imports all steps",
                      count, count - 1));
    }
    if (plays) {
      for (const Imported& imported : step.grids) {
        played.largest = std::max(played.largest, imported.made.grid->memUsage());
      }
      if (number == steps.back() && !scene.empty()) scene = playScene(scene, played, step.notes);
    }
    text += textOf(out, step);
    reports.push_back(jsonOf(out, step));
    writeStep(options, out, step, teller, telling, group);
    const std::vector<std::uint64_t> peaks = gatherOne(group, peakMemory());
    reports.back()["memory"]["peak"] = *std::max_element(peaks.begin(), peaks.end());
  }
  if (options.iso && !has_contrast) {
    throw VolumeError(options.request.file.string(), "no step has a surface at the value of --iso",
                      "give an --iso within the range of the file's values, which an import "
                      "without --iso prints");
  }
  writeScene(options, scene, teller);
  if (group.rank() != 0) return cli::kDone;
  if (options.scene == "-") {
    teller.out(scene);
  } else if (options.json) {
    teller.out(cli::dump(options.time == "all" ? reports : reports[0], 2) + "\n");
  } else {
    teller.out(text + lastWords(options, first, scene, plays ? steps.size() : 0));
  }
  return cli::kDone;
}

/// Throws Error for options that do not apply to displacement fields.
void checkDisplacementOptions(const Options& options) {
  const auto refuse = [](const char* name, bool given, const char* remedy) {
    if (given) throw Error(name, "this option does not apply to a displacement field", remedy);
  };
  refuse("--bricks", options.bricks,
         "omit it, because palpate reads a whole displacement field into memory");
  refuse("--scene", !options.scene.empty(),
         "import the image with --scene, and add \"warp\" to the \"place\" of the image");
  refuse("--iso", options.iso.has_value(), "omit this option");
  refuse("--tolerance", options.tolerance.has_value(),
         "omit it, because a warp needs a displacement at each voxel");
}

void check(const Options& options) {
  if (!options.bricks) cli::checkReplaceable(options.out);
  if (options.scene != "-") cli::checkReplaceable(options.scene);
  if ((options.out.extension() == ".vdb") == options.bricks) {
    throw Error(options.out.string(),
                options.bricks ? "--bricks writes a folder, but the name ends in .vdb"
                               : "the name does not end in .vdb",
                options.bricks ? "omit .vdb in the name" : "add .vdb to the name");
  }
  if (options.bricks && !options.scene.empty()) {
    throw Error("--scene", "this option makes a scene of a .vdb, but --bricks writes none",
                "omit --scene, then run palpate scene on the folder of bricks");
  }
  const bool is_scene_twice =
      !options.scene.empty() && (cli::isSamePlace(options.scene, options.out) ||
                                 cli::isSamePlace(options.scene, options.request.file));
  if (is_scene_twice || cli::isSamePlace(options.request.file, options.out)) {
    throw Error(is_scene_twice ? "--scene" : options.out.string(),
                is_scene_twice ? "the scene and another file of the command have the same path"
                               : "the input and the output have the same path",
                "give each file its own path");
  }
  if (isDisplacement(options)) {
    checkDisplacementOptions(options);
  } else if (!options.direction.empty()) {
    throw Error("--direction", "only a displacement field has a direction",
                "add --as displacement, or omit this option");
  }
  if (options.scene == "-" && options.json) {
    throw Error("--json", "--scene - already writes to standard output",
                "omit one of the two options");
  }
  const auto width = [](const char* name, double value, double most) {
    if (!(value >= 0.0 && value <= most)) {
      throw Error(name, fmt::format("{} is out of range", value),
                  fmt::format("give a number from 0 to {:g}", most));
    }
  };
  width("--smooth", options.smooth.sigma, 1e6);
  width("--voxel", options.voxel, 1e9);
  width("--tolerance", options.tolerance.value_or(0.0), 1e30);
  if (options.iso && !std::isfinite(*options.iso)) {
    throw Error("--iso", "the value is not a finite number",
                "give a value within the range of the data");
  }
}

/// Returns the width that --smooth states: a number in the file's unit, or in voxels, such as
/// 1.5vx.
SmoothWidth smoothWidthOf(const std::string& text) {
  SmoothWidth width;
  width.in_file_units = !text.ends_with("vx");
  const char* end = text.data() + text.size() - (width.in_file_units ? 0 : 2);
  const auto parsed = std::from_chars(text.data(), end, width.sigma);
  if (parsed.ec != std::errc() || parsed.ptr != end) {
    throw CLI::ConversionError("--smooth", std::vector<std::string>{text});
  }
  return width;
}

void addSmooth(CLI::App& app, SmoothWidth& width) {
  app.add_option_function<std::string>(
         "--smooth", [&](const std::string& text) { width = smoothWidthOf(text); },
         "Smooth images with a Gaussian of this standard deviation, in the file's unit (usually "
         "mm), or in voxels: 1.5vx")
      ->type_name("WIDTH");
}

/// Imports the file. Converts exceptions of OpenVDB, such as for an invalid transform, to
/// VolumeError.
int import(const Options& options, Teller& teller, ProcessGroup& group) {
  try {
    return importAll(options, teller, group);
  } catch (const openvdb::Exception& e) {
    throw VolumeError(options.request.file.string(),
                      fmt::format("OpenVDB rejects the grid ({})", e.what()),
                      "check the sizes, positions and spacing in the file");
  }
}

void checkTogether(const Options& options) {
  if (!options.bricks) {
    throw Error("mpirun", "several processes can write only a folder of bricks",
                "add --bricks, or start one process without mpirun");
  }
  if (!canJoinGroup()) {
    throw Error(
        "mpirun", "this importer was built without MPI",
        "install the package palpate-import, or install libopenmpi-dev and build palpate again, or "
        "start one process without mpirun");
  }
}

/// Returns the remedy for an import that needs more memory than there is.
std::string needLess(const Options& options) {
  if (options.request.as == "displacement") {
    return "resample the field to a larger --voxel";
  }
  return options.bricks
             ? "export the image as uncompressed .nii, MetaImage or NRRD, which --bricks reads in "
               "parts, and omit --voxel and --iso"
             : "import fewer arrays (--field), resample to a larger --voxel, or write an image as "
               "bricks (--bricks)";
}

/// Imports as one rank of a group. Every rank checks options and files, which may differ between
/// machines. One rank reports errors.
int importTogether(const Options& options) {
  // MPI may end a process by exit() without a message; palpate then prints this message.
  const Error silent("mpirun", "this rank stopped without a message",
                     "check the network between the machines, or import the file with one process");
  return runGuarded(
      options.request.file.string(), needLess(options),
      [&](Teller& teller) {
        const std::unique_ptr<ProcessGroup> group = joinGroup();
        if (group->size() == 1 && ranksByEnvironment() > 1) {
          throw Error("mpirun",
                      "the processes cannot connect, because mpirun and palpate use different MPI "
                      "libraries",
                      "use the mpirun of the MPI library that palpate was built with");
        }
        return workTogether(*group, [&] {
          check(options);
          return import(options, teller, *group);
        });
      },
      silent.what());
}

int importAlone(const Options& options) {
  check(options);
  return runGuarded(options.request.file.string(), needLess(options), [&](Teller& teller) {
    SingleProcess alone;
    return import(options, teller, alone);
  });
}

/// Adds the options that control how a file is read.
void addReading(CLI::App& app, Options& options) {
  Request& request = options.request;
  app.add_option("--series", request.series,
                 "DICOM: select a series by its number, UID or description");
  app.add_option("--level", request.level,
                 "OME-Zarr: level of resolution, counted from 0, the finest; default: 0");
  app.add_option_function<std::string>(
         "--spacing", [&](const std::string& text) { request.spacing = spacingOf(text); },
         "Slices (TIFF, PNG): edges of a voxel along x, y and z, with a unit (m, cm, mm, um, nm): "
         "10,10,20um; default: as ImageJ's or OME's description in a TIFF states")
      ->type_name("DX,DY,DZ");
  app.add_option("--as", request.as,
                 "vector or tensor: the 3 or 6 volumes of a 4-D NIfTI, or channels of a MetaImage, "
                 "are components; displacement: the NIfTI, MetaImage or NRRD is the displacement "
                 "field of a registration, for \"warp\" in a scene")
      ->check(CLI::IsMember({"vector", "tensor", "displacement"}));
  app.add_option("--direction", options.direction,
                 "Direction for --as displacement: backward (default): from the fixed to the "
                 "moving image, as in ITK, ANTs and elastix; forward: the import inverts the field")
      ->check(CLI::IsMember({"backward", "forward"}));
  app.add_flag(
      "--follow", request.follow,
      "NRRD, MetaImage, Zarr, .pvd, .series: also read data files in other folders than the "
      "header's");
  app.add_option("--solution", request.solution, "PLOT3D: the solution (Q file) of the grid IN");
  app.add_option("--raw", request.raw,
                 "Layout of raw values: JSON, or the path of a JSON file; keys: size, type, "
                 "endian, components, order, skip, spacing, axes, origin, name, unit");
}

}  // namespace
}  // namespace palpate::importer

int main(int argc, char** argv) {
  using namespace palpate;
  CLI::App app{
      "palpate import: converts files of scanners and solvers to a .vdb, one grid per array, in "
      "the file's own space and units"};
  app.name("palpate import");
  importer::Options options;
  importer::Request& request = options.request;
  app.add_option(
         "IN", request.file,
         "NIfTI, MetaImage, NRRD, an OME-Zarr or Zarr folder, MINC 1, a DICOM file or folder, a "
         "TIFF "
         "stack, a folder of TIFF or PNG slices, VTK (legacy, XML, HDF5, .pvd or .series), Exodus "
         "II, CGNS, an OpenFOAM case, netCDF (CF or WRF), PLOT3D with --solution, or raw values "
         "with --raw")
      ->required();
  app.add_option("OUT", options.out, "The .vdb to write, or the folder with --bricks")->required();
  app.add_option("--field", request.fields,
                 "Name of an array to import; may be repeated; default: all arrays");
  app.add_option(
      "--voxel", options.voxel,
      "Edge of the cubic voxels to resample to, in the file's unit; default: an image keeps its "
      "voxels; a mesh gets half the edge of its median cell, and at most 16 voxels per point");
  app.add_option("--iso", options.iso,
                 "Make a level set of the surface where a scalar has this value");
  importer::addSmooth(app, options.smooth);
  app.add_option("--tolerance", options.tolerance,
                 "Image values within this distance of the background become background; default: "
                 "0, or 0.1 % of the range with --smooth");
  app.add_option(
      "--time", options.time,
      "Time step of a series, counted from 0; all: one .vdb per step, and --scene plays them; "
      "default: 0");
  importer::addReading(app, options);
  app.add_option("--scene", options.scene, "Write a first scene file to edit; - prints the scene");
  app.add_flag("--bricks", options.bricks,
               "Write a folder of bricks, for volumes larger than memory");
  app.add_flag("--json", options.json, "Print the report as JSON");
  app.footer(
      "Examples:\n"
      "  palpate import head.nii.gz head.vdb --smooth 1 --scene head.json\n"
      "  palpate import dicom_folder/ ct.vdb --iso 300\n"
      "  palpate import slices/ bone.vdb --spacing 18,18,18um\n"
      "  palpate import flow.ex2 flow.vdb --field V --field Pres --voxel 0.1\n"
      "  palpate import mri.raw mri.vdb --raw '{\"size\":[128,128,84],\"type\":\"uint8\"}'");
  // If there are several ranks, only rank 0 reports errors in the options.
  const std::optional<int> rank = importer::rankByEnvironment();
  bool quiet = rank.value_or(0) != 0;
  try {
    app.parse(argc, argv);
    // A single rank without --bricks works alone: mpirun may have started a script that calls this
    // program.
    const bool together = rank && (options.bricks || importer::ranksByEnvironment() > 1);
    if (together) importer::checkTogether(options);
    quiet = false;
    return together ? importer::importTogether(options) : importer::importAlone(options);
  } catch (const CLI::Success& e) {
    return quiet ? cli::kDone : app.exit(e);
  } catch (const CLI::ParseError& e) {
    // With a nonzero status, mpirun would end the rank that reports.
    if (quiet) return cli::kDone;
    cli::complain(fmt::format("usage: {}: see palpate import --help", e.what()));
  } catch (const Error& e) {
    if (quiet) return cli::kDone;
    cli::complain(e.what());
  } catch (const std::exception& e) {
    cli::complain(fmt::format(
        "internal error: {}: please report this message and your command line", e.what()));
    return cli::kInternal;
  }
  return cli::kBadInput;
}
