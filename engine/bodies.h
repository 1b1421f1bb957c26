/// The moving volumes of a tick: where they are, and where the proxy is in the resting frame of
/// each of them.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "palpate/engine/felt.h"
#include "palpate/engine/graph.h"
#include "palpate/engine/placement.h"
#include "palpate/engine/step_report.h"

namespace palpate {

/// One Body for each of Graph::motions. Before the balance a volume carries along what is in it:
/// its fields are read, and its primitives stand, where it has carried the proxy. Memory is
/// allocated when a Bodies is made.
class Bodies {
 public:
  Bodies() : bodies_(kMaxMotions) {}

  /// Takes over the motions of another graph, or begins for a proxy that is new here: the volumes
  /// are where they are at `time` [s], about the proxy [m].
  void place(const Graph& graph, double time, const Vec3& proxy) noexcept PALPATE_NONBLOCKING;

  /// The number of slices in which the volumes move on to `time` [s]: in each at most half a voxel
  /// where the proxy is or can come to. At most `most`; where more are needed the report says so.
  ///
  /// @param felt  The scene's own graph.
  [[nodiscard]] int plan(std::span<const Felt> felt, double time, const Vec3& proxy,
                         const Vec3& probe, int most,
                         StepReport& report) noexcept PALPATE_NONBLOCKING;
  /// Moves the volumes to their poses in one of the slices, `part` of 1 to `parts`, and finds where
  /// each sees the proxy. What deforms goes on as the last reading of it says, where that is sure
  /// to a quarter of a voxel; else it is read where it has carried the proxy. The next reading,
  /// in the same slice, says how it is. Returns how many were read.
  int move(const Graph& graph, int part, int parts, const Vec3& proxy) noexcept PALPATE_NONBLOCKING;
  /// Ends a motion: the volumes are where plan() led.
  void arrive() noexcept { posed_at_ = time_; }

  /// Notes that properties are read at p [m], and reads how volumes deform there: a reading each,
  /// the number is returned.
  int readAt(const Graph& graph, const Vec3& p) noexcept PALPATE_NONBLOCKING;
  /// Notes that the proxy stands there [m]: no volume has carried it away since.
  void stand(const Vec3& proxy) noexcept {
    for (Body& body : all()) {
      body.from = body.pose.toRest(proxy);
      body.carried = proxy;
      body.moved = false;
    }
  }

  /// How far the proxy may go on the path from a to b [m] before properties are read again [m]: a
  /// voxel of the finest volume that the path can reach, infinitely far where it reaches none. For
  /// a volume that has carried the place of its reading away from a the distance counts from there.
  ///
  /// @param onward  True: a is where properties were read last, not where the proxy stands.
  [[nodiscard]] double reachFrom(std::span<const Felt> felt, const Vec3& a, const Vec3& b,
                                 bool onward) const noexcept PALPATE_NONBLOCKING;
  /// Goes a share of the path to b, for a proxy that one moving volume holds back: `end` is a voxel
  /// of that volume from where it carried the proxy, as if it stood still. False, and `end`
  /// unchanged, where no moved volume is on the path or what another one read does not hold so far.
  [[nodiscard]] bool follow(std::span<const Felt> felt, const Vec3& proxy, const Vec3& b,
                            Vec3& end) const noexcept PALPATE_NONBLOCKING;

  /// The body of a motion, an index into Graph::motions; null for -1.
  [[nodiscard]] const Body* of(int motion) const noexcept {
    return motion < 0 ? nullptr : &bodies_[static_cast<std::size_t>(motion)];
  }
  /// One body for each of Graph::motions, in their order.
  [[nodiscard]] std::span<const Body> items() const noexcept { return {bodies_.data(), count_}; }
  /// True if the graph has no motions.
  [[nodiscard]] bool empty() const noexcept { return count_ == 0; }

 private:
  [[nodiscard]] std::span<Body> all() noexcept { return {bodies_.data(), count_}; }
  /// The pose that a body will have about what rests at `rest` [m], by `about` or by a reading that
  /// takes its place; the number of these.
  static int foresee(const Motion& motion, double time, const Vec3& rest, double sure,
                     Deformation& about, Pose& pose) noexcept PALPATE_NONBLOCKING;

  std::vector<Body> bodies_;
  std::size_t count_ = 0;
  double posed_at_ = 0.0;  ///< Time of the present poses [s].
  double time_ = 0.0;      ///< Time of the poses that the volumes move to [s].
  double now_ = 0.0;       ///< Time of the slice [s].
};

}  // namespace palpate
