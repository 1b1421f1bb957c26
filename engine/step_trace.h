/// What a tick did, balance by balance, where a caller asks for it.
#pragma once

#include <array>
#include <bitset>
#include <cstddef>
#include <cstdint>
#include <span>

#include "palpate/engine/graph.h"
#include "palpate/engine/scene.h"
#include "palpate/engine/types.h"

namespace palpate {

/// What limited how far the proxy could go from a balance at once.
enum class StepEnd : std::uint8_t {
  kFree,     ///< Nothing: the step went where the balance and Newton's step lead.
  kVoxel,    ///< What was read could be trusted no farther.
  kTrusted,  ///< The trust radius of Newton's step: the last one turned back.
  kSurface,  ///< A surface that the step reached.
  kParts,    ///< The place where other parts of the scene begin.
};

/// The steps of one tick, in order. Fixed memory: hapticStep fills it where it is asked to.
struct StepTrace {
  /// One balance, and how far the proxy, or the next reading, went from it.
  struct Step {
    bool foreseen = false;          ///< Balanced with the last reading's planes: nothing was read.
    Vec3 at = Vec3::Zero();         ///< x, where properties were read [m]; foreseen: remembered.
    Vec3 proxy = Vec3::Zero();      ///< Where the proxy stood [m].
    Vec3 balance = Vec3::Zero();    ///< G(x) [m].
    Vec3 newton = Vec3::Zero();     ///< Newton's step from x [m].
    StepEnd end = StepEnd::kFree;   ///< What limited the step from here.
    Vec3 went = Vec3::Zero();       ///< Where the step ended [m].
    std::bitset<kMaxModes> yields;  ///< Modes of the scene's own graph of which a primitive yielded
                                    ///< in this balance; directed forces aside.
  };

  /// The steps that are filled, in the order in which the tick made them.
  [[nodiscard]] std::span<const Step> steps() const noexcept { return {all.data(), count}; }

  std::array<Step, std::size_t{2} * kMostSubsteps>
      all;                ///< At most a reading and a foreseen balance for each sub-step.
  std::size_t count = 0;  ///< Steps that are filled; balances beyond the room are not recorded.
};

/// The word for what limited a step.
[[nodiscard]] const char* wordFor(StepEnd end) noexcept;

}  // namespace palpate
