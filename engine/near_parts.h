/// The parts of a scene that a proxy can reach: a tick samples only those whose data are near.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "palpate/engine/broad_phase.h"
#include "palpate/engine/felt.h"
#include "palpate/engine/mode.h"
#include "palpate/engine/primitive.h"
#include "palpate/engine/properties.h"
#include "palpate/engine/scene.h"
#include "palpate/engine/step_report.h"

namespace palpate {

/// A part of the scene that the tick samples and balances.
struct NearPart {
  static constexpr std::size_t kNone = static_cast<std::size_t>(-1);  ///< The index of no part.

  std::size_t part = kNone;  ///< Index into Scene::parts; kNone: the slot is empty.
  std::size_t modes = 0;     ///< Number of the part's modes.
  Properties properties;     ///< What was read for the part last.
  std::array<ModeMemory, kMaxPartModes> memories;  ///< Of its modes, the first `modes` in use.
};

/// Chooses the parts of a tick, and keeps what is remembered of them while they are near.
/// See docs/scale.md. Its memory is allocated when it is made.
class NearParts {
 public:
  NearParts() : slots_(kMaxNearParts), awake_(NearBoxes::kMost), free_(NearBoxes::kMost) {}

  /// Forgets all parts: the scene is another one, or what was remembered of them is void.
  void forget() noexcept;

  /// Chooses the parts whose data a path as long as from the proxy to the probe can reach, and some
  /// little farther. A new part is read where the proxy is; `scratch` is for what its modes place.
  /// `report` gets parts, left_out, missing and samples. RT: no allocation. Cost: six comparisons
  /// where nothing has changed, else a few ns for each part whose box is near.
  void meet(const Scene& scene, Reader& reader, const Vec3& proxy, const Vec3& probe,
            PrimitiveSet& scratch, StepReport& report) noexcept PALPATE_NONBLOCKING;

  /// Writes the near parts, ready to be read, to `felt` in the scene's order. Returns their number.
  ///
  /// @pre felt has room for kMaxNearParts.
  std::size_t bind(const Scene& scene, Reader& reader,
                   std::span<Felt> felt) noexcept PALPATE_NONBLOCKING;

  /// The share, 0 to 1, of the path `from` - `to` [m] that surely reaches no part left unchosen.
  [[nodiscard]] double knownShare(const Vec3& from, const Vec3& to) const noexcept;

  /// The part in a slot, one of order(); other slots below kMaxNearParts are empty.
  [[nodiscard]] const NearPart& operator[](std::size_t slot) const noexcept { return slots_[slot]; }
  /// Slots of the last tick's parts, in the order of the parts.
  [[nodiscard]] std::span<const std::uint8_t> order() const noexcept {
    return {order_.data(), count_};
  }

 private:
  void choose(const Scene& scene, Reader& reader, std::span<const std::uint32_t> near,
              const Vec3& proxy, const Vec3& probe, PrimitiveSet& scratch,
              StepReport& report) noexcept;
  std::size_t strongest(const Scene& scene, std::span<std::uint32_t> parts,
                        StepReport& report) noexcept;
  /// Keeps only these parts from now on, with what is remembered of those that were kept before.
  /// Calls `fresh` with the index and the slot of each part that is new.
  ///
  /// @pre near ascends.
  template <class New>
  void keep(std::span<const std::uint32_t> near, New&& fresh) noexcept;

  std::vector<NearPart> slots_;
  std::array<std::uint8_t, kMaxNearParts> order_{};
  std::size_t count_ = 0;
  NearBoxes boxes_;
  std::vector<std::uint32_t> awake_;  ///< Scratch: parts that the proxy can reach.
  std::vector<double> free_;          ///< Scratch: distance to the data, for each near box [m].
  Vec3 chosen_at_ = Vec3::Zero();     ///< Where the proxy was at the last choice [m].
  double chosen_for_ = 0.0;           ///< Radius about there without data of parts not chosen [m].
  bool crowded_ = false;              ///< There was no room for some parts that are near.
};

}  // namespace palpate
