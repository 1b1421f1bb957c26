/// Division of a scene into parts: independent groups of volumes and modes.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "palpate/engine/scene/graph.h"

namespace palpate {

/// Volumes that modes read together, and those modes: a thing.
struct PartPlan {
  GraphSpec graph;                   ///< At rest; its modes have the names of the scene.
  std::vector<std::string> volumes;  ///< Volumes that it reads.
  std::string leader;  ///< The volume with the instances at which the part stands; empty: it stands
                       ///< once.
};

/// Result of planParts: each mode is in one of its graphs.
struct ScenePlan {
  GraphSpec base;               ///< The graph outside of the parts.
  std::vector<PartPlan> parts;  ///< In the order of their first modes; may be empty.
};

/// Placement of a volume, as planParts needs it.
struct PlanVolume {
  std::string leader;       ///< The volume whose instances place this one; empty: no instances.
  bool may_be_part = true;  ///< Static, and its place is known.
};

/// Divides a scene into parts. Things without instances stay in one graph if the scene has few
/// things (kFewThings). Else each thing that may be a part becomes one. A thing with instances
/// always becomes a part. Throws SceneError (/modes/0) if a mode reads a volume with instances
/// together with something else, or in a scene with parts, if a mode reads an unknown name.
[[nodiscard]] ScenePlan planParts(const GraphSpec& graph,
                                  const std::map<std::string, PlanVolume>& volumes);

/// Up to this many things without instances are one graph.
inline constexpr std::size_t kFewThings = 8;

}  // namespace palpate
