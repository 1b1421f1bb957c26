#include "palpate/scenes/library/build_scene.h"

#include <algorithm>
#include <cmath>
#include <mutex>
#include <set>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/bricks.h"
#include "palpate/samplers/parallel.h"
#include "palpate/scenes/library/brick_places.h"
#include "palpate/scenes/library/frames.h"
#include "palpate/scenes/library/plan_parts.h"
#include "palpate/scenes/library/scene_cache.h"

namespace palpate {
namespace {

std::string at(const SceneSpec& spec, const std::string& path) {
  return spec.source.empty() ? path : spec.source + ": " + path;
}

constexpr double kFarthest = 1e6;        // [m]
constexpr double kSmallestVoxel = 1e-9;  // [m]: a hand cannot press smaller ones
constexpr double kLargestProperty = 1e6;
constexpr double kLongestTime = 1e9;  // [s]

/// Throws for numbers so large that a tick would overflow; the error has the number's path.
void checkSize(const SceneSpec& spec, const std::string& path, double value, double most,
               const char* unit) {
  if (std::abs(value) <= most) return;
  throw SceneError(at(spec, path), fmt::format("{:g}{} is beyond {:g}", value, unit, most),
                   "give one of a size that a hand can feel");
}

/// Checks numbers outside of the volumes' places.
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
              kFarthest, " m");
  }
  for (const auto& [name, volume] : spec.volumes) {
    for (std::size_t i = 0; i < volume.place.keyframes.size(); ++i) {
      const Keyframe& key = volume.place.keyframes[i];
      const std::string path = fmt::format("/volumes/{}/place/keyframes/{}", name, i);
      checkSize(spec, path + "/time", key.time, kLongestTime, " s");
      checkSize(spec, path + "/translate", key.translate.lpNorm<Eigen::Infinity>(), kFarthest,
                " m");
    }
  }
}

/// Resolves the places of all volumes; a volume with "like" takes the place of the other one.
class Placer {
 public:
  Placer(const SceneSpec& spec, const std::map<std::string, const GridInfo*>& volumes)
      : spec_(spec), volumes_(volumes) {}

  /// Returns an instance's placement, for the volume with the instances and those placed like it.
  Placement placementOf(const std::string& leader, std::size_t instance) {
    const std::string path = at(spec_, fmt::format("/volumes/{}/instances/{}", leader, instance));
    const PlaceSpec& place = spec_.volumes.at(leader).instances.at(instance);
    if (place.kind == PlaceSpec::Kind::kLike || !place.keyframes.empty()) {
      throw SceneError(path, "an instance has a place of its own and stands still",
                       "give fit, unit or scale");
    }
    return compute(leader, place, path);
  }
  /// Returns the placement of a volume; with instances the first one.
  Placement placementOf(const std::string& name) {
    const auto known = done_.find(name);
    if (known != done_.end()) return known->second;
    const std::string path = at(spec_, "/volumes/" + name + "/place");
    if (!open_.insert(name).second) {
      throw SceneError(path + "/like", "the volumes are placed like each other in a circle",
                       "place one of them by fit, unit or scale");
    }
    const VolumeSpec& volume = spec_.volumes.at(name);
    if (volume.place.kind == PlaceSpec::Kind::kLike && !volume.instances.empty()) {
      throw SceneError(at(spec_, "/volumes/" + name + "/instances"),
                       "it is placed like another volume as well",
                       "give one of place and instances");
    }
    return done_[name] =
               volume.instances.empty() ? compute(name, volume.place, path) : placementOf(name, 0);
  }

 private:
  Placement compute(const std::string& name, const PlaceSpec& place, const std::string& path) {
    Placement placed = computeAny(name, place, path);
    // Also check a volume placed like another: it may be larger.
    const GridInfo& info = *volumes_.at(name);
    const double voxel = placed.scale * info.voxel.minCoeff();
    const double reach =
        placed.translate.norm() +
        placed.scale * std::max(info.bounds.lower.norm(), info.bounds.upper.norm());
    if (!(voxel >= kSmallestVoxel)) {
      throw SceneError(path, fmt::format("its voxels are {:g} m", voxel),
                       fmt::format("make it larger: {:g} m or more", kSmallestVoxel));
    }
    if (!(reach <= kFarthest)) {
      throw SceneError(path, fmt::format("it reaches {:g} m from the middle of the world", reach),
                       "place it within 1,000 km");
    }
    return placed;
  }

