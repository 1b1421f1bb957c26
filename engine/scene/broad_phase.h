/// Finds the boxes near a query with a flat tree, so that a tick visits only volumes within reach.
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
  /// Builds the tree; slow, allocates. A box that is empty or not finite is never found.
  explicit BroadPhase(std::span<const Box> boxes);

  /// Returns the number of boxes, including boxes that are never found.
  [[nodiscard]] std::size_t size() const noexcept { return size_; }

  /// Moves the boxes. Queries cost more the farther the boxes have moved. A box that was empty or
  /// not finite at construction is never found. Do not call this function while a tick of any
  /// thread may query the tree. No allocation.
  ///
  /// @pre boxes.size() == size().
  void refit(std::span<const Box> boxes) noexcept;

  /// Writes the indices of the boxes that overlap or touch `query` [m] into `found`, in any order.
  /// A box whose distance from the query is less than a millionth of its distance from the origin
  /// may count as touching. Returns the number of these boxes. If this number exceeds the size of
  /// `found`, `found` misses the excess indices. A query that is empty or not finite overlaps no
  /// box. RT: no allocation. Cost: the nodes that the query overlaps, and their children.
  std::size_t meeting(const Box& query,
                      std::span<std::uint32_t> found) const noexcept PALPATE_NONBLOCKING;

 private:
  /// The nodes are stored depth first: node, first child's nodes, second child's nodes.
  struct Node {
    float lower[3];
    float upper[3];
    std::uint32_t skip;  ///< Index of the first node after this node's subtree.
    std::uint32_t item;  ///< Index of the box of a leaf; kInner for an inner node.
  };
  static constexpr std::uint32_t kInner = 0xFFFFFFFF;

  void build(std::span<const Box> boxes, std::span<std::uint32_t> items);

  std::vector<Node> nodes_;
  std::size_t size_ = 0;  ///< Number of boxes. Boxes that are never found have no node.
};

/// The boxes near a hand, kept from tick to tick. near() queries the tree with a larger box than
/// requested. It queries the tree again only if a later request exceeds that box.
class NearBoxes {
 public:
  static constexpr std::size_t kMost = 1024;  ///< Most boxes that near() can return.

  /// @param margin  The tree query exceeds the requested box by this on every side [m].
  explicit NearBoxes(double margin = 0.01) : margin_(margin), found_(kMost) {}

  /// Returns the indices, in ascending order, of all boxes that overlap `query` [m], and of other
  /// boxes that overlap known(). If more than kMost boxes overlap `query`, returns kMost indices,
  /// and complete() is false. The result is valid until the next call. RT: no allocation. Cost: six
  /// comparisons if the query is inside the box of the last tree query.
  [[nodiscard]] std::span<const std::uint32_t> near(const BroadPhase& boxes,
                                                    const Box& query) noexcept PALPATE_NONBLOCKING;
  /// Returns false if near() had no room for some of the boxes that overlap its query.
  [[nodiscard]] bool complete() const noexcept { return left_out_ == 0; }
  /// Returns the number of boxes for which near() had no room.
  [[nodiscard]] std::size_t leftOut() const noexcept { return left_out_; }
  /// Returns the box of the last tree query; empty if too many boxes overlapped it.
  [[nodiscard]] const Box& known() const noexcept { return known_; }
  /// Returns true if the last call of near() has queried the tree.
  [[nodiscard]] bool asked() const noexcept { return asked_; }
  /// Forgets the boxes found. Call this function when boxes have moved or were replaced.
  void forget() noexcept { known_ = {}; }

 private:
  double margin_;
  std::vector<std::uint32_t> found_;
  std::size_t count_ = 0;
  Box known_;
  std::size_t left_out_ = 0;
  bool asked_ = false;
};

}  // namespace palpate
