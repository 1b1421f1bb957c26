#include "palpate/scenes/library/plan_parts.h"

#include <algorithm>
#include <set>
#include <utility>

#include "palpate/engine/error.h"
#include "palpate/engine/scene/scene.h"

namespace palpate {
namespace {

/// Disjoint groups of names (union-find).
class Together {
 public:
  void add(const std::string& name) { above_.emplace(name, name); }
  [[nodiscard]] bool knows(const std::string& name) const { return above_.count(name) != 0; }
  const std::string& find(const std::string& name) {
    std::string& above = above_.at(name);
    if (above != name) above = find(above);
    return above;
  }
  void join(const std::string& a, const std::string& b) {
    if (knows(a) && knows(b)) above_.at(find(a)) = find(b);
  }

 private:
  std::map<std::string, std::string> above_;
};

std::vector<std::pair<std::string, std::string>> keyedNamesOf(const ModeSpec& mode) {
  std::vector<std::pair<std::string, std::string>> names;
  const auto add = [&](const std::string& key, const std::string& name) {
    if (!name.empty()) names.emplace_back(key, name);
  };
  for (const std::string& name : mode.user.reads) add("reads", name);
  add("of", mode.of);
  add("by", mode.by);
  add("in", mode.in);
  const auto read = [&](const char* key, const TransferSpec& transfer) {
    const bool product = transfer.factors.size() > 1;
    for (std::size_t i = 0; i < transfer.factors.size(); ++i) {
      add(key + (product ? "/product/" + std::to_string(i) : std::string()) + "/by",
          transfer.factors[i].by);
    }
  };
  read("strength", mode.strength);
  read("friction", mode.friction);
  read("viscosity", mode.viscosity);
  return names;
}

std::vector<std::string> namesOf(const ModeSpec& mode) {
  const auto keyed = keyedNamesOf(mode);
  std::vector<std::string> names(keyed.size());
  std::transform(keyed.begin(), keyed.end(), names.begin(),
                 [](const auto& entry) { return entry.second; });
  return names;
}

void checkNames(const GraphSpec& graph, const std::map<std::string, PlanVolume>& volumes) {
  const auto check = [&](const std::string& path, const std::string& name) {
    if (volumes.count(name) != 0 || graph.fields.count(name) != 0) return;
    std::vector<std::string> all;
    all.reserve(volumes.size() + graph.fields.size());
    for (const auto& [other, volume] : volumes) all.push_back(other);
    for (const auto& [other, derived] : graph.fields) all.push_back(other);
    const std::string near = nearestName(name, all);
    throw SceneError(
        path, "there is no volume or field \"" + name + "\"",
        near.empty() ? "name a volume or field of this scene" : "did you mean \"" + near + "\"?");
  };
  for (std::size_t i = 0; i < graph.modes.size(); ++i) {
    for (const auto& [key, name] : keyedNamesOf(graph.modes[i])) {
      check("/modes/" + std::to_string(i) + "/" + key, name);
    }
  }
  for (const auto& [name, derived] : graph.fields) check("/fields/" + name, derived.of);
}

/// Returns the index of the first mode that reads both a volume with the leader's instances and a
/// volume without them. If there is none, returns the index of the part's first mode.
std::size_t firstMixed(const PartPlan& part, const GraphSpec& graph,
                       const std::map<std::string, PlanVolume>& volumes) {
  const auto with_leader = [&](std::string name) {
    std::size_t steps = 0;
    for (auto derived = graph.fields.find(name);
         derived != graph.fields.end() && steps++ < graph.fields.size();
         derived = graph.fields.find(name)) {
      name = derived->second.of;
    }
    const auto volume = volumes.find(name);
    return volume != volumes.end() && volume->second.leader == part.leader;
  };
  for (const std::size_t i : part.graph.mode_numbers) {
    const std::vector<std::string> names = namesOf(graph.modes[i]);
    const auto count = std::count_if(names.begin(), names.end(), with_leader);
    if (count > 0 && static_cast<std::size_t>(count) < names.size()) return i;
  }
  return part.graph.mode_numbers.front();
}

struct Division {
  Together together;
  std::set<std::string> base;  ///< Groups, by their name from find(), that cannot become parts.
  std::map<std::string, PartPlan> things;
  std::vector<std::size_t> stay;

