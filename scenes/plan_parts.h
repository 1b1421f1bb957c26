/// Which of a scene's volumes and modes stand for themselves, so that they can be parts.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "palpate/engine/graph.h"

namespace palpate {

/// Volumes that modes read together, and those modes.
struct PartPlan {
  GraphSpec graph;                   ///< At rest; its modes are called as the scene calls them.
  std::vector<std::string> volumes;  ///< That it reads.
  std::string leader;  ///< The volume that says where it is placed, many times; empty:
                       ///< it is there once.
};

/// What planParts makes of a graph: each mode is in one of its graphs.
struct ScenePlan {
  GraphSpec base;               ///< What is always there.
  std::vector<PartPlan> parts;  ///< In the order of their first modes; may be empty.
};

/// Volumes of a graph, and where they are many times.
struct PlanVolume {
  std::string leader;       ///< The volume with instances that it is placed by; empty: it has none.
  bool may_be_part = true;  ///< It stands still, and somebody knows where.
};

/// A scene of few things that are there once stays one graph; of more, each that may becomes a
/// part. What is there many times always does. Throws SceneError (/modes/0) where a mode reads what
/// is there many times together with something else, or, of a scene with parts, what nothing is
/// called.
[[nodiscard]] ScenePlan planParts(const GraphSpec& graph,
                                  const std::map<std::string, PlanVolume>& volumes);

/// So many things, each there once, are one graph.
inline constexpr std::size_t kFewThings = 8;

}  // namespace palpate
