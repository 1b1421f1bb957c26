/// All data about the world that a tick needs: built outside the haptic thread, then const.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "palpate/engine/balance/coupling.h"
#include "palpate/engine/balance/solver.h"
#include "palpate/engine/field/field.h"
#include "palpate/engine/scene/broad_phase.h"
#include "palpate/engine/scene/graph.h"

namespace palpate {

/// Accuracy of the motion within a tick.
struct StepParams {
  int max_substeps = 16;  ///< Most moves, 1 to 64, in which a primitive holds the proxy; the rest
                          ///< of the path then waits for the next tick. Where there are data, a
                          ///< move is at most one voxel long. Moves without a primitive that holds
                          ///< the proxy do not count, up to kMostSubsteps in all.
  int max_iterations = 130;  ///< Limit of a tick's iterations (StepReport::iterations), >= 1. At
                             ///< the limit, the tick reads once more in each slice that is left;
                             ///< the rest of the path waits for the next tick. A balance that has
                             ///< begun ends within SolverParams::max_iterations for its frictions,
                             ///< and as many and 40 pivots for its place.
  double tolerance_voxels = 0.01;  ///< Largest distance by which the motion may leave the proxy off
                                   ///< its surface or stream, in the interpolated volume [voxels]:
                                   ///< above 0, at most kMostTolerance.
};

/// Largest StepParams::tolerance_voxels.
inline constexpr double kMostTolerance = 1.0;
/// Most sub-steps (readings) of one tick.
inline constexpr int kMostSubsteps = 64;

/// One of many objects in a scene: volumes that lie together, with their own modes. A tick samples
/// and balances it only while the hand is near.
struct Part {
  Graph graph;        ///< Graph of fields at rest, without a varying stiffness.
  Box bounds;         ///< Bounds within which the part can act [m].
  double most = 0.0;  ///< Largest force that all its modes together can hold [N].
};

/// A field is near within this distance from its bounds [voxels].
inline constexpr double kFrameMargin = 2.0;
/// Most fields and modes of one part.
inline constexpr std::size_t kMaxPartFields = 8;
inline constexpr std::size_t kMaxPartModes = 16;  ///< makePart rejects more.
/// Most parts that a tick samples and balances.
inline constexpr std::size_t kMaxNearParts = 64;

/// Fields, graph and parameters. Immutable once made; readers and the proxy's state are stored
/// elsewhere.
struct Scene {
  std::uint64_t id = 0;     ///< Unique in the process, so that a proxy notices a swap of its scene.
  std::uint64_t shape = 0;  ///< Equal for scenes with the same fields and kinds of modes, which
                            ///< differ in numbers only: a swap between them engages as an edit.
  Graph graph;              ///< Read in every tick: all that moves, guides, a varying stiffness.
  std::vector<Part> parts;  ///< The parts, each read only near the hand.
  BroadPhase bounds;        ///< Boxes of the parts.
  double strongest_part = 0.0;  ///< The largest Part::most [N].
  CouplingParams coupling;      ///< A stiffness that varies begins here, at its lowest value.
  StepParams step;              ///< Accuracy of the motion within each tick.
  SolverParams solver;          ///< Accuracy of each balance; makeScene leaves the defaults.
};

/// Returns the fields that a tick reads at p_W [m]: those of the modes, and of the varying
/// stiffness, with a support that contains p_W. Moving fields are tested at Body::seen of their
/// motion; without bodies they rest. RT: no allocation. Cost: a few ns for each field and mode.
[[nodiscard]] FieldSet fieldsAt(const Graph& graph, const Vec3& p_W,
                                std::span<const Body> bodies = {}) noexcept PALPATE_NONBLOCKING;

/// Returns true while the data of a field that modes read are no longer available: Fault::kVolume.
/// RT: no allocation. Cost: a few ns for each attentive field.
[[nodiscard]] bool dataLost(const Graph& graph) noexcept PALPATE_NONBLOCKING;

/// Checks and compiles a part from fields by name. Safe from several threads. Throws SceneError for
/// the errors of compileGraph, and for contents that a part may not have or has too many of.
[[nodiscard]] Part makePart(const GraphSpec& spec, const std::map<std::string, FieldPtr>& fields);

/// Checks and compiles a scene from fields by name. A scene without parts needs a mode. Throws
/// SceneError. Slow, allocates.
[[nodiscard]] std::unique_ptr<const Scene> makeScene(const GraphSpec& spec,
                                                     const std::map<std::string, FieldPtr>& fields,
                                                     const CouplingParams& coupling = {},
                                                     const StepParams& step = {},
                                                     std::vector<Part> parts = {});

/// A graph, and the caches with which one thread reads its fields.
struct BoundGraph {
  const Graph* graph = nullptr;  ///< The scene's own graph, or a part's; null: no graph is bound.
  std::span<FieldCache> caches;  ///< Caches of Graph::scalar_fields, then of Graph::vector_fields.

