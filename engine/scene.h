/// Everything one tick needs to know about the world: built off the haptic thread, then const.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "palpate/engine/broad_phase.h"
#include "palpate/engine/coupling.h"
#include "palpate/engine/field.h"
#include "palpate/engine/graph.h"
#include "palpate/engine/solver.h"

namespace palpate {

/// Accuracy of the motion within a tick.
struct StepParams {
  int max_substeps = 16;  ///< Most moves, 1 to 64, in which a primitive holds the proxy; the rest
                          ///< of the path then waits for the next tick. Where there is data a move
                          ///< is at most a voxel long. Moves in which nothing holds the proxy do
                          ///< not count, up to kMostSubsteps in all.
  int max_iterations = 130;  ///< A tick that has taken so many (StepReport::iterations), >= 1,
                             ///< reads once more in each slice that is left, and no more: the rest
                             ///< of the path waits for the next one. A balance under way ends
                             ///< within SolverParams::max_iterations for its frictions, and as many
                             ///< and 40 pivots for its place.
  double tolerance_voxels = 0.01;  ///< How far its motion may leave the proxy from its surface or
                                   ///< stream, in the volume as interpolated [voxels]: above 0, at
                                   ///< most kMostTolerance.
};

/// Largest StepParams::tolerance_voxels.
inline constexpr double kMostTolerance = 1.0;
/// Most sub-steps, which are readings, of one tick.
inline constexpr int kMostSubsteps = 64;

/// One of many things that a scene places: volumes that lie together, and modes of their own. It is
/// sampled and balanced only while the hand is near.
struct Part {
  Graph graph;        ///< Graph of fields at rest; no varying stiffness.
  Box bounds;         ///< Bounds of all that can be felt of the part [m].
  double most = 0.0;  ///< Largest force that its modes can hold, all together [N].
};

/// Distance from its bounds within which a field is near [voxels].
inline constexpr double kFrameMargin = 2.0;
/// Most fields and modes of one part.
inline constexpr std::size_t kMaxPartFields = 8;
inline constexpr std::size_t kMaxPartModes = 16;  ///< makePart refuses more.
/// Most parts that a tick samples and balances.
inline constexpr std::size_t kMaxNearParts = 64;

/// Fields, graph and parameters. Immutable once made; readers and the proxy's memory live
/// elsewhere.
struct Scene {
  std::uint64_t id = 0;     ///< Unique in the process: a proxy notices that its scene was swapped.
  std::uint64_t shape = 0;  ///< The same for scenes with the same fields and kinds of modes, which
                            ///< differ in numbers only: such a swap engages as an edit.
  Graph graph;              ///< What every tick reads: whatever moves, guides, a varying stiffness.
  std::vector<Part> parts;  ///< The parts, each read only near the hand.
  BroadPhase bounds;        ///< Boxes of the parts.
  double strongest_part = 0.0;  ///< The largest Part::most [N].
  CouplingParams coupling;      ///< A stiffness that varies begins here, at its lowest value.
  StepParams step;              ///< Accuracy of the motion within each tick.
  SolverParams solver;          ///< Accuracy of each balance; makeScene leaves the defaults.
};

/// The fields that a tick at p_W [m] reads: those of the modes, and of the varying stiffness, whose
/// support holds p_W. Moving fields are asked at Body::seen of their motion; without bodies they
/// rest. RT: no allocation. Cost: a few ns a field and mode.
[[nodiscard]] FieldSet fieldsAt(const Graph& graph, const Vec3& p_W,
                                std::span<const Body> bodies = {}) noexcept PALPATE_NONBLOCKING;

/// True while the data of some field that modes read are not there any more: Fault::kVolume. RT: no
/// allocation. Cost: a few ns a field that attends.
[[nodiscard]] bool dataLost(const Graph& graph) noexcept PALPATE_NONBLOCKING;

/// Checks and compiles a part from fields by name; safe from several threads. Throws SceneError for
/// what compileGraph refuses, and for what a part may not have or has too many of.
[[nodiscard]] Part makePart(const GraphSpec& spec, const std::map<std::string, FieldPtr>& fields);

/// Checks and compiles a scene from fields by name. Without parts it needs a mode. Throws
/// SceneError; slow, allocates.
[[nodiscard]] std::unique_ptr<const Scene> makeScene(const GraphSpec& spec,
                                                     const std::map<std::string, FieldPtr>& fields,
                                                     const CouplingParams& coupling = {},
                                                     const StepParams& step = {},
                                                     std::vector<Part> parts = {});

/// A graph, and the caches with which one thread reads its fields.
struct BoundGraph {
  const Graph* graph = nullptr;  ///< The scene's own, or a part's; null: nothing is bound.
  std::span<FieldCache> caches;  ///< Those of Graph::scalar_fields, then of Graph::vector_fields.

