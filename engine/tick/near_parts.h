/// Chooses the parts of a scene that a proxy can reach. A tick samples no other parts.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/field/properties.h"
#include "palpate/engine/modes/mode.h"
#include "palpate/engine/scene/broad_phase.h"
#include "palpate/engine/scene/scene.h"
#include "palpate/engine/tick/felt.h"
#include "palpate/engine/tick/step_report.h"

namespace palpate {

/// A part of the scene that the tick samples and balances.
struct NearPart {
  /// Value of `part` in an empty slot.
  static constexpr std::size_t kNone = static_cast<std::size_t>(-1);

  std::size_t part = kNone;  ///< Index into Scene::parts, or kNone.
  std::size_t modes = 0;     ///< Number of the part's modes.
  Properties properties;     ///< Properties from the last reading of the part.
  /// Memories of the modes; the first `modes` are in use.
  std::array<ModeMemory, kMaxPartModes> memories;
};

/// Chooses the parts of a tick, and keeps their state (docs/scale.md). The constructor allocates
/// all memory.
class NearParts {
 public:
  NearParts() : slots_(kMaxNearParts), awake_(NearBoxes::kMost), free_(NearBoxes::kMost) {}

  /// Forgets all parts. Call this function for a new scene, or if their state is no longer valid.
  void forget() noexcept;

  /// Chooses the parts that have data within a radius about the proxy: its distance from the probe
  /// plus a margin of 2 mm. If these are too many, chooses without the margin, and if needed only
  /// the strongest. Reads a new part at the proxy; its modes place primitives in `scratch`. Sets
  /// `parts` of the report, raises `left_out` and `missing`, and adds to `samples`. RT: no
  /// allocation. Cost: a few comparisons if the choice stays, else a query of AnyField::freeWithin
  /// for each field of each part with a near box, and a reading of each new part.
  void meet(const Scene& scene, Reader& reader, const Vec3& proxy, const Vec3& probe,
            PrimitiveSet& scratch, StepReport& report) noexcept PALPATE_NONBLOCKING;

  /// Binds the near parts to the reader, writes them to `felt` (room for kMaxNearParts) in the
  /// scene's order, and returns their number.
  std::size_t bind(const Scene& scene, Reader& reader,
                   std::span<Felt> felt) noexcept PALPATE_NONBLOCKING;

  /// Returns a share, 0 to 1, of the path [m] on which only chosen parts can have data.
  [[nodiscard]] double knownShare(const Vec3& from, const Vec3& to) const noexcept;

  /// Returns the part in a slot. The slots in order() are in use; all others are empty.
  [[nodiscard]] const NearPart& operator[](std::size_t slot) const noexcept { return slots_[slot]; }
  /// Returns the slots of the last tick's parts, in the order of the parts.
  [[nodiscard]] std::span<const std::uint8_t> order() const noexcept {
    return {order_.data(), count_};
  }

 private:
  void choose(const Scene& scene, Reader& reader, std::span<const std::uint32_t> near,
              const Vec3& proxy, const Vec3& probe, PrimitiveSet& scratch,
              StepReport& report) noexcept;
  std::size_t strongest(const Scene& scene, std::span<std::uint32_t> parts,
                        StepReport& report) noexcept;
  /// Chooses the parts `near` (indices in ascending order). Parts that were chosen before keep
  /// their state. Calls `fresh` with the index and the slot of each new part.
  template <class New>
  void keep(std::span<const std::uint32_t> near, New&& fresh) noexcept;

  std::vector<NearPart> slots_;
  std::array<std::uint8_t, kMaxNearParts> order_{};
  std::size_t count_ = 0;
  NearBoxes boxes_;
  std::vector<std::uint32_t> awake_;  ///< Scratch: parts that the proxy can reach.
  std::vector<double> free_;          ///< Scratch: distance to the data, for each near box [m].
  Vec3 chosen_at_ = Vec3::Zero();     ///< Position of the proxy at the last choice [m].
  double chosen_for_ = 0.0;  ///< Radius about chosen_at_ within which no other part has data [m].
  bool crowded_ = false;     ///< True if some near parts were left out for lack of room.
};

}  // namespace palpate
