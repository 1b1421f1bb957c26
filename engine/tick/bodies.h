/// The moving volumes of a tick: their poses, and the proxy's place in the resting frame of each.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "palpate/engine/field/placement.h"
#include "palpate/engine/scene/graph.h"
#include "palpate/engine/tick/felt.h"
#include "palpate/engine/tick/step_report.h"

namespace palpate {

/// One body for each of Graph::motions. Before the balance, each volume moves and carries the proxy
/// to Body::carried. The tick reads the volume's fields there, and puts its primitives there. The
/// constructor allocates all memory.
class Bodies {
 public:
  Bodies() : bodies_(kMaxMotions) {}

  /// Places the bodies at `time` [s], about the proxy [m], for another graph or a new proxy.
  void place(const Graph& graph, double time, const Vec3& proxy) noexcept PALPATE_NONBLOCKING;

  /// Plans the motion of the volumes to `time` [s] and returns the number of slices, at most
  /// `most`. A slice is a part of the tick's motion (iteration.h). In each slice, a volume near the
  /// path from the proxy to the hand moves at most half a voxel at the proxy. If more slices are
  /// needed, the report gets kSubstepLimit. `felt[0]` is the scene's own graph.
  [[nodiscard]] int plan(std::span<const Felt> felt, double time, const Vec3& proxy,
                         const Vec3& probe, int most,
                         StepReport& report) noexcept PALPATE_NONBLOCKING;
  /// Moves the volumes to their poses in slice `part`, 1 to `parts`, and finds the proxy's place
  /// relative to each. A warp is predicted from its last reading if the error is at most a quarter
  /// of a voxel. Otherwise it is sampled at the place to which it has carried the proxy. Returns
  /// the number of warps sampled; plan() has counted those of a single slice.
  int move(const Graph& graph, int part, int parts, const Vec3& proxy) noexcept PALPATE_NONBLOCKING;
  /// Ends the motion that plan() began: the poses are now those of its `time`.
  void arrive() noexcept { posed_at_ = time_; }

  /// Records that properties are read at p [m]; samples the warps there and returns their number.
  int readAt(const Graph& graph, const Vec3& p) noexcept PALPATE_NONBLOCKING;
  /// Records that the proxy is at `proxy` [m]: no volume has carried it away.
  void stand(const Vec3& proxy) noexcept {
    for (Body& body : all()) {
      body.from = body.pose.toRest(proxy);
      body.carried = proxy;
      body.moved = false;
    }
  }

  /// Returns the distance [m] that the proxy may move on the path from a to b [m] before properties
  /// are read again. This is one voxel of the finest volume on the path, and infinity without a
  /// volume. If a volume has carried the place of its reading away from a, the distance counts from
  /// that place, but is at least half a voxel. `onward` is true if a is the place of the last
  /// reading, false if it is the proxy's place.
  [[nodiscard]] double reachFrom(std::span<const Felt> felt, const Vec3& a, const Vec3& b,
                                 bool onward) const noexcept PALPATE_NONBLOCKING;
  /// Serves a proxy that a moving volume holds back. Sets `end` to the point one voxel of that
  /// volume from Body::carried towards b. Returns false and leaves `end` unchanged if no moved
  /// volume is on the path, or if the reading of another volume is not valid that far.
  [[nodiscard]] bool follow(std::span<const Felt> felt, const Vec3& proxy, const Vec3& b,
                            Vec3& end) const noexcept PALPATE_NONBLOCKING;

  /// Returns the body of a motion, given its index in Graph::motions; null for -1.
  [[nodiscard]] const Body* of(int motion) const noexcept {
    return motion < 0 ? nullptr : &bodies_[static_cast<std::size_t>(motion)];
  }
  /// Returns one body for each of Graph::motions, in their order.
  [[nodiscard]] std::span<const Body> items() const noexcept { return {bodies_.data(), count_}; }
  /// Returns true if the graph has no motions.
  [[nodiscard]] bool empty() const noexcept { return count_ == 0; }

 private:
  [[nodiscard]] std::span<Body> all() noexcept { return {bodies_.data(), count_}; }
  /// Predicts the pose of a body about the material point at `rest` [m] of its resting frame. Uses
  /// the reading `about`, or replaces it by a new reading. Returns the number of new readings.
  static int foresee(const Motion& motion, double time, const Vec3& rest, double sure,
                     Deformation& about, Pose& pose) noexcept PALPATE_NONBLOCKING;

  std::vector<Body> bodies_;
  std::size_t count_ = 0;
  double posed_at_ = 0.0;  ///< Time of the present poses [s].
  double time_ = 0.0;      ///< Time of the poses to which the volumes move [s].
  double now_ = 0.0;       ///< Time of the poses in the present slice [s].
};

}  // namespace palpate
