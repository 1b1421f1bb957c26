/// The moving volumes of a tick: their poses, and the place of the proxy in the resting frame of
/// each.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "palpate/engine/field/placement.h"
#include "palpate/engine/scene/graph.h"
#include "palpate/engine/tick/felt.h"
#include "palpate/engine/tick/step_report.h"

namespace palpate {

/// One Body for each of Graph::motions. Before the balance, a volume carries its contents along:
/// its fields are read, and its primitives stand, where it has carried the proxy. The constructor
/// allocates all memory.
class Bodies {
 public:
  Bodies() : bodies_(kMaxMotions) {}

  /// Takes over the motions of another graph, or begins for a proxy that is new here. Places the
  /// volumes where they are at `time` [s], about the proxy [m].
  void place(const Graph& graph, double time, const Vec3& proxy) noexcept PALPATE_NONBLOCKING;

  /// Returns the number of slices in which the volumes move on to `time` [s], at most `most`. In
  /// each slice a volume moves at most half a voxel at the proxy and where the proxy may go. If
  /// more than `most` are needed, the report gets kSubstepLimit.
  ///
  /// @param felt  The scene's own graph.
  [[nodiscard]] int plan(std::span<const Felt> felt, double time, const Vec3& proxy,
                         const Vec3& probe, int most,
                         StepReport& report) noexcept PALPATE_NONBLOCKING;
  /// Moves the volumes to their poses in slice `part` of 1 to `parts`, and finds where each sees
  /// the proxy. A warp continues as its last reading predicts, if that is sure to a quarter of a
  /// voxel. Else the warp is sampled again where it has carried the proxy. The next reading in the
  /// same slice replaces the prediction. Returns the number of warps sampled.
  int move(const Graph& graph, int part, int parts, const Vec3& proxy) noexcept PALPATE_NONBLOCKING;
  /// Ends a motion: the volumes are where plan() led.
  void arrive() noexcept { posed_at_ = time_; }

  /// Notes that properties are read at p [m], and samples how volumes deform there. Returns the
  /// number of samples, one for each warp.
  int readAt(const Graph& graph, const Vec3& p) noexcept PALPATE_NONBLOCKING;
  /// Notes that the proxy stands at `proxy` [m]: no volume has carried it away since.
  void stand(const Vec3& proxy) noexcept {
    for (Body& body : all()) {
      body.from = body.pose.toRest(proxy);
      body.carried = proxy;
      body.moved = false;
    }
  }

  /// Returns how far the proxy may go on the path from a to b [m] before properties are read again
  /// [m]: a voxel of the finest volume that the path can reach, infinity if the path reaches no
  /// volume. If a volume has carried the place of its reading away from a, the distance counts from
  /// that place.
  ///
  /// @param onward  True: a is the place of the last reading, not of the proxy.
  [[nodiscard]] double reachFrom(std::span<const Felt> felt, const Vec3& a, const Vec3& b,
                                 bool onward) const noexcept PALPATE_NONBLOCKING;
  /// Goes a share of the path to b, for a proxy that one moving volume holds back. `end` is one
  /// voxel of the volume from the place to which it carried the proxy, as if the volume stood
  /// still. Returns false and leaves `end` unchanged if no moved volume is on the path, or if the
  /// reading of another volume does not hold so far.
  [[nodiscard]] bool follow(std::span<const Felt> felt, const Vec3& proxy, const Vec3& b,
                            Vec3& end) const noexcept PALPATE_NONBLOCKING;

  /// Returns the body of a motion, an index into Graph::motions; null for -1.
  [[nodiscard]] const Body* of(int motion) const noexcept {
    return motion < 0 ? nullptr : &bodies_[static_cast<std::size_t>(motion)];
  }
  /// Returns one body for each of Graph::motions, in their order.
  [[nodiscard]] std::span<const Body> items() const noexcept { return {bodies_.data(), count_}; }
  /// Returns true if the graph has no motions.
  [[nodiscard]] bool empty() const noexcept { return count_ == 0; }

 private:
  [[nodiscard]] std::span<Body> all() noexcept { return {bodies_.data(), count_}; }
  /// Predicts the pose of a body about the point at `rest` [m] in its resting frame. It uses
  /// `about`, or a new reading that replaces `about`. Returns the number of readings.
  static int foresee(const Motion& motion, double time, const Vec3& rest, double sure,
                     Deformation& about, Pose& pose) noexcept PALPATE_NONBLOCKING;

  std::vector<Body> bodies_;
  std::size_t count_ = 0;
  double posed_at_ = 0.0;  ///< Time of the present poses [s].
  double time_ = 0.0;      ///< Time of the poses that the volumes move to [s].
  double now_ = 0.0;       ///< Time of the slice [s].
};

}  // namespace palpate
