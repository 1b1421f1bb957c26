/// The checksum of recordings: CRC-32C (Castagnoli), as iSCSI, ext4 and HDFS have it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace palpate {

/// Of `bytes` after others whose checksum is `before`; 0: there are none before.
[[nodiscard]] std::uint32_t crc32c(std::span<const std::byte> bytes,
                                   std::uint32_t before = 0) noexcept;

}  // namespace palpate
