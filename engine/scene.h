/// Everything one tick needs to know about the world: built off the haptic thread, then const.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "engine/coupling.h"
#include "engine/field.h"
#include "engine/graph.h"
#include "engine/solver.h"

namespace palpate {

/// Accuracy of the motion within a tick.
struct StepParams {
  int max_substeps = 8;  ///< The proxy moves at most a voxel at a time where there is data; after
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

/// Fields, graph and parameters. Immutable once made; readers and the proxy's memory live
/// elsewhere.
struct Scene {
  std::uint64_t id = 0;     ///< Unique in the process: a proxy notices that its scene was swapped.
  std::uint64_t shape = 0;  ///< The same for scenes with the same fields and kinds of modes, which
                            ///< differ in numbers only: a swap is felt as an edit.
  Graph graph;
  CouplingParams coupling;  ///< Where the stiffness varies: from its lowest value.
  StepParams step;
  SolverParams solver;
};

/// The fields that a tick at p_W [m] reads: those of the modes, and of the varying stiffness, whose
/// support holds it. Moving fields are asked at Body::seen of their motion; without bodies they
/// rest. RT: no allocation. Cost: a few ns a field and mode.
[[nodiscard]] FieldSet fieldsAt(const Graph& graph, const Vec3& p_W,
                                std::span<const Body> bodies = {}) noexcept PALPATE_NONBLOCKING;

/// Checks and compiles a scene from fields by name. Throws SceneError; slow, allocates.
[[nodiscard]] std::unique_ptr<const Scene> makeScene(const GraphSpec& spec,
                                                     const std::map<std::string, FieldPtr>& fields,
                                                     const CouplingParams& coupling = {},
                                                     const StepParams& step = {});

/// What one thread's reads change: a cache for each field that a scene reads. Its memory is taken
/// when it is made, so that a swapped scene costs no allocation.
class Reader {
 public:
  Reader() : caches_(kMaxFields) {}

  /// Readies the caches for a scene; nothing where it is the scene of the last call.
  /// RT: no allocation. Cost: O(fields).
  void bind(const Scene& scene) noexcept;

  /// Step 1 of the paper's figure 1: samples at p_W [m] what the modes read whose support holds it.
  /// What is not read has no data. Moving fields are read at Body::seen of their motion and their
  /// directions turned by its pose; without bodies they rest. Call bind first. Returns how many
  /// fields were read. RT: no allocation.
  int sample(const Scene& scene, const Vec3& p_W, Properties& out,
             std::span<const Body> bodies = {}) noexcept PALPATE_NONBLOCKING;

  /// Turns what was read of fields whose volumes have moved since by Body::carry: once a move.
  /// RT: no allocation. Cost: O(fields).
  static void turn(const Scene& scene, Properties& read,
                   std::span<const Body> bodies) noexcept PALPATE_NONBLOCKING;

  /// The contact of a way [m] with a surface, in the resting frame of its field; see
  /// ScalarField::firstFall. RT: no allocation.
  [[nodiscard]] Crossing firstFall(const Scene& scene, const Skin& skin, double level,
                                   const Vec3& from, const Vec3& to) noexcept PALPATE_NONBLOCKING {
    const auto i = static_cast<std::size_t>(skin.field);
    return scene.graph.scalar_fields[i]->firstFall(from, to, level, skin.sign, caches_[i]);
  }
  /// Along a stream, in the resting frame of its field, an index into Graph::vector_fields; see
  /// VectorField::trace. RT: no allocation.
  [[nodiscard]] Trace trace(const Scene& scene, int field, const Vec3& p,
                            const TraceOrder& order) noexcept PALPATE_NONBLOCKING {
    const auto i = static_cast<std::size_t>(field);
    return scene.graph.vector_fields[i]->trace(p, order,
                                               caches_[scene.graph.scalar_fields.size() + i]);
  }

 private:
  std::vector<FieldCache> caches_;
  std::uint64_t scene_id_ = 0;
};

}  // namespace palpate
