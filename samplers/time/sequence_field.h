/// Makes a field of the engine from a volume that is played frame by frame.
#pragma once

#include <memory>

#include "palpate/engine/field/field.h"
#include "palpate/samplers/time/frame_sequence.h"

namespace palpate {

/// Makes a field over a sequence. Between two frames, each value, gradient and Jacobian is the
/// weighted mean of the two. So readings are continuous in time, at any speed and in both
/// directions.
///
/// Play jumps after a seek, at an end of play from which it continues at the other end, or if
/// frames are late. The reading then fades within 50 ms from the last played moment to the present
/// moment. While frames are missing, the reading stays at the last shown moment. So the reading is
/// continuous in time for any change of the play position, while ticks follow each other within
/// 50 ms. After a longer pause, a reader whose frames have left memory reads the first frame.
///
/// The field has data where any blended frame has data. In a blend, the default
/// ScalarField::firstFall searches for surfaces. A reading outside of a tick (without attend())
/// uses the first frame. At most 16 readers may be in ticks at the same time; further readers read
/// the first frame.
///
/// RT: no allocation; no lock, except in attend() if SequenceParams::waits is true. Cost: up to two
/// readings; up to four during a fade.
[[nodiscard]] FieldPtr makeSequenceField(std::shared_ptr<const FrameSequence> sequence);

}  // namespace palpate
