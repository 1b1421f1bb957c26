#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <vector>

#include "palpate/engine/scene/scene.h"
#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/place_volumes.h"
#include "palpate/scenes/library/plan_parts.h"
#include "palpate/scenes/library/scene_cache.h"

namespace palpate {

/// Builds the parts of a scene in parallel. Call plan() first, then otherFields() and build().
class PartBuilder {
 public:
  /// The arguments must outlive the builder.
  PartBuilder(const SceneSpec& spec, BuiltScene& built, SceneCache& cache, Placer& placer)
      : spec_(spec), built_(built), cache_(cache), placer_(placer) {}

  /// Divides the scene into parts. Returns the graph of the modes outside parts. Throws SceneError.
  GraphSpec plan(const GraphSpec& graph);
  [[nodiscard]] std::map<std::string, FieldPtr> otherFields() const;
  /// Builds the parts. Adds their groups and their bounds to the scene.
  std::vector<Part> build(const Progress& progress);

 private:
  struct Job {
    const PartPlan* plan;
    std::size_t first;
  };

  [[nodiscard]] std::string originOf(const std::string& name) const;
  void addJobs(const PartPlan& plan, std::vector<SceneCache::Placed>& wanted);

  const SceneSpec& spec_;
  BuiltScene& built_;
  SceneCache& cache_;
  Placer& placer_;
  std::vector<PartPlan> plans_;
  std::vector<Job> jobs_;
};

}  // namespace palpate
