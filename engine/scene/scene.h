/// The scene: all data that a tick needs. makeScene builds the scene outside the haptic thread. The
/// scene is then const.
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
  /// Largest number of a tick's readings that are at a surface on the path, or after which a
  /// primitive holds the proxy; 1 to 64. At the limit, the rest of the path waits for the next
  /// tick. This number does not limit the readings of a free proxy (kMostSubsteps).
  int max_substeps = 16;
  /// Limit of a tick's iterations (StepReport::iterations), >= 1. At the limit, the tick reads
  /// properties once more in each remaining slice (iteration.h), and completes the balance in
  /// progress (at most twice SolverParams::max_iterations and 40 pivots). The rest of the path
  /// waits.
  int max_iterations = 130;
  /// Wanted bound of the distance between a converged proxy and its surface or stream in the
  /// interpolated volume [voxels]; above 0, at most kMostTolerance.
  double tolerance_voxels = 0.01;
};

/// Largest StepParams::tolerance_voxels.
inline constexpr double kMostTolerance = 1.0;
/// Largest number of sub-steps (readings) of one tick. A free proxy may get a few more, at a
/// surface or at new parts on its path.
inline constexpr int kMostSubsteps = 64;

/// One of many objects in a scene: volumes with their modes, evaluated only near the hand.
struct Part {
  Graph graph;        ///< Graph of the part. Its fields stand still, and its stiffness is constant.
  Box bounds;         ///< Box that contains all effects of the part [m].
  double most = 0.0;  ///< Upper bound of the sum of the forces of the part's modes [N].
};

/// A field counts as near within this distance from its bounds [voxels].
inline constexpr double kFrameMargin = 2.0;
/// Largest number of fields of one part.
inline constexpr std::size_t kMaxPartFields = 8;
inline constexpr std::size_t kMaxPartModes = 16;  ///< Largest number of modes of one part.
/// Largest number of parts that a tick samples and balances.
inline constexpr std::size_t kMaxNearParts = 64;

/// Fields, graph and parameters; immutable once made.
struct Scene {
  /// Id, unique in the process. A proxy compares it to notice a new scene.
  std::uint64_t id = 0;
  /// Hash of the fields, the kinds of modes and the motions. A change between scenes with equal
  /// hashes has the short ramp of an edit (kEngageEdit).
  std::uint64_t shape = 0;
  /// Graph that every tick evaluates. Only it may have motions, guides, user-defined modes and a
  /// varying stiffness.
  Graph graph;
  std::vector<Part> parts;      ///< Parts, which a tick reads only near the hand.
  BroadPhase bounds;            ///< Boxes of the parts.
  double strongest_part = 0.0;  ///< The largest Part::most [N].
  /// Coupling parameters. A varying stiffness begins with the value here, its lowest value.
  CouplingParams coupling;
  StepParams step;      ///< Accuracy of the motion within each tick.
  SolverParams solver;  ///< Stopping criteria of each balance. makeScene leaves the defaults.
  /// True if the scene has no parts, motions, guides and user-defined modes. A tick on a free path
  /// then needs no reading (moveProxy).
  bool still = false;
};

/// Returns the fields that a tick reads at p_W [m]: those of modes whose support contains p_W and
/// of the varying stiffness, within their bounds. Moving fields are tested at Body::seen; without
/// bodies, all fields stand still. RT: no allocation. Cost: O(fields + modes).
[[nodiscard]] FieldSet fieldsAt(const Graph& graph, const Vec3& p_W,
                                std::span<const Body> bodies = {}) noexcept PALPATE_NONBLOCKING;

/// Returns true while the data of a field of the graph are unavailable (Fault::kVolume). RT: no
/// allocation. Cost: O(attentive fields).
[[nodiscard]] bool dataLost(const Graph& graph) noexcept PALPATE_NONBLOCKING;

/// Checks and compiles a part from fields by name. Safe to call from several threads. Throws
/// SceneError as compileGraph does, and if the spec has motions, guides, user-defined modes, a
/// varying stiffness, or too many fields or modes.
[[nodiscard]] Part makePart(const GraphSpec& spec, const std::map<std::string, FieldPtr>& fields);

