/// The checksum of recordings: CRC-32C (Castagnoli), as in iSCSI, ext4 and HDFS.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace palpate {

/// Returns the checksum of `bytes`, continued from the checksum `before` of earlier bytes.
[[nodiscard]] std::uint32_t crc32c(std::span<const std::byte> bytes,
                                   std::uint32_t before = 0) noexcept;

}  // namespace palpate