  Placement computeAny(const std::string& name, const PlaceSpec& place, const std::string& path) {
    const auto positive = [&](double value, const char* key) {
      if (!std::isfinite(value) || value <= 0.0) {
        throw SceneError(path + "/" + key, fmt::format("{} is not a finite number > 0", value),
                         "give metres, as 0.1");
      }
      return value;
    };
    switch (place.kind) {
      case PlaceSpec::Kind::kFit:
        try {
          return fitInto(volumes_.at(name)->bounds, positive(place.size, "fit"));
        } catch (const VolumeError& e) {
          throw SceneError::within(path, e);
        }
      case PlaceSpec::Kind::kUnit: {
        Placement placement;
        placement.scale = positive(place.size, "unit");
        placement.translate = -placement.scale * volumes_.at(name)->bounds.centre();
        return placement;
      }
      case PlaceSpec::Kind::kMap: {
        const auto& q = place.rotation_wxyz;
        const Eigen::Quaterniond rotation(q[0], q[1], q[2], q[3]);
        if (!(rotation.norm() > 1e-6) || !std::isfinite(rotation.norm())) {
          throw SceneError(path + "/rotation_wxyz", "it is no rotation",
                           "give w, x, y, z, as [1, 0, 0, 0]");
        }
        if (!place.translate.allFinite()) {
          throw SceneError(path + "/translate", "it is not finite", "give metres");
        }
        return {positive(place.scale, "scale"), rotation.normalized().toRotationMatrix(),
                place.translate};
      }
      case PlaceSpec::Kind::kLike:
        break;
    }
    if (volumes_.count(place.like) == 0) {
      std::vector<std::string> names;
      for (const auto& [other, volume] : volumes_) names.push_back(other);
      const std::string near = nearestName(place.like, names);
      throw SceneError(
          path + "/like", "there is no volume \"" + place.like + "\"",
          near.empty() ? "name a volume of this scene" : "did you mean \"" + near + "\"?");
    }
    return placementOf(place.like);
  }

  const SceneSpec& spec_;
  const std::map<std::string, const GridInfo*>& volumes_;
  std::map<std::string, Placement> done_;
  std::set<std::string> open_;
};

bool given(const FieldPtr& field) {
  return std::visit([](const auto& pointer) { return pointer != nullptr; }, field);
}

/// Frames of the displacement volumes, by name.
using Displacements = std::map<std::string, std::vector<std::shared_ptr<const Volume>>>;

/// Returns the names of the displacement volumes.
std::set<std::string> displacementNames(const SceneSpec& spec) {
  std::set<std::string> names;
  for (const auto& [name, volume] : spec.volumes) {
    const auto& warp = volume.place.warp;
    if (!warp || warp->warp != nullptr) continue;
    if (spec.volumes.count(warp->field) == 0) {
      std::vector<std::string> others;
      for (const auto& [other, of] : spec.volumes) others.push_back(other);
      const std::string near = nearestName(warp->field, others);
      throw SceneError(
          at(spec, "/volumes/" + name + "/place/warp/field"),
          "there is no volume \"" + warp->field + "\"",
          near.empty() ? "name a volume of this scene" : "did you mean \"" + near + "\"?");
    }
    names.insert(warp->field);
  }
  return names;
}

/// Throws if a mode or a field uses a displacement.
void checkDisplacements(const SceneSpec& spec, const std::set<std::string>& names) {
  const auto check = [&](const std::string& of, const std::string& path) {
    if (names.count(of) == 0) return;
    throw SceneError(at(spec, path), "\"" + of + "\" is how another volume deforms",
                     "name a volume of the same file besides it");
  };
  for (std::size_t i = 0; i < spec.graph.modes.size(); ++i) {
    const ModeSpec& mode = spec.graph.modes[i];
    check(mode.of, fmt::format("/modes/{}/of", i));
    check(mode.by, fmt::format("/modes/{}/by", i));
    for (const auto& [transfer, key] : {std::pair{&mode.strength, "strength"},
                                        {&mode.friction, "friction"},
                                        {&mode.viscosity, "viscosity"}}) {
      for (const TransferSpec::Factor& factor : transfer->factors) {
        check(factor.by, fmt::format("/modes/{}/{}", i, key));
      }
    }
  }
  for (const auto& [i, name] : spec.guide_volumes) check(name, fmt::format("/modes/{}/in", i));
  if (spec.graph.stiffness) {
    for (const TransferSpec::Factor& factor : spec.graph.stiffness->factors) {
      check(factor.by, "/coupling/stiffness");
    }
  }
  for (const std::string& name : names) {
    if (spec.volumes.at(name).frames) {
      throw SceneError(at(spec, "/volumes/" + name + "/frames"),
                       "it is how another volume deforms, and its times are in the warp",
                       "remove it");
    }
    const PlaceSpec& place = spec.volumes.at(name).place;
    if (place.keyframes.empty() && !place.warp && spec.volumes.at(name).instances.empty()) continue;
    throw SceneError(at(spec, "/volumes/" + name),
                     "it is how another volume deforms, and moves or stands more than once itself",
                     "give it one place, as {\"like\": ...}");
  }
  for (const auto& [name, derived] : spec.graph.fields) check(derived.of, "/fields/" + name);
}

