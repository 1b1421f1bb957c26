/// Private to samplers: one brick to its object and back. Include it in .cpp files only.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "palpate/samplers/bricks.h"

namespace palpate {

/// Of an object: CRC-32 as zlib, and so Python's own zlib.crc32, has it.
[[nodiscard]] std::uint32_t brickChecksum(std::span<const std::byte> bytes) noexcept;

/// How a brick that has been read is.
struct BrickVerdict {
  BrickStatus status = BrickStatus::kArrived;  ///< For who has asked.
  std::string why;                             ///< In words; empty where nothing is wrong.
};

/// Compresses and decompresses with memory that is kept. Not for several threads at once.
class BrickCodec {
 public:
  /// @param identity  Of the volume, as BrickManifest.
  BrickCodec(const BrickFormat& format, std::uint64_t identity);
  BrickCodec(BrickCodec&&) noexcept;             ///< What is moved from can only be destroyed.
  BrickCodec& operator=(BrickCodec&&) noexcept;  ///< Likewise.
  ~BrickCodec();

  /// A brick's object, until the next call.
  /// @param values  Rounded to the format already.
  /// @param active  kBrickActiveBytes.
  [[nodiscard]] std::span<const std::byte> encode(const BrickId& id, std::span<const float> values,
                                                  std::span<const std::uint8_t> active,
                                                  int compression);

  /// Where an object is to be put for decode(): a byte more than any may have.
  [[nodiscard]] std::span<std::byte> object() noexcept { return object_; }
  /// Decompresses the first `bytes` of object() into a slot, and looks whether it is that brick.
  /// @param entry  What the manifest says of it; null: nothing yet, its own checksum counts.
  [[nodiscard]] BrickVerdict decode(const BrickId& id, std::size_t bytes, const BrickEntry* entry,
                                    std::span<std::byte> slot);

 private:
  struct Contexts;

  /// False: it cannot be decompressed to a brick.
  [[nodiscard]] bool decompress(std::size_t bytes, std::span<std::byte> slot);
  /// Of another place or volume than this.
  [[nodiscard]] bool isOthers(const BrickId& id, std::span<const std::byte> slot) const;
  [[nodiscard]] bool isFinite(std::span<const std::byte> slot) const;

  BrickFormat format_;
  std::uint64_t identity_;
  std::vector<std::byte> object_;
  std::vector<std::byte> brick_;  ///< Uncompressed, for encode().
  std::unique_ptr<Contexts> contexts_;
};

/// A slot's values as floats and its bits, for who computes with them.
void unpackBrick(const BrickFormat& format, std::span<const std::byte> slot,
                 std::span<float> values, std::span<std::uint8_t> active);

/// A slot that is all of one value.
void fillBrick(const BrickFormat& format, const BrickEntry& entry, std::span<std::byte> slot);

}  // namespace palpate
