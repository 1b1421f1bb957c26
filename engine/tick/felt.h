/// The graphs that a tick evaluates: the scene's own graph and the graphs of the parts near the
/// proxy.
#pragma once

#include <algorithm>
#include <cstddef>
#include <span>

#include "palpate/engine/field/properties.h"
#include "palpate/engine/modes/mode.h"
#include "palpate/engine/scene/scene.h"

namespace palpate {

/// A graph that a tick evaluates, with its properties and the memories of its modes.
struct Felt {
  BoundGraph bound;                  ///< The graph, with the caches of the thread that reads it.
  Properties* properties = nullptr;  ///< Properties from the last reading of the graph.
  ModeMemory* memories = nullptr;    ///< One memory for each of Graph::modes, in their order.

  /// Returns the bound graph, which must not be null.
  [[nodiscard]] const Graph& graph() const noexcept { return *bound.graph; }
};

/// Calls `look` with each mode, its memory, its Felt and its index in the graph, until a call
/// returns true. Returns true if a call of `look` returned true.
template <class Do>
bool anyMode(std::span<const Felt> all, Do&& look) noexcept {
  for (const Felt& felt : all) {
    std::size_t i = 0;
    for (const Mode& mode : felt.graph().modes) {
      if (look(mode, felt.memories[i], felt, i)) return true;
      ++i;
    }
  }
  return false;
}
/// Calls `look` as anyMode does, only with the modes in Graph::surfaces.
template <class Do>
bool anySurface(std::span<const Felt> all, Do&& look) noexcept {
  for (const Felt& felt : all) {
    const Graph& graph = felt.graph();
    for (const std::size_t i : graph.surfaces) {
      if (look(graph.modes[i], felt.memories[i], felt, i)) return true;
    }
  }
  return false;
}
/// Calls `look` with every mode in Graph::surfaces, and ignores its result.
template <class Do>
void eachSurface(std::span<const Felt> all, Do&& look) noexcept {
  (void)anySurface(all, [&](const Mode& mode, ModeMemory& memory, const Felt& felt, std::size_t i) {
    look(mode, memory, felt, i);
    return false;
  });
}
/// Returns true if a graph has a mode in Graph::curves.
[[nodiscard]] inline bool hasCurve(std::span<const Felt> all) noexcept {
  return std::any_of(all.begin(), all.end(),
                     [](const Felt& felt) { return !felt.graph().curves.empty(); });
}
/// Calls `look` with every mode, as anyMode does, and ignores its result.
template <class Do>
void eachMode(std::span<const Felt> all, Do&& look) noexcept {
  (void)anyMode(all, [&](const Mode& mode, ModeMemory& memory, const Felt& felt, std::size_t i) {
    look(mode, memory, felt, i);
    return false;
  });
}

/// Adds the primitives of mode i, with the contact `touch`, at the evaluation point `stand`. After
/// a reading, also computes Contact::turn. Returns false if the set was full. RT: no allocation.
[[nodiscard]] inline bool placeMode(const Felt& felt, std::size_t i, const EvaluationPoint& stand,
                                    const ContactReference& touch, std::span<const Body> bodies,
                                    PrimitiveSet& set) noexcept {
  const Mode& mode = felt.graph().modes[i];
  ModeMemory& memory = felt.memories[i];
  const bool room = addPrimitives(mode, *felt.properties, stand, memory, set);
  if (stand.foreseen) return room;
  if (touch.skin == nullptr || !touch.contact->placed) return room;
  touch.contact->turn.setZero();
  if (touch.contact->seen) {
    readTurn(*touch.contact, *touch.skin, *felt.properties,
             felt.bound.gradientJacobian(static_cast<std::size_t>(touch.skin->field), stand.read,
                                         bodies),
             stand.seam);
  }
  return room;
}

/// Calls `look` with the frame of every field and the index of its motion.
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

/// Returns true if the box `way` [m], in a field's resting frame, is at most kFrameMargin voxels
/// from the field's bounds.
[[nodiscard]] inline bool meets(const Box& way, const FieldFrame& frame) noexcept {
  const double margin = kFrameMargin * frame.voxel;
  const bool apart = (way.lower.array() > frame.bounds.upper.array() + margin).any() ||
                     (way.upper.array() < frame.bounds.lower.array() - margin).any();
  return !apart;
}

}  // namespace palpate
