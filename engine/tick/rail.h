/// Streamline tracking: the proxy follows a curve of the stream to the place nearest to the hand.
#pragma once

#include <array>
#include <cstddef>

#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/tick/felt.h"
#include "palpate/engine/tick/tick.h"
#include "palpate/engine/tick/trial.h"
#include "palpate/engine/types.h"

namespace palpate {

/// The line of a stream after its curve was traced.
struct RailLine {
  const ModeMemory* of;  ///< Memory of the mode that added the line.
  int motion;            ///< Motion of the line's volume; -1 if the volume stands still.
  Vec3 along_rest;       ///< Direction of the line in the resting frame of its volume.
  Vec3 place;            ///< End of the traced curve [m].
  Vec3 ahead;            ///< Unit tangent at that end.
  double strength;       ///< Strength of the line [N].

  /// Returns the line as a primitive.
  [[nodiscard]] Primitive line() const noexcept {
    return {PrimitiveKind::kLine, place, ahead, strength};
  }
};

/// The lines of streams with traced curves. Lines of further streams are anchored at the proxy.
struct Rail {
  static constexpr std::size_t kMost = 4;  ///< Largest number of lines.

  bool laid = false;                  ///< True if the curves were traced for the last balance.
  bool any = false;                   ///< True if a stream has a line.
  std::size_t count = 0;              ///< Number of lines.
  std::array<RailLine, kMost> lines;  ///< The lines; the first `count` are valid.
  /// Shift of the probe [m] that cancels the spring's remaining pull along the followed stream.
  /// Zero if that pull exceeds the tolerance or the strength of the line, or if a wall fixes the
  /// proxy along the stream.
  Vec3 waiting = Vec3::Zero();
  /// Memory of the mode whose line the proxy follows; null if there is none yet.
  const ModeMemory* followed = nullptr;

  /// Returns the line of a mode; null if its curve was not traced.
  [[nodiscard]] const RailLine* lineOf(const ModeMemory& memory) const noexcept {
    for (std::size_t i = 0; i < count; ++i) {
      if (lines[i].of == &memory) return &lines[i];
    }
    return nullptr;
  }
  /// Forgets all lines.
  void clear() noexcept {
    laid = any = false;
    count = 0;
    followed = nullptr;
    waiting.setZero();
  }
};

/// Re-anchors the lines to their material points: the ends of the curves in the resting frame. Call
/// this function after a reading at `at` [m] has sampled the warp again. RT: no allocation.
void keepRail(const Tick& tick, const Vec3& at, Rail& rail) noexcept PALPATE_NONBLOCKING;

/// Traces the curve that the proxy follows, and moves the end of the trial step to the end of the
/// trace. This end is the place nearest to the hand, as far as the last reading is valid. If there
/// are several streams, the proxy follows the strongest of those that hold it, or the strongest if
/// all yield. Each other stream is traced to the point of its curve that is nearest to the end of
/// the trial step. Its line then pulls to that point, so that parallel streams hold together.
/// `balance` [m] is the last balance. See docs/tick.md, streamline tracking. RT: no allocation.
/// Cost: VectorField::trace for at most 1 + Rail::kMost streams.
void layRail(Tick& tick, const Vec3& balance, Rail& rail,
             Trial& trial) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
