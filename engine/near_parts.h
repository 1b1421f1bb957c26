/// The parts of a scene that a proxy can come to: of many only those are felt whose data are near.
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

/// A part that is felt.
struct NearPart {
  static constexpr std::size_t kNone = static_cast<std::size_t>(-1);

  std::size_t part = kNone;  ///< Index into Scene::parts; kNone: none.
  std::size_t modes = 0;     ///< How many it has.
  Properties properties;
  std::array<ModeMemory, kMaxPartModes> memories;
};

/// Chooses the parts of a tick, and keeps what is remembered of them while they are near.
/// docs/scale.md. Its memory is taken when it is made.
class NearParts {
 public:
  NearParts() : slots_(kMaxNearParts), awake_(NearBoxes::kMost), free_(NearBoxes::kMost) {}

  /// The parts are others, or what was remembered of them means nothing any more.
  void forget() noexcept;

  /// Chooses those whose data a way as long as that to the probe can meet, and some that are not
  /// much farther. Those that are new are read where the proxy is, with `scratch` for what their
  /// modes place. `report`: parts, left_out, missing, samples. RT: no allocation. Cost: six
  /// comparisons where nothing has changed, else a few ns a part whose box is near.
  void meet(const Scene& scene, Reader& reader, const Vec3& proxy, const Vec3& probe,
            PrimitiveSet& scratch, StepReport& report) noexcept PALPATE_NONBLOCKING;

  /// What they are felt by, in the order of the scene; how many they are.
  ///
  /// @pre felt has room for kMaxNearParts.
  std::size_t bind(const Scene& scene, Reader& reader,
                   std::span<Felt> felt) noexcept PALPATE_NONBLOCKING;

  /// So much of a way [m] comes to no part that was not chosen: 0 to 1.
  [[nodiscard]] double knownShare(const Vec3& from, const Vec3& to) const noexcept;

  [[nodiscard]] const NearPart& operator[](std::size_t slot) const noexcept { return slots_[slot]; }
  /// Slots in the order of their parts: those of the last tick.
  [[nodiscard]] std::span<const std::uint8_t> order() const noexcept {
    return {order_.data(), count_};
  }

 private:
  void choose(const Scene& scene, Reader& reader, std::span<const std::uint32_t> near,
              const Vec3& proxy, const Vec3& probe, PrimitiveSet& scratch,
              StepReport& report) noexcept;
  std::size_t strongest(const Scene& scene, std::span<std::uint32_t> parts,
                        StepReport& report) noexcept;
  /// Only these parts from now on; what is remembered of those that were there stays. Calls back
  /// with the slot of each that is new.
  ///
  /// @pre near ascends.
  template <class New>
  void keep(std::span<const std::uint32_t> near, New&& fresh) noexcept;

  std::vector<NearPart> slots_;
  std::array<std::uint8_t, kMaxNearParts> order_{};
  std::size_t count_ = 0;
  NearBoxes boxes_;
  std::vector<std::uint32_t> awake_;  ///< Scratch: parts that the proxy can come to.
  std::vector<double> free_;          ///< Scratch: of each part whose box is near.
  Vec3 chosen_at_ = Vec3::Zero();     ///< Where these were chosen last [m];
  double chosen_for_ = 0.0;           ///< within so much of there no other has data [m].
  bool crowded_ = false;              ///< There was no room for some.
};

}  // namespace palpate