/// Returns a volume's warp, or null.
WarpPtr warpOf(const SceneSpec& spec, const std::string& name, const Displacements& displacements,
               Placer& placer, SceneCache& cache) {
  const auto& warp = spec.volumes.at(name).place.warp;
  if (!warp || warp->warp != nullptr) return warp ? warp->warp : nullptr;
  return cache.warp(displacements.at(warp->field), placer.placementOf(warp->field),
                    {warp->times, warp->repeat}, at(spec, "/volumes/" + name + "/place/warp"));
}

/// Returns the volumes' own motions.
std::map<std::string, MotionPtr> ownMotions(const SceneSpec& spec,
                                            const Displacements& displacements, Placer& placer,
                                            SceneCache& cache) {
  std::map<std::string, MotionPtr> motions;
  for (const auto& [name, volume] : spec.volumes) {
    const PlaceSpec& place = volume.place;
    const std::string path = at(spec, "/volumes/" + name + "/place");
    if (place.keyframes.empty() && place.repeat) {
      throw SceneError(path + "/repeat", "there are no keyframes to repeat", "add \"keyframes\"");
    }
    if (place.keyframes.empty() && !place.warp) continue;
    if (place.kind == PlaceSpec::Kind::kLike && !given(volume.field)) {
      throw SceneError(path + (place.warp ? "/warp" : "/keyframes"),
                       "a volume placed like another moves with that",
                       "remove them, or place it by fit, unit or scale");
    }
    const WarpPtr warp = warpOf(spec, name, displacements, placer, cache);
    motions[name] = place.keyframes.empty()
                        ? std::make_shared<const Motion>(warp)
                        : std::make_shared<const Motion>(place.keyframes, place.repeat,
                                                         path + "/keyframes", warp);
  }
  return motions;
}

/// Gives the motion of a moving volume to volumes placed like it and to fields computed from it.
/// All places are resolved, so "like" contains no unknown names and no circles.
void joinMotions(const SceneSpec& spec, BuiltScene& built) {
  const auto follow = [&](const std::string& name, const std::string& leader) {
    const auto motion = built.motions.find(leader);
    if (motion != built.motions.end()) built.motions[name] = motion->second;
  };
  for (const auto& [name, volume] : spec.volumes) {
    if (given(volume.field) || built.fields.count(name) == 0) continue;
    const std::string* leader = &name;
    while (spec.volumes.at(*leader).place.kind == PlaceSpec::Kind::kLike) {
      leader = &spec.volumes.at(*leader).place.like;
    }
    follow(name, *leader);
  }
  for (const auto& [name, computed] : built.computed) follow(name, computed.from);
}

/// Returns the sampling of a volume.
Sampling samplingOf(const SceneSpec& spec, const std::string& name) {
  Sampling sampling = spec.volumes.at(name).sampling;
  sampling.slope_reach = spec.slope_reach;
  return sampling;
}

/// Throws if a mode needs the gradient of a volume that is sampled without one.
void checkGradients(const SceneSpec& spec) {
  for (std::size_t i = 0; i < spec.graph.modes.size(); ++i) {
    const ModeSpec& mode = spec.graph.modes[i];
    const auto volume = spec.volumes.find(mode.of);
    if (volume == spec.volumes.end() || given(volume->second.field) ||
        volume->second.sampling.interpolation != Interpolation::kNearest) {
      continue;
    }
    if (mode.kind != ModeKind::kSurface && mode.kind != ModeKind::kIsosurface) continue;
    throw SceneError(at(spec, fmt::format("/modes/{}/of", i)),
                     fmt::format("mode {} needs a gradient, and \"{}\" is read by its nearest "
                                 "voxel, which has none",
                                 wordFor(mode.kind), mode.of),
                     "use another interpolation for it");
  }
}

bool inBricks(const VolumeSpec& volume) {
  return volume.volume == nullptr && !volume.file.empty() && isBrickPlace(volume.file);
}

/// Returns a grid's properties; for bricks those of the finest level.
const GridInfo& infoOf(const BuiltScene& built, const std::string& name) {
  const auto window = built.windows.find(name);
  return window != built.windows.end() ? window->second->manifest().info()
                                       : built.volumes.at(name)->info();
}

