#include "palpate/scenes/library/place_volumes.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/library/spec_lookup.h"

namespace palpate {
namespace {

constexpr double kSmallestVoxel = 1e-9;  // [m]: smallest allowed edge of a voxel

}  // namespace

Placement Placer::placementOf(const std::string& leader, std::size_t instance) {
  const std::string path = pathIn(spec_, fmt::format("/volumes/{}/instances/{}", leader, instance));
  const PlaceSpec& place = spec_.volumes.at(leader).instances.at(instance);
  if (place.kind == PlaceSpec::Kind::kLike || !place.keyframes.empty() || place.repeat ||
      place.warp) {
    throw SceneError(path,
                     "an instance cannot move or deform, and cannot be placed like another volume",
                     "give fit, unit or scale without keyframes, repeat and warp");
  }
  return compute(leader, place, path);
}

Placement Placer::placementOf(const std::string& name) {
  const auto known = done_.find(name);
  if (known != done_.end()) return known->second;
  const std::string path = pathIn(spec_, "/volumes/" + name + "/place");
  if (!open_.insert(name).second) {
    std::string circle = name;
    const std::string* next = &name;
    do {
      next = &spec_.volumes.at(*next).place.like;
      circle += ", " + *next;
    } while (*next != name);
    throw SceneError(path + "/like", "the \"like\" keys form a circle: " + circle,
                     "place one of these volumes by fit, unit or scale");
  }
  const VolumeSpec& volume = spec_.volumes.at(name);
  if (volume.place.kind == PlaceSpec::Kind::kLike && !volume.instances.empty()) {
    throw SceneError(pathIn(spec_, "/volumes/" + name + "/instances"),
                     "the volume has instances and is also placed like another volume",
                     "remove \"place\" or \"instances\"");
  }
  return done_[name] =
             volume.instances.empty() ? compute(name, volume.place, path) : placementOf(name, 0);
}

Placement Placer::compute(const std::string& name, const PlaceSpec& place,
                          const std::string& path) {
  Placement placed = computeAny(name, place, path);
  // Also checks a volume that is placed like another volume, because the two grids may differ.
  const GridInfo& info = *volumes_.at(name);
  const double voxel = placed.scale * info.voxel.minCoeff();
  const double reach = placed.translate.norm() +
                       placed.scale * std::max(info.bounds.lower.norm(), info.bounds.upper.norm());
  if (!(voxel >= kSmallestVoxel)) {
    throw SceneError(
        path,
        fmt::format("the shortest edge of a voxel is {:g} m, below {:g} m", voxel, kSmallestVoxel),
        "give the volume a larger size");
  }
  if (!(reach <= kFarthestPlace)) {
    throw SceneError(path,
                     fmt::format("the volume reaches {:g} m from the origin of the world", reach),
                     "place the volume within 1,000 km");
  }
  return placed;
}

Placement Placer::computeAny(const std::string& name, const PlaceSpec& place,
                             const std::string& path) {
  const auto positive = [&](double value, const char* key) {
    if (!std::isfinite(value) || value <= 0.0) {
      throw SceneError(path + "/" + key, fmt::format("{} is not a finite number > 0", value),
                       place.kind == PlaceSpec::Kind::kFit
                           ? "give metres, such as 0.1"
                           : "give metres per unit of the file, such as 0.001");
    }
    return value;
  };
  const auto rotation = [&]() -> Mat3 {
    const auto& q = place.rotation_wxyz;
    const Eigen::Quaterniond given(q[0], q[1], q[2], q[3]);
    if (!(given.norm() > 1e-6) || !std::isfinite(given.norm())) {
      throw SceneError(
          path + "/rotation_wxyz",
          fmt::format("the quaternion's length {:g} is below 1e-6 or not finite", given.norm()),
          "give w, x, y, z, such as [1, 0, 0, 0]");
    }
    return given.normalized().toRotationMatrix();
  };
  if (!place.translate.allFinite()) {
    throw SceneError(path + "/translate", "the translation is not finite",
                     "give three finite numbers [m]");
  }
  const auto centred = [&](double scale) -> Placement {
    const Mat3 turn = rotation();
    const Vec3 centre = volumes_.at(name)->bounds.centre();
    return {scale, turn, place.translate - turn * (scale * centre)};
  };
  switch (place.kind) {
    case PlaceSpec::Kind::kFit:
      try {
        return centred(fitInto(*volumes_.at(name), positive(place.size, "fit")).scale);
      } catch (const VolumeError& e) {
        throw SceneError::within(path, e);
      }
    case PlaceSpec::Kind::kUnit:
      return centred(positive(place.size, "unit"));
    case PlaceSpec::Kind::kMap:
      return {positive(place.scale, "scale"), rotation(), place.translate};
    case PlaceSpec::Kind::kLike:
      break;
  }
  if (volumes_.count(place.like) == 0) {
    std::vector<std::string> names;
    for (const auto& [other, volume] : volumes_) names.push_back(other);
    throw unknownVolume(path + "/like", place.like, names);
  }
  return placementOf(place.like);
}

void placeGuides(const SceneSpec& spec, const BuiltScene& built, GraphSpec& graph) {
  for (const auto& [i, name] : spec.guide_volumes) {
    const auto placement = built.placements.find(name);
    if (placement == built.placements.end()) {
      std::vector<std::string> names;
      for (const auto& [other, place] : built.placements) names.push_back(other);
      throw unknownVolume(pathIn(spec, fmt::format("/modes/{}/in", i)), name, names);
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

}  // namespace palpate
