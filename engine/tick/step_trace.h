/// Record of the balances of a tick, for callers that request it.
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

/// The limit of the proxy's step after a balance.
enum class StepEnd : std::uint8_t {
  kFree,     ///< No limit: the step reached the target of Newton's step.
  kVoxel,    ///< The distance to which the last reading is valid, or the end of a traced stream.
  kTrusted,  ///< The trust radius of Newton's step, after a step turned back.
  kSurface,  ///< A surface on the path.
  kParts,    ///< The border of the chosen parts of the scene.
};

/// The steps of one tick, in order. Fixed memory; hapticStep fills it on request.
struct StepTrace {
  /// A balance, and the step after it: of the proxy, or only of the place of the next reading.
  struct Step {
    /// True if the balance used the planes of the last reading, without a new reading.
    bool foreseen = false;
    Vec3 at = Vec3::Zero();  ///< x, the place of the reading, or of the remembered primitives [m].
    Vec3 proxy = Vec3::Zero();      ///< Position of the proxy [m].
    Vec3 balance = Vec3::Zero();    ///< The balance G(x) [m].
    Vec3 newton = Vec3::Zero();     ///< Newton's step from x [m].
    StepEnd end = StepEnd::kFree;   ///< Limit of the step after this balance.
    Vec3 went = Vec3::Zero();       ///< End of the step [m].
    std::bitset<kMaxModes> yields;  ///< Modes of the scene's own graph with a primitive that
                                    ///< yielded in this balance, other than directed forces.
  };

  /// Returns the filled steps, in the order of the tick.
  [[nodiscard]] std::span<const Step> steps() const noexcept { return {all.data(), count}; }

  std::array<Step, std::size_t{2} * kMostSubsteps>
      all;                ///< Room for a reading and a foreseen balance in each sub-step.
  std::size_t count = 0;  ///< Number of filled steps; further balances are not recorded.
};

/// Returns the word for the limit of a step, as in traces.
[[nodiscard]] const char* wordFor(StepEnd end) noexcept;

}  // namespace palpate