/// Compiles a scene of at least one mode or part. Throws SceneError if an argument is invalid.
/// Slow; allocates.
[[nodiscard]] std::unique_ptr<const Scene> makeScene(const GraphSpec& spec,
                                                     const std::map<std::string, FieldPtr>& fields,
                                                     const CouplingParams& coupling = {},
                                                     const StepParams& step = {},
                                                     std::vector<Part> parts = {});

/// A graph, and the caches with which one thread reads its fields.
struct BoundGraph {
  /// The scene's own graph or that of a part; null if no graph is bound.
  const Graph* graph = nullptr;
  std::span<FieldCache> caches;  ///< Caches of Graph::scalar_fields, then of Graph::vector_fields.

  /// Samples the properties at p_W [m], step 1 of the paper's figure 1, for the varying stiffness
  /// and the modes whose support contains p_W. All other properties have no data. Moving fields are
  /// read at Body::seen; their pose rotates the directions. Without bodies, all fields stand still.
  /// Returns the number of fields read. RT: no allocation.
  int sample(const Vec3& p_W, Properties& out,
             std::span<const Body> bodies = {}) const noexcept PALPATE_NONBLOCKING;

  /// Notifies attentive fields of a tick; positions are in W. Returns true if values have changed
  /// without a motion (AnyField::attend). RT: no allocation.
  bool attend(const Attention& at, std::span<const Body> bodies) const noexcept PALPATE_NONBLOCKING;
  /// Notifies the same fields that the tick is over. RT: no allocation.
  void leave() const noexcept PALPATE_NONBLOCKING;

  /// Rotates the properties of volumes that have moved since the reading, by Body::carry. Call this
  /// function once for each move. RT: no allocation. Cost: O(fields).
  void turn(Properties& read, std::span<const Body> bodies) const noexcept PALPATE_NONBLOCKING;

  /// Finds the first place at which the path between `from` and `to` [m] passes a surface; see
  /// ScalarField::firstFall. All places are in the resting frame of the surface's field. RT: no
  /// allocation.
  [[nodiscard]] Crossing firstFall(const SurfaceSource& skin, double level, const Vec3& from,
                                   const Vec3& to) const noexcept PALPATE_NONBLOCKING {
    const auto i = static_cast<std::size_t>(skin.field);
    return graph->scalar_fields[i]->firstFall(from, to, level, skin.sign, caches[i]);
  }
  /// Returns the height of p [m] above the surface V = level, in voxels, from the interpolated V
  /// and its slope. p is in the field's resting frame. Not finite for a zero slope. RT: no
  /// allocation.
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

  /// Computes Graph::units and Graph::magnitudes from the properties read. RT: no allocation.
  void makeSteps(Properties& of) const noexcept PALPATE_NONBLOCKING;
};

/// The caches of one thread, enough for any scene; the constructor allocates them.
class Reader {
 public:
  Reader()
      : caches_(kMaxFields + kMaxNearParts * kMaxPartFields),
        fields_(caches_.size()),
        parts_(kMaxNearParts) {}

  /// Binds the scene's own graph. If the scene is new, unbinds all parts, and prepares the caches
  /// whose index now has another field. RT: no allocation. Cost: O(fields).
  BoundGraph bind(const Scene& scene) noexcept;
  /// Binds a part to one of kMaxNearParts slots. If the slot contained another part, prepares its
  /// caches. Call this function after bind(scene). RT: no allocation. Cost: O(fields).
  BoundGraph bind(const Scene& scene, std::size_t part, std::size_t slot) noexcept;

  /// Binds the scene's own graph and calls BoundGraph::sample. RT: no allocation.
  int sample(const Scene& scene, const Vec3& p_W, Properties& out,
             std::span<const Body> bodies = {}) noexcept PALPATE_NONBLOCKING {
    return bind(scene).sample(p_W, out, bodies);
  }

 private:
  static constexpr std::size_t kNone = static_cast<std::size_t>(-1);

  /// Prepares `count` caches, from index `first`, for the fields of a graph.
  void ready(const Graph& graph, std::size_t first, std::size_t count) noexcept;

  std::vector<FieldCache> caches_;  ///< Caches of the scene's graph, then of each slot.
  /// For each cache, AnyField::id() of its field, or 0.
  std::vector<std::uint64_t> fields_;
  std::vector<std::size_t> parts_;  ///< Index of the part in each slot.
  std::uint64_t scene_id_ = 0;
};

}  // namespace palpate