  void keepInBase(const std::string& name) {
    if (together.knows(name)) base.insert(together.find(name));
  }
};

/// Joins volumes and fields that depend on each other, that a mode reads together, or that have the
/// same instances.
Together joinNames(const GraphSpec& graph, const std::map<std::string, PlanVolume>& volumes) {
  Together together;
  for (const auto& [name, volume] : volumes) together.add(name);
  for (const auto& [name, derived] : graph.fields) together.add(name);
  for (const auto& [name, derived] : graph.fields) together.join(name, derived.of);
  for (const auto& [name, volume] : volumes) {
    if (!volume.leader.empty()) together.join(name, volume.leader);
  }
  for (const ModeSpec& mode : graph.modes) {
    const std::vector<std::string> names = namesOf(mode);
    for (const std::string& name : names) together.join(names.front(), name);
  }
  return together;
}

/// Assigns each mode to the thing that it reads. Adds guides, user-defined modes, and modes that
/// read no field or an unknown field to Division::stay.
void divideModes(const std::vector<ModeSpec>& modes, Division& division) {
  for (std::size_t i = 0; i < modes.size(); ++i) {
    const ModeSpec& mode = modes[i];
    const std::vector<std::string> names = namesOf(mode);
    const bool stranger = std::any_of(names.begin(), names.end(), [&](const std::string& name) {
      return !division.together.knows(name);
    });
    const bool placed = mode.kind == ModeKind::kGuide || mode.kind == ModeKind::kUser;
    if (names.empty() || stranger || placed) {
      for (const std::string& name : names) division.keepInBase(name);
      division.stay.push_back(i);
      continue;
    }
    PartPlan& thing = division.things[division.together.find(names.front())];
    thing.graph.modes.push_back(mode);
    thing.graph.mode_numbers.push_back(i);
  }
}

void divideFields(const GraphSpec& graph, const std::map<std::string, PlanVolume>& volumes,
                  Division& division) {
  for (const auto& [name, volume] : volumes) {
    const auto thing = division.things.find(division.together.find(name));
    if (thing == division.things.end()) continue;
    thing->second.volumes.push_back(name);
    if (!volume.leader.empty()) thing->second.leader = volume.leader;
  }
  for (const auto& [name, derived] : graph.fields) {
    const auto thing = division.things.find(division.together.find(name));
    if (thing != division.things.end()) thing->second.graph.fields[name] = derived;
  }
}

Division divide(const GraphSpec& graph, const std::map<std::string, PlanVolume>& volumes) {
  Division division{joinNames(graph, volumes), {}, {}, {}};
  for (const auto& [name, volume] : volumes) {
    if (!volume.may_be_part) division.keepInBase(name);
  }
  if (graph.stiffness) {
    for (const TransferSpec::Factor& factor : graph.stiffness->factors) {
      division.keepInBase(factor.by);
    }
  }
  divideModes(graph.modes, division);
  divideFields(graph, volumes, division);
  return division;
}

/// Throws SceneError if a volume of the thing lacks the thing's instances, or if the thing must
/// stay outside parts (`in_base`).
void checkInstances(const PartPlan& thing, bool in_base, const GraphSpec& graph,
                    const std::map<std::string, PlanVolume>& volumes) {
  const std::string path = "/modes/" + std::to_string(firstMixed(thing, graph, volumes));
  for (const std::string& volume : thing.volumes) {
    if (volumes.at(volume).leader == thing.leader) continue;
    throw SceneError(
        path,
        "\"" + volume + "\" is read together with \"" + thing.leader + "\", which has instances",
        "give \"" + volume + "\" the place {\"like\": \"" + thing.leader + "\"}");
  }
  if (!in_base) return;
  const std::string instances = "/volumes/" + thing.leader + "/instances";
  for (const std::string& volume : thing.volumes) {
    if (volumes.at(volume).may_be_part) continue;
    throw SceneError(instances,
                     "\"" + volume +
                         "\" moves, is a sequence or is in bricks, and is placed like this volume, "
                         "which has instances",
                     "place \"" + volume + "\" by fit, unit or scale, or remove the instances");
  }
  throw SceneError(instances,
                   "a guide, a user-defined mode or the coupling reads this volume or one placed "
                   "like it, so this volume cannot have instances",
                   "remove the guide, the mode or the varying stiffness, or remove the instances");
}

/// Returns the things that become parts. The modes of all other things stay outside parts.
std::vector<PartPlan> takeParts(const GraphSpec& graph,
                                const std::map<std::string, PlanVolume>& volumes,
                                Division& division) {
  std::vector<PartPlan> parts;
  const bool few = division.things.size() <= kFewThings;
  for (auto& [name, thing] : division.things) {
    const bool in_base = division.base.count(name) != 0;
    const bool fits =
        thing.volumes.size() <= kMaxPartFields && thing.graph.modes.size() <= kMaxPartModes;
    const std::vector<std::size_t>& numbers = thing.graph.mode_numbers;
    if (!thing.leader.empty()) {
      checkInstances(thing, in_base, graph, volumes);
    } else if (few || in_base || !fits) {
      division.stay.insert(division.stay.end(), numbers.begin(), numbers.end());
      continue;
    }
    parts.push_back(std::move(thing));
  }
  std::sort(division.stay.begin(), division.stay.end());
  const auto first = [](const PartPlan& part) { return part.graph.mode_numbers.front(); };
  std::sort(parts.begin(), parts.end(),
            [&](const PartPlan& a, const PartPlan& b) { return first(a) < first(b); });
  return parts;
}

}  // namespace

ScenePlan planParts(const GraphSpec& graph, const std::map<std::string, PlanVolume>& volumes) {
  const bool placed_often = std::any_of(volumes.begin(), volumes.end(), [](const auto& entry) {
    return !entry.second.leader.empty();
  });
  if (placed_often) checkNames(graph, volumes);
  Division division = divide(graph, volumes);
  ScenePlan plan{graph, takeParts(graph, volumes, division)};
  if (plan.parts.empty()) return plan;
  if (!placed_often) checkNames(graph, volumes);
  plan.base.modes.clear();
  for (const std::size_t i : division.stay) {
    plan.base.modes.push_back(graph.modes[i]);
    plan.base.mode_numbers.push_back(i);
  }
  for (const PartPlan& part : plan.parts) {
    for (const auto& [name, derived] : part.graph.fields) plan.base.fields.erase(name);
  }
  return plan;
}

}  // namespace palpate