/// Opens a brick volume. Throws if the scene asks for processing at load.
void openBricks(const SceneSpec& spec, const std::string& name, BuiltScene& built,
                SceneCache& cache) {
  const VolumeSpec& volume = spec.volumes.at(name);
  const std::string path = at(spec, "/volumes/" + name);
  const auto refuse = [&](bool wrong, const char* key, const char* why, const char* remedy) {
    if (wrong) throw SceneError(path + "/" + key, why, remedy);
  };
  refuse(volume.smooth > 0, "smooth", "a volume in bricks is read as it was written",
         "smooth it before it is written");
  refuse(volume.sampling.interpolation != Interpolation::kTrilinear, "interpolation",
         "a volume in bricks is read trilinearly", "remove it");
  refuse(volume.sampling.axial, "axial", "a volume in bricks has vectors with a sign", "remove it");
  refuse(!volume.instances.empty(), "instances", "a volume in bricks stands once",
         "give it one place");
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
      throw VolumeError(volume.file.string(), "it is the grid \"" + is + "\"",
                        "remove \"grid\", or name another folder");
    }
    built.windows[name] = bricks.window;
    built.volumes[name] = bricks.coarsest;
  } catch (const VolumeError& e) {
    throw SceneError::within(path, e);
  }
}

/// Returns true if the volume is a sequence.
bool isPlayed(const VolumeSpec& volume) {
  return volume.frames.has_value() && volume.volume == nullptr && !given(volume.field);
}

/// Throws if a sequence has a setting that sequences cannot have.
void checkPlayed(const SceneSpec& spec, const std::string& name) {
  const VolumeSpec& volume = spec.volumes.at(name);
  const std::string path = at(spec, "/volumes/" + name);
  const auto refuse = [&](bool wrong, const char* key, const char* why, const char* remedy) {
    if (wrong) throw SceneError(path + "/" + key, why, remedy);
  };
  const FramesSpec& frames = *volume.frames;
  refuse(frames.times.empty() == (frames.rate == 0.0), "frames", "it has one of rate and times",
         "give frames a second, or the time of each");
  refuse(!std::isfinite(frames.rate) || frames.rate < 0.0, "frames/rate",
         "it is not a finite number > 0", "give frames a second, as 25");
  refuse(inBricks(volume), "frames", "a folder of bricks is one volume", "give frames in .vdb");
  refuse(volume.budget_mb.has_value(), "window", "a sequence is no volume in bricks",
         "give the budget in \"frames\"");
  refuse(!volume.instances.empty(), "instances", "a sequence stands once", "give it one place");
}

/// Opens a placed sequence.
std::shared_ptr<const FrameSequence> openSequence(const SceneSpec& spec, const std::string& name,
                                                  const Placement& placement, SceneCache& cache) {
  const VolumeSpec& volume = spec.volumes.at(name);
  const FramesSpec& of = *volume.frames;
  std::vector<VolumeRequest> frames = framesOf(volume);
  const FrameTimes when = of.rate > 0.0 ? evenTimes(frames.size(), of.rate, of.repeat)
                                        : FrameTimes{of.times, of.repeat};
  constexpr double kDefault = 1024.0;
  constexpr double kMost = 1e9;
  SequenceParams params;
  params.budget =
      static_cast<std::uint64_t>(std::min(kMost, of.budget_mb.value_or(kDefault)) * 1024 * 1024);
  params.waits = spec.waits;
  return cache.sequence({std::move(frames), when, placement, samplingOf(spec, name), params});
}

/// Returns how the scene's sequences are played.
PlayParams playOf(const SceneSpec& spec, const BuiltScene& built) {
  if (built.sequences.empty()) {
    if (!spec.play) return {};
    throw SceneError(at(spec, "/play"), "there is no sequence to play",
                     "give a volume \"frames\", or remove it");
  }
  const PlaySpec play = spec.play.value_or(PlaySpec{});
  PlayParams out;
  out.speed = play.speed;
  out.paused = play.paused;
  out.repeat = play.repeat;
  constexpr double kForEver = std::numeric_limits<double>::infinity();
  double first = kForEver;
  double end = -kForEver;
  bool all_repeat = true;
  for (const auto& [name, sequence] : built.sequences) {
    const FrameTimes& when = sequence->times();
    first = std::min(first, when.times.front());
    end = std::max(end, when.repeat ? kForEver : when.times.back());
    all_repeat = all_repeat && when.repeat;
  }
  // Sequences that repeat extend in both directions.
  out.from = play.from.value_or(all_repeat && !out.repeat ? -kForEver : first);
  out.to = play.to.value_or(end);
  out.begin = play.from.value_or(std::min(first, out.to));
  if (out.speed < 0.0 && std::isfinite(out.to)) out.begin = out.to;
  const auto refuse = [&](bool wrong, const char* key, const char* why, const char* remedy) {
    if (wrong) throw SceneError(at(spec, std::string("/play/") + key), why, remedy);
  };
  refuse(!std::isfinite(out.speed), "speed", "it is not finite", "give seconds a second, as 1");
  refuse(play.from && !std::isfinite(out.from), "from", "it is not finite", "give seconds");
  refuse(!play.to && out.to < out.from, "from", "the sequences have ended by then",
         "give seconds before the last frame's");
  refuse(std::isnan(out.to) || out.to < out.from, "to", "it ends before it begins",
         "give seconds, after \"from\"");
  refuse(out.repeat && !std::isfinite(out.to), "repeat", "it has no end to go on from",
         "give \"to\": its sequences repeat of themselves");
  refuse(out.speed < 0.0 && out.begin <= out.from, "speed", "it goes back from where it begins",
         "give \"to\": there it begins");
  return out;
}

