/// `palpate-import`: what scanners and solvers write becomes a .vdb that can be felt.
#include <algorithm>
#include <array>
#include <charconv>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <new>
#include <optional>
#include <string>
#include <sys/resource.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <openvdb/openvdb.h>

#include "engine/error.h"
#include "scenes/cli/common.h"
#include "scenes/cli/version.h"
#include "scenes/import/grids.h"
#include "scenes/import/guard.h"
#include "scenes/import/level_set.h"
#include "scenes/import/pieces.h"
#include "scenes/import/reader.h"
#include "scenes/import/resample.h"
#include "scenes/import/smooth.h"
#include "scenes/import/suggest.h"

namespace palpate::importer {
namespace {

using cli::OrderedJson;

struct Options {
  Request request;
  std::filesystem::path out;
  double voxel = 0.0;       ///< In the file's units; 0: the image's own, or a suggested one.
  double smooth = 0.0;      ///< In the file's units.
  double tolerance = -1.0;  ///< In the values' units; below 0: chosen.
  std::optional<double> iso;
  std::string time;  ///< "", a number, or "all".
  std::filesystem::path scene;
  bool json = false;
};

/// Of this process so far [bytes].
std::uint64_t peakMemory() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<std::uint64_t>(usage.ru_maxrss) * 1024;
}

/// A grid and the report of it.
struct Made {
  Gridded grid;
  std::optional<ResamplingError> resampling;
  double voxel = 0.0;      ///< Of the resampling.
  double smoothing = 0.0;  ///< Rms change.
  std::optional<LevelSet> level_set;
  std::optional<openvdb::CoordBBox> image;  ///< The voxels of an image as it was read.
};

/// Voxels, said once for arrays that share them.
std::string voxelsOf(const Made& made) {
  const openvdb::GridBase& grid = *made.grid.grid;
  const openvdb::Vec3d edge = grid.voxelSize();
  std::string line = fmt::format("{} active voxels", grid.activeVoxelCount());
  if (!made.level_set) {
    line += fmt::format(" ({:.3g} %)", 100.0 * static_cast<double>(grid.activeVoxelCount()) /
                                           static_cast<double>(made.grid.voxels));
  }
  line += fmt::format(" of {:.4g} x {:.4g} x {:.4g}", edge.x(), edge.y(), edge.z());
  if (made.resampling) {
    line += fmt::format(", compared with the original at {} points", made.resampling->points);
    if (made.resampling->edge_points > 0) {
      line += fmt::format(" ({} more lie at the edge of the data)", made.resampling->edge_points);
    }
  }
  return "  " + line + "\n";
}

/// Range, and what was lost.
std::string lineOf(const Made& made) {
  const openvdb::GridBase& grid = *made.grid.grid;
  const bool vector = grid.isType<openvdb::Vec3SGrid>();
  std::string line = "    " + grid.getName() + ": ";
  if (made.level_set) {
    line += fmt::format("level set, solid {}; off by {:.2g} voxels rms, {:.2g} at p99",
                        made.level_set->solid_above ? "above" : "below", made.level_set->rms_error,
                        made.level_set->p99_error);
  } else {
    line += fmt::format("{} {:.5g} .. {:.5g}", vector ? "lengths" : "values", made.grid.lowest,
                        made.grid.highest);
    if (!vector) line += fmt::format(", background {:.5g}", made.grid.background);
  }
  if (made.grid.tolerance > 0.0) {
    line += fmt::format("; within {:.3g} of the background became it", made.grid.tolerance);
  }
  if (made.smoothing > 0.0) {
    line += fmt::format("; smoothing changed it by {:.3g} rms", made.smoothing);
  }
  if (made.grid.holes > 0) line += fmt::format("; {} voxels have no data", made.grid.holes);
  if (made.resampling) {
    line += fmt::format("; resampling is off by {:.2g} % of the range rms, {:.2g} % at most",
                        100.0 * made.resampling->rms, 100.0 * made.resampling->largest);
  }
  if (made.grid.quieter_tolerance > 0.0) {
    line += fmt::format("; --tolerance {:.3g} would leave {:.3g} %", made.grid.quieter_tolerance,
                        100.0 * made.grid.quieter_share);
  }
  return line + "\n";
}

OrderedJson jsonOf(const Made& made) {
  const openvdb::GridBase& grid = *made.grid.grid;
  const openvdb::Vec3d edge = grid.voxelSize();
  OrderedJson json{{"name", grid.getName()},
                   {"type", grid.isType<openvdb::Vec3SGrid>() ? "vec3s" : "float"},
                   {"voxel", {edge.x(), edge.y(), edge.z()}},
                   {"active_voxels", grid.activeVoxelCount()},
                   {"voxels", made.grid.voxels},
                   {"holes", made.grid.holes},
                   {"lowest", made.grid.lowest},
                   {"highest", made.grid.highest},
                   {"background", made.grid.background},
                   {"tolerance", made.grid.tolerance}};
  if (made.grid.quieter_tolerance > 0.0) {
    json["quieter"] = {{"tolerance", made.grid.quieter_tolerance},
                       {"share", made.grid.quieter_share}};
  }
  if (made.smoothing > 0.0) json["smoothing_rms"] = made.smoothing;
  if (made.resampling) {
    json["resampling"] = {{"rms", made.resampling->rms},
                          {"largest", made.resampling->largest},
                          {"points", made.resampling->points},
                          {"edge_points", made.resampling->edge_points}};
  }
  if (made.level_set) {
    json["level_set"] = {{"solid", made.level_set->solid_above ? "above" : "below"},
                         {"rms_voxels", made.level_set->rms_error},
                         {"p99_voxels", made.level_set->p99_error},
                         {"crossings", made.level_set->crossings}};
  }
  return json;
}

/// A direction whose sign means nothing; tensors.h makes such.
bool isAxial(const openvdb::GridBase& grid) {
  const std::string name = grid.getName();
  constexpr std::string_view kEnd = "_direction";
  return grid.isType<openvdb::Vec3SGrid>() && name.size() > kEnd.size() &&
         name.compare(name.size() - kEnd.size(), kEnd.size(), kEnd) == 0;
}

/// Where it comes from and what was done to it.
void setMetadata(openvdb::GridBase& grid, const Options& options, const Content& content,
                 const Made& made, const std::vector<double>& times, std::size_t step) {
  const auto text = [&](const char* key, const std::string& value) {
    if (!value.empty()) grid.insertMeta(key, openvdb::StringMetadata(value));
  };
  const auto number = [&](const char* key, double value) {
    grid.insertMeta(key, openvdb::DoubleMetadata(value));
  };
  text("source", options.request.file.filename().string());
  text("imported_by", std::string("palpate ") + cli::kVersion);
  text("description", content.description);
  text("length_unit", content.length_unit);
  const auto unit = content.value_unit.find(grid.getName());
  if (unit != content.value_unit.end()) text("value_unit", unit->second);
  if (made.resampling) number("resampled_to", made.voxel);
  if (made.resampling) number("resampling_rms", made.resampling->rms);
  if (options.smooth > 0.0) number("smooth", options.smooth);
  if (options.iso) number("iso", *options.iso);
  if (step < times.size()) number("time", times[step]);
  if (grid.isType<openvdb::Vec3SGrid>()) {
    grid.setVectorType(openvdb::VEC_CONTRAVARIANT_RELATIVE);
    grid.setIsInWorldSpace(true);
  } else if (!made.level_set) {
    grid.setGridClass(openvdb::GRID_FOG_VOLUME);
  }
}

std::vector<Made> makeGrids(const Options& options, Piece& piece, const std::string& in,
                            Teller& teller) {
  std::vector<Made> out;
  const Progress progress = [&](double done) { teller.progress(done); };
  if (!piece.isImage()) {
    if (options.smooth > 0.0) {
      throw Error("--smooth", "it works on images, and " + in + " is a mesh",
                  "smooth it in the scene: \"smooth\": N");
    }
    teller.stage("resampling");
    const double voxel = options.voxel > 0.0 ? options.voxel : suggestVoxel(piece);
    for (Resampled& resampled : resampleMesh(piece, voxel, in, progress)) {
      Made made;
      made.grid = std::move(resampled.made);
      made.resampling = resampled.error;
      made.voxel = voxel;
      out.push_back(std::move(made));
    }
    return out;
  }
  const auto transform = transformOf(piece.file_from_index, in);
  for (Array& array : piece.arrays) {
    teller.stage(array.name);
    Made made;
    double tolerance = std::max(options.tolerance, 0.0);
    if (options.smooth > 0.0) {
      const Smoothed smoothed = smoothImage(piece, array, options.smooth, in);
      made.smoothing = smoothed.rms_change;
      // The filter leaves tails of next to nothing about everything.
      if (options.tolerance < 0.0) tolerance = 1e-3 * smoothed.range;
    }
    made.grid = gridFromImage(piece, array, tolerance, progress);
    array.values = nullptr;  // one array at a time is in memory twice
    if (made.grid.grid->empty()) continue;
    made.grid.grid->setTransform(transform->copy());
    if (options.voxel > 0.0 && !options.iso) {
      Resampled resampled = resampleGrid(made.grid, options.voxel, in);
      made.grid = std::move(resampled.made);
      made.resampling = resampled.error;
      made.voxel = options.voxel;
      made.image = openvdb::CoordBBox();
    } else {
      made.image =
          openvdb::CoordBBox(0, 0, 0, piece.size[0] - 1, piece.size[1] - 1, piece.size[2] - 1);
    }
    out.push_back(std::move(made));
  }
  return out;
}

/// Replaces the one scalar by its level set.
void takeSurface(const Options& options, std::vector<Made>& all, const std::string& in,
                 Teller& teller) {
  std::vector<std::string> scalars;
  for (const Made& made : all) {
    if (made.grid.grid->isType<openvdb::FloatGrid>()) scalars.push_back(made.grid.grid->getName());
  }
  if (scalars.size() != 1) {
    throw Error("--iso",
                scalars.empty() ? "there is no scalar in it"
                                : fmt::format("it has {} scalars: {}", scalars.size(),
                                              fmt::join(scalars, ", ")),
                scalars.empty() ? "leave it out" : "choose one with --field");
  }
  std::erase_if(all,
                [](const Made& made) { return !made.grid.grid->isType<openvdb::FloatGrid>(); });
  teller.stage("level set");
  Made& made = all.front();
  made.level_set =
      levelSetOf(*openvdb::gridConstPtrCast<openvdb::FloatGrid>(made.grid.grid), *options.iso,
                 options.voxel, in, [&](double done) { teller.progress(done); });
  made.grid.grid = made.level_set->grid;
}

/// Whole or not at all.
void writeVdb(const std::filesystem::path& out, const openvdb::GridCPtrVec& grids, Teller& teller) {
  const std::string partial = fmt::format("{}.partial-{}", out.string(), getpid());
  teller.partial(partial);
  try {
    openvdb::io::File file(partial);
    file.setCompression(openvdb::io::COMPRESS_BLOSC | openvdb::io::COMPRESS_ACTIVE_MASK);
    file.write(grids);
    file.close();
    std::filesystem::rename(partial, out);
  } catch (const std::exception&) {
    std::error_code error;
    std::filesystem::remove(partial, error);
    throw Error(out.string(), "it cannot be written", "choose another place, or make room");
  }
}

/// A first scene, that refers to the .vdb by the way from its own folder.
std::string sceneFor(const std::filesystem::path& scene, const std::filesystem::path& out,
                     const std::vector<Made>& all, const Content& content) {
  std::vector<SuggestInput> inputs;
  for (const Made& made : all) {
    SuggestInput input;
    input.grid = made.grid.grid;
    input.modality = content.modality;
    const auto unit = content.value_unit.find(made.grid.grid->getName());
    if (unit != content.value_unit.end()) input.value_unit = unit->second;
    input.axial = isAxial(*made.grid.grid);
    input.inactive_is_data = made.image.has_value();
    if (made.image && !made.image->empty()) input.extent = *made.image;
    inputs.push_back(std::move(input));
  }
  const auto folder = std::filesystem::absolute(scene).parent_path();
  return suggestScene(std::filesystem::absolute(out).lexically_relative(folder).string(), inputs);
}

/// One step of the file into one .vdb; returns the report.
OrderedJson importStep(const Options& options, Reader& reader, const std::vector<double>& times,
                       std::size_t step, bool first, const std::filesystem::path& out,
                       Teller& teller, std::string& text) {
  const std::string in = options.request.file.string();
  teller.stage("reading");
  Content content = reader.read(step);
  std::vector<std::string> notes = content.notes;
  std::vector<Piece> pieces = takeApart(content, in, notes);
  content.data = nullptr;
  select(pieces, options.request.fields, in);

  std::vector<Made> all;
  for (Piece& piece : pieces) {
    std::vector<std::string> before;
    for (const Array& array : piece.arrays) before.push_back(array.name);
    for (Made& made : makeGrids(options, piece, in, teller)) {
      std::erase(before, made.grid.grid->getName());
      all.push_back(std::move(made));
    }
    for (const std::string& name : before) {
      notes.push_back(fmt::format("{}: left out: all its voxels have one value", name));
    }
    piece.arrays.clear();
  }
  if (all.empty())
    throw Error(in, "all its voxels have one value", "there is nothing to feel in it");
  if (options.iso) takeSurface(options, all, in, teller);

  openvdb::GridCPtrVec grids;
  for (Made& made : all) {
    setMetadata(*made.grid.grid, options, content, made, times, step);
    grids.push_back(made.grid.grid);
  }
  // Both files or none.
  std::optional<cli::WholeFile> scene;
  if (!options.scene.empty() && first) {
    teller.stage("scene");
    const std::string json = sceneFor(options.scene, out, all, content);
    teller.partial(fmt::format("{}.partial-{}", options.scene.string(), getpid()));
    scene.emplace(options.scene);
    scene->write(json + "\n");
  }
  teller.stage("writing");
  writeVdb(out, grids, teller);
  if (scene) scene->commit();

  OrderedJson report{{"file", out.string()}};
  text += out.string() + ":\n";
  if (step < times.size()) report["time"] = times[step];
  report["grids"] = OrderedJson::array();
  std::string voxels;
  for (const Made& made : all) {
    report["grids"].push_back(jsonOf(made));
    if (voxelsOf(made) != voxels) text += voxels = voxelsOf(made);
    text += lineOf(made);
  }
  std::uint64_t memory = 0;
  for (const Made& made : all) memory += made.grid.grid->memUsage();
  report["memory"] = {{"grids", memory}, {"peak", peakMemory()}};
  report["notes"] = notes;
  for (const std::string& note : notes) text += "  " + note + "\n";
  return report;
}

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
      throw Error("--time", fmt::format("\"{}\" is no step of it", time),
                  count == 1 ? "it has one step: leave it out"
                             : fmt::format("give 0 to {}, or all", count - 1));
    }
  }
  return {step};
}

