#include "palpate/scenes/library/build_scene.h"

#include <algorithm>
#include <cmath>
#include <exception>
#include <set>
#include <utility>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/bricks.h"
#include "palpate/samplers/time/first_frame.h"
#include "palpate/scenes/library/build_parts.h"
#include "palpate/scenes/library/compute_fields.h"
#include "palpate/scenes/library/frames.h"
#include "palpate/scenes/library/label_modes.h"
#include "palpate/scenes/library/move_volumes.h"
#include "palpate/scenes/library/place_volumes.h"
#include "palpate/scenes/library/play_sequences.h"
#include "palpate/scenes/library/scene_cache.h"
#include "palpate/scenes/library/spec_lookup.h"

namespace palpate {
namespace {

constexpr double kLargestProperty = 1e6;
constexpr double kLongestTime = 1e9;  // [s]: largest time of a keyframe

/// Rejects a number that is so large that a tick would overflow.
void checkSize(const SceneSpec& spec, const std::string& path, double value, double most,
               const char* unit) {
  if (std::abs(value) <= most) return;
  throw SceneError(pathIn(spec, path),
                   fmt::format("{}{} is beyond the limit of {:g}{}", value, unit, most, unit),
                   "give a number within the limit");
}

/// Checks the sizes of the numbers of the coupling, the modes and the keyframes. Placer checks the
/// places of volumes.
void checkSizes(const SceneSpec& spec, const GraphSpec& placed) {
  checkSize(spec, "/coupling/stiffness", stiffestCoupling(spec).stiffness, kLargestProperty,
            " N/m");
  checkSize(spec, "/coupling/damping", spec.coupling.damping, kLargestProperty, " N s/m");
  for (std::size_t i = 0; i < spec.graph.modes.size(); ++i) {
    const ModeSpec& mode = spec.graph.modes[i];
    const std::string path = fmt::format("/modes/{}", i);
    checkSize(spec, path + "/strength", mode.strength.highest(), kLargestProperty, " N");
    checkSize(spec, path + "/friction", mode.friction.highest(), kLargestProperty, "");
    checkSize(spec, path + "/viscosity", mode.viscosity.highest(), kLargestProperty, " N");
    if (mode.kind != ModeKind::kGuide) continue;
    checkSize(spec, path + "/at", placed.modes[i].guide.position.lpNorm<Eigen::Infinity>(),
              kFarthestPlace, " m");
  }
  for (const auto& [name, volume] : spec.volumes) {
    for (std::size_t i = 0; i < volume.place.keyframes.size(); ++i) {
      const Keyframe& key = volume.place.keyframes[i];
      const std::string path = fmt::format("/volumes/{}/place/keyframes/{}", name, i);
      checkSize(spec, path + "/time", key.time, kLongestTime, " s");
      checkSize(spec, path + "/translate", key.translate.lpNorm<Eigen::Infinity>(), kFarthestPlace,
                " m");
    }
  }
}

/// Rejects surfaces, isosurfaces and forces of scalars with nearest-neighbour interpolation.
void checkGradients(const SceneSpec& spec, const BuiltScene& built) {
  for (std::size_t i = 0; i < spec.graph.modes.size(); ++i) {
    const ModeSpec& mode = spec.graph.modes[i];
    const auto volume = spec.volumes.find(mode.of);
    if (volume == spec.volumes.end() || isGiven(volume->second.field) ||
        volume->second.sampling.interpolation != Interpolation::kNearest) {
      continue;
    }
    const auto read = built.volumes.find(mode.of);
    const bool scalar = read != built.volumes.end() && !read->second->info().vector;
    const bool force = mode.kind == ModeKind::kForce && scalar;
    if (mode.kind != ModeKind::kSurface && mode.kind != ModeKind::kIsosurface && !force) continue;
    throw SceneError(
        pathIn(spec, fmt::format("/modes/{}/of", i)),
        fmt::format("mode {} needs a gradient, but \"{}\" has the interpolation "
                    "\"nearest\", which has no gradient",
                    wordFor(mode.kind), mode.of),
        "set the volume's \"interpolation\" to \"trilinear\", \"quadratic\" or \"cubic\"");
  }
}

/// Returns the properties of a volume; for bricks, of the finest level.
const GridInfo& infoOf(const BuiltScene& built, const std::string& name) {
  const auto window = built.windows.find(name);
  return window != built.windows.end() ? window->second->manifest().info()
                                       : built.volumes.at(name)->info();
}

/// Opens a volume in bricks. Rejects options that volumes in bricks do not support.
void openBricks(const SceneSpec& spec, const std::string& name, BuiltScene& built,
                SceneCache& cache) {
  const VolumeSpec& volume = spec.volumes.at(name);
  const std::string path = pathIn(spec, "/volumes/" + name);
  const auto refuse = [&](bool wrong, const char* key, const char* why, const char* remedy) {
    if (wrong) throw SceneError(path + "/" + key, why, remedy);
  };
  refuse(volume.smooth.sigma != 0.0, "smooth", "a volume in bricks cannot be smoothed at load",
         "smooth the volume before you write the bricks");
  refuse(volume.sampling.interpolation != Interpolation::kTrilinear, "interpolation",
         "a volume in bricks has trilinear interpolation only",
         "give the volume as a .vdb, or remove \"interpolation\" if trilinear suits its values");
  refuse(volume.sampling.axial, "axial", "a volume in bricks cannot be axial",
         "give the volume as a .vdb, or remove \"axial\" if the signs of its vectors matter");
  refuse(!volume.instances.empty(), "instances", "a volume in bricks can have only one place",
         "give the volume as a .vdb, or replace \"instances\" by \"place\"");
  constexpr double kDefault = 256.0;
  WindowParams params;
  constexpr double kMost = 1e9;
  params.budget = static_cast<std::uint64_t>(std::min(kMost, volume.budget_mb.value_or(kDefault)) *
                                             1024 * 1024);
  params.lock = !spec.waits;
  params.waits = spec.waits;
  try {
    const SceneCache::Bricks bricks = cache.bricks(volume.file, params);
    const std::string& is = bricks.window->manifest().info().name;
    if (!volume.grid.empty() && volume.grid != is) {
      throw VolumeError(volume.file.string(), "the bricks hold the grid \"" + is + "\"",
                        "correct \"grid\", or name another folder");
    }
    built.windows[name] = bricks.window;
    built.volumes[name] = bricks.coarsest;
  } catch (const VolumeError& e) {
    throw SceneError::within(path, e);
  }
}

std::vector<std::string> remarks(const GridInfo& info) {
  std::vector<std::string> out;
  if (info.filled > 0) {
    out.push_back(fmt::format(
        "{} values were NaN, infinite or above 1e100: the background, {}, replaces them",
        info.filled, info.background));
  }
  if (info.was_local) {
    out.emplace_back("the vectors were in index space and now are in world space");
  }
  if (info.smoothing.sigma > 0.0) {
    const Smoothing& s = info.smoothing;
    out.push_back(
        fmt::format("smoothed with a Gaussian of {:.3g} voxels: values changed by {:.3g} rms, "
                    "{:.3g} at most; waves "
                    "shorter than {:.1f} voxels keep less than half their height",
                    s.sigma, s.rms_change, s.largest_change, s.half_height_voxels));
  }
  return out;
}

/// Collects the files of a scene, and then loads them together.
class VolumeLoader {
 public:
  VolumeLoader(const SceneSpec& spec, BuiltScene& built, SceneCache& cache)
      : spec_(spec), built_(built), cache_(cache), displacing_(displacementNames(spec)) {
    checkDisplacements(spec, displacing_);
  }