/// Returns remarks for the user on changes to a grid at load.
std::vector<std::string> remarks(const GridInfo& info) {
  std::vector<std::string> out;
  if (info.filled > 0) {
    out.push_back(fmt::format("{} values were NaN or infinite: now the background {}, no data",
                              info.filled, info.background));
  }
  if (info.was_local) out.emplace_back("its vectors were in index space: now in world space");
  if (info.smoothing.width > 0) {
    const Smoothing& s = info.smoothing;
    out.push_back(fmt::format(
        "smoothed over {} voxels: values moved by {:.3g} rms, {:.3g} at most; waves shorter than "
        "{:.1f} voxels keep less than half their height",
        s.width, s.rms_change, s.largest_change, s.half_height_voxels));
  }
  return out;
}

/// Computes the derived fields whose own derivatives are needed.
class FieldComputer {
 public:
  FieldComputer(const SceneSpec& spec, BuiltScene& built, SceneCache& cache)
      : spec_(spec), built_(built), cache_(cache) {}

  /// Adds the fields to the volumes and returns the graph of the rest, which is derived on the fly.
  /// The graph reports errors in fields.
  GraphSpec compute() {
    GraphSpec graph = spec_.graph;
    for (const auto& [name, why] : wanted()) {
      const Made* made = make(name);
      if (made == nullptr) continue;
      Sampling sampling = samplingOf(spec_, made->from);
      sampling.axial = made->axial;
      const DerivedSpec& derived = spec_.graph.fields.at(name);
      built_.computed[name] = {std::string(wordFor(derived.derivation)) + " of " + derived.of,
                               made->from, why};
      built_.volumes[name] = made->volume;
      built_.placements[name] = built_.placements.at(made->from);
      built_.samplings[name] = sampling;
      built_.fields[name] = cache_.field(made->volume, built_.placements.at(name), sampling);
      graph.fields.erase(name);
    }
    return graph;
  }

 private:
  static constexpr int kMostComputed = 64;  ///< Each may be as large as its volume.
  struct Made {
    std::shared_ptr<const Volume> volume;
    std::string from;
    bool axial = false;
  };

  /// Returns names and reasons.
  [[nodiscard]] std::map<std::string, std::string> wanted() const {
    const auto& fields = spec_.graph.fields;
    std::map<std::string, std::string> names;
    for (std::size_t i = 0; i < spec_.graph.modes.size(); ++i) {
      const ModeSpec& mode = spec_.graph.modes[i];
      const auto field = fields.find(mode.of);
      if (field == fields.end() || kindOf(field->second.derivation).vector) continue;
      if (mode.kind != ModeKind::kSurface && mode.kind != ModeKind::kIsosurface &&
          mode.kind != ModeKind::kForce) {
        continue;
      }
      names.emplace(mode.of, mode.name.empty()
                                 ? fmt::format("mode /modes/{} needs its gradient", i)
                                 : fmt::format("mode \"{}\" needs its gradient", mode.name));
    }
    for (const auto& [name, field] : fields) {
      if (kindOf(field.derivation).of_volume && fields.count(field.of) != 0) {
        names.emplace(field.of, fmt::format("field \"{}\" needs its derivatives", name));
      }
    }
    for (const auto& [name, volume] : spec_.volumes) names.erase(name);  // rejected by the graph
    return names;
  }

