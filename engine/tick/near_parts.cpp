#include "palpate/engine/tick/near_parts.h"

#include <algorithm>
#include <cstddef>
#include <limits>

namespace palpate {

namespace {

/// The choice includes parts this far beyond the hand, so that it changes less often [m].
constexpr double kAhead = 2e-3;

/// Returns a lower bound on the distance from p to a part's data [m]. If p is farther than `enough`
/// [m] from the part's box, returns the distance to the box.
double freeWithin(const Part& part, const Vec3& p, double enough) noexcept {
  const Box& box = part.bounds;
  const double outside = (box.lower - p).cwiseMax(p - box.upper).cwiseMax(0.0).norm();
  if (outside > enough) return outside;
  double free = std::numeric_limits<double>::infinity();
  for (const auto& field : part.graph.scalar_fields) free = std::min(free, field->freeWithin(p));
  for (const auto& field : part.graph.vector_fields) free = std::min(free, field->freeWithin(p));
  return std::max(outside, free);
}

}  // namespace

void NearParts::forget() noexcept {
  for (NearPart& slot : slots_) slot.part = NearPart::kNone;
  count_ = 0;
  boxes_.forget();
}

void NearParts::meet(const Scene& scene, Reader& reader, const Vec3& proxy, const Vec3& probe,
                     PrimitiveSet& scratch, StepReport& report) noexcept {
  // A balance may move the proxy sideways, but seldom by more than the distance to the hand.
  const double length = (probe - proxy).norm();
  const Vec3 about = Vec3::Constant(length);
  const std::span<const std::uint32_t> near =
      boxes_.near(scene.bounds, {proxy - about, proxy + about});
  const double gone = (proxy - chosen_at_).norm();
  if (boxes_.asked() || crowded_ || gone + length >= chosen_for_) {
    choose(scene, reader, near, proxy, probe, scratch, report);
  }
  report.parts = static_cast<int>(count_);
}

std::size_t NearParts::bind(const Scene& scene, Reader& reader, std::span<Felt> felt) noexcept {
  std::size_t i = 0;
  for (const std::uint8_t slot : order()) {
    NearPart& near = slots_[slot];
    felt[i++] = {reader.bind(scene, near.part, slot), &near.properties, near.memories.data()};
  }
  return count_;
}

double NearParts::knownShare(const Vec3& from, const Vec3& to) const noexcept {
  const Vec3 line = to - from;
  const Box& known = boxes_.known();
  double share = 1.0;
  for (int a = 0; a < 3 && !known.empty(); ++a) {
    if (to[a] > known.upper[a]) {
      share = std::min(share, (known.upper[a] - from[a]) / line[a]);
    } else if (to[a] < known.lower[a]) {
      share = std::min(share, (known.lower[a] - from[a]) / line[a]);
    }
  }
  if ((to - chosen_at_).norm() >= chosen_for_) {
    const double gone = (from - chosen_at_).norm();
    share = std::min(share, (chosen_for_ - gone) / line.norm());
  }
  return share >= 1.0 ? 1.0 : std::max(share, 0.0);
}

void NearParts::choose(const Scene& scene, Reader& reader, std::span<const std::uint32_t> near,
                       const Vec3& proxy, const Vec3& probe, PrimitiveSet& scratch,
                       StepReport& report) noexcept {
  const double length = (probe - proxy).norm();
  std::size_t count = 0;
  const auto take = [&](double reach) {
    count = 0;
    chosen_for_ = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < near.size(); ++i) {
      if (free_[i] > reach) {
        chosen_for_ = std::min(chosen_for_, free_[i]);
      } else {
        awake_[count++] = near[i];
      }
    }
  };
  chosen_at_ = proxy;
  for (std::size_t i = 0; i < near.size(); ++i) {
    free_[i] = freeWithin(scene.parts[near[i]], proxy, length + kAhead);
  }
  take(length + kAhead);
  if (count > kMaxNearParts) take(length);
  crowded_ = count > kMaxNearParts || !boxes_.complete();  // if true, every tick chooses again
  if (crowded_) count = strongest(scene, {awake_.data(), count}, report);
  keep({awake_.data(), count}, [&](std::size_t part, std::size_t slot) {
    // Places primitives, so that each mode knows the proxy's side of its surface before a sweep.
    NearPart& fresh = slots_[slot];
    fresh.part = part;
    const Felt felt{reader.bind(scene, part, slot), &fresh.properties, fresh.memories.data()};
    const auto& modes = felt.graph().modes;
    fresh.modes = modes.size();
    report.samples += felt.bound.sample(proxy, fresh.properties);
    const EvaluationPoint stand{proxy, proxy, probe, nullptr};
    scratch.clear();
    for (std::size_t i = 0; i < modes.size(); ++i) {
      fresh.memories[i] = memoryFor(modes[i]);
      const ContactReference touch = touchOf(modes[i], fresh.memories[i]);
      (void)placeMode(felt, i, stand, touch, {}, scratch);
    }
  });
}

/// Moves the parts with the largest Part::most, at most kMaxNearParts, to the front, in the scene's
/// order. Of equal parts, prefers the earlier. Returns the number of parts at the front.
std::size_t NearParts::strongest(const Scene& scene, std::span<std::uint32_t> parts,
                                 StepReport& report) noexcept {
  const auto begin = parts.begin();
  const auto room = begin + static_cast<std::ptrdiff_t>(std::min(kMaxNearParts, parts.size()));
  std::nth_element(begin, room, parts.end(), [&](std::uint32_t a, std::uint32_t b) {
    const double most = scene.parts[a].most;
    return most > scene.parts[b].most || (most == scene.parts[b].most && a < b);
  });
  const std::size_t unknown = boxes_.leftOut();
  double missing = static_cast<double>(unknown) * scene.strongest_part;
  for (auto left = room; left != parts.end(); ++left) missing += scene.parts[*left].most;
  report.missing = std::max(report.missing, missing);
  report.left_out = std::max(
      report.left_out, static_cast<int>(unknown + static_cast<std::size_t>(parts.end() - room)));
  std::sort(begin, room);
  return static_cast<std::size_t>(room - begin);
}

template <class New>
void NearParts::keep(std::span<const std::uint32_t> near, New&& fresh) noexcept {
  for (const std::uint8_t slot : order()) {
    std::size_t& part = slots_[slot].part;
    if (!std::binary_search(near.begin(), near.end(), part)) part = NearPart::kNone;
  }
  const std::array<std::uint8_t, kMaxNearParts> before = order_;
  const std::size_t known = count_;
  count_ = 0;
  std::size_t old = 0;
  std::uint8_t free = 0;
  for (const std::uint32_t part : near) {
    while (old < known &&
           (slots_[before[old]].part == NearPart::kNone || slots_[before[old]].part < part)) {
      ++old;
    }
    std::uint8_t& slot = order_[count_++];
    if (old < known && slots_[before[old]].part == part) {
      slot = before[old];
      continue;
    }
    while (slots_[free].part != NearPart::kNone) ++free;
    slot = free;
    fresh(part, slot);
  }
}

}  // namespace palpate