  Displacements load(const Progress& progress) {
    for (const auto& [name, volume] : spec_.volumes) {
      try {
        open(name, volume);
      } catch (const VolumeError& e) {
        throw SceneError::within(pathIn(spec_, "/volumes/" + name), e);
      }
    }
    const std::vector<LoadResult> loaded = cache_.load(requests_, progress);
    for (std::size_t i = 0; i < names_.size(); ++i) {
      try {
        put(names_[i],
            loaded[i].error ? firstFrameOf(names_[i], loaded[i].error) : loaded[i].volume);
      } catch (const VolumeError& e) {
        throw SceneError::within(pathIn(spec_, "/volumes/" + names_[i]), e);
      }
    }
    return std::move(displacements_);
  }

 private:
  /// Opens a volume, or adds its files to those that load() will load.
  void open(const std::string& name, const VolumeSpec& volume) {
    const bool displaces = displacing_.count(name) != 0;
    if (!displaces && isGiven(volume.field)) {
      built_.fields[name] = volume.field;
    } else if (!displaces && isSequence(volume)) {
      checkSequence(spec_, name);
      // The first frame with data determines the place of all frames.
      request(name, framesOf(volume).front());
    } else if (!displaces && isInBricks(volume)) {
      openBricks(spec_, name, built_, cache_);
    } else if (volume.volume != nullptr) {
      put(name, volume.volume);
    } else if (isMask(volume)) {
      return;  // computeMasks() makes it from another volume
    } else if (displaces) {
      for (VolumeRequest& frame : framesOf(volume)) request(name, std::move(frame));
    } else {
      checkFile(name, volume);
      request(name, {volume.file, volume.grid, volume.non_finite, volume.smooth});
    }
  }

