/// What a tick did, balance by balance, for those who ask.
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

/// How far the proxy could go from a balance at once.
enum class StepEnd : std::uint8_t {
  kFree,     ///< To where the balance and Newton's step lead.
  kVoxel,    ///< As far as what was read can be trusted.
  kTrusted,  ///< As far as Newton's step is believed: the last one turned back.
  kSurface,  ///< To a surface that it met.
  kParts,    ///< To where other parts of the scene begin.
};

/// The steps of one tick, in order. Fixed memory: hapticStep fills it where it is asked to.
struct StepTrace {
  struct Step {
    bool foreseen = false;          ///< By the planes of the tick before: nothing was read.
    Vec3 at = Vec3::Zero();         ///< x, where properties were read [m]; foreseen: remembered.
    Vec3 proxy = Vec3::Zero();      ///< Where it stood [m].
    Vec3 balance = Vec3::Zero();    ///< G(x) [m].
    Vec3 newton = Vec3::Zero();     ///< Newton's step from x [m].
    StepEnd end = StepEnd::kFree;   ///< Of the way there,
    Vec3 went = Vec3::Zero();       ///< and where that ended [m].
    std::bitset<kMaxModes> yields;  ///< Modes of the scene's own graph of which a primitive gave
                                    ///< all its strength in this balance; directed forces aside.
  };

  [[nodiscard]] std::span<const Step> steps() const noexcept { return {all.data(), count}; }

  std::array<Step, std::size_t{2} * kMostSubsteps>
      all;  ///< A reading and a foreseen balance each, at most.
  std::size_t count = 0;
};

/// The word for it.
[[nodiscard]] const char* wordFor(StepEnd end) noexcept;

}  // namespace palpate
