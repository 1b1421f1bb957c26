#pragma once

#include <cstdint>

namespace palpate {

/// Modality of a medical image. It determines what the values mean.
enum class Modality : std::uint8_t { kUnknown, kCt, kMr };

}  // namespace palpate