  void checkFile(const std::string& name, const VolumeSpec& volume) const {
    std::error_code error;
    if (volume.budget_mb && std::filesystem::exists(volume.file, error)) {
      throw SceneError(pathIn(spec_, fmt::format("/volumes/{}/window", name)),
                       "the volume is not in bricks, so the whole volume is in memory",
                       "remove \"window\", or convert the volume with palpate brick");
    }
    if (isPattern(volume.file)) {
      throw SceneError(pathIn(spec_, fmt::format("/volumes/{}/file", name)),
                       "the name is a pattern for many files, but their times are missing",
                       "add \"frames\": {\"rate\": 25}, or name one file");
    }
    if (volume.sampling.axial && volume.smooth.sigma != 0.0) {
      throw SceneError(pathIn(spec_, fmt::format("/volumes/{}/smooth", name)),
                       "smoothing cancels axial vectors, because they have no sign",
                       "remove \"smooth\"");
    }
  }

  /// Returns the first frame with data, if `name` is a sequence. Otherwise rethrows `error`.
  [[nodiscard]] std::shared_ptr<const Volume> firstFrameOf(const std::string& name,
                                                           const std::exception_ptr& error) {
    const VolumeSpec& volume = spec_.volumes.at(name);
    if (!isSequence(volume) || displacing_.count(name) != 0) std::rethrow_exception(error);
    return firstWithData(framesOf(volume),
                         [&](const VolumeRequest& frame) {
                           const LoadResult loaded = cache_.load({frame}, nullptr).front();
                           if (loaded.error) std::rethrow_exception(loaded.error);
                           return loaded.volume;
                         })
        .second;
  }

  void request(const std::string& name, VolumeRequest frame) {
    names_.push_back(name);
    requests_.push_back(std::move(frame));
  }

  void put(const std::string& name, const std::shared_ptr<const Volume>& volume) {
    if (displacing_.count(name) != 0) {
      displacements_[name].push_back(volume);
    } else {
      built_.volumes[name] = volume;
    }
  }

