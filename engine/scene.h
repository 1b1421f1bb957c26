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
  int max_substeps = 16;  ///< The proxy moves at most a voxel at a time where there is data; after
                          ///< so many moves in which a primitive held it, the rest of the way waits
                          ///< for the next tick. 1 to 64. Moves in which nothing holds it are free,
                          ///< up to kMostSubsteps in all.
  double tolerance_voxels = 0.01;  ///< How far the proxy may be off its surface or stream by its
                                   ///< motion, of the volume as interpolated [voxels]: above 0, at
                                   ///< most kMostTolerance.
};

/// Largest StepParams::tolerance_voxels.
inline constexpr double kMostTolerance = 1.0;
/// Most sub-steps, which are readings, of one tick.
inline constexpr int kMostSubsteps = 64;

/// One of many things that a scene places: volumes that lie together, and modes of their own. It is
/// sampled and balanced only while the hand is near.
struct Part {
  Graph graph;        ///< At rest; no varying stiffness.
  Box bounds;         ///< Of what can be felt of it [m].
  double most = 0.0;  ///< Newtons that its modes can hold, all together.
};

/// A field is near within so many voxels of its bounds.
inline constexpr double kFrameMargin = 2.0;
/// Most fields and modes of one part.
inline constexpr std::size_t kMaxPartFields = 8;
inline constexpr std::size_t kMaxPartModes = 16;
/// Most parts that are felt at once.
inline constexpr std::size_t kMaxNearParts = 64;

/// Fields, graph and parameters. Immutable once made; readers and the proxy's memory live
/// elsewhere.
struct Scene {
  std::uint64_t id = 0;     ///< Unique in the process: a proxy notices that its scene was swapped.
  std::uint64_t shape = 0;  ///< The same for scenes with the same fields and kinds of modes, which
                            ///< differ in numbers only: a swap is felt as an edit.
  Graph graph;              ///< What is always there: whatever moves, guides, a varying stiffness.
  std::vector<Part> parts;  ///< What is felt where it is.
  BroadPhase bounds;        ///< Of the parts.
  double strongest_part = 0.0;  ///< The largest Part::most [N].
  CouplingParams coupling;      ///< Where the stiffness varies: from its lowest value.
  StepParams step;
  SolverParams solver;
};

/// The fields that a tick at p_W [m] reads: those of the modes, and of the varying stiffness, whose
/// support holds it. Moving fields are asked at Body::seen of their motion; without bodies they
/// rest. RT: no allocation. Cost: a few ns a field and mode.
[[nodiscard]] FieldSet fieldsAt(const Graph& graph, const Vec3& p_W,
                                std::span<const Body> bodies = {}) noexcept PALPATE_NONBLOCKING;

/// Checks and compiles a part from fields by name; several threads may. Throws SceneError for what
/// compileGraph does, and for more than a part may have.
[[nodiscard]] Part makePart(const GraphSpec& spec, const std::map<std::string, FieldPtr>& fields);

/// Checks and compiles a scene from fields by name. Without parts it needs a mode. Throws
/// SceneError; slow, allocates.
[[nodiscard]] std::unique_ptr<const Scene> makeScene(const GraphSpec& spec,
                                                     const std::map<std::string, FieldPtr>& fields,
                                                     const CouplingParams& coupling = {},
                                                     const StepParams& step = {},
                                                     std::vector<Part> parts = {});

/// A graph, and a cache for each of its fields: what one thread reads it with.
struct BoundGraph {
  const Graph* graph = nullptr;
  std::span<FieldCache> caches;

  /// Step 1 of the paper's figure 1: samples at p_W [m] what the modes read whose support holds it.
  /// What is not read has no data. Moving fields are read at Body::seen of their motion and their
  /// directions turned by its pose; without bodies they rest. Returns how many fields were read.
  /// RT: no allocation.
  int sample(const Vec3& p_W, Properties& out,
             std::span<const Body> bodies = {}) const noexcept PALPATE_NONBLOCKING;

  /// Turns what was read of fields whose volumes have moved since by Body::carry: once a move.
  /// RT: no allocation. Cost: O(fields).
  void turn(Properties& read, std::span<const Body> bodies) const noexcept PALPATE_NONBLOCKING;

  /// The contact of a way [m] with a surface, in the resting frame of its field; see
  /// ScalarField::firstFall. RT: no allocation.
  [[nodiscard]] Crossing firstFall(const Skin& skin, double level, const Vec3& from,
                                   const Vec3& to) const noexcept PALPATE_NONBLOCKING {
    const auto i = static_cast<std::size_t>(skin.field);
    return graph->scalar_fields[i]->firstFall(from, to, level, skin.sign, caches[i]);
  }
  /// ScalarField::gradientJacobian of a field, an index into Graph::scalar_fields, in W, where
  /// sample() has read it. RT: no allocation.
  [[nodiscard]] Mat3 gradientJacobian(std::size_t field, const Vec3& p_W,
                                      std::span<const Body> bodies) const noexcept
      PALPATE_NONBLOCKING;
  /// Along a stream, in the resting frame of its field, an index into Graph::vector_fields; see
  /// VectorField::trace. RT: no allocation.
  [[nodiscard]] Trace trace(int field, const Vec3& p,
                            const TraceOrder& order) const noexcept PALPATE_NONBLOCKING {
    const auto i = static_cast<std::size_t>(field);
    return graph->vector_fields[i]->trace(p, order, caches[graph->scalar_fields.size() + i]);
  }

  /// Directions and magnitudes of what was read. RT: no allocation.
  void makeSteps(Properties& of) const noexcept PALPATE_NONBLOCKING;
};

/// What one thread's reads change: a cache for each field that it may read at once. Its memory is
/// taken when it is made, whatever scenes there will be: a swapped scene costs no allocation, ten
/// thousand parts no more than one.
class Reader {
 public:
  Reader() : caches_(kMaxFields + kMaxNearParts * kMaxPartFields), parts_(kMaxNearParts) {}

  /// The scene's own graph; readies its caches where the scene is not that of the last call.
  /// RT: no allocation. Cost: O(fields).
  BoundGraph bind(const Scene& scene) noexcept;
  /// A part, in one of kMaxNearParts slots; readies its caches where another one was in it.
  /// Call bind() first. RT: no allocation.
  BoundGraph bind(const Scene& scene, std::size_t part, std::size_t slot) noexcept;

  /// BoundGraph::sample of the scene's own graph. RT: no allocation.
  int sample(const Scene& scene, const Vec3& p_W, Properties& out,
             std::span<const Body> bodies = {}) noexcept PALPATE_NONBLOCKING {
    return bind(scene).sample(p_W, out, bodies);
  }

 private:
  static constexpr std::size_t kNone = static_cast<std::size_t>(-1);

  std::vector<FieldCache> caches_;  ///< Of the graph, then of each slot.
  std::vector<std::size_t> parts_;  ///< In each slot.
  std::uint64_t scene_id_ = 0;
};

}  // namespace palpate
