/// Modality of a patient's image.
#pragma once

#include <cstdint>

namespace palpate {

/// Modality: the meaning of an image's values.
enum class Modality : std::uint8_t { kUnknown, kCt, kMr };

}  // namespace palpate
