/// Messages of OpenIGTLink, which 3D Slicer speaks: numbers to bytes and back, after the protocol's
/// published description. No sockets here.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "palpate/engine/types.h"
#include "palpate/samplers/volume.h"

namespace palpate::cli {

using Bytes = std::vector<std::uint8_t>;
using ByteView = std::span<const std::uint8_t>;

inline constexpr std::size_t kIgtlHead = 58;  ///< [bytes]

/// What stands before each body.
struct IgtlHead {
  std::uint16_t version = 0;  ///< 1; or 2, of protocol 3: bodies have more around their content.
  std::string type;           ///< As TRANSFORM.
  std::string name;           ///< Of the sender's device: any bytes, as they please.
  std::uint64_t size = 0;     ///< Of the body [bytes], as the sender says.
  std::uint64_t crc = 0;      ///< Of the body.
};
/// Takes any bytes.
[[nodiscard]] IgtlHead readIgtlHead(std::span<const std::uint8_t, kIgtlHead> bytes);

/// The protocol's checksum of `bytes` that go on from those of `before`: CRC-64 of ECMA-182.
[[nodiscard]] std::uint64_t igtlCrc(ByteView bytes, std::uint64_t before = 0) noexcept;

/// How a message ended, of the numbers that STATUS has.
enum class IgtlCode : std::uint16_t {
  kOk = 1,
  kNotFound = 4,
  kDenied = 5,
  kBusy = 6,
  kUnknown = 12,
  kDisabled = 15,
};

/// Whole messages of version 1. `now`: since 1970 [ns]; longer names and texts are cut.
[[nodiscard]] Bytes igtlTransform(std::string_view name, std::int64_t now, const Vec3& place);
[[nodiscard]] Bytes igtlString(std::string_view name, std::int64_t now, std::string_view text);
[[nodiscard]] Bytes igtlStatus(std::string_view name, std::int64_t now, IgtlCode code,
                               std::string_view text);
/// What a server understands: names of types.
[[nodiscard]] Bytes igtlCapability(std::string_view name, std::int64_t now,
                                   std::span<const char* const> types);

/// The content of a body, without what protocol 3 has around it. Throws Error.
[[nodiscard]] ByteView igtlContent(const IgtlHead& head, ByteView body);
/// The place of a TRANSFORM's content. Throws Error where a number of it is not finite.
[[nodiscard]] Vec3 readIgtlTransform(ByteView content);
/// Any bytes. Throws Error.
[[nodiscard]] std::string readIgtlString(ByteView content);

inline constexpr std::uint64_t kIgtlMostImage = 512ULL << 20U;   ///< Of an IMAGE [bytes].
inline constexpr std::uint64_t kIgtlMostValues = 128ULL << 20U;  ///< Of an IMAGE.

/// An IMAGE that has been checked, but for its values.
struct IgtlImage {
  std::string name;                    ///< Its volume's.
  std::array<std::int64_t, 3> size{};  ///< Voxels along i, j and k.
  int components = 1;                  ///< 1, or 3 of a vector.
  std::uint8_t scalar = 0;             ///< The protocol's number of its type.
  bool big_endian = false;             ///< Of its values.
  Mat3 axes = Mat3::Identity();        ///< Steps along i, j and k in RAS [mm].
  Vec3 origin = Vec3::Zero();          ///< The first voxel's middle in RAS [mm].
  Bytes bytes;                         ///< Values from `first` on, i fastest.
  std::size_t first = 0;
};
/// Throws Error, and says what is wrong with it.
[[nodiscard]] IgtlImage readIgtlImage(const IgtlHead& head, Bytes body);
/// Throws VolumeError where it cannot be felt. Slow, in parallel.
[[nodiscard]] std::shared_ptr<const Volume> volumeOf(const IgtlImage& image);

}  // namespace palpate::cli
