/// Private to samplers: compresses a brick into its object, and back. Include it in .cpp files
/// only.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "palpate/samplers/bricks/bricks.h"

namespace palpate {

/// Returns the checksum of an object: CRC-32 as in zlib, and so in Python's zlib.crc32.
[[nodiscard]] std::uint32_t brickChecksum(std::span<const std::byte> bytes) noexcept;

/// The result of reading a brick.
struct BrickVerdict {
  BrickStatus status = BrickStatus::kArrived;  ///< Status for the caller.
  std::string why;                             ///< Reason in words; empty if the brick is valid.
};

/// Compresses and decompresses bricks and reuses its memory. Not thread-safe.
class BrickCodec {
 public:
  /// @param identity  The volume's, see BrickManifest.
  BrickCodec(const BrickFormat& format, std::uint64_t identity);
  BrickCodec(BrickCodec&&) noexcept;             ///< A moved-from codec can only be destroyed.
  BrickCodec& operator=(BrickCodec&&) noexcept;  ///< A moved-from codec can only be destroyed.
  ~BrickCodec();

  /// Returns the object of a brick; valid until the next call.
  /// @param values  Already rounded to the format.
  /// @param active  kBrickActiveBytes.
  [[nodiscard]] std::span<const std::byte> encode(const BrickId& id, std::span<const float> values,
                                                  std::span<const std::uint8_t> active,
                                                  int compression);

  /// Returns the buffer for an object that decode() reads: one byte more than the longest object.
  [[nodiscard]] std::span<std::byte> object() noexcept { return object_; }
  /// Decompresses the first `bytes` of object() into a slot, and checks that it is brick `id`.
  /// @param entry  The manifest's entry: size and checksum have to match. Null: not compared.
  [[nodiscard]] BrickVerdict decode(const BrickId& id, std::size_t bytes, const BrickEntry* entry,
                                    std::span<std::byte> slot);

 private:
  struct Contexts;

  /// Returns false if the object cannot be decompressed to a brick.
  [[nodiscard]] bool decompress(std::size_t bytes, std::span<std::byte> slot);
  /// Returns true if the slot holds a brick of another place or another volume.
  [[nodiscard]] bool isOthers(const BrickId& id, std::span<const std::byte> slot) const;
  [[nodiscard]] bool isFinite(std::span<const std::byte> slot) const;

  BrickFormat format_;
  std::uint64_t identity_;
  std::vector<std::byte> object_;
  std::vector<std::byte> brick_;  ///< Uncompressed, for encode().
  std::unique_ptr<Contexts> contexts_;
};

/// Copies the values of a slot as floats, and its bits.
void unpackBrick(const BrickFormat& format, std::span<const std::byte> slot,
                 std::span<float> values, std::span<std::uint8_t> active);

/// Fills a slot with the one value of an entry.
void fillBrick(const BrickFormat& format, const BrickEntry& entry, std::span<std::byte> slot);

}  // namespace palpate