  const SceneSpec& spec_;
  BuiltScene& built_;
  SceneCache& cache_;
  const std::set<std::string> displacing_;
  std::vector<std::string> names_;
  std::vector<VolumeRequest> requests_;
  Displacements displacements_;
};

std::map<std::string, const GridInfo*> gridsOf(const BuiltScene& built,
                                               const Displacements& displacements) {
  std::map<std::string, const GridInfo*> grids;
  for (const auto& [name, volume] : built.volumes) grids[name] = &infoOf(built, name);
  for (const auto& [name, frames] : displacements) grids[name] = &frames.front()->info();
  return grids;
}

/// Adds the remarks on a volume to the notes. `which` is its name, or its name and a frame.
void noteRemarks(const SceneSpec& spec, const std::string& which, const Volume& volume,
                 BuiltScene& built) {
  for (const std::string& remark : remarks(volume.info())) {
    built.notes.push_back(fmt::format("{}: {}", pathIn(spec, "/volumes/" + which), remark));
  }
}

void makeFields(const SceneSpec& spec, BuiltScene& built, Placer& placer, SceneCache& cache) {
  for (const auto& [name, volume] : built.volumes) {
    built.placements[name] = placer.placementOf(name);
    if (!spec.volumes.at(name).mask) noteRemarks(spec, name, *volume, built);
    built.samplings[name] = samplingOf(spec, name);
    try {
      const auto window = built.windows.find(name);
      if (window != built.windows.end()) {
        built.fields[name] = cache.field(window->second, built.placements[name], spec.slope_reach);
      } else if (isSequence(spec.volumes.at(name))) {
        built.sequences[name] = openSequence(spec, name, built.placements[name], cache);
        built.fields[name] = cache.field(built.sequences[name]);
      } else {
        built.fields[name] = cache.field(volume, built.placements[name], built.samplings[name]);
      }
    } catch (const VolumeError& e) {
      throw SceneError::within(pathIn(spec, "/volumes/" + name), e);
    }
  }
}

/// Extends the scene's bounds by each field at all times of its motion.
void extendBounds(BuiltScene& built) {
  for (const auto& [name, field] : built.fields) {
    Box box = std::visit([](const auto& f) { return f->frame().bounds; }, field);
    const auto motion = built.motions.find(name);
    if (motion != built.motions.end()) box = motion->second->sweep(box);
    built.bounds.extend(box.lower);
    built.bounds.extend(box.upper);
  }
}

void noteEmptySurfaces(const SceneSpec& spec, BuiltScene& built) {
  for (std::size_t i = 0; i < spec.graph.modes.size(); ++i) {
    const ModeSpec& mode = spec.graph.modes[i];
    const auto volume = built.volumes.find(mode.of);
    if (mode.kind != ModeKind::kIsosurface || volume == built.volumes.end()) continue;
    if (built.sequences.count(mode.of) != 0) continue;  // another frame may have the value
    const GridInfo& info = infoOf(built, mode.of);
    const double low = std::min(info.lowest, info.background);
    const double high = std::max(info.highest, info.background);
    if (mode.value >= low && mode.value <= high) continue;
    const auto of = spec.volumes.find(mode.of);
    if (of != spec.volumes.end() && of->second.mask) {
      built.notes.push_back(pathIn(
          spec, fmt::format(
                    "/modes/{}/smooth: a Gaussian of {:g} voxels removes the whole label, which is "
                    "small or thin: give a smaller \"smooth\"",
                    i, of->second.mask->smooth)));
      continue;
    }
    built.notes.push_back(pathIn(
        spec,
        fmt::format(
            "/modes/{}/value: {} is outside the grid's values, {} to {}: the isosurface is empty: "
            "give a value between them",
            i, mode.value, low, high)));
  }
}

}  // namespace

BuiltScene buildScene(const SceneSpec& spec, const Progress& progress, SceneCache* cache) {
  SceneCache own;
  SceneCache& things = cache != nullptr ? *cache : own;
  SceneCache::Building building(things);
  BuiltScene built;
  const Displacements displacements = VolumeLoader(spec, built, things).load(progress);
  computeMasks(spec, built, things);
  const std::map<std::string, const GridInfo*> grids = gridsOf(built, displacements);
  Placer placer(spec, grids);
  for (const auto& [name, frames] : displacements) {
    for (std::size_t i = 0; i < frames.size(); ++i) {
      const std::string which =
          frames.size() > 1 ? fmt::format("{}: frame {} of {}", name, i + 1, frames.size()) : name;
      noteRemarks(spec, which, *frames[i], built);
    }
  }
  makeFields(spec, built, placer, things);
  built.play = playOf(spec, built);
  noteSequences(spec, built);
  built.motions = ownMotions(spec, displacements, placer, things);
  GraphSpec graph = computeFields(spec, built, things);
  placeGuides(spec, built, graph);
  checkSizes(spec, graph);
  joinMotions(spec, built);
  graph.motions = built.motions;
  extendBounds(built);
  try {
    PartBuilder parts(spec, built, things, placer);
    const GraphSpec base = parts.plan(graph);
    built.scene =
        makeScene(base, parts.otherFields(), spec.coupling, spec.step, parts.build(progress));
  } catch (const SceneError& e) {
    if (spec.source.empty()) throw;
    throw SceneError::within(spec.source, e);
  }
  checkGradients(spec, built);
  noteEmptySurfaces(spec, built);
  building.done();
  return built;
}

SceneSpec coarsely(SceneSpec spec, const BuiltScene& built) {
  for (const auto& [name, volume] : built.volumes) {
    if (built.sequences.count(name) == 0) continue;
    spec.volumes.at(name).volume = volume;
    spec.volumes.at(name).frames.reset();
  }
  spec.play.reset();
  for (const auto& [name, window] : built.windows) {
    VolumeSpec& volume = spec.volumes.at(name);
    volume.volume = built.volumes.at(name);
    volume.budget_mb.reset();
    // For a coarse level, kFit and kUnit would compute another place from other bounds.
    const Placement& place = built.placements.at(name);
    if (volume.place.kind == PlaceSpec::Kind::kLike) continue;
    const Eigen::Quaterniond rotation(place.rotation);
    volume.place.kind = PlaceSpec::Kind::kMap;
    volume.place.scale = place.scale;
    volume.place.rotation_wxyz = {rotation.w(), rotation.x(), rotation.y(), rotation.z()};
    volume.place.translate = place.translate;
  }
  return spec;
}

std::string fitCoupling(SceneSpec& spec, const DeviceInfo& device) {
  double& stiffness = spec.coupling.stiffness;
  if (!spec.any_stiffness || spec.graph.stiffness || stiffness <= device.max_stiffness) return {};
  const double usual = std::exchange(stiffness, device.max_stiffness);
  return fmt::format(
      "the coupling is {} N/m instead of the default {} N/m: the device \"{}\" renders at most "
      "this stiffness ({})",
      stiffness, usual, device.name, device.source);
}

void checkDevice(const SceneSpec& spec, const DeviceInfo& device) {
  const CouplingParams asked = stiffestCoupling(spec);
  const auto check = [&](const char* key, double value, const char* unit, double most) {
    if (value <= most) return;
    throw SceneError(pathIn(spec, std::string("/coupling/") + key),
                     fmt::format("{} {} is more than the device \"{}\" renders stably ({})", value,
                                 unit, device.name, device.source),
                     fmt::format("use at most {} {}", most, unit));
  };
  check("stiffness", asked.stiffness, "N/m", device.max_stiffness);
  check("damping", asked.damping, "N s/m", device.max_damping);
}

CouplingParams stiffestCoupling(const SceneSpec& spec) {
  CouplingParams most = spec.coupling;
  if (spec.graph.stiffness) most.stiffness = spec.graph.stiffness->highest();
  return most;
}

}  // namespace palpate
