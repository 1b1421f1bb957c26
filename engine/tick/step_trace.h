/// Record of a tick, balance by balance, for callers that request it.
#pragma once

#include <array>
#include <bitset>
#include <cstddef>
#include <cstdint>
#include <span>

#include "palpate/engine/scene/graph.h"
#include "palpate/engine/scene/scene.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Limit of the step that the proxy could take from a balance.
enum class StepEnd : std::uint8_t {
  kFree,     ///< No limit: the step went where the balance and Newton's step lead.
  kVoxel,    ///< The distance to which the last reading can be trusted.
  kTrusted,  ///< The trust radius of Newton's step, after the last step turned back.
  kSurface,  ///< A surface that the step reached.
  kParts,    ///< The place where other parts of the scene begin.
};

/// The steps of one tick, in order. Uses fixed memory; hapticStep fills it on request.
struct StepTrace {
  /// One balance, and how far the proxy, or the next reading, went from it.
  struct Step {
    bool foreseen = false;          ///< Balanced with the last reading's planes, without a reading.
    Vec3 at = Vec3::Zero();         ///< x, where properties were read [m]; foreseen: remembered.
    Vec3 proxy = Vec3::Zero();      ///< Position of the proxy [m].
    Vec3 balance = Vec3::Zero();    ///< G(x) [m].
    Vec3 newton = Vec3::Zero();     ///< Newton's step from x [m].
    StepEnd end = StepEnd::kFree;   ///< Limit of the step from here.
    Vec3 went = Vec3::Zero();       ///< End of the step [m].
    std::bitset<kMaxModes> yields;  ///< Modes of the scene's own graph with a primitive that
                                    ///< yielded in this balance; directed forces do not count.
  };

  /// Returns the filled steps, in the order of the tick.
  [[nodiscard]] std::span<const Step> steps() const noexcept { return {all.data(), count}; }

  std::array<Step, std::size_t{2} * kMostSubsteps>
      all;                ///< At most a reading and a foreseen balance for each sub-step.
  std::size_t count = 0;  ///< Number of filled steps; further balances are not recorded.
};

/// Returns the word for the limit of a step.
[[nodiscard]] const char* wordFor(StepEnd end) noexcept;

}  // namespace palpate