int import(const Options& options, Teller& teller) {
  Request request = options.request;
  request.progress = [&](double done) { teller.progress(done); };
  const std::unique_ptr<Reader> reader = openAny(request);
  const std::vector<double> times = reader->times();
  const std::vector<std::size_t> steps =
      stepsOf(options.time, std::max<std::size_t>(times.size(), 1));
  openvdb::initialize();

  std::string text;
  OrderedJson reports = OrderedJson::array();
  for (const std::size_t step : steps) {
    std::filesystem::path out = options.out;
    if (options.time == "all") {
      out.replace_filename(fmt::format("{}_{:04}.vdb", options.out.stem().string(), step));
    }
    reports.push_back(
        importStep(options, *reader, times, step, step == steps.front(), out, teller, text));
  }
  if (times.size() > 1 && options.time.empty()) {
    const std::string note =
        fmt::format("the first of {} steps: --time N takes another, --time all each", times.size());
    reports[0]["notes"].push_back(note);
    text += "  " + note + "\n";
  }
  teller.out(options.json ? cli::dump(reports.size() == 1 ? reports[0] : reports, 2) + "\n" : text);
  return cli::kDone;
}

void check(const Options& options) {
  if (options.out.extension() != ".vdb") {
    throw Error(options.out.string(), "the output is not named .vdb", "name it so");
  }
  const auto width = [](const char* name, double value) {
    if (!(value >= 0.0 && value <= 1e6)) {
      throw Error(name, fmt::format("{} is no width", value), "give it in the file's units, as 1");
    }
  };
  width("--smooth", options.smooth);
  width("--voxel", options.voxel);
  if (options.iso && !std::isfinite(*options.iso)) {
    throw Error("--iso", "it is no number", "give a value of the data");
  }
}

}  // namespace
}  // namespace palpate::importer

