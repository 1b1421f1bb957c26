#include "palpate/scenes/library/move_volumes.h"

#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/library/spec_lookup.h"

namespace palpate {
namespace {

WarpPtr warpOf(const SceneSpec& spec, const std::string& name, const Displacements& displacements,
               Placer& placer, SceneCache& cache) {
  const auto& warp = spec.volumes.at(name).place.warp;
  if (!warp || warp->warp != nullptr) return warp ? warp->warp : nullptr;
  return cache.warp(displacements.at(warp->field), placer.placementOf(warp->field),
                    {warp->times, warp->repeat}, pathIn(spec, "/volumes/" + name + "/place/warp"));
}

}  // namespace

std::set<std::string> displacementNames(const SceneSpec& spec) {
  std::set<std::string> names;
  for (const auto& [name, volume] : spec.volumes) {
    const auto& warp = volume.place.warp;
    if (!warp || warp->warp != nullptr) continue;
    if (spec.volumes.count(warp->field) == 0) {
      std::vector<std::string> others;
      for (const auto& [other, of] : spec.volumes) others.push_back(other);
      throw unknownVolume(pathIn(spec, "/volumes/" + name + "/place/warp/field"), warp->field,
                          others);
    }
    names.insert(warp->field);
  }
  return names;
}

void checkDisplacements(const SceneSpec& spec, const std::set<std::string>& names) {
  const auto check = [&](const std::string& of, const std::string& path) {
    if (names.count(of) == 0) return;
    throw SceneError(
        pathIn(spec, path),
        "\"" + of +
            "\" is the displacement of another volume, so modes, fields and the coupling cannot "
            "read it",
        "add another volume of the same file, and name that volume");
  };
  for (std::size_t i = 0; i < spec.graph.modes.size(); ++i) {
    const ModeSpec& mode = spec.graph.modes[i];
    check(mode.of, fmt::format("/modes/{}/of", i));
    check(mode.by, fmt::format("/modes/{}/by", i));
    for (const std::string& name : mode.user.reads) {
      check(name, fmt::format("/modes/{}/user/reads", i));
    }
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
      throw SceneError(pathIn(spec, "/volumes/" + name + "/frames"),
                       "the volume is the displacement of another volume, whose warp has the times",
                       "remove \"frames\"");
    }
    const PlaceSpec& place = spec.volumes.at(name).place;
    if (place.keyframes.empty() && !place.warp && spec.volumes.at(name).instances.empty()) continue;
    throw SceneError(
        pathIn(spec, "/volumes/" + name),
        "the volume is the displacement of another volume, so it cannot move or have instances",
        "give the volume one place, such as {\"like\": ...}");
  }
  for (const auto& [name, derived] : spec.graph.fields) check(derived.of, "/fields/" + name);
}

std::map<std::string, MotionPtr> ownMotions(const SceneSpec& spec,
                                            const Displacements& displacements, Placer& placer,
                                            SceneCache& cache) {
  std::map<std::string, MotionPtr> motions;
  for (const auto& [name, volume] : spec.volumes) {
    const PlaceSpec& place = volume.place;
    const std::string path = pathIn(spec, "/volumes/" + name + "/place");
    if (place.keyframes.empty() && place.repeat) {
      throw SceneError(path + "/repeat", "\"repeat\" needs keyframes", "add \"keyframes\"");
    }
    if (place.keyframes.empty() && !place.warp) continue;
    if (place.kind == PlaceSpec::Kind::kLike && !isGiven(volume.field)) {
      throw SceneError(path + (place.warp ? "/warp" : "/keyframes"),
                       "a volume that is placed like another volume moves with it",
                       "remove keyframes and warp, or place the volume by fit, unit or scale");
    }
    const WarpPtr warp = warpOf(spec, name, displacements, placer, cache);
    motions[name] = place.keyframes.empty()
                        ? std::make_shared<const Motion>(warp)
                        : std::make_shared<const Motion>(place.keyframes, place.repeat,
                                                         path + "/keyframes", warp);
  }
  return motions;
}

void joinMotions(const SceneSpec& spec, BuiltScene& built) {
  const auto follow = [&](const std::string& name, const std::string& leader) {
    const auto motion = built.motions.find(leader);
    if (motion != built.motions.end()) built.motions[name] = motion->second;
  };
  for (const auto& [name, volume] : spec.volumes) {
    if (isGiven(volume.field) || built.fields.count(name) == 0) continue;
    const std::string* leader = &name;
    while (spec.volumes.at(*leader).place.kind == PlaceSpec::Kind::kLike) {
      leader = &spec.volumes.at(*leader).place.like;
    }
    follow(name, *leader);
  }
  for (const auto& [name, computed] : built.computed) follow(name, computed.from);
}

}  // namespace palpate