  /// Returns the volume of a name; null if it has no volume, or one that its derivation cannot use.
  const Made* make(const std::string& name) {
    const auto known = made_.find(name);
    if (known != made_.end()) return known->second.volume != nullptr ? &known->second : nullptr;
    // The entry stays null until the volume is made; this ends circles.
    Made& made = made_[name];
    const auto volume = built_.volumes.find(name);
    if (volume != built_.volumes.end()) {
      made = {volume->second, name, spec_.volumes.at(name).sampling.axial};
      return &made;
    }
    const auto field = spec_.graph.fields.find(name);
    if (field == spec_.graph.fields.end()) return nullptr;
    const Derivation what = field->second.derivation;
    const Made* of = make(field->second.of);
    if (of == nullptr || of->volume->info().vector != kindOf(what).of_vector) return nullptr;
    const std::string path = at(spec_, "/fields/" + name);
    if (built_.sequences.count(of->from) != 0) {
      throw SceneError(path, "it is to be computed at load, of a sequence, which is not in memory",
                       "compute it frame by frame, or let no mode need its gradient");
    }
    if (built_.windows.count(of->from) != 0) {
      throw SceneError(
          path, "it is to be computed at load, of a volume in bricks, which is not in memory",
          "compute it before the bricks are written, or let no mode need its gradient");
    }
    if (of->axial && kindOf(what).of_volume) {
      throw SceneError(path, "it is to be computed at load, and axial vectors have no derivatives",
                       "remove \"axial\", or let no mode need its gradient");
    }
    // A message from another site may name thousands.
    if (++computed_ > kMostComputed) {
      throw SceneError(path,
                       fmt::format("more than {} fields are to be computed at load", kMostComputed),
                       "derive fewer of derived ones");
    }
    try {
      made = {cache_.derive(of->volume, what), of->from, of->axial && what == Derivation::kUnit};
    } catch (const VolumeError& e) {
      throw SceneError::within(path, e);
    }
    return &made;
  }

  const SceneSpec& spec_;
  BuiltScene& built_;
  SceneCache& cache_;
  int computed_ = 0;
  std::map<std::string, Made> made_;
};

/// Returns the volume that sets a volume's instances; empty if the volume stands once.
std::string leaderOf(const SceneSpec& spec, const std::string& name) {
  const std::string* leader = &name;
  while (spec.volumes.at(*leader).place.kind == PlaceSpec::Kind::kLike) {
    leader = &spec.volumes.at(*leader).place.like;
  }
  return spec.volumes.at(*leader).instances.empty() ? "" : *leader;
}

/// Builds the parts of a scene, one for each instance, in parallel.
class PartBuilder {
 public:
  PartBuilder(const SceneSpec& spec, BuiltScene& built, SceneCache& cache, Placer& placer)
      : spec_(spec), built_(built), cache_(cache), placer_(placer) {}

  /// Returns the scene's own graph; build() builds the rest.
  GraphSpec plan(const GraphSpec& graph) {
    if (spec_.one_graph) return graph;
    std::map<std::string, PlanVolume> volumes;
    for (const auto& [name, field] : built_.fields) {
      PlanVolume& volume = volumes[name];
      const bool grid = built_.volumes.count(name) != 0;
      if (grid) volume.leader = leaderOf(spec_, originOf(name));
      volume.may_be_part = grid && built_.motions.count(name) == 0 &&
                           built_.windows.count(name) == 0 && built_.sequences.count(name) == 0;
    }
    ScenePlan plan = planParts(graph, volumes);
    plans_ = std::move(plan.parts);
    return std::move(plan.base);
  }

  /// Returns the fields that are in no part.
  [[nodiscard]] std::map<std::string, FieldPtr> otherFields() const {
    std::map<std::string, FieldPtr> fields = built_.fields;
    for (const PartPlan& plan : plans_) {
      for (const std::string& name : plan.volumes) fields.erase(name);
    }
    return fields;
  }

  std::vector<Part> build(const Progress& progress) {
    std::vector<SceneCache::Placed> wanted;
    for (const PartPlan& plan : plans_) addJobs(plan, wanted);
    const std::vector<FieldPtr> fields = cache_.fields(wanted);
    std::vector<Part> parts(jobs_.size());
    std::mutex mutex;
    std::size_t done = 0;
    constexpr std::size_t kTold = 64;  // parts in a block
    inParallel((jobs_.size() + kTold - 1) / kTold, [&](std::size_t block) {
      const std::size_t begin = block * kTold;
      const std::size_t end = std::min(begin + kTold, jobs_.size());
      for (std::size_t i = begin; i < end; ++i) {
        const Job& job = jobs_[i];
        std::map<std::string, FieldPtr> own;
        for (std::size_t j = 0; j < job.plan->volumes.size(); ++j) {
          own[job.plan->volumes[j]] = fields[job.first + j];
        }
        parts[i] = makePart(job.plan->graph, own);
      }
      if (!progress) return;
      const std::lock_guard lock(mutex);
      done += end - begin;
      progress(static_cast<double>(done) / static_cast<double>(jobs_.size()));
    });
    for (const Part& part : parts) {
      built_.bounds.extend(part.bounds.lower);
      built_.bounds.extend(part.bounds.upper);
    }
    return parts;
  }

 private:
  struct Job {
    const PartPlan* plan;
    std::size_t first;  ///< Index of its first field.
  };

