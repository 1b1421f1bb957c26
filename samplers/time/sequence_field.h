/// Makes a field of the engine from a volume that is played frame by frame.
#pragma once

#include <memory>

#include "palpate/engine/field/field.h"
#include "palpate/samplers/time/frame_sequence.h"

namespace palpate {

/// Makes a field over a sequence. Between two frames each value, gradient and Jacobian is a
/// weighted mean of both frames, each interpolated in space. So all readings are continuous in time
/// while play continues, at any speed, back or forth.
///
/// If play jumps (a seek, the end of a loop, frames that arrived late), the last played
/// moment fades over 50 ms into the current one. If frames do not arrive in time, play stands
/// still. Both are continuous in time for any change of play.
///
/// The field has data where one of the blended frames has data. Surfaces across a blend are
/// searched as ScalarField::firstFall does without cells. A reading outside a tick (without
/// attend()) takes the first frame. At most 16 readers may be in ticks at the same time; further
/// ones read the first frame.
///
/// RT: no lock, no allocation. Cost: readings of two frames, or of four during a jump.
[[nodiscard]] FieldPtr makeSequenceField(std::shared_ptr<const FrameSequence> sequence);

}  // namespace palpate
