#include "palpate/scenes/library/build_parts.h"

#include <algorithm>
#include <mutex>
#include <utility>

#include "palpate/engine/error.h"
#include "palpate/samplers/parallel.h"
#include "palpate/scenes/library/spec_lookup.h"

namespace palpate {
namespace {

/// Returns the volume at the end of the chain of `like`; "" if that volume has no instances.
std::string leaderOf(const SceneSpec& spec, const std::string& name) {
  const std::string* leader = &name;
  while (spec.volumes.at(*leader).place.kind == PlaceSpec::Kind::kLike) {
    leader = &spec.volumes.at(*leader).place.like;
  }
  return spec.volumes.at(*leader).instances.empty() ? "" : *leader;
}

}  // namespace

GraphSpec PartBuilder::plan(const GraphSpec& graph) {
  if (spec_.one_graph) {
    for (const auto& [name, volume] : spec_.volumes) {
      if (volume.instances.empty()) continue;
      throw SceneError(pathIn(spec_, "/volumes/" + name + "/instances"),
                       "a scene of one graph has no parts, so its volumes cannot have instances",
                       "set one_graph to false, or give the volume one place");
    }
    return graph;
  }
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

std::map<std::string, FieldPtr> PartBuilder::otherFields() const {
  std::map<std::string, FieldPtr> fields = built_.fields;
  for (const PartPlan& plan : plans_) {
    for (const std::string& name : plan.volumes) fields.erase(name);
  }
  return fields;
}

std::vector<Part> PartBuilder::build(const Progress& progress) {
  std::vector<SceneCache::Placed> wanted;
  for (const PartPlan& plan : plans_) addJobs(plan, wanted);
  const std::vector<FieldPtr> fields = cache_.fields(wanted);
  std::vector<Part> parts(jobs_.size());
  std::mutex mutex;
  std::size_t done = 0;
  constexpr std::size_t kBlock = 64;
  inParallel((jobs_.size() + kBlock - 1) / kBlock, [&](std::size_t block) {
    const std::size_t begin = block * kBlock;
    const std::size_t end = std::min(begin + kBlock, jobs_.size());
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

std::string PartBuilder::originOf(const std::string& name) const {
  const auto computed = built_.computed.find(name);
  return computed == built_.computed.end() ? name : computed->second.from;
}

void PartBuilder::addJobs(const PartPlan& plan, std::vector<SceneCache::Placed>& wanted) {
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

}  // namespace palpate
