/// The volumes that move, as a tick sees them: where they are, and the proxy as each of them sees
/// it.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "palpate/engine/felt.h"
#include "palpate/engine/graph.h"
#include "palpate/engine/placement.h"
#include "palpate/engine/step_report.h"

namespace palpate {

/// One Body for each of Graph::motions. A volume carries along what is in it before the balance:
/// its fields are read, and its primitives stand, where it has carried the proxy. Its memory is
/// taken when it is made.
class Bodies {
 public:
  Bodies() : bodies_(kMaxMotions) {}

  /// The volumes of another graph, or a proxy that is new here: they are where they are at that
  /// time [s].
  void place(const Graph& graph, double time) noexcept PALPATE_NONBLOCKING;

  /// In how many parts they move on to a time [s]: each at most half a voxel where the proxy is or
  /// can come to. More than `most` are not made, and the report says so.
  ///
  /// @param felt  The scene's own graph.
  [[nodiscard]] int plan(std::span<const Felt> felt, double time, const Vec3& proxy,
                         const Vec3& probe, int most,
                         StepReport& report) noexcept PALPATE_NONBLOCKING;
  /// Moves them to their place in one of so many parts, 1 to `parts`, and finds where each sees the
  /// proxy.
  void move(const Graph& graph, int part, int parts,
            const Vec3& proxy) noexcept PALPATE_NONBLOCKING;
  /// They are where plan() led.
  void arrive() noexcept { posed_at_ = time_; }

  /// Properties are read there [m].
  void readAt(const Vec3& p) noexcept {
    for (Body& body : all()) body.seen = body.pose.toRest(p);
  }
  /// The proxy stands there [m]: none has carried it away since.
  void stand(const Vec3& proxy) noexcept {
    for (Body& body : all()) {
      body.from = body.pose.toRest(proxy);
      body.carried = proxy;
      body.moved = false;
    }
  }

  /// How far a way from a to b may go before properties are read again: a voxel of the finest
  /// volume that it can meet. A volume that has carried the place of its reading away from a counts
  /// from there.
  ///
  /// @param onward  a is where properties were read last, not where the proxy stands.
  [[nodiscard]] double reachFrom(std::span<const Felt> felt, const Vec3& a, const Vec3& b,
                                 bool onward) const noexcept PALPATE_NONBLOCKING;
  /// Part of the way to b, for a proxy that one moving volume holds back: a voxel of it from where
  /// that volume was read, as if it stood still. False, and nothing done, where another volume
  /// could not follow that.
  [[nodiscard]] bool follow(std::span<const Felt> felt, const Vec3& proxy, const Vec3& b,
                            Vec3& end) const noexcept PALPATE_NONBLOCKING;

  /// Of a motion, an index into Graph::motions; none for -1.
  [[nodiscard]] const Body* of(int motion) const noexcept {
    return motion < 0 ? nullptr : &bodies_[static_cast<std::size_t>(motion)];
  }
  [[nodiscard]] std::span<const Body> items() const noexcept { return {bodies_.data(), count_}; }
  [[nodiscard]] bool empty() const noexcept { return count_ == 0; }

 private:
  [[nodiscard]] std::span<Body> all() noexcept { return {bodies_.data(), count_}; }

  std::vector<Body> bodies_;
  std::size_t count_ = 0;
  double posed_at_ = 0.0;  ///< Time of their poses [s],
  double time_ = 0.0;      ///< and of where they go.
};

}  // namespace palpate
