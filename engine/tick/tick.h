/// State that the functions of a tick share, and state that is kept from tick to tick.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "palpate/engine/balance/friction.h"
#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/balance/solver.h"
#include "palpate/engine/field/properties.h"
#include "palpate/engine/scene/scene.h"
#include "palpate/engine/tick/bodies.h"
#include "palpate/engine/tick/felt.h"
#include "palpate/engine/tick/near_parts.h"
#include "palpate/engine/tick/step_report.h"
#include "palpate/engine/tick/step_trace.h"

namespace palpate {

/// The proxy and its path.
struct Proxy {
  Vec3 position = Vec3::Zero();  ///< Position [m].
  Vec3 offset = Vec3::Zero();    ///< Position minus the probe's [m].
  Vec3 beyond = Vec3::Zero();    ///< Position minus the place of the last reading [m].
  bool placed = false;           ///< False if the next tick starts the proxy at the hand.
  bool known = false;            ///< True if properties have been read in this scene.
  /// True if the last slice arrived at a balance of its last reading. moveProxy clears it before a
  /// slice in which anything other than the hand moves.
  bool arrived = false;
  /// Number of free ticks in a row: without a primitive, and on a path where no field acts without
  /// a contact (moveProxy).
  int free_ticks = 0;
  bool lost = false;  ///< True if the proxy reached the hand on a path that was not completely
                      ///< swept. The next tick then forgets contacts.
};

/// The surroundings of the proxy: the graphs to evaluate, and the moving volumes.
struct Surroundings {
  Surroundings() : memories(kMaxModes), graphs(1 + kMaxNearParts) {}

  /// Returns the graphs of this tick: the scene's own graph, then those of the near parts.
  [[nodiscard]] std::span<const Felt> felt() const noexcept { return {graphs.data(), count}; }

  std::vector<ModeMemory> memories;  ///< Memories of the modes of the scene's own graph.
  Properties properties;             ///< Properties from the last reading of that graph.
  /// Storage of felt(); the first `count` graphs are in use.
  std::vector<Felt> graphs;
  std::size_t count = 1;  ///< Number of graphs in use.
  NearParts near;         ///< Parts of the scene with data that the proxy can reach.
  Bodies bodies;          ///< The moving volumes of the scene's own graph.
};

/// The last balance, and the starting values for the next one.
struct BalanceMemory {
  BalanceMemory() : forces(kMaxPrimitives, Vec3::Zero()) {}

  double stiffness = 0.0;    ///< Coupling stiffness k [N/m].
  PrimitiveSet primitives;   ///< Primitives of the last balance, at most kMaxPrimitives.
  std::vector<Vec3> forces;  ///< Force of each primitive on the proxy [N].
  std::size_t surfaces = 0;  ///< Number of varying primitives that are planes of surfaces.
  WarmStart warm;            ///< Start of the next solveProxy.
  FrictionStart friction;    ///< Start of the next solveWithFriction.
};

/// The state of one tick.
struct Tick {
  const Scene& scene;      ///< Fields, modes and parameters.
  Reader& reader;          ///< This thread's reader, with the caches of all reads.
  Proxy& proxy;            ///< The proxy, which the tick moves.
  Surroundings& around;    ///< The graphs to evaluate, and the memories of their modes.
  BalanceMemory& balance;  ///< The last balance, from which the next one starts.
  StepReport& report;      ///< Filled during the tick.
  StepTrace* trace;        ///< Null if no trace is requested.
  Vec3 probe;              ///< Position of the hand in this slice of the tick [m].
  int held = 0;  ///< Number of readings at a surface on the path, or after which a primitive held
                 ///< the proxy.
  int strayed = 0;       ///< Number of steps that led beyond the chosen parts.
  bool changed = false;  ///< Result of BoundGraph::attend in this tick.

  /// Returns Surroundings::felt of this tick.
  [[nodiscard]] std::span<const Felt> felt() const noexcept { return around.felt(); }
};

}  // namespace palpate
