/// Divides a scene into parts: independent groups of volumes and modes.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "palpate/engine/scene/graph.h"

namespace palpate {

/// A thing: volumes that modes read together or that have the same instances, and the modes that
/// read them. A thing may become a part.
struct PartPlan {
  GraphSpec graph;  ///< Graph of the thing, with the scene's names of modes and volumes.
  std::vector<std::string> volumes;  ///< Names of its volumes.
  /// Name of the volume that has the thing's instances; may be empty.
  std::string leader;
};

/// Result of planParts(). Each mode is in exactly one of the graphs.
struct ScenePlan {
  GraphSpec base;               ///< Graph of the modes outside the parts.
  std::vector<PartPlan> parts;  ///< Parts in the order of their first modes; may be empty.
};

/// Facts about a volume that planParts() needs.
struct PlanVolume {
  std::string leader;  ///< Name of the volume that has this volume's instances, or "".
  /// False if the volume moves, is a sequence or in bricks, or is not a grid.
  bool may_be_part = true;
};

/// Divides a scene into parts. A thing with instances always becomes a part. Another thing becomes
/// a part if the scene has more than kFewThings things and the thing is suitable. A thing is
/// suitable under three conditions:
///
/// - it has at most kMaxPartFields volumes and kMaxPartModes modes;
/// - all its volumes may be in a part (PlanVolume::may_be_part);
/// - no guide, user-defined mode, coupling, or mode with an unknown name reads them.
///
/// Throws SceneError, with the JSON path, if a volume with instances cannot be in a part. Also
/// throws if the scene has parts or instances, and a mode or field reads an unknown name.
[[nodiscard]] ScenePlan planParts(const GraphSpec& graph,
                                  const std::map<std::string, PlanVolume>& volumes);

/// If a scene has at most this number of things, those without instances stay in one graph.
inline constexpr std::size_t kFewThings = 8;

}  // namespace palpate
