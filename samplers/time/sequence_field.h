/// Makes a field of the engine from a volume that is played frame by frame.
#pragma once

#include <memory>

#include "palpate/engine/field/field.h"
#include "palpate/samplers/time/frame_sequence.h"

namespace palpate {

/// Makes a field over a sequence. Each value, gradient and Jacobian between two frames is a
/// weighted mean of the two frames' values, each interpolated in space. So while play continues,
/// all readings are continuous in time, at any speed and in both directions.
///
/// Play may jump: by a seek, at the end of a loop, or because frames arrived late. The reading then
/// fades within 50 ms from the last played moment to the present moment. If frames do not arrive in
/// time, the reading stays at the shown moment. So the reading is continuous in time for any change
/// of the play position.
///
/// The field has data where any of the blended frames has data. For a blend of several frames,
/// surfaces are searched by the default of ScalarField::firstFall. A reading outside of a tick
/// (without attend()) uses the first frame. At most 16 readers may be in ticks at the same time.
/// Further readers read the first frame.
///
/// RT: no lock, no allocation. Cost: two readings, one of each blended frame; four readings during
/// a fade.
[[nodiscard]] FieldPtr makeSequenceField(std::shared_ptr<const FrameSequence> sequence);

}  // namespace palpate