int main(int argc, char** argv) {
  using namespace palpate;
  CLI::App app{
      "palpate import: what scanners and solvers write becomes a .vdb, one grid an array, in the "
      "file's own space"};
  app.name("palpate import");
  importer::Options options;
  importer::Request& request = options.request;
  app.add_option("IN", request.file,
                 "NIfTI, MetaImage, NRRD, a DICOM file or folder, VTK (legacy or XML), Exodus II, "
                 "PLOT3D, or raw values with --raw")
      ->required();
  app.add_option("OUT", options.out, "The .vdb to write")->required();
  app.add_option("--field", request.fields, "An array to take; again for more; default all");
  app.add_option("--voxel", options.voxel,
                 "Resample to cubes of this edge, in the file's units; meshes always are");
  app.add_option("--iso", options.iso, "Make a level set of the surface of this value");
  app.add_option("--smooth", options.smooth,
                 "Standard deviation of a Gaussian, in the file's units (usually mm)");
  app.add_option("--tolerance", options.tolerance,
                 "Values so near to the background become it; default 0, or 0.1 % of the range "
                 "with --smooth");
  app.add_option("--time", options.time, "Step of a series, 0 the first; all: one .vdb a step");
  app.add_option("--series", request.series, "One of several DICOM series, by number or identity");
  app.add_option("--as", request.as, "What a 4-D NIfTI is: vector (3 volumes) or tensor (6)");
  app.add_option("--solution", request.solution, "PLOT3D: the Q file of the grid IN");
  app.add_option("--raw", request.raw, "Layout of raw values: JSON or a file of it");
  app.add_option("--scene", options.scene, "Write a first scene file, to be edited");
  app.add_flag("--json", options.json, "Report as JSON");
  app.footer(
      "Examples:\n"
      "  palpate import head.nii.gz head.vdb --smooth 1 --scene head.json\n"
      "  palpate import flow.ex2 flow.vdb --field V --field Pres --voxel 0.1\n"
      "  palpate import mri.raw mri.vdb --raw '{\"size\":[128,128,84],\"type\":\"uint8\"}'");
  try {
    app.parse(argc, argv);
    importer::check(options);
    return importer::runGuarded(request.file.string(), [&](importer::Teller& teller) {
      return importer::import(options, teller);
    });
  } catch (const CLI::CallForHelp& e) {
    return app.exit(e);
  } catch (const CLI::ParseError& e) {
    cli::complain(fmt::format("usage: {}: see palpate import --help", e.what()));
  } catch (const Error& e) {
    cli::complain(e.what());
  } catch (const std::exception& e) {
    cli::complain(fmt::format("internal error: {}: please report it with the command", e.what()));
    return cli::kInternal;
  }
  return cli::kBadInput;
}
