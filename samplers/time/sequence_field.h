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
/// After a jump (a seek, the end of a loop, frames that arrived late), the reading fades over 50 ms
/// from the last played moment to the current moment. If frames do not arrive in time, the shown
/// moment stays. Both are continuous in time for any change of the play position.
///
/// The field has data where one of the blended frames has data. Surfaces across a blend are
/// searched as ScalarField::firstFall does without cells. A reading outside a tick (without
/// attend()) takes the first frame. At most 16 readers may be in ticks at the same time; further
/// ones read the first frame.
///
/// RT: no lock, no allocation. Cost: readings of two frames, or of four during a jump.
[[nodiscard]] FieldPtr makeSequenceField(std::shared_ptr<const FrameSequence> sequence);

}  // namespace palpate
