/// Which of many boxes are near: a flat tree over them, so that a tick pays for the volumes that it
/// can touch and not for all that are placed. No OpenVDB, no field.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "palpate/engine/types.h"

namespace palpate {

/// Boxes in W, fixed in number; const in the tick.
class BroadPhase {
 public:
  BroadPhase() = default;
  /// Slow, allocates. Empty boxes, and boxes that are not
  /// finite, are never near.
  explicit BroadPhase(std::span<const Box> boxes);

  [[nodiscard]] std::size_t size() const noexcept { return size_; }

  /// The same boxes elsewhere, as many as before; the tree stays, and is the worse the farther they
  /// went. Not in a tick: nobody may ask meanwhile. No allocation.
  ///
  /// @pre boxes.size() == size().
  void refit(std::span<const Box> boxes) noexcept;

  /// Writes the indices of the boxes that meet `query` [m] into `found`, in no order; touching
  /// counts, and a box that is nearer than a millionth of its distance from the origin may be
  /// found. Returns how many there are, which may be more than fit: then those that fit are some of
  /// them. Nothing meets what is not finite. RT: no allocation. Cost: the nodes that the query
  /// meets, and their children.
  std::size_t meeting(const Box& query,
                      std::span<std::uint32_t> found) const noexcept PALPATE_NONBLOCKING;

 private:
  /// In the order of a walk: after an inner node come its first child's nodes, then its second's.
  struct Node {
    float lower[3];
    float upper[3];
    std::uint32_t skip;  ///< The node after all of this one's.
    std::uint32_t item;  ///< Of a leaf: its box; kInner.
  };
  static constexpr std::uint32_t kInner = 0xFFFFFFFF;

  void build(std::span<const Box> boxes, std::span<std::uint32_t> items);

  std::vector<Node> nodes_;
  std::size_t size_ = 0;  ///< Boxes; those that are nowhere have no node.
};

/// The boxes near a hand, from tick to tick: asks the tree only when the hand leaves the larger box
/// that was asked for last.
class NearBoxes {
 public:
  static constexpr std::size_t kMost = 1024;

  /// @param margin  So much larger than the query is what the tree is asked for, every way [m].
  explicit NearBoxes(double margin = 0.01) : margin_(margin), found_(kMost) {}

  /// Indices, ascending, of all boxes that meet `query` [m] and of some that are within the margin;
  /// where there are more than kMost of these, of some of them, and `complete` says so. Valid until
  /// the next call. RT: no allocation. Cost: six comparisons where the query is in the last one's
  /// box.
  [[nodiscard]] std::span<const std::uint32_t> near(const BroadPhase& boxes,
                                                    const Box& query) noexcept PALPATE_NONBLOCKING;
  [[nodiscard]] bool complete() const noexcept { return left_out_ == 0; }
  /// So many that meet the query are not among them.
  [[nodiscard]] std::size_t leftOut() const noexcept { return left_out_; }
  /// What the tree was asked for last; empty where it was too much.
  [[nodiscard]] const Box& known() const noexcept { return known_; }
  /// True if the last call has asked the tree.
  [[nodiscard]] bool asked() const noexcept { return asked_; }
  /// The boxes have moved, or are others.
  void forget() noexcept { known_ = {}; }

 private:
  double margin_;
  std::vector<std::uint32_t> found_;
  std::size_t count_ = 0;
  Box known_;  ///< What was asked for; empty: nothing.
  std::size_t left_out_ = 0;
  bool asked_ = false;
};

}  // namespace palpate