  /// Step 1 of the paper's figure 1: samples at p_W [m] what is read by modes whose support holds
  /// p_W. A property that is not read has no data. Moving fields are read at Body::seen of their
  /// motion, and their directions turned by its pose; without bodies they rest. Returns how many
  /// fields were read. RT: no allocation.
  int sample(const Vec3& p_W, Properties& out,
             std::span<const Body> bodies = {}) const noexcept PALPATE_NONBLOCKING;

  /// Tells the fields that want to be told of a tick, with proxy and hand in W. True: one of them
  /// has changed by itself (AnyField::attend). RT: no allocation.
  bool attend(const Attention& at, std::span<const Body> bodies) const noexcept PALPATE_NONBLOCKING;
  /// Tells the same fields that the tick is over. RT: no allocation.
  void leave() const noexcept PALPATE_NONBLOCKING;

  /// Turns what was read of volumes that have moved since, by Body::carry; called once a move.
  /// RT: no allocation. Cost: O(fields).
  void turn(Properties& read, std::span<const Body> bodies) const noexcept PALPATE_NONBLOCKING;

  /// The contact of a path [m] with a surface, in the resting frame of the surface's field; see
  /// ScalarField::firstFall. RT: no allocation.
  [[nodiscard]] Crossing firstFall(const Skin& skin, double level, const Vec3& from,
                                   const Vec3& to) const noexcept PALPATE_NONBLOCKING {
    const auto i = static_cast<std::size_t>(skin.field);
    return graph->scalar_fields[i]->firstFall(from, to, level, skin.sign, caches[i]);
  }
  /// How high p [m] is above the surface V = level, in voxels, by V as interpolated and its slope
  /// there; p in the resting frame of the surface's field. Not finite without a slope. RT: no
  /// allocation.
  [[nodiscard]] double heightAt(const Skin& skin, double level,
                                const Vec3& p) const noexcept PALPATE_NONBLOCKING;
  /// ScalarField::gradientJacobian of Graph::scalar_fields[field] at p_W [m], in W, where
  /// sample() has read the field. RT: no allocation.
  [[nodiscard]] Mat3 gradientJacobian(std::size_t field, const Vec3& p_W,
                                      std::span<const Body> bodies) const noexcept
      PALPATE_NONBLOCKING;
  /// Traces a stream of Graph::vector_fields[field] from p [m], in the field's resting frame; see
  /// VectorField::trace. RT: no allocation.
  [[nodiscard]] Trace trace(int field, const Vec3& p,
                            const TraceOrder& order) const noexcept PALPATE_NONBLOCKING {
    const auto i = static_cast<std::size_t>(field);
    return graph->vector_fields[i]->trace(p, order, caches[graph->scalar_fields.size() + i]);
  }

  /// Computes the directions and magnitudes of what was read. RT: no allocation.
  void makeSteps(Properties& of) const noexcept PALPATE_NONBLOCKING;
};

/// What one thread's reads change: a cache for each field that it may read at once. Its memory is
/// taken when it is made, whatever scenes there will be: a swapped scene costs no allocation, ten
/// thousand parts no more than one.
class Reader {
 public:
  Reader()
      : caches_(kMaxFields + kMaxNearParts * kMaxPartFields),
        fields_(caches_.size()),
        parts_(kMaxNearParts) {}

  /// Binds the scene's own graph; where the scene is not that of the last call, readies the caches
  /// of fields that it has in other places. RT: no allocation. Cost: O(fields).
  BoundGraph bind(const Scene& scene) noexcept;
  /// Binds a part to one of kMaxNearParts slots; readies the caches where the slot held another.
  /// To be called after bind(scene). RT: no allocation. Cost: O(fields).
  BoundGraph bind(const Scene& scene, std::size_t part, std::size_t slot) noexcept;

  /// BoundGraph::sample of the scene's own graph. RT: no allocation.
  int sample(const Scene& scene, const Vec3& p_W, Properties& out,
             std::span<const Body> bodies = {}) noexcept PALPATE_NONBLOCKING {
    return bind(scene).sample(p_W, out, bodies);
  }

 private:
  static constexpr std::size_t kNone = static_cast<std::size_t>(-1);

  /// Readies `count` caches from `first` on for the fields of a graph.
  void ready(const Graph& graph, std::size_t first, std::size_t count) noexcept;

  std::vector<FieldCache> caches_;     ///< Caches of the scene's graph, then of each slot.
  std::vector<std::uint64_t> fields_;  ///< AnyField::id() of what each cache is of; 0: of nothing.
  std::vector<std::size_t> parts_;     ///< Index of the part in each slot.
  std::uint64_t scene_id_ = 0;
};

}  // namespace palpate
