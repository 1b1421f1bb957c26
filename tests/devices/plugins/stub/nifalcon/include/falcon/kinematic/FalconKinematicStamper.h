#pragma once
#include <falcon/core/FalconDevice.h>
namespace libnifalcon {
class FalconKinematicStamper : public FalconKinematic {};
}  // namespace libnifalcon