  /// Returns the volume itself, or the volume that it was computed from.
  [[nodiscard]] std::string originOf(const std::string& name) const {
    const auto computed = built_.computed.find(name);
    return computed == built_.computed.end() ? name : computed->second.from;
  }

  void addJobs(const PartPlan& plan, std::vector<SceneCache::Placed>& wanted) {
    const std::size_t count =
        plan.leader.empty() ? 1 : spec_.volumes.at(plan.leader).instances.size();
    std::vector<std::string> things = plan.volumes;
    for (const auto& [name, derived] : plan.graph.fields) things.push_back(name);
    built_.parts.push_back(
        {jobs_.size(), count, std::move(things), plan.leader, plan.graph.mode_numbers});
    for (std::size_t i = 0; i < count; ++i) {
      jobs_.push_back({&plan, wanted.size()});
      for (const std::string& name : plan.volumes) {
        const Placement place =
            plan.leader.empty() ? built_.placements.at(name) : placer_.placementOf(plan.leader, i);
        wanted.push_back({built_.volumes.at(name), place, built_.samplings.at(name)});
      }
    }
  }

  const SceneSpec& spec_;
  BuiltScene& built_;
  SceneCache& cache_;
  Placer& placer_;
  std::vector<PartPlan> plans_;
  std::vector<Job> jobs_;
};

/// Transforms guides from a volume's units to W; the guides move with the volume.
void placeGuides(const SceneSpec& spec, const BuiltScene& built, GraphSpec& graph) {
  for (const auto& [i, name] : spec.guide_volumes) {
    const auto placement = built.placements.find(name);
    if (placement == built.placements.end()) {
      std::vector<std::string> names;
      for (const auto& [other, place] : built.placements) names.push_back(other);
      const std::string near = nearestName(name, names);
      throw SceneError(
          at(spec, fmt::format("/modes/{}/in", i)), "there is no volume \"" + name + "\"",
          near.empty() ? "name a volume of this scene" : "did you mean \"" + near + "\"?");
    }
    const Placement& place = placement->second;
    graph.modes.at(i).in = name;
    GuideSpec& guide = graph.modes.at(i).guide;
    guide.position = place.translate + place.rotation * (place.scale * guide.position);
    guide.direction = place.rotation * guide.direction;
    guide.snap *= place.scale;
    guide.metres_per_unit = place.scale;
  }
}

/// Opens the volumes of a scene. Files are collected first, then loaded together.
class VolumeLoader {
 public:
  VolumeLoader(const SceneSpec& spec, BuiltScene& built, SceneCache& cache)
      : spec_(spec), built_(built), cache_(cache), displacing_(displacementNames(spec)) {
    checkDisplacements(spec, displacing_);
  }

  /// Opens all volumes; returns the frames of those that are displacements of others.
  Displacements load(const Progress& progress) {
    for (const auto& [name, volume] : spec_.volumes) {
      try {
        open(name, volume);
      } catch (const VolumeError& e) {
        throw SceneError::within(at(spec_, "/volumes/" + name), e);
      }
    }
    const std::vector<LoadResult> loaded = cache_.load(requests_, progress);
    for (std::size_t i = 0; i < names_.size(); ++i) {
      try {
        if (loaded[i].error) std::rethrow_exception(loaded[i].error);
      } catch (const VolumeError& e) {
        throw SceneError::within(at(spec_, "/volumes/" + names_[i]), e);
      }
      put(names_[i], loaded[i].volume);
    }
    return std::move(displacements_);
  }

