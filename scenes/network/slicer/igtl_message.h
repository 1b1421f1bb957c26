/// Messages of OpenIGTLink, the protocol of 3D Slicer: numbers to bytes and back, after the
/// protocol's published description. Without sockets.
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

inline constexpr std::size_t kIgtlHead = 58;  ///< [bytes]

/// Header of each message.
struct IgtlHead {
  std::uint16_t version = 0;  ///< 1; or 2 for protocol 3: bodies have more around their content.
  std::string type;           ///< For example TRANSFORM.
  std::string name;           ///< Name of the sender's device: any bytes.
  std::uint64_t size = 0;     ///< Size of the body as sent [bytes].
  std::uint64_t crc = 0;      ///< Checksum of the body.
};
/// Reads a header from any bytes.
[[nodiscard]] IgtlHead readIgtlHead(std::span<const std::uint8_t, kIgtlHead> bytes);

/// Returns the protocol's checksum of `bytes` (CRC-64 of ECMA-182), continued from the checksum
/// `before`.
[[nodiscard]] std::uint64_t igtlCrc(ByteView bytes, std::uint64_t before = 0) noexcept;

/// Result of a message: numbers from STATUS.
enum class IgtlCode : std::uint16_t {
  kOk = 1,
  kNotFound = 4,
  kDenied = 5,
  kBusy = 6,
  kUnknown = 12,
  kDisabled = 15,
};

/// Return whole messages of version 1. `now`: since 1970 [ns]; longer names and texts are cut.
[[nodiscard]] Bytes igtlTransform(std::string_view name, std::int64_t now, const Vec3& place);
[[nodiscard]] Bytes igtlString(std::string_view name, std::int64_t now, std::string_view text);
[[nodiscard]] Bytes igtlStatus(std::string_view name, std::int64_t now, IgtlCode code,
                               std::string_view text);
/// Returns the types that a server understands, by name.
[[nodiscard]] Bytes igtlCapability(std::string_view name, std::int64_t now,
                                   std::span<const char* const> types);

/// Returns the content of a body, without the data around it in protocol 3. Throws Error.
[[nodiscard]] ByteView igtlContent(const IgtlHead& head, ByteView body);
/// Returns the position in a TRANSFORM's content. Throws Error if a number is not finite.
[[nodiscard]] Vec3 readIgtlTransform(ByteView content);
/// Returns a text of any bytes. Throws Error.
[[nodiscard]] std::string readIgtlString(ByteView content);

inline constexpr std::uint64_t kIgtlMostImage = 512ULL << 20U;   ///< Limit of an IMAGE [bytes].
inline constexpr std::uint64_t kIgtlMostValues = 128ULL << 20U;  ///< Limit of values in an IMAGE.

/// A checked IMAGE; its values are not checked.
struct IgtlImage {
  std::string name;                    ///< Name of its volume.
  std::array<std::int64_t, 3> size{};  ///< Voxels along i, j and k.
  int components = 1;                  ///< 1, or 3 for a vector.
  std::uint8_t scalar = 0;             ///< The protocol's number of the scalar type.
  bool big_endian = false;             ///< Byte order of the values.
  Mat3 axes = Mat3::Identity();        ///< Steps along i, j and k in RAS [mm].
  Vec3 origin = Vec3::Zero();          ///< The first voxel's middle in RAS [mm].
  Bytes bytes;                         ///< Values from `first` on, i fastest.
  std::size_t first = 0;
};
/// Throws Error with the reason if the image is invalid.
[[nodiscard]] IgtlImage readIgtlImage(const IgtlHead& head, Bytes body);
/// Throws VolumeError if the image is not usable as a volume. Slow, in parallel.
[[nodiscard]] std::shared_ptr<const Volume> volumeOf(const IgtlImage& image);

}  // namespace palpate::cli
