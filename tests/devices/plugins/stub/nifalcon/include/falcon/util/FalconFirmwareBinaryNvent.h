#pragma once
#include <cstdint>
namespace libnifalcon {
const std::uint8_t NOVINT_FALCON_NVENT_FIRMWARE[4] = {1, 2, 3, 4};
const long NOVINT_FALCON_NVENT_FIRMWARE_SIZE = 4;
}  // namespace libnifalcon
