#pragma once
#include <falcon/core/FalconDevice.h>
namespace libnifalcon {
class FalconFirmwareNovintSDK : public FalconFirmware {};
}  // namespace libnifalcon
