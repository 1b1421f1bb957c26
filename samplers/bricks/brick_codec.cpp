#include "palpate/samplers/bricks/brick_codec.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <new>
#include <zlib.h>
#include <zstd.h>

namespace palpate {
namespace {

static_assert(std::endian::native == std::endian::little, "bricks need a little-endian machine");
static_assert(kBrickVoxels % 8 == 0);

/// Identity of a brick, which is stored in its last bytes.
struct Tail {
  std::uint64_t identity = 0;
  std::int32_t level = 0;
  VoxelAt at{};
};
static_assert(sizeof(Tail) == 24);

Tail tailOf(std::span<const std::byte> slot) noexcept {
  Tail tail;
  std::memcpy(&tail, slot.data() + slot.size() - sizeof tail, sizeof tail);
  return tail;
}

}  // namespace

std::size_t BrickFormat::slabs() const noexcept {
  const std::size_t more = kBrickActiveBytes + sizeof(Tail);
  return kBrickEdge + (more + slabBytes() - 1) / slabBytes();
}

std::uint32_t brickChecksum(std::span<const std::byte> bytes) noexcept {
  return static_cast<std::uint32_t>(
      crc32_z(0, reinterpret_cast<const Bytef*>(bytes.data()), bytes.size()));  // NOLINT: zlib's
}

struct BrickCodec::Contexts {
  ZSTD_CCtx* out = nullptr;
  ZSTD_DCtx* in = ZSTD_createDCtx();

