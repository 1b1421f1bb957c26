/// Which of many boxes are near: a flat tree over them, so that a tick pays for the volumes that it
/// can touch and not for all that are placed. No OpenVDB, no field.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "palpate/engine/types.h"

namespace palpate {

/// A tree over boxes in W, fixed in number; const in the tick.
class BroadPhase {
 public:
  BroadPhase() = default;
  /// Builds the tree: slow, allocates. Empty boxes, and boxes that are not finite, are never
  /// near.
  explicit BroadPhase(std::span<const Box> boxes);

  /// Number of boxes that it was built of, those that are never near included.
  [[nodiscard]] std::size_t size() const noexcept { return size_; }

  /// Takes as many boxes as before at other places. The tree's shape stays, and queries cost the
  /// more the farther the boxes went. Not in a tick: no query may run meanwhile. No allocation.
  ///
  /// @pre boxes.size() == size().
  void refit(std::span<const Box> boxes) noexcept;

  /// Writes the indices of the boxes that overlap `query` [m] into `found`, in no order. Boxes that
  /// touch it count, and a box may be found that is nearer to it than a millionth of that box's
  /// distance from the origin. Returns how many there are, which may be more than fit: `found` then
  /// holds some of them. Nothing overlaps a query that is not finite. RT: no allocation. Cost: the
  /// nodes that the query overlaps, and their children.
  std::size_t meeting(const Box& query,
                      std::span<std::uint32_t> found) const noexcept PALPATE_NONBLOCKING;

 private:
  /// A node, depth first: after an inner node come its first child's nodes, then its second's.
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

/// The boxes near a hand, from tick to tick: the tree is asked only when the query leaves the
/// larger box that was asked for last.
class NearBoxes {
 public:
  static constexpr std::size_t kMost = 1024;  ///< Most boxes that near() can return.

  /// @param margin  How much larger than the query, on every side, the box asked for is [m].
  explicit NearBoxes(double margin = 0.01) : margin_(margin), found_(kMost) {}

  /// Indices, ascending, of all boxes that overlap `query` [m] and of some that are within the
  /// margin; where more than kMost overlap it, indices of kMost of these, and complete() is false.
  /// Valid until the next call. RT: no allocation. Cost: six comparisons where the query is in the
  /// box that was asked for last.
  [[nodiscard]] std::span<const std::uint32_t> near(const BroadPhase& boxes,
                                                    const Box& query) noexcept PALPATE_NONBLOCKING;
  /// False where near() had no room for some of the boxes that overlap its query.
  [[nodiscard]] bool complete() const noexcept { return left_out_ == 0; }
  /// Number of boxes that overlap the query and for which there was no room.
  [[nodiscard]] std::size_t leftOut() const noexcept { return left_out_; }
  /// The box that the tree was asked for last; empty where too many boxes overlapped it.
  [[nodiscard]] const Box& known() const noexcept { return known_; }
  /// True if the last call has asked the tree.
  [[nodiscard]] bool asked() const noexcept { return asked_; }
  /// Forgets what was found: the boxes have moved, or are others.
  void forget() noexcept { known_ = {}; }

 private:
  double margin_;
  std::vector<std::uint32_t> found_;
  std::size_t count_ = 0;
  Box known_;  ///< The box asked for; empty: none.
  std::size_t left_out_ = 0;
  bool asked_ = false;
};

}  // namespace palpate
