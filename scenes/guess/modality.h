/// Modality of a medical image.
#pragma once

#include <cstdint>

namespace palpate {

/// Modality with which an image was acquired, which determines what its values mean.
enum class Modality : std::uint8_t { kUnknown, kCt, kMr };

}  // namespace palpate
