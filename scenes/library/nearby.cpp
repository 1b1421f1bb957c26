#include "palpate/scenes/library/nearby.h"

#include <algorithm>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

using Volumes = std::map<std::string, VolumeSpec>;

ModeSpec named(const GraphSpec& graph, std::size_t number) {
  ModeSpec mode = graph.modes[number];
  if (mode.name.empty()) mode.name = fmt::format("/modes/{}", number);
  return mode;
}

/// Returns the volumes, each at its first instance. Each part adds its own copy of a volume.
Volumes placedOnce(const SceneSpec& spec) {
  Volumes volumes = spec.volumes;
  for (auto& [name, volume] : volumes) {
    const std::vector<PlaceSpec> places = std::exchange(volume.instances, {});
    if (!places.empty()) volume.place = places.front();
  }
  return volumes;
}

/// Copies one part of a group into a scene. The copies of an instance have the instance's number in
/// their names.
class Copy {
 public:
  Copy(const SceneSpec& spec, const PartGroup& group, std::size_t part)
      : spec_(spec), group_(group), instance_(part - group.first) {}

  void addThings(const Volumes& once, SceneSpec& out) const {
    for (const std::string& name : group_.things) {
      checkFree(called(name));
      const auto volume = once.find(name);
      if (volume == once.end()) {
        DerivedSpec derived = spec_.graph.fields.at(name);
        rename(derived.of);
        out.graph.fields[called(name)] = derived;
        continue;
      }
      VolumeSpec copy = volume->second;
      if (name == group_.leader) copy.place = spec_.volumes.at(name).instances.at(instance_);
      rename(copy.place.like);
      if (copy.mask) rename(copy.mask->of);
      out.volumes[called(name)] = std::move(copy);
    }
  }

  void addMode(std::size_t number, SceneSpec& out) const {
    ModeSpec mode = named(spec_.graph, number);
    mode.name = called(mode.name);
    rename(mode.of);
    rename(mode.by);
    for (std::string& name : mode.user.reads) rename(name);
    for (TransferSpec* transfer : {&mode.strength, &mode.friction, &mode.viscosity}) {
      for (TransferSpec::Factor& factor : transfer->factors) rename(factor.by);
    }
    out.graph.modes.push_back(std::move(mode));
  }

 private:
  [[nodiscard]] std::string called(const std::string& name) const {
    return group_.leader.empty() ? name : fmt::format("{}[{}]", name, instance_);
  }
  void rename(std::string& name) const {
    const auto& things = group_.things;
    if (std::find(things.begin(), things.end(), name) != things.end()) name = called(name);
  }
  void checkFree(const std::string& name) const {
    const bool own = spec_.volumes.count(name) != 0 || spec_.graph.fields.count(name) != 0;
    if (group_.leader.empty() || !own) return;
    throw SceneError(
        fmt::format("{}/volumes/{}/instances/{}", spec_.source.empty() ? "" : spec_.source + ": ",
                    group_.leader, instance_),
        fmt::format("palpate names this instance \"{}\", but a volume or field of the scene has "
                    "this name",
                    name),
        "rename that volume or field");
  }

  const SceneSpec& spec_;
  const PartGroup& group_;
  std::size_t instance_;
};

/// Adds the volumes that `like` refers to, even if no mode reads them.
void addPlaces(const Volumes& once, Volumes& out) {
  for (bool more = true; more;) {
    std::set<std::string> missing;
    for (const auto& [name, volume] : out) {
      const bool like = volume.place.kind == PlaceSpec::Kind::kLike;
      if (like && out.count(volume.place.like) == 0) missing.insert(volume.place.like);
    }
    more = !missing.empty();
    for (const std::string& name : missing) out[name] = once.at(name);
  }
}

}  // namespace

SceneSpec nearby(const SceneSpec& spec, const BuiltScene& built,
                 const std::set<std::size_t>& parts) {
  const Volumes once = placedOnce(spec);
  SceneSpec out = spec;
  out.one_graph = true;
  out.volumes = once;
  out.graph.modes.clear();
  out.guide_volumes.clear();
  for (const PartGroup& group : built.parts) {
    for (const std::string& name : group.things) {
      out.volumes.erase(name);
      out.graph.fields.erase(name);
    }
  }
  std::map<std::size_t, std::vector<Copy>> copies;
  for (const PartGroup& group : built.parts) {
    for (const std::size_t mode : group.modes) copies[mode];
    const auto end = parts.lower_bound(group.first + group.count);
    for (auto part = parts.lower_bound(group.first); part != end; ++part) {
      const Copy copy(spec, group, *part);
      copy.addThings(once, out);
      for (const std::size_t mode : group.modes) copies[mode].push_back(copy);
    }
  }
  addPlaces(once, out.volumes);
  for (std::size_t i = 0; i < spec.graph.modes.size(); ++i) {
    const auto several = copies.find(i);
    if (several != copies.end()) {
      for (const Copy& copy : several->second) copy.addMode(i, out);
      continue;
    }
    const auto guide = spec.guide_volumes.find(i);
    if (guide != spec.guide_volumes.end()) {
      out.guide_volumes[out.graph.modes.size()] = guide->second;
    }
    out.graph.modes.push_back(named(spec.graph, i));
  }
  return out;
}

}  // namespace palpate