  Contexts() {
    if (in == nullptr) throw std::bad_alloc();
  }
  Contexts(const Contexts&) = delete;
  Contexts& operator=(const Contexts&) = delete;
  ~Contexts() {
    ZSTD_freeCCtx(out);
    ZSTD_freeDCtx(in);
  }
};

BrickCodec::BrickCodec(const BrickFormat& format, std::uint64_t identity)
    : format_(format),
      identity_(identity),
      object_(ZSTD_compressBound(format.bytes()) + 1),
      contexts_(std::make_unique<Contexts>()) {}

BrickCodec::BrickCodec(BrickCodec&&) noexcept = default;
BrickCodec& BrickCodec::operator=(BrickCodec&&) noexcept = default;
BrickCodec::~BrickCodec() = default;

std::span<const std::byte> BrickCodec::encode(const BrickId& id, std::span<const float> values,
                                              std::span<const std::uint8_t> active,
                                              int compression) {
  brick_.assign(format_.bytes(), std::byte{0});
  if (format_.half) {
    for (std::size_t n = 0; n < values.size(); ++n) {
      const std::uint16_t half = halfOfFloat(values[n]);
      std::memcpy(brick_.data() + 2 * n, &half, sizeof half);
    }
  } else {
    std::memcpy(brick_.data(), values.data(), values.size_bytes());
  }
  std::memcpy(brick_.data() + format_.activeBegin(), active.data(), active.size());
  const Tail tail{identity_, id.level, id.at};
  std::memcpy(brick_.data() + brick_.size() - sizeof tail, &tail, sizeof tail);

  if (contexts_->out == nullptr) {
    contexts_->out = ZSTD_createCCtx();
    if (contexts_->out == nullptr) throw std::bad_alloc();
  }
  ZSTD_CCtx_setParameter(contexts_->out, ZSTD_c_compressionLevel, compression);
  ZSTD_CCtx_setParameter(contexts_->out, ZSTD_c_checksumFlag, 1);
  const std::size_t bytes =
      ZSTD_compress2(contexts_->out, object_.data(), object_.size(), brick_.data(), brick_.size());
  // The buffer fits any result, so the only possible error is a lack of memory.
  if (ZSTD_isError(bytes) != 0) throw std::bad_alloc();
  return std::span(object_).first(bytes);
}

bool BrickCodec::decompress(std::size_t bytes, std::span<std::byte> slot) {
  return ZSTD_decompressDCtx(contexts_->in, slot.data(), slot.size(), object_.data(), bytes) ==
         slot.size();
}

bool BrickCodec::isOthers(const BrickId& id, std::span<const std::byte> slot) const {
  const Tail tail = tailOf(slot);
  return tail.identity != identity_ || tail.level != id.level || tail.at != id.at;
}

bool BrickCodec::isFinite(std::span<const std::byte> slot) const {
  // Tests whether all bits of the exponent are set, without a branch on values, for vectorisation.
  const std::size_t count = kBrickVoxels * format_.components();
  unsigned endless = 0;
  for (std::size_t n = 0; n < count; ++n) {
    if (format_.half) {
      std::uint16_t bits = 0;
      std::memcpy(&bits, slot.data() + 2 * n, sizeof bits);
      endless |= static_cast<unsigned>((bits & 0x7C00U) == 0x7C00U);
    } else {
      std::uint32_t bits = 0;
      std::memcpy(&bits, slot.data() + 4 * n, sizeof bits);
      endless |= static_cast<unsigned>((bits & 0x7F800000U) == 0x7F800000U);
    }
  }
  return endless == 0;
}

BrickVerdict BrickCodec::decode(const BrickId& id, std::size_t bytes, const BrickEntry* entry,
                                std::span<std::byte> slot) {
  const bool cut = entry != nullptr && bytes != entry->bytes;
  const bool wrong =
      !cut && entry != nullptr &&
      brickChecksum(std::span<const std::byte>(object_).first(bytes)) != entry->checksum;
  const bool whole = decompress(bytes, slot);
  if (whole && isOthers(id, slot)) {
    const bool volume = tailOf(slot).identity != identity_;
    return {BrickStatus::kOthers, volume ? "it is a brick of another volume"
                                         : "it is the brick of another level or position"};
  }
  if (cut) {
    return {BrickStatus::kCut, "it has " + std::to_string(bytes) + " bytes instead of the " +
                                   std::to_string(entry->bytes) + " in the manifest"};
  }
  if (wrong) return {BrickStatus::kDamaged, "its checksum is wrong"};
  if (!whole) return {BrickStatus::kDamaged, "it cannot be decompressed to a brick"};
  if (!isFinite(slot)) return {BrickStatus::kDamaged, "some of its values are not finite"};
  return {};
}

void unpackBrick(const BrickFormat& format, std::span<const std::byte> slot,
                 std::span<float> values, std::span<std::uint8_t> active) {
  if (format.half) {
    for (std::size_t n = 0; n < values.size(); ++n) {
      std::uint16_t half = 0;
      std::memcpy(&half, slot.data() + 2 * n, sizeof half);
      values[n] = floatOfHalf(half);
    }
  } else {
    std::memcpy(values.data(), slot.data(), values.size_bytes());
  }
  std::memcpy(active.data(), slot.data() + format.activeBegin(), active.size());
}

void fillBrick(const BrickFormat& format, const BrickEntry& entry, std::span<std::byte> slot) {
  const std::size_t bytes = format.components() * format.componentBytes();
  std::array<std::byte, 12> one{};
  for (std::size_t c = 0; c < format.components(); ++c) {
    const std::uint16_t half = halfOfFloat(entry.value[c]);
    std::memcpy(one.data() + c * format.componentBytes(),
                format.half ? static_cast<const void*>(&half) : &entry.value[c],
                format.componentBytes());
  }
  for (std::size_t n = 0; n < kBrickVoxels; ++n) {
    std::memcpy(slot.data() + n * bytes, one.data(), bytes);
  }
  const auto rest = slot.subspan(format.activeBegin());
  std::fill(rest.begin(), rest.end(), std::byte{0});
  if (entry.kind == BrickKind::kActive) {
    std::fill_n(rest.begin(), kBrickActiveBytes, std::byte{0xFF});
  }
}

}  // namespace palpate
