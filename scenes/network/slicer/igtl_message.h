/// Converts messages of OpenIGTLink, 3D Slicer's protocol, from and to bytes.
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
#include "palpate/samplers/grid/volume.h"

namespace palpate::cli {

using Bytes = std::vector<std::uint8_t>;
using ByteView = std::span<const std::uint8_t>;

inline constexpr std::size_t kIgtlHead = 58;  ///< Size of a header [bytes].

struct IgtlHead {
  /// 1 to 3 in a valid message. From 2 on, bodies have data before and after the content.
  std::uint16_t version = 0;
  std::string type;        ///< Type of the message, for example TRANSFORM.
  std::string name;        ///< Name of the sending device; may contain any bytes.
  std::uint64_t size = 0;  ///< Size of the body as sent [bytes].
  std::uint64_t crc = 0;   ///< Checksum of the body (igtlCrc).
};
[[nodiscard]] IgtlHead readIgtlHead(std::span<const std::uint8_t, kIgtlHead> bytes);

/// Returns the protocol's checksum (CRC-64 of ECMA-182). `before` is the checksum of the bytes
/// before `bytes`.
[[nodiscard]] std::uint64_t igtlCrc(ByteView bytes, std::uint64_t before = 0) noexcept;

/// Result of a request. The values are those of the message STATUS.
enum class IgtlCode : std::uint16_t {
  kOk = 1,
  kNotFound = 4,
  kDenied = 5,
  kBusy = 6,
  kInvalid = 10,  ///< "Configuration error": the data cannot be used.
  kUnknown = 12,
  kDisabled = 15,
};

/// The next three functions return complete messages of version 1. They shorten a name to 20 bytes,
/// and the text of a STRING to 65535 bytes. `name` is the device's name in the message. `now` is in
/// ns since 1970. `place` is in the space and unit that the client expects.
[[nodiscard]] Bytes igtlTransform(std::string_view name, std::int64_t now, const Vec3& place);
[[nodiscard]] Bytes igtlString(std::string_view name, std::int64_t now, std::string_view text);
[[nodiscard]] Bytes igtlStatus(std::string_view name, std::int64_t now, IgtlCode code,
                               std::string_view text);
/// Returns a message that lists the message types which the server understands.
[[nodiscard]] Bytes igtlCapability(std::string_view name, std::int64_t now,
                                   std::span<const char* const> types);

/// Returns a body without the data that versions 2 and 3 add before and after the content. Throws
/// Error if the body is too short for these data.
[[nodiscard]] ByteView igtlContent(const IgtlHead& head, ByteView body);
/// Returns the position in the content of a TRANSFORM. Throws Error if there are not 12 numbers, or
/// one is not finite.
[[nodiscard]] Vec3 readIgtlTransform(ByteView content);
/// Returns the text in the content of a STRING, which may contain any bytes. Throws Error.
[[nodiscard]] std::string readIgtlString(ByteView content);

/// Limit of the size of an IMAGE [bytes]. The server accepts 64 KiB more, for the header.
inline constexpr std::uint64_t kIgtlMostImage = 512ULL << 20U;
/// Limit of the number of values in an IMAGE.
inline constexpr std::uint64_t kIgtlMostValues = 128ULL << 20U;

/// An image from an IMAGE message. All members are valid; the values may be any numbers.
struct IgtlImage {
  std::string name;                    ///< Name of the volume that the image replaces.
  std::array<std::int64_t, 3> size{};  ///< Number of voxels along i, j and k.
  int components = 1;                  ///< Components per voxel: 1, or 3 for a vector.
  std::uint8_t scalar = 0;             ///< Number of the scalar type in the protocol.
  bool big_endian = false;
  Mat3 axes = Mat3::Identity();  ///< Steps along i, j and k in RAS [mm].
  Vec3 origin = Vec3::Zero();    ///< Centre of the first voxel in RAS [mm].
  Bytes bytes;                   ///< Body of the message. The values begin at `first`, i fastest.
  std::size_t first = 0;
};
/// Returns the image in the body of a message. Throws Error if the image is invalid.
[[nodiscard]] IgtlImage readIgtlImage(const IgtlHead& head, Bytes body);
/// Returns the image as a volume. Throws VolumeError if the image is not usable. Slow; uses all
/// cores.
[[nodiscard]] std::shared_ptr<const Volume> volumeOf(const IgtlImage& image);

}  // namespace palpate::cli
