/// State that the parts of one tick share, and state that is kept from tick to tick.
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

/// The proxy: its position, and how it came there.
struct Proxy {
  Vec3 position = Vec3::Zero();  ///< [m]
  Vec3 offset = Vec3::Zero();    ///< Position minus the probe's [m].
  Vec3 beyond = Vec3::Zero();    ///< Position minus the place of the last reading [m].
  bool placed = false;           ///< False: the next tick starts it at the hand.
  bool known = false;            ///< Properties have been read in this scene.
  bool lost = false;             ///< The proxy came to the hand on a path that was not completely
                                 ///< swept: the next tick forgets contacts.
};

/// The surroundings of the proxy: graphs, the memories of their modes, and moving volumes.
struct Surroundings {
  Surroundings() : memories(kMaxModes), graphs(1 + kMaxNearParts) {}

  /// Returns the graphs of this tick: the scene's own, then those of the parts near the proxy.
  [[nodiscard]] std::span<const Felt> felt() const noexcept { return {graphs.data(), count}; }

  std::vector<ModeMemory> memories;  ///< Memories of the modes of the scene's own graph.
  Properties properties;             ///< Properties read last for that graph.
  std::vector<Felt> graphs;          ///< Graphs of this tick: the scene's own, then near parts.
  std::size_t count = 1;             ///< Number of graphs in use.
  NearParts near;                    ///< Parts of the scene with data that the proxy can reach.
  Bodies bodies;                     ///< The moving volumes of the scene's own graph.
};

/// The data and the result of the last balance, and the start of the next one.
struct BalanceMemory {
  BalanceMemory() : forces(kMaxPrimitives, Vec3::Zero()) {}

  double stiffness = 0.0;    ///< k [N/m].
  PrimitiveSet primitives;   ///< Primitives of the last balance, at most kMaxPrimitives.
  std::vector<Vec3> forces;  ///< Force of each primitive on the proxy [N].
  std::size_t surfaces = 0;  ///< Number of varying primitives that are planes of surfaces.
  WarmStart warm;            ///< Start of the next solveProxy.
  FrictionStart friction;    ///< Start of the next solveWithFriction.
};

/// One tick.
struct Tick {
  const Scene& scene;      ///< Fields, modes and parameters.
  Reader& reader;          ///< This thread's reader, with the caches of all reads.
  Proxy& proxy;            ///< Moved by the tick from its last position.
  Surroundings& around;    ///< Graphs to evaluate, and the memories of their modes.
  BalanceMemory& balance;  ///< The last balance, from which the next one starts.
  StepReport& report;      ///< Filled during the tick.
  StepTrace* trace;        ///< Null: no trace is wanted.
  Vec3 probe;              ///< Position of the hand in this slice of the tick [m].
  int held = 0;            ///< Number of readings after which something held the proxy.
  int strayed = 0;         ///< Number of steps that led beyond the chosen parts.
  bool changed = false;    ///< Data have changed by themselves since the last tick.

  /// Returns Surroundings::felt of this tick.
  [[nodiscard]] std::span<const Felt> felt() const noexcept { return around.felt(); }
};

}  // namespace palpate
