#pragma once

#include <cstdint>

namespace palpate {

/// Modality of a medical image, which determines the meaning of the values.
enum class Modality : std::uint8_t { kUnknown, kCt, kMr };

}  // namespace palpate
