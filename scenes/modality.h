/// How a patient's image was taken.
#pragma once

#include <cstdint>

namespace palpate {

/// What the values of a patient's image mean.
enum class Modality : std::uint8_t { kUnknown, kCt, kMr };

}  // namespace palpate
