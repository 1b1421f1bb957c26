#include "palpate/engine/scene/broad_phase.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace palpate {

namespace {

/// below() and above() round x down and up, so that a box of floats contains the box of doubles.
float below(double x) {
  const auto f = static_cast<float>(x);
  return static_cast<double>(f) <= x ? f
                                     : std::nextafter(f, -std::numeric_limits<float>::infinity());
}
float above(double x) {
  return -below(-x);
}

bool usable(const Box& box) {
  return box.lower.allFinite() && box.upper.allFinite() && !box.empty();
}

double areaOf(const Box& box) {
  const Vec3 d = box.upper - box.lower;
  return d.x() * d.y() + d.y() * d.z() + d.z() * d.x();
}

/// Splits the items for fast queries: by the surface area heuristic in 16 bins along the axis with
/// the largest spread of centres. If all centres coincide, splits the items into halves.
std::size_t part(std::span<const Box> boxes, std::span<std::uint32_t> items) {
  const auto twice_middle = [&](std::uint32_t i) -> Vec3 {
    return boxes[i].lower + boxes[i].upper;
  };
  Box middles;
  for (const std::uint32_t i : items) middles.extend(twice_middle(i));
  const Vec3 spread = middles.upper - middles.lower;
  int axis = 0;
  spread.maxCoeff(&axis);
  const std::size_t half = items.size() / 2;
  const auto order = [&](std::uint32_t a, std::uint32_t b) {
    const double x = twice_middle(a)[axis];
    const double y = twice_middle(b)[axis];
    return x != y ? x < y : a < b;
  };
  if (!(spread[axis] > 0.0)) return half;

  constexpr std::size_t kBins = 16;
  struct Bin {
    Box box;
    std::size_t count = 0;
  };
  std::array<Bin, kBins> bins;
  const auto bin_of = [&](std::uint32_t i) {
    const double at = (twice_middle(i)[axis] - middles.lower[axis]) / spread[axis];
    return std::min(kBins - 1, static_cast<std::size_t>(at * kBins));
  };
  for (const std::uint32_t i : items) {
    Bin& bin = bins[bin_of(i)];
    bin.box.extend(boxes[i].lower);
    bin.box.extend(boxes[i].upper);
    ++bin.count;
  }
  std::array<double, kBins> right{};  // cost of the bins from i to the end
  Bin sum;
  const auto add = [&](const Bin& bin) {
    if (bin.count == 0) return;
    sum.box.extend(bin.box.lower);
    sum.box.extend(bin.box.upper);
    sum.count += bin.count;
  };
  const auto cost = [&] {
    return sum.count == 0 ? 0.0 : areaOf(sum.box) * static_cast<double>(sum.count);
  };
  for (std::size_t i = kBins; i-- > 1;) {
    add(bins[i]);
    right[i] = cost();
  }
  sum = {};
  double best = std::numeric_limits<double>::infinity();
  std::size_t split = 0;
  std::size_t left_count = 0;
  for (std::size_t i = 1; i < kBins; ++i) {
    add(bins[i - 1]);
    const double both = cost() + right[i];
    if (sum.count == 0 || sum.count == items.size() || both >= best) continue;
    best = both;
    split = i;
    left_count = sum.count;
  }
  if (split == 0) {
    std::nth_element(items.begin(), items.begin() + static_cast<std::ptrdiff_t>(half), items.end(),
                     order);
    return half;
  }
  std::partition(items.begin(), items.end(), [&](std::uint32_t i) { return bin_of(i) < split; });
  return left_count;
}

}  // namespace

BroadPhase::BroadPhase(std::span<const Box> boxes) : size_(boxes.size()) {
  std::vector<std::uint32_t> items;
  for (std::size_t i = 0; i < boxes.size(); ++i) {
    if (usable(boxes[i])) items.push_back(static_cast<std::uint32_t>(i));
  }
  if (items.empty()) return;
  nodes_.reserve(2 * items.size() - 1);
  build(boxes, items);
  refit(boxes);
}

void BroadPhase::build(std::span<const Box> boxes, std::span<std::uint32_t> items) {
  const std::size_t here = nodes_.size();
  nodes_.push_back({});
  if (items.size() == 1) {
    nodes_[here].item = items[0];
  } else {
    nodes_[here].item = kInner;
    const std::size_t left = part(boxes, items);
    build(boxes, items.first(left));
    build(boxes, items.subspan(left));
  }
  nodes_[here].skip = static_cast<std::uint32_t>(nodes_.size());
}

void BroadPhase::refit(std::span<const Box> boxes) noexcept {
  // Updates the last node first, because children come after their parent.
  for (std::size_t n = nodes_.size(); n-- > 0;) {
    Node& node = nodes_[n];
    if (node.item != kInner) {
      const Box& box = boxes[node.item];
      const bool there = usable(box);
      for (int a = 0; a < 3; ++a) {
        // An unusable box becomes an empty node, which no query touches.
        node.lower[a] = there ? below(box.lower[a]) : std::numeric_limits<float>::infinity();
        node.upper[a] = there ? above(box.upper[a]) : -std::numeric_limits<float>::infinity();
      }
      continue;
    }
    const Node& one = nodes_[n + 1];
    const Node& two = nodes_[one.skip];
    for (int a = 0; a < 3; ++a) {
      node.lower[a] = std::min(one.lower[a], two.lower[a]);
      node.upper[a] = std::max(one.upper[a], two.upper[a]);
    }
  }
}

std::size_t BroadPhase::meeting(const Box& query, std::span<std::uint32_t> found) const noexcept {
  if (!usable(query)) return 0;
  float lower[3];
  float upper[3];
  for (int a = 0; a < 3; ++a) {
    lower[a] = below(query.lower[a]);
    upper[a] = above(query.upper[a]);
  }
  std::size_t count = 0;
  const std::size_t n = nodes_.size();
  for (std::size_t i = 0; i < n;) {
    const Node& node = nodes_[i];
    const bool meets = node.lower[0] <= upper[0] && node.upper[0] >= lower[0] &&
                       node.lower[1] <= upper[1] && node.upper[1] >= lower[1] &&
                       node.lower[2] <= upper[2] && node.upper[2] >= lower[2];
    if (!meets) {
      i = node.skip;
      continue;
    }
    if (node.item != kInner) {
      if (count < found.size()) found[count] = node.item;
      ++count;
    }
    ++i;
  }
  return count;
}

std::span<const std::uint32_t> NearBoxes::near(const BroadPhase& boxes, const Box& query) noexcept {
  asked_ = false;
  const bool inside = !known_.empty() && (query.lower.array() >= known_.lower.array()).all() &&
                      (query.upper.array() <= known_.upper.array()).all();
  if (!inside) {
    asked_ = true;
    const Box wide{query.lower - Vec3::Constant(margin_), query.upper + Vec3::Constant(margin_)};
    const std::size_t all = boxes.meeting(wide, found_);
    count_ = std::min(all, found_.size());
    left_out_ = 0;
    if (all > found_.size()) {
      const std::size_t exact = boxes.meeting(query, found_);
      count_ = std::min(exact, found_.size());
      left_out_ = exact - count_;
    }
    known_ = count_ == all ? wide : Box{};
    std::sort(found_.begin(), found_.begin() + static_cast<std::ptrdiff_t>(count_));
  }
  return std::span<const std::uint32_t>(found_).first(count_);
}

}  // namespace palpate