 private:
  /// The one place for each kind of volume: displacement, formula, frames, bricks, memory, file.
  void open(const std::string& name, const VolumeSpec& volume) {
    const bool displaces = displacing_.count(name) != 0;
    if (!displaces && given(volume.field)) {
      built_.fields[name] = volume.field;
    } else if (!displaces && isPlayed(volume)) {
      checkPlayed(spec_, name);
      // The first frame determines the placement of the others.
      request(name, framesOf(volume).front());
    } else if (!displaces && inBricks(volume)) {
      openBricks(spec_, name, built_, cache_);
    } else if (volume.volume != nullptr) {
      put(name, volume.volume);
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
      throw SceneError(at(spec_, fmt::format("/volumes/{}/window", name)),
                       "it is no volume in bricks, and is in memory as a whole",
                       "remove it, or write it in bricks: palpate brick");
    }
    if (isPattern(volume.file)) {
      throw SceneError(at(spec_, fmt::format("/volumes/{}/file", name)),
                       "its name stands for many, and nothing says when each is felt",
                       "add \"frames\": {\"rate\": 25}, or name one of them");
    }
    if (volume.sampling.axial && volume.smooth > 0) {
      throw SceneError(at(spec_, fmt::format("/volumes/{}/smooth", name)),
                       "axial vectors would cancel in the filter", "remove \"smooth\"");
    }
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
  std::vector<std::string> names_;  ///< One for each request; frames share their volume's.
  std::vector<VolumeRequest> requests_;
  Displacements displacements_;
};

/// Returns the grids that determine placements, by the volume's name.
std::map<std::string, const GridInfo*> gridsOf(const BuiltScene& built,
                                               const Displacements& displacements) {
  std::map<std::string, const GridInfo*> grids;
  for (const auto& [name, volume] : built.volumes) grids[name] = &infoOf(built, name);
  for (const auto& [name, frames] : displacements) grids[name] = &frames.front()->info();
  return grids;
}

void noteRemarks(const SceneSpec& spec, const std::string& name, const Volume& volume,
                 BuiltScene& built) {
  for (const std::string& remark : remarks(volume.info())) {
    built.notes.push_back(fmt::format("{}: {}", at(spec, "/volumes/" + name), remark));
  }
}

/// Places each volume and makes its field.
void makeFields(const SceneSpec& spec, BuiltScene& built, Placer& placer, SceneCache& cache) {
  for (const auto& [name, volume] : built.volumes) {
    built.placements[name] = placer.placementOf(name);
    noteRemarks(spec, name, *volume, built);
    built.samplings[name] = samplingOf(spec, name);
    try {
      const auto window = built.windows.find(name);
      if (window != built.windows.end()) {
        built.fields[name] = cache.field(window->second, built.placements[name], spec.slope_reach);
      } else if (isPlayed(spec.volumes.at(name))) {
        built.sequences[name] = openSequence(spec, name, built.placements[name], cache);
        built.fields[name] = cache.field(built.sequences[name]);
      } else {
        built.fields[name] = cache.field(volume, built.placements[name], built.samplings[name]);
      }
    } catch (const VolumeError& e) {
      throw SceneError::within(at(spec, "/volumes/" + name), e);
    }
  }
}

/// Notes sequences of one frame, and sequences whose budget is too small for the speed of play.
void noteSequences(const SceneSpec& spec, BuiltScene& built) {
  for (const auto& [name, sequence] : built.sequences) {
    const SequenceState state = sequence->state();
    if (state.frames == 1) {
      built.notes.push_back(fmt::format(
          "{}: it has one frame, and stands: give a file for each frame, as frame_%04d.vdb, or a "
          "file with a grid for each",
          at(spec, "/volumes/" + name + "/frames")));
    }
    const std::uint64_t needed = sequence->neededFor(std::abs(built.play.speed));
    if (state.slots >= std::min(needed, state.frames)) continue;
    built.notes.push_back(fmt::format(
        "{}: memory holds {} of its {} frames, and to be played at this speed on time it needs {}: "
        "give a larger budget_mb, or a lower speed",
        at(spec, "/volumes/" + name + "/frames"), state.slots, state.frames, needed));
  }
}

/// Extends the scene's bounds by those of each field, over all of its motion.
void extendBounds(BuiltScene& built) {
  for (const auto& [name, field] : built.fields) {
    Box box = std::visit([](const auto& f) { return f->frame().bounds; }, field);
    const auto motion = built.motions.find(name);
    if (motion != built.motions.end()) box = motion->second->sweep(box);
    built.bounds.extend(box.lower);
    built.bounds.extend(box.upper);
  }
}

/// Notes isosurfaces whose value no voxel has.
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
    built.notes.push_back(at(spec, fmt::format("/modes/{}/value: {} is outside the grid's values, "
                                               "{} to {}: there is no surface to feel",
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
  const std::map<std::string, const GridInfo*> grids = gridsOf(built, displacements);
  Placer placer(spec, grids);
  for (const auto& [name, frames] : displacements) {
    for (const auto& frame : frames) noteRemarks(spec, name, *frame, built);
  }
  makeFields(spec, built, placer, things);
  built.play = playOf(spec, built);
  noteSequences(spec, built);
  built.motions = ownMotions(spec, displacements, placer, things);
  GraphSpec graph = FieldComputer(spec, built, things).compute();
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
  checkGradients(spec);
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
    // With its own bounds a coarse level would be placed elsewhere.
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
      "the coupling is {} N/m, not the usual {}: the device \"{}\" renders no more "
      "({})",
      stiffness, usual, device.name, device.source);
}

void checkDevice(const SceneSpec& spec, const DeviceInfo& device) {
  const CouplingParams asked = stiffestCoupling(spec);
  const auto check = [&](const char* key, double value, const char* unit, double most) {
    if (value <= most) return;
    throw SceneError(at(spec, std::string("/coupling/") + key),
                     fmt::format("{} {} is more than the device \"{}\" renders stably", value, unit,
                                 device.name),
                     fmt::format("use at most {}", most));
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
