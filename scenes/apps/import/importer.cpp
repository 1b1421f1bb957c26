#include "palpate/scenes/apps/import/importer.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <tuple>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "palpate/engine/error.h"
#include "palpate/engine/version.h"
#include "palpate/samplers/bricks/brick_grid.h"
#include "palpate/samplers/grid/labels.h"
#include "palpate/samplers/grid/make_volume.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/volume.h"
#include "palpate/scenes/apps/import/even_slices.h"
#include "palpate/scenes/apps/import/fill_values.h"
#include "palpate/scenes/apps/import/pieces.h"
#include "palpate/scenes/apps/import/smooth.h"
#include "palpate/scenes/apps/import/whole_numbers.h"
#include "palpate/scenes/guess/body.h"
#include "palpate/scenes/guess/metadata.h"
#include "palpate/scenes/guess/suggest.h"

namespace palpate::importer {
namespace {

std::string emptyBecause(const Imported& imported) {
  const Gridded& made = imported.made;
  if (made.holes == made.voxels) return "no voxel has data";
  const std::string all = made.holes > 0 ? "all voxels with data " : "all voxels ";
  return all + (made.tolerance > 0.0 ? "are within the tolerance of the background"
                                     : "have the same value");
}

/// Replaces fill values by NaN, subtracts an offset from large whole numbers, and adds a note about
/// the loss that remains. Leaves the values of labels unchanged.
void prepareValues(Array& array, EarlierSteps& earlier, std::vector<std::string>& notes,
                   const Shared& shared) {
  if (!array.labels) {
    hideFillValues(array, notes, shared);
    subtractOffset(array, earlier.value_offsets[array.name], shared);
  }
  // Floats represent all whole numbers of 1 and 2 bytes.
  if (array.values.bytesEach() < 4) return;
  const Loss own = shared.isKnown() ? Loss() : floatLoss(array.values);
  if (const Loss loss = shared.worst(own); !loss.empty()) {
    notes.push_back(fmt::format("{}: {}", array.name, loss));
  }
}

std::vector<Imported> fromMesh(const Options& options, Piece& piece, const std::string& in,
                               const Telling& telling, std::vector<std::string>& notes,
                               const Shared& shared, EarlierSteps& earlier) {
  if (options.smooth.sigma > 0.0) {
    throw Error("--smooth", "this option works on images, but " + in + " is a mesh",
                "smooth the values in the scene, with \"smooth\": 1.5 (voxels)");
  }
  if (options.tolerance) {
    throw Error("--tolerance", "this option works on images, but " + in + " is a mesh",
                "omit this option");
  }
  telling.stage("resampling");
  for (Array& array : piece.arrays) prepareValues(array, earlier, notes, shared);
  double voxel = options.iso ? 0.0 : options.voxel;
  if (voxel <= 0.0) {
    const SuggestedVoxel suggested = piece.mesh->suggestVoxel();
    voxel = suggested.edge;
    if (suggested.edge > suggested.by_cell) {
      notes.push_back(fmt::format(
          "the voxel edge is {:g} in the file's unit, which limits the voxels to {:g} per point "
          "(33 x 33 x 33 in a small mesh); without this limit, the edge would be {:g}, for {:.2g} "
          "million voxels; {}",
          voxel, kVoxelsPerPoint, suggested.by_cell, 1e-6 * suggested.voxels_by_cell,
          options.iso ? "smaller voxels are not possible with --iso on a mesh"
                      : fmt::format("--voxel {:g} selects the smaller voxels", suggested.by_cell)));
    }
  }
  std::vector<Imported> out;
  std::vector<Resampled> all = piece.mesh->resample(piece.arrays, voxel, in, telling.progress);
  for (std::size_t a = 0; a < all.size(); ++a) {
    Imported imported;
    imported.made = std::move(all[a].made);
    imported.made.active = imported.made.grid->activeVoxelCount();
    imported.resampling = all[a].error;
    imported.voxel = voxel;
    imported.unit = piece.arrays[a].unit;
    imported.axial = piece.arrays[a].axial;
    imported.value_offset = piece.arrays[a].value_offset;
    out.push_back(std::move(imported));
  }
  return out;
}

/// Returns true if the bricks get the image's own voxels.
bool keepsVoxelsInBricks(const Options& options) {
  return options.bricks && !options.iso && !(options.voxel > 0.0);
}

/// Returns the slices that this rank reads: those of its bricks and their aprons, one more on each
/// side for the values beside voxels without data, and those that the smoothing filter reads.
Slab neededOf(const Options& options, const Shared& shared, int slices, const Affine& map) {
  return shared.own(slices, kBrickApron + 1 + smoothingReach(map, slices, options.smooth));
}

/// Returns an image without its arrays, which would keep their memory.
Piece withoutArrays(const Piece& image) {
  Piece out;
  out.size = image.size;
  out.held = image.held;
  out.file_from_index = image.file_from_index;
  out.depths = image.depths;
  out.hidden = image.hidden;
  out.by_cell = image.by_cell;
  return out;
}

ResamplingError sumOf(ResamplingError second, const ResamplingError& first) {
  second.rms += first.rms;
  second.largest += first.largest;
  return second;
}

/// Tolerance with which no voxel counts as background.
constexpr double kKeepAll = -1.0;

/// Returns true if a constant array is imported: a vector, which may be a displacement of zero, or
/// a frame of a sequence. A level set (--iso) needs values that vary.
bool keepsConstant(const Options& options, const Array& array) {
  return !options.iso && (options.time == "all" || array.values.components() == 3);
}

Values constantLike(const Values& values, double constant) {
  Values out(Type::kFloat32, values.components(), values.tuples());
  std::fill_n(out.as<float>(), out.size(), static_cast<float>(constant));
  return out;
}

/// Throws Error if an option would blend the labels of a segmentation.
void checkNotBlended(const Options& options, const Array& array) {
  if (!array.labels) return;
  const auto refuse = [&](bool wrong, const char* option, const char* remedy) {
    if (!wrong) return;
    throw Error(option, array.name + " has labels, which must not be blended", remedy);
  };
  refuse(options.smooth.sigma > 0.0, "--smooth",
         "omit this option: the mode of a label has its own \"smooth\"");
  refuse(options.voxel > 0.0 && !options.iso, "--voxel", "omit this option");
  refuse(options.tolerance.value_or(0.0) > 0.0, "--tolerance", "omit this option");
  // The coarse levels have means, and a scene cannot select labels in bricks.
  refuse(options.bricks && !options.iso, "--bricks", "omit this option");
}

Imported fromImage(const Options& options, const Piece& whole, Array array,
                   const std::string& length_unit, const std::string& in, const Telling& telling,
                   std::vector<std::string>& notes, const Shared& shared, EarlierSteps& earlier) {
  telling.stage(array.name);
  checkNotBlended(options, array);
  prepareValues(array, earlier, notes, shared);
  Imported imported;
  imported.labels = array.labels.value_or(std::vector<Label>());
  Piece piece = withoutArrays(whole);
  if (!piece.depths.empty()) imported.resampling = evenSlices(piece, array);
  if (!shared.isAlone()) {
    // Takes the slices of this rank: the reader may have read the whole image.
    const Slab needed = neededOf(options, shared, piece.size[2], piece.file_from_index);
    array.values = slicesOf(piece, array.values, needed);
    piece.hidden = slicesOf(piece, piece.hidden, needed);
    piece.held = needed;
  }
  imported.unit = array.unit;
  imported.axial = array.axial;
  imported.value_offset = array.value_offset;
  double tolerance = options.tolerance.value_or(0.0);
  if (options.smooth.sigma > 0.0) {
    telling.stage("smoothing " + array.name);
    const Smoothed smoothed =
        smoothImage(piece, array, options.smooth, in, telling.progress, shared);
    telling.stage(array.name);
    imported.smoothing = smoothed.rms_change;
    // The filter leaves small values around each object. The default tolerance makes them inactive.
    if (!options.tolerance) tolerance = 1e-3 * smoothed.range;
  }
  const bool on_cubes = options.voxel > 0.0 && !options.iso;
  const auto make = [&](double within) {
    if (on_cubes) return gridOnCubes(piece, array, options.voxel, within, in, telling.progress);
    return keepsVoxelsInBricks(options)
               ? gridOnRequest(piece, array, within, in, telling.progress, shared)
               : gridFromImage(piece, array, within, in, telling.progress);
  };
  imported.made = make(isDisplacement(options) ? kKeepAll : tolerance);
  if (!isDisplacement(options) && imported.made.active == 0 && keepsConstant(options, array)) {
    if (imported.made.holes == imported.made.voxels) {
      const auto last = earlier.backgrounds.find(array.name);
      const bool is_first = last == earlier.backgrounds.end();
      const double background = is_first ? 0.0 : last->second;
      array.values = constantLike(array.values, background);
      piece.hidden = Values();
      notes.push_back(fmt::format(
          "{}: no voxel has data: all get the {} {:g}", array.name,
          is_first ? "value" : "background of the last step whose values vary,", background));
    } else {
      notes.push_back(fmt::format("{}: {}, and all are kept", array.name, emptyBecause(imported)));
    }
    imported.made = make(kKeepAll);
    imported.made.tolerance = 0.0;
  } else if (array.values.components() == 1) {
    earlier.backgrounds[array.name] = imported.made.background;
  }
  if (on_cubes) {
    imported.resampling = sumOf(errorOf(piece, array, imported.made),
                                imported.resampling.value_or(ResamplingError{}));
    imported.voxel = options.voxel;
    imported.image = openvdb::CoordBBox();
  } else {
    imported.image =
        openvdb::CoordBBox(0, 0, 0, piece.size[0] - 1, piece.size[1] - 1, piece.size[2] - 1);
  }
  if (imported.made.make) {
    imported.parts = GridParts{imported.made.grid,
                               *imported.image,
                               {shared.bricks(piece.size[2])},
                               [make = imported.made.make](std::size_t) { return make; }};
  }
  if (isDisplacement(options)) {
    // Inverts the field after errorOf(), which must compare the given vectors with the array.
    telling.stage("displacement");
    takeDisplacement(imported.made,
                     options.direction == "forward" ? Direction::kForward : Direction::kBackward,
                     length_unit, in, telling.progress, notes);
  }
  return imported;
}

/// Returns true if a step may be an empty level set, which a scene plays as background. Bricks
/// cannot be empty.
bool keepsEmptySurface(const Options& options) {
  return options.iso && options.time == "all" && !options.bricks;
}

void takeSurface(const Options& options, const std::string& length_unit, const std::string& in,
                 const Telling& telling, Step& step, EarlierSteps& earlier) {
  std::vector<std::string> scalars;
  std::vector<std::string> others;
  for (const Imported& imported : step.grids) {
    const openvdb::GridBase& grid = *imported.made.grid;
    (grid.isType<openvdb::FloatGrid>() ? scalars : others).push_back(grid.getName());
  }
  if (scalars.size() != 1) {
    throw Error("--iso",
                scalars.empty() ? "none of the imported arrays is a scalar"
                                : fmt::format("{} scalars are imported: {}", scalars.size(),
                                              fmt::join(scalars, ", ")),
                scalars.empty() ? "with --field choose a scalar whose values vary, or omit --iso"
                                : "choose one with --field");
  }
  if (!others.empty()) {
    step.notes.push_back(
        fmt::format("{}: skipped: --iso applies to scalars only", fmt::join(others, ", ")));
  }
  std::erase_if(step.grids, [](const Imported& imported) {
    return !imported.made.grid->isType<openvdb::FloatGrid>();
  });
  telling.stage("level set");
  Imported& imported = step.grids.front();
  Gridded& made = imported.made;
  imported.level_set = levelSetOf(*openvdb::gridConstPtrCast<openvdb::FloatGrid>(made.grid),
                                  *options.iso - imported.value_offset, options.voxel, in,
                                  telling.progress, keepsEmptySurface(options));
  imported.value_offset = 0.0;
  imported.unit = length_unit;
  made.grid = imported.level_set->grid;
  made.background = static_cast<double>(imported.level_set->grid->background());
  made.lowest = -made.background;
  made.highest = made.background;
  made.voxels = imported.level_set->grid->activeVoxelCount();
  made.active = made.voxels;
  made.quieter_tolerance = 0.0;
  if (made.active == 0 && !std::exchange(earlier.has_empty, true)) {
    step.notes.push_back(
        fmt::format("{}: no surface has the value of --iso in this step: the file of each such "
                    "step has an empty level set, which a scene plays as background",
                    made.grid->getName()));
  }
}

void setMetadata(const Options& options, const Content& content, const Step& step,
                 const Imported& imported) {
  openvdb::GridBase& grid = *imported.made.grid;
  const auto text = [&](const char* key, const std::string& value) {
    if (!value.empty()) grid.insertMeta(key, openvdb::StringMetadata(value));
  };
  const auto number = [&](const char* key, double value) {
    grid.insertMeta(key, openvdb::DoubleMetadata(value));
  };
  text("source", options.request.file.filename().string());
  text("imported_by", std::string("palpate ") + kVersion);
  text("description", content.description);
  text(kMetaLengthUnit, content.length_unit);
  text(kMetaValueUnit, imported.unit);
  if (content.patient) text(kMetaSpace, "RAS");
  if (imported.resampling) {
    if (imported.voxel > 0.0) number("resampled_to", imported.voxel);
    if (imported.resampling->points > 0) number("resampling_rms", imported.resampling->rms);
    if (imported.resampling->edge_points > 0) {
      number("resampling_edge_rms", imported.resampling->edge_rms);
    }
  }
  if (options.smooth.sigma > 0.0)
    number(options.smooth.in_file_units ? "smooth" : "smooth_voxels", options.smooth.sigma);
  if (imported.made.tolerance > 0.0) number("tolerance", imported.made.tolerance);
  if (imported.value_offset != 0.0) {
    constexpr double kEnd = 9223372036854775808.0;  // 2^63
    if (imported.value_offset >= -kEnd && imported.value_offset < kEnd) {
      grid.insertMeta("value_offset",
                      openvdb::Int64Metadata(static_cast<std::int64_t>(imported.value_offset)));
    } else {
      number("value_offset", imported.value_offset);
    }
  }
  if (imported.image && !imported.level_set && imported.made.holes > 0) {
    grid.insertMeta(kMetaInactiveIsMissing, openvdb::BoolMetadata(true));
  }
  if (imported.level_set) number("iso", *options.iso);
  if (step.time) number("time", *step.time);
  // From the metadata, `palpate scene` guesses the same scene as this import.
  text(kMetaImportedFrom, imported.image ? "image" : "mesh");
  if (imported.image && !imported.image->empty() && !imported.level_set) {
    const openvdb::Coord size = imported.image->dim();
    grid.insertMeta(guess::kMetaImageSize, openvdb::Vec3IMetadata({size.x(), size.y(), size.z()}));
  }
  if (step.modality == Modality::kCt) text(guess::kMetaModality, "CT");
  if (step.modality == Modality::kMr) text(guess::kMetaModality, "MR");
  if (!imported.level_set) insertLabels(grid, imported.labels);
  if (imported.axial) grid.insertMeta(guess::kMetaAxial, openvdb::BoolMetadata(true));
  if (grid.isType<openvdb::Vec3SGrid>()) {
    grid.setVectorType(openvdb::VEC_CONTRAVARIANT_RELATIVE);
    grid.setIsInWorldSpace(true);
  } else if (!imported.level_set) {
    grid.setGridClass(openvdb::GRID_FOG_VOLUME);
  }
}

/// Throws Error if the first array does not match --as, because some readers ignore this option.
void checkAsked(const Request& request, const Content& content) {
  if (request.as.empty()) return;
  const int width = content.pieces.front().arrays.front().values.components();
  const bool tensor = request.as == "tensor";
  if (tensor ? width >= 6 : width == 3) return;
  throw Error(
      "--as",
      fmt::format("{} has {} per voxel, not the {} of a {}", request.file.string(),
                  width == 1 ? "one value" : fmt::format("{} values", width), tensor ? 6 : 3,
                  request.as),
      fmt::format("give a file with {} values per voxel, or omit this option", tensor ? 6 : 3));
}

/// Throws Error if --bricks would have to write several arrays. takeSurface() checks those of
/// --iso.
void checkOneForBricks(const Options& options, const std::vector<Piece>& pieces) {
  if (!options.bricks || options.iso) return;
  std::vector<std::string> names;
  for (const Piece& piece : pieces) {
    for (const Array& array : piece.arrays) names.push_back(array.name);
  }
  if (names.size() <= 1) return;
  throw Error("--bricks",
              fmt::format("{} arrays are imported, and --bricks writes only one: {}", names.size(),
                          fmt::join(names, ", ")),
              "choose one with --field");
}

/// Returns a Telling that is silent while the group is divided, because each slab repeats all
/// stages.
Telling unlessDivided(const Telling& telling, const SlabGroup& group) {
  Telling out;
  out.stage = [stage = telling.stage, &group](const std::string& what) {
    if (!group.isDivided()) stage(what);
  };
  if (telling.progress) {
    out.progress = [progress = telling.progress, &group](double done) {
      if (!group.isDivided()) progress(done);
    };
  }
  return out;
}

/// Imports a step in one rank of the group (importStep).
Step importRank(const Options& options, Reader& reader, std::size_t step, const Telling& telling,
                SlabGroup& group, EarlierSteps& earlier) {
  SingleProcess alone;
  const Shared shared = keepsVoxelsInBricks(options) ? Shared(group) : Shared(alone);
  const std::string in = options.request.file.string();
  telling.stage("reading");
  Content content = reader.read(step);
  checkAsked(options.request, content);
  Step out;
  out.modality = content.modality;
  out.notes = content.notes;
  const std::vector<double> times = reader.times();
  if (step < times.size()) out.time = times[step];
  std::vector<Piece> pieces = makeReady(content, in, out.notes);
  joinComponents(pieces, options.request.fields, out.notes);
  select(pieces, options.request.fields, in);
  checkOneForBricks(options, pieces);
  std::vector<Imported> constant;

  for (Piece& piece : pieces) {
    if (!piece.isImage()) {
      for (Imported& imported : fromMesh(options, piece, in, telling, out.notes, shared, earlier)) {
        out.grids.push_back(std::move(imported));
      }
      continue;
    }
    for (Array& array : piece.arrays) {
      // Passes each array on before the next one is converted, so that only one array is in memory
      // twice.
      Imported imported = fromImage(options, piece, std::exchange(array, {}), content.length_unit,
                                    in, telling, out.notes, shared, earlier);
      if (imported.made.active == 0) imported.made.grid->newTree();  // frees the voxels
      (imported.made.active == 0 ? constant : out.grids).push_back(std::move(imported));
    }
  }
  const auto is_scalar = [](const Imported& imported) {
    return imported.made.grid->isType<openvdb::FloatGrid>();
  };
  if (keepsEmptySurface(options) && constant.size() == 1 && is_scalar(constant.front()) &&
      std::none_of(out.grids.begin(), out.grids.end(), is_scalar)) {
    out.grids.push_back(std::move(constant.front()));
    constant.clear();
  }
  for (const Imported& imported : constant) {
    const std::string name = imported.made.grid->getName();
    out.notes.push_back(fmt::format("{}: skipped: {}", name, emptyBecause(imported)));
  }
  if (options.iso && !out.grids.empty()) {
    takeSurface(options, content.length_unit, in, telling, out, earlier);
  }
  for (const Imported& imported : out.grids) {
    setMetadata(options, content, out, imported);
    if (imported.value_offset == 0.0) continue;
    out.notes.push_back(
        fmt::format("{}: a float cannot hold these whole numbers exactly: the grid stores each "
                    "value minus {:.0f} (metadata value_offset); subtract the same number from the "
                    "values in a scene",
                    imported.made.grid->getName(), imported.value_offset));
  }
  return out;
}

}  // namespace

bool hasContrast(const Step& step) {
  return std::any_of(step.grids.begin(), step.grids.end(), [](const Imported& imported) {
    return imported.level_set ? imported.made.active > 0
                              : imported.made.lowest < imported.made.highest;
  });
}

std::unique_ptr<Reader> openFor(const Options& options, const Telling& telling, SlabGroup& group) {
  Request request = options.request;
  request.progress = unlessDivided(telling, group).progress;
  request.timed = !options.time.empty();
  if (keepsVoxelsInBricks(options)) {
    request.slices = [&options, &group](const std::array<int, 3>& size, const Affine& map,
                                        bool is_packed, int depth) {
      if (!is_packed) group.divide(size, /*is_slow=*/options.smooth.sigma > 0.0, depth);
      return neededOf(options, Shared(group), size[2], map);
    };
  }
  return openAny(request);
}

Step importStep(const Options& options, Reader& reader, std::size_t step, const Telling& telling,
                SlabGroup& group, EarlierSteps& earlier) {
  const auto work = [&options, &reader, step, quiet = unlessDivided(telling, group), &group,
                     before = earlier] {
    EarlierSteps now = before;
    Step out = importRank(options, reader, step, quiet, group, now);
    return std::pair(std::move(out), std::move(now));
  };
  const auto turn = [&](int pass) {
    if (group.rank() == 0) telling.stage(fmt::format("reading, pass {}", pass + 1));
    if (telling.progress) telling.progress(static_cast<double>(group.rank()) / group.size());
  };
  Step out;
  std::tie(out, earlier) = group.run(work, turn);
  if (!group.isDivided()) return out;
  for (std::size_t n = 0; n < out.grids.size(); ++n) {
    Imported& imported = out.grids[n];
    if (!imported.parts) continue;
    imported.made.make = nullptr;  // frees the first slab
    const int layers = (imported.image->dim().z() + kBrickSide - 1) / kBrickSide;
    imported.parts->shares = group.sharesOf(layers);
    imported.parts->open = [&group, work, n](std::size_t part) {
      return group.runAgain(static_cast<int>(part), work).first.grids[n].made.make;
    };
  }
  return out;
}

namespace {

guess::SuggestInput inputOf(const Imported& imported, const Step& step) {
  guess::SuggestInput input;
  input.grid = imported.made.grid;
  input.modality = step.modality;
  input.value_unit = imported.level_set ? "" : imported.unit;
  input.axial = imported.axial;
  input.inactive_is_data = imported.image.has_value() && imported.made.holes == 0;
  if (imported.image && !imported.image->empty()) input.extent = *imported.image;
  return input;
}

/// Returns a region like that of findLargestBody(), with all voxels of the image.
openvdb::FloatGrid::Ptr wholeRegion(const Imported& image) {
  auto region = openvdb::FloatGrid::create(0.0F);
  region->setTransform(image.made.grid->transform().copy());
  region->setName(guess::bodyNameOf(image.made.grid->getName()));
  region->insertMeta(guess::kMetaBodyOf, openvdb::StringMetadata(image.made.grid->getName()));
  region->fill(image.image->empty() ? image.made.grid->evalActiveVoxelBoundingBox() : *image.image,
               1.0F, true);
  return region;
}

}  // namespace

void addBodies(Step& step, EarlierSteps& earlier) {
  for (std::size_t i = 0, count = step.grids.size(); i < count; ++i) {
    const Imported& image = step.grids[i];
    if (!image.image || image.level_set) continue;
    const std::string name = image.made.grid->getName();
    const bool is_first = !earlier.bodies.contains(name);
    const std::optional<guess::LargestBody> body = guess::findLargestBody(inputOf(image, step));
    if (!body && is_first) continue;
    Imported region;
    region.made.grid = body ? body->region : wholeRegion(image);
    region.made.voxels = image.made.voxels;
    region.made.active = region.made.grid->activeVoxelCount();
    region.made.lowest = region.made.highest = 1.0;
    region.image = image.image;
    region.made.grid->insertMeta(kMetaImportedFrom, openvdb::StringMetadata("image"));
    if (is_first) {
      earlier.bodies.insert(name);
      step.notes.push_back(
          fmt::format("{0}: this grid marks the region of the largest body: the image has {1} "
                      "other {2}, such as the table below a patient, and the scene's modes act "
                      "only in this region; to feel all bodies, remove \"by\": \"{3}\" from the "
                      "modes, and the factors of a \"product\" that have it",
                      region.made.grid->getName(), body->left, body->left == 1 ? "body" : "bodies",
                      guess::volumeNameOf(region.made.grid->getName())));
    }
    step.grids.push_back(std::move(region));
  }
}

std::string sceneFor(const std::string& vdb, const Step& step) {
  std::vector<guess::SuggestInput> inputs;
  for (const Imported& imported : step.grids) inputs.push_back(inputOf(imported, step));
  return guess::suggestScene(vdb, inputs);
}

}  // namespace palpate::importer