  /// Step 1 of the paper's figure 1: samples at p_W [m] the properties for the modes with a support
  /// that contains p_W. A property that is not read has no data. Moving fields are read at
  /// Body::seen of their motion, and their directions are turned by its pose; without bodies they
  /// rest. Returns the number of fields read. RT: no allocation.
  int sample(const Vec3& p_W, Properties& out,
             std::span<const Body> bodies = {}) const noexcept PALPATE_NONBLOCKING;

  /// Notifies attentive fields of a tick, with proxy and hand in W. Returns true if one of them has
  /// changed by itself (AnyField::attend). RT: no allocation.
  bool attend(const Attention& at, std::span<const Body> bodies) const noexcept PALPATE_NONBLOCKING;
  /// Notifies the same fields that the tick is over. RT: no allocation.
  void leave() const noexcept PALPATE_NONBLOCKING;

  /// Turns the properties read in volumes that have moved since, by Body::carry; called once a
  /// move. RT: no allocation. Cost: O(fields).
  void turn(Properties& read, std::span<const Body> bodies) const noexcept PALPATE_NONBLOCKING;

  /// Returns the contact of a path [m] with a surface, in the resting frame of the surface's field;
  /// see ScalarField::firstFall. RT: no allocation.
  [[nodiscard]] Crossing firstFall(const SurfaceSource& skin, double level, const Vec3& from,
                                   const Vec3& to) const noexcept PALPATE_NONBLOCKING {
    const auto i = static_cast<std::size_t>(skin.field);
    return graph->scalar_fields[i]->firstFall(from, to, level, skin.sign, caches[i]);
  }
  /// Returns the height of p [m] above the surface V = level, in voxels, by the interpolated V and
  /// its slope there. p is in the resting frame of the surface's field. Not finite without a slope.
  /// RT: no allocation.
  [[nodiscard]] double heightAt(const SurfaceSource& skin, double level,
                                const Vec3& p) const noexcept PALPATE_NONBLOCKING;
  /// Returns ScalarField::gradientJacobian of Graph::scalar_fields[field] at p_W [m], in W.
  /// sample() must have read the field there. RT: no allocation.
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

  /// Computes the directions and magnitudes of the properties read. RT: no allocation.
  void makeSteps(Properties& of) const noexcept PALPATE_NONBLOCKING;
};

/// State that one thread's reads change: a cache for each field that it may read at once. The
/// constructor allocates all memory, for any scene. So a swapped scene costs no allocation, and ten
/// thousand parts cost no more than one.
class Reader {
 public:
  Reader()
      : caches_(kMaxFields + kMaxNearParts * kMaxPartFields),
        fields_(caches_.size()),
        parts_(kMaxNearParts) {}

  /// Binds the scene's own graph. If the scene is not that of the last call, prepares the caches of
  /// fields that have another place in the scene. RT: no allocation. Cost: O(fields).
  BoundGraph bind(const Scene& scene) noexcept;
  /// Binds a part to one of kMaxNearParts slots; prepares the caches if the slot held another part.
  /// Call it after bind(scene). RT: no allocation. Cost: O(fields).
  BoundGraph bind(const Scene& scene, std::size_t part, std::size_t slot) noexcept;

  /// Calls BoundGraph::sample of the scene's own graph. RT: no allocation.
  int sample(const Scene& scene, const Vec3& p_W, Properties& out,
             std::span<const Body> bodies = {}) noexcept PALPATE_NONBLOCKING {
    return bind(scene).sample(p_W, out, bodies);
  }

 private:
  static constexpr std::size_t kNone = static_cast<std::size_t>(-1);

  /// Prepares `count` caches from `first` on for the fields of a graph.
  void ready(const Graph& graph, std::size_t first, std::size_t count) noexcept;

  std::vector<FieldCache> caches_;     ///< Caches of the scene's graph, then of each slot.
  std::vector<std::uint64_t> fields_;  ///< AnyField::id() of the field of each cache; 0: no field.
  std::vector<std::size_t> parts_;     ///< Index of the part in each slot.
  std::uint64_t scene_id_ = 0;
};

}  // namespace palpate
