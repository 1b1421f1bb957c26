/// The graphs that a tick evaluates: the scene's own, and those of the parts near the proxy.
#pragma once

#include <cstddef>
#include <span>

#include "palpate/engine/mode.h"
#include "palpate/engine/properties.h"
#include "palpate/engine/scene.h"

namespace palpate {

/// A graph that a tick evaluates, with its properties and what its modes remember.
struct Felt {
  BoundGraph bound;                  ///< The graph, with the caches of the thread that reads it.
  Properties* properties = nullptr;  ///< What was read for the graph last.
  ModeMemory* memories = nullptr;    ///< One for each of Graph::modes, in their order.

  /// The graph that is bound; there must be one.
  [[nodiscard]] const Graph& graph() const noexcept { return *bound.graph; }
};

/// Calls back with every mode of these graphs, its memory, its graph and its index there, until a
/// call returns true. True if one did.
template <class Do>
bool anyMode(std::span<const Felt> all, Do&& look) noexcept {
  for (const Felt& felt : all) {
    const auto& modes = felt.graph().modes;
    for (std::size_t i = 0; i < modes.size(); ++i) {
      if (look(modes[i], felt.memories[i], felt, i)) return true;
    }
  }
  return false;
}
/// Calls back as anyMode does, with every mode: what `look` returns does not end it.
template <class Do>
void eachMode(std::span<const Felt> all, Do&& look) noexcept {
  (void)anyMode(all, [&](const Mode& mode, ModeMemory& memory, const Felt& felt, std::size_t i) {
    look(mode, memory, felt, i);
    return false;
  });
}

/// Adds the primitives of mode i at `stand`, and reads how its plane turns where properties were
/// read. False if the set was full. RT: no allocation.
[[nodiscard]] inline bool placeMode(const Felt& felt, std::size_t i, const Stand& stand,
                                    std::span<const Body> bodies, PrimitiveSet& set) noexcept {
  const Mode& mode = felt.graph().modes[i];
  ModeMemory& memory = felt.memories[i];
  const bool room = addPrimitives(mode, *felt.properties, stand, memory, set);
  if (stand.foreseen) return room;
  const Touch touch = touchOf(mode, memory);
  if (touch.skin == nullptr || !touch.contact->placed) return room;
  touch.contact->turn.setZero();
  if (touch.contact->seen) {
    readTurn(*touch.contact, *touch.skin, *felt.properties,
             felt.bound.gradientJacobian(static_cast<std::size_t>(touch.skin->field), stand.read,
                                         bodies));
  }
  return room;
}

/// Calls back with the frame and the index of the motion of every field.
template <class Do>
void eachField(std::span<const Felt> all, Do&& look) noexcept {
  for (const Felt& felt : all) {
    const Graph& graph = felt.graph();
    for (std::size_t i = 0; i < graph.scalar_frames.size(); ++i) {
      look(graph.scalar_frames[i], graph.scalar_motions[i]);
    }
    for (std::size_t i = 0; i < graph.vector_frames.size(); ++i) {
      look(graph.vector_frames[i], graph.vector_motions[i]);
    }
  }
}

/// True if a box [m] in a field's resting frame comes within kFrameMargin voxels of its bounds.
[[nodiscard]] inline bool meets(const Box& way, const FieldFrame& frame) noexcept {
  const double margin = kFrameMargin * frame.voxel;
  const bool apart = (way.lower.array() > frame.bounds.upper.array() + margin).any() ||
                     (way.upper.array() < frame.bounds.lower.array() - margin).any();
  return !apart;
}

}  // namespace palpate
