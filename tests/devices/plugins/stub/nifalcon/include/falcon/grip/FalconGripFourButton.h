#pragma once
#include <falcon/core/FalconDevice.h>
namespace libnifalcon {
class FalconGripFourButton : public FalconGrip {};
}  // namespace libnifalcon
