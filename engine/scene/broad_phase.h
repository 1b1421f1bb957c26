/// Finds which of many boxes are near, by a flat tree over them. So a tick pays only for volumes
/// within reach, not for all that are placed. Uses no OpenVDB and no field.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "palpate/engine/types.h"

namespace palpate {

/// A tree over a fixed number of boxes in W; const in the tick.
class BroadPhase {
 public:
  BroadPhase() = default;
  /// Builds the tree: slow, allocates. Empty boxes, and boxes that are not finite, are never
  /// near.
  explicit BroadPhase(std::span<const Box> boxes);

  /// Returns the number of boxes in the constructor, including those that are never near.
  [[nodiscard]] std::size_t size() const noexcept { return size_; }

  /// Moves the boxes; their number stays. The tree's shape stays too, and queries cost more the
  /// farther the boxes moved. Do not call it in a tick: no query may run at the same time. No
  /// allocation.
  ///
  /// @pre boxes.size() == size().
  void refit(std::span<const Box> boxes) noexcept;

  /// Writes the indices of the boxes that overlap `query` [m] into `found`, in no order. Boxes that
  /// touch the query count. A box may also be found if its distance from the query is less than a
  /// millionth of its distance from the origin. Returns the number of boxes, which may be more than
  /// fit: `found` then holds some of the indices. A query that is not finite overlaps no box. RT:
  /// no allocation. Cost: the nodes that the query overlaps, and their children.
  std::size_t meeting(const Box& query,
                      std::span<std::uint32_t> found) const noexcept PALPATE_NONBLOCKING;

 private:
  /// A node, depth first: an inner node is followed by its first child's nodes, then by its
  /// second's.
  struct Node {
    float lower[3];
    float upper[3];
    std::uint32_t skip;  ///< The node after this one's subtree.
    std::uint32_t item;  ///< Box of a leaf; kInner in an inner node.
  };
  static constexpr std::uint32_t kInner = 0xFFFFFFFF;

  void build(std::span<const Box> boxes, std::span<std::uint32_t> items);

  std::vector<Node> nodes_;
  std::size_t size_ = 0;  ///< Number of boxes; those that are never near have no node.
};

/// The boxes near a hand, from tick to tick. The tree is queried only when the query leaves the
/// larger box of the last tree query.
class NearBoxes {
 public:
  static constexpr std::size_t kMost = 1024;  ///< Most boxes that near() can return.

  /// @param margin  Distance by which that box exceeds the query on every side [m].
  explicit NearBoxes(double margin = 0.01) : margin_(margin), found_(kMost) {}

  /// Returns the indices, ascending, of all boxes that overlap `query` [m] and of some within the
  /// margin. If more than kMost boxes overlap it, returns kMost indices, and complete() is false.
  /// Valid until the next call. RT: no allocation. Cost: six comparisons if the query is in the box
  /// of the last tree query.
  [[nodiscard]] std::span<const std::uint32_t> near(const BroadPhase& boxes,
                                                    const Box& query) noexcept PALPATE_NONBLOCKING;
  /// Returns false if near() had no room for some of the boxes that overlap its query.
  [[nodiscard]] bool complete() const noexcept { return left_out_ == 0; }
  /// Returns the number of boxes that overlap the query but were left out for lack of room.
  [[nodiscard]] std::size_t leftOut() const noexcept { return left_out_; }
  /// Returns the box of the last tree query; empty if too many boxes overlapped it.
  [[nodiscard]] const Box& known() const noexcept { return known_; }
  /// Returns true if the last call has queried the tree.
  [[nodiscard]] bool asked() const noexcept { return asked_; }
  /// Forgets the boxes found: call it when the boxes have moved or are others.
  void forget() noexcept { known_ = {}; }

 private:
  double margin_;
  std::vector<std::uint32_t> found_;
  std::size_t count_ = 0;
  Box known_;  ///< The box of the last tree query; empty: unknown.
  std::size_t left_out_ = 0;
  bool asked_ = false;
};

}  // namespace palpate
