/// A volume that is played frame by frame, as a field of the engine.
#pragma once

#include <memory>

#include "palpate/engine/field.h"
#include "palpate/samplers/frame_sequence.h"

namespace palpate {

/// A field over a sequence: between two frames each value, gradient and Jacobian is a share of the
/// one and the rest of the other, as each is interpolated in space. So all that is read is
/// continuous in time while play goes on, at any speed, back or forth.
///
/// Where play jumps (a seek, the end of a loop, frames that were not there in time), what was
/// played last fades over 50 ms into what is played now; what does not come in time stands still.
/// Neither steps in time, whatever is done to play.
///
/// It has data where one of the blended frames has. Surfaces across a blend are looked for as
/// ScalarField::firstFall does where it has no cells. Read outside a tick (without attend()) it is
/// its first frame. Of readers in ticks at the same time there may be 16; more read the first
/// frame.
///
/// RT: no lock, no allocation. Cost: readings of two frames, of four within a jump.
[[nodiscard]] FieldPtr makeSequenceField(std::shared_ptr<const FrameSequence> sequence);

}  // namespace palpate
