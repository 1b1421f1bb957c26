/// What the parts of one tick share, and what is remembered for them from tick to tick.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "palpate/engine/bodies.h"
#include "palpate/engine/felt.h"
#include "palpate/engine/friction.h"
#include "palpate/engine/near_parts.h"
#include "palpate/engine/primitive.h"
#include "palpate/engine/properties.h"
#include "palpate/engine/scene.h"
#include "palpate/engine/solver.h"
#include "palpate/engine/step_report.h"
#include "palpate/engine/step_trace.h"

namespace palpate {

/// Where the proxy is.
struct Proxy {
  Vec3 position = Vec3::Zero();  ///< [m]
  Vec3 offset = Vec3::Zero();    ///< From the probe [m].
  Vec3 beyond = Vec3::Zero();    ///< And from where properties were read last [m].
  bool placed = false;           ///< Else it begins anew, at the hand.
  bool known = false;            ///< Properties have been read in this scene.
  bool lost = false;             ///< It came to the hand by a way that was not looked at: contacts
                                 ///< are forgotten at the next tick.
};

/// What is about the proxy: graphs, what their modes remember, and what moves.
struct Surroundings {
  Surroundings() : memories(kMaxModes), graphs(1 + kMaxNearParts) {}

  /// The graphs of this tick: the scene's own, then those of the parts near the proxy.
  [[nodiscard]] std::span<const Felt> felt() const noexcept { return {graphs.data(), count}; }

  std::vector<ModeMemory> memories;  ///< Of the scene's own graph,
  Properties properties;             ///< and what was read for it last.
  std::vector<Felt> graphs;          ///< This tick's: that graph, then near parts;
  std::size_t count = 1;             ///< so many.
  NearParts near;                    ///< Parts of the scene whose data the proxy can reach.
  Bodies bodies;                     ///< The moving volumes of the scene's own graph.
};

/// What a balance is of, what it came to, and what the next one begins with.
struct BalanceMemory {
  BalanceMemory() : forces(kMaxPrimitives, Vec3::Zero()) {}

  double stiffness = 0.0;    ///< k [N/m].
  PrimitiveSet primitives;   ///< Placed for the last balance, at most kMaxPrimitives.
  std::vector<Vec3> forces;  ///< Of each on the proxy [N].
  std::size_t surfaces = 0;  ///< Of the primitives that vary so many are planes of surfaces.
  WarmStart warm;            ///< What the next solveProxy starts from.
  FrictionStart friction;    ///< What the next solveWithFriction starts from.
};

/// One tick.
struct Tick {
  const Scene& scene;      ///< What is felt: fields, modes, parameters.
  Reader& reader;          ///< Of this thread: the caches of all that is read.
  Proxy& proxy;            ///< Moved by the tick, from where the last one left it.
  Surroundings& around;    ///< Graphs that are evaluated, and what their modes remember.
  BalanceMemory& balance;  ///< The last balance, from which the next one starts.
  StepReport& report;      ///< Filled as the tick goes on.
  StepTrace* trace;        ///< None: nobody asks.
  Vec3 probe;              ///< The hand [m]: of this slice of the tick.
  int held = 0;            ///< Readings after which something held the proxy.
  int strayed = 0;         ///< Ways that led beyond the parts that were chosen.
  bool changed = false;    ///< Data have changed by themselves since the last tick.

  /// Surroundings::felt of this tick.
  [[nodiscard]] std::span<const Felt> felt() const noexcept { return around.felt(); }
};

}  // namespace palpate
