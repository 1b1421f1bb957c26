/// Private to samplers, for .cpp files only: compresses bricks into objects and decompresses them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "palpate/samplers/bricks/bricks.h"

namespace palpate {

/// Returns the checksum of an object: CRC-32, equal to Python's zlib.crc32.
[[nodiscard]] std::uint32_t brickChecksum(std::span<const std::byte> bytes) noexcept;

/// The result of reading a brick.
struct BrickVerdict {
  BrickStatus status = BrickStatus::kArrived;  ///< Status for the caller.
  std::string why;  ///< Reason in words; empty if the status is kArrived.
};

/// Compresses and decompresses bricks in memory that it keeps from brick to brick. Not thread-safe.
class BrickCodec {
 public:
  /// @param identity  Identity of the volume (BrickManifest::identity).
  BrickCodec(const BrickFormat& format, std::uint64_t identity);
  BrickCodec(BrickCodec&&) noexcept;             ///< A moved-from codec can only be destroyed.
  BrickCodec& operator=(BrickCodec&&) noexcept;  ///< A moved-from codec can only be destroyed.
  ~BrickCodec();

  /// Compresses a brick and returns its object, which is valid until the next call.
  /// @param values  Values of all voxels of the brick, already rounded to the format.
  /// @param active  Active bits of the voxels, kBrickActiveBytes bytes.
  /// @param compression  Compression level of zstd, 1 to 19.
  [[nodiscard]] std::span<const std::byte> encode(const BrickId& id, std::span<const float> values,
                                                  std::span<const std::uint8_t> active,
                                                  int compression);

  /// Returns the buffer for the object that decode() reads. It has one byte more than the longest
  /// object, so that a longer object is detected.
  [[nodiscard]] std::span<std::byte> object() noexcept { return object_; }
  /// Decompresses the first `bytes` bytes of object() into `slot`, and checks that the result is
  /// brick `id`.
  /// @param entry  Entry with the expected size and checksum. If null, decode() does not check
  ///               them.
  /// @param slot   Receives the brick, BrickFormat::bytes() bytes.
  [[nodiscard]] BrickVerdict decode(const BrickId& id, std::size_t bytes, const BrickEntry* entry,
                                    std::span<std::byte> slot);

 private:
  struct Contexts;

  /// Decompresses the object into `slot`. Returns false if the object does not contain a brick.
  [[nodiscard]] bool decompress(std::size_t bytes, std::span<std::byte> slot);
  /// Returns true if the slot contains another brick than `id`, or a brick of another volume.
  [[nodiscard]] bool isOthers(const BrickId& id, std::span<const std::byte> slot) const;
  [[nodiscard]] bool isFinite(std::span<const std::byte> slot) const;

  BrickFormat format_;
  std::uint64_t identity_;
  std::vector<std::byte> object_;
  std::vector<std::byte> brick_;  ///< Uncompressed brick from which encode() makes the object.
  std::unique_ptr<Contexts> contexts_;
};

/// Converts the values of a slot to floats, and copies its active bits.
void unpackBrick(const BrickFormat& format, std::span<const std::byte> slot,
                 std::span<float> values, std::span<std::uint8_t> active);

/// Fills a slot with the single value of an entry that has no object.
void fillBrick(const BrickFormat& format, const BrickEntry& entry, std::span<std::byte> slot);

}  // namespace palpate
