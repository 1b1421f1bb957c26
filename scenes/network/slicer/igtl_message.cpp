#include "palpate/scenes/network/slicer/igtl_message.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <type_traits>

#include <Eigen/LU>
#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/array_volume.h"

namespace palpate::cli {
namespace {

constexpr std::size_t kType = 12;  ///< Size of a type in a message [bytes].
constexpr std::size_t kName = 20;  ///< Size of a name in a message [bytes].
constexpr std::size_t kImageHead = 72;

template <std::size_t kBytes>
using Word = std::conditional_t<
    kBytes == 1, std::uint8_t,
    std::conditional_t<kBytes == 2, std::uint16_t,
                       std::conditional_t<kBytes == 4, std::uint32_t, std::uint64_t>>>;

/// Reads a number; if kBig, its most significant byte is first.
template <class T, bool kBig>
T numberAt(const std::uint8_t* bytes) noexcept {
  Word<sizeof(T)> word = 0;
  for (std::size_t i = 0; i < sizeof(T); ++i) {
    const std::size_t place = 8 * (kBig ? sizeof(T) - 1 - i : i);
    word = static_cast<Word<sizeof(T)>>(
        word | static_cast<Word<sizeof(T)>>(static_cast<std::uint64_t>(bytes[i]) << place));
  }
  return std::bit_cast<T>(word);
}

/// Reads big-endian values. The caller must check that there are enough bytes.
class In {
 public:
  explicit In(ByteView bytes) : at_(bytes.data()) {}
  template <class T>
  T take() noexcept {
    const T value = numberAt<T, true>(at_);
    at_ += sizeof(T);
    return value;
  }
  /// Returns a field of `room` bytes as text, up to the first zero byte.
  std::string text(std::size_t room) {
    const std::uint8_t* end = std::find(at_, at_ + room, 0);
    std::string text(at_, end);
    at_ += room;
    return text;
  }

 private:
  const std::uint8_t* at_;
};

class Out {
 public:
  template <class T>
  void put(T value) {
    const auto word = std::bit_cast<Word<sizeof(T)>>(value);
    for (std::size_t i = sizeof(T); i-- > 0;) {
      bytes.push_back(static_cast<std::uint8_t>(word >> (8 * i)));
    }
  }
  void text(std::string_view text, std::size_t room) {
    text = text.substr(0, room);
    bytes.insert(bytes.end(), text.begin(), text.end());
    bytes.resize(bytes.size() + room - text.size());
  }

  Bytes bytes;
};

Bytes message(std::string_view type, std::string_view name, std::int64_t now, const Bytes& body) {
  constexpr std::uint64_t kSecond = 1'000'000'000;
  const auto time = static_cast<std::uint64_t>(now);
  Out out;
  out.put<std::uint16_t>(1);
  out.text(type, kType);
  out.text(name, kName);
  // Seconds, and then the fraction in units of 2^-32 s.
  out.put<std::uint64_t>((time / kSecond) << 32U | ((time % kSecond) << 32U) / kSecond);
  out.put<std::uint64_t>(body.size());
  out.put<std::uint64_t>(igtlCrc(body));
  out.bytes.insert(out.bytes.end(), body.begin(), body.end());
  return out.bytes;
}

[[noreturn]] void refuse(const std::string& what, const std::string& why,
                         const std::string& remedy) {
  throw Error(what, why, remedy);
}

/// Returns the size of a scalar type [bytes], by its number in the protocol; 0: unknown.
std::size_t bytesOf(std::uint8_t scalar) {
  switch (scalar) {
    case 2:
    case 3:
      return 1;
    case 4:
    case 5:
      return 2;
    case 6:
    case 7:
    case 10:
      return 4;
    case 11:
      return 8;
    default:
      return 0;
  }
}

template <class From, class To>
std::vector<To> converted(const IgtlImage& image) {
  const std::size_t count = (image.bytes.size() - image.first) / sizeof(From);
  std::vector<To> values(count);
  const std::uint8_t* at = image.bytes.data() + image.first;
  for (To& value : values) {
    value =
        static_cast<To>(image.big_endian ? numberAt<From, true>(at) : numberAt<From, false>(at));
    at += sizeof(From);
  }
  return values;
}

template <class From, class To>
std::shared_ptr<const Volume> make(const IgtlImage& image) {
  const std::vector<To> values = converted<From, To>(image);
  VoxelArray array;
  array.values = values.data();
  array.type = std::is_same_v<To, float> ? VoxelArray::Type::kFloat : VoxelArray::Type::kDouble;
  array.vector = image.components == 3;
  array.size = image.size;
  array.component_stride = sizeof(To);
  array.stride[0] = static_cast<std::ptrdiff_t>(sizeof(To)) * image.components;
  array.stride[1] = array.stride[0] * image.size[0];
  array.stride[2] = array.stride[1] * image.size[1];
  array.axes = image.axes;
  array.origin = image.origin;
  array.name = image.name;
  return makeVolume(array);
}

struct ImageHead {
  std::uint8_t components = 0;
  std::uint8_t scalar = 0;
  std::uint8_t endian = 0;
  std::uint8_t space = 0;
  std::array<std::int64_t, 3> size{};
  /// Columns: steps along i, j and k, and the centre of the image.
  std::array<double, 12> matrix{};
  std::array<std::int64_t, 3> offset{};
  std::array<std::int64_t, 3> part{};
};

ImageHead readImageHead(ByteView content) {
  In in(content);
  ImageHead head;
  (void)in.take<std::uint16_t>();  // version, which does not change this header
  head.components = in.take<std::uint8_t>();
  head.scalar = in.take<std::uint8_t>();
  head.endian = in.take<std::uint8_t>();
  head.space = in.take<std::uint8_t>();
  for (std::int64_t& side : head.size) side = in.take<std::uint16_t>();
  for (double& number : head.matrix) number = in.take<float>();
  for (std::int64_t& side : head.offset) side = in.take<std::uint16_t>();
  for (std::int64_t& side : head.part) side = in.take<std::uint16_t>();
  return head;
}

void checkImageHead(const std::string& what, const ImageHead& head) {
  if (bytesOf(head.scalar) == 0) {
    refuse(what, fmt::format("its scalars are of type {}", head.scalar),
           "send type 2 to 7 (int8 to uint32), 10 (float32) or 11 (float64)");
  }
  if (head.components != 1 && head.components != 3) {
    refuse(what, fmt::format("it has {} components", head.components),
           "send 1 (scalars) or 3 (vectors)");
  }
  if (head.endian != 1 && head.endian != 2) {
    refuse(what, fmt::format("its byte order {} is unknown", head.endian),
           "send 1 (big) or 2 (little)");
  }
  if (head.space != 1 && head.space != 2) {
    refuse(what, fmt::format("its coordinate system {} is unknown", head.space),
           "send 1 (RAS) or 2 (LPS)");
  }
  if (head.part != head.size || head.offset != std::array<std::int64_t, 3>{}) {
    refuse(what, "it is a part of an image", "send the whole image in one message");
  }
}

std::uint64_t countValues(const std::string& what, const ImageHead& head) {
  const auto& size = head.size;
  // Sizes are below 2^16 and `components` is below 2^8, so the product is below 2^56.
  const auto values = static_cast<std::uint64_t>(size[0] * size[1] * size[2] * head.components);
  if (values == 0 || values > kIgtlMostValues) {
    refuse(what,
           fmt::format("it has {} x {} x {} voxels with {} values each", size[0], size[1], size[2],
                       head.components),
           fmt::format("send 1 to {} values in all", kIgtlMostValues));
  }
  return values;
}

/// Sets the axes and origin of an image, in RAS.
void placeImage(const std::string& what, const ImageHead& head, IgtlImage& image) {
  Vec3 middle(head.matrix[9], head.matrix[10], head.matrix[11]);
  for (Eigen::Index column = 0; column < 3; ++column) {
    for (Eigen::Index row = 0; row < 3; ++row) {
      image.axes(row, column) = head.matrix[static_cast<std::size_t>(3 * column + row)];
    }
  }
  const double room =
      image.axes.col(0).norm() * image.axes.col(1).norm() * image.axes.col(2).norm();
  constexpr double kFlat = 1e-6;
  if (!image.axes.allFinite() || !middle.allFinite() ||
      !(std::abs(image.axes.determinant()) > kFlat * room)) {
    refuse(what, "its matrix is not finite, or its axes are in one plane",
           "send three independent axes and a position");
  }
  if (head.space == 2) {
    image.axes.topRows<2>() *= -1.0;
    middle.head<2>() *= -1.0;
  }
  const Vec3 half =
      0.5 * Vec3(static_cast<double>(head.size[0] - 1), static_cast<double>(head.size[1] - 1),
                 static_cast<double>(head.size[2] - 1));
  image.origin = middle - image.axes * half;
}

}  // namespace

IgtlHead readIgtlHead(std::span<const std::uint8_t, kIgtlHead> bytes) {
  In in(bytes);
  IgtlHead head;
  head.version = in.take<std::uint16_t>();
  head.type = in.text(kType);
  head.name = in.text(kName);
  (void)in.take<std::uint64_t>();
  head.size = in.take<std::uint64_t>();
  head.crc = in.take<std::uint64_t>();
  return head;
}

std::uint64_t igtlCrc(ByteView bytes, std::uint64_t before) noexcept {
  static const std::array<std::uint64_t, 256> words = [] {
    constexpr std::uint64_t kPolynomial = 0x42F0E1EBA9EA3693ULL;
    constexpr std::uint64_t kTop = 1ULL << 63U;
    std::array<std::uint64_t, 256> table{};
    for (std::size_t i = 0; i < table.size(); ++i) {
      std::uint64_t word = static_cast<std::uint64_t>(i) << 56U;
      for (int bit = 0; bit < 8; ++bit) {
        word = (word & kTop) != 0 ? word << 1U ^ kPolynomial : word << 1U;
      }
      table[i] = word;
    }
    return table;
  }();
  std::uint64_t crc = before;
  for (const std::uint8_t byte : bytes) crc = words[(crc >> 56U ^ byte) & 0xFFU] ^ crc << 8U;
  return crc;
}

Bytes igtlTransform(std::string_view name, std::int64_t now, const Vec3& place) {
  Out out;
  // The columns of the identity: no rotation.
  for (const double x : Mat3::Identity().reshaped()) out.put(static_cast<float>(x));
  for (const double x : place) out.put(static_cast<float>(x));
  return message("TRANSFORM", name, now, out.bytes);
}

Bytes igtlString(std::string_view name, std::int64_t now, std::string_view text) {
  constexpr std::uint16_t kAscii = 3;
  text = text.substr(0, 0xFFFF);
  Out out;
  out.put(kAscii);
  out.put(static_cast<std::uint16_t>(text.size()));
  out.text(text, text.size());
  return message("STRING", name, now, out.bytes);
}

Bytes igtlStatus(std::string_view name, std::int64_t now, IgtlCode code, std::string_view text) {
  Out out;
  out.put(static_cast<std::uint16_t>(code));
  out.put<std::int64_t>(0);
  out.text(code == IgtlCode::kOk ? "" : "refused", kName);
  out.text(text, text.size());
  out.put<std::uint8_t>(0);
  return message("STATUS", name, now, out.bytes);
}

Bytes igtlCapability(std::string_view name, std::int64_t now, std::span<const char* const> types) {
  Out out;
  for (const char* type : types) out.text(type, kType);
  return message("CAPABILITY", name, now, out.bytes);
}

ByteView igtlContent(const IgtlHead& head, ByteView body) {
  if (head.version < 2) return body;
  constexpr std::size_t kLeast = 12;
  if (body.size() < kLeast) {
    refuse(head.type,
           fmt::format("its body has {} bytes, too few for an extended header", body.size()),
           "send at least 12 bytes");
  }
  In in(body);
  const std::uint64_t begin = in.take<std::uint16_t>();
  const std::uint64_t about = in.take<std::uint16_t>();
  const std::uint64_t more = in.take<std::uint32_t>();
  if (begin < kLeast || begin + about + more > body.size()) {
    refuse(head.type, "its extended header does not fit its body",
           "correct the sizes in the extended header");
  }
  return body.subspan(begin, body.size() - begin - about - more);
}

Vec3 readIgtlTransform(ByteView content) {
  if (content.size() != 12 * sizeof(float)) {
    refuse("TRANSFORM", fmt::format("it has {} bytes, not 48", content.size()),
           "send twelve numbers of 32 bits");
  }
  In in(content);
  std::array<float, 12> numbers{};
  for (float& number : numbers) {
    number = in.take<float>();
    if (!std::isfinite(number))
      refuse("TRANSFORM", "one of its numbers is not finite", "send twelve finite numbers");
  }
  return {numbers[9], numbers[10], numbers[11]};
}

std::string readIgtlString(ByteView content) {
  constexpr std::size_t kHead = 4;
  if (content.size() >= kHead) {
    In in(content);
    (void)in.take<std::uint16_t>();  // encoding; all encodings are accepted
    if (in.take<std::uint16_t>() == content.size() - kHead) {
      return {content.begin() + kHead, content.end()};
    }
  }
  refuse("STRING", "its length does not match its body", "send the number of bytes of the text");
}

IgtlImage readIgtlImage(const IgtlHead& head, Bytes body) {
  const std::string what = "IMAGE " + head.name;
  const ByteView content = igtlContent(head, body);
  if (content.size() < kImageHead) {
    refuse(what, fmt::format("its header has {} bytes", content.size()), "send at least 72 bytes");
  }
  const ImageHead sent = readImageHead(content);
  checkImageHead(what, sent);
  const std::uint64_t size = countValues(what, sent) * bytesOf(sent.scalar);
  if (content.size() - kImageHead != size) {
    refuse(what,
           fmt::format("its values have {} bytes, but its header states {}",
                       content.size() - kImageHead, size),
           "correct the size, the scalar type or the number of components");
  }
  IgtlImage image;
  image.name = head.name;
  image.size = sent.size;
  image.components = sent.components;
  image.scalar = sent.scalar;
  image.big_endian = sent.endian == 1;
  placeImage(what, sent, image);
  image.first = static_cast<std::size_t>(content.data() - body.data()) + kImageHead;
  body.resize(image.first + size);
  image.bytes = std::move(body);
  return image;
}

std::shared_ptr<const Volume> volumeOf(const IgtlImage& image) {
  switch (image.scalar) {
    case 2:
      return make<std::int8_t, float>(image);
    case 3:
      return make<std::uint8_t, float>(image);
    case 4:
      return make<std::int16_t, float>(image);
    case 5:
      return make<std::uint16_t, float>(image);
    // A float cannot represent all values of these types.
    case 6:
      return make<std::int32_t, double>(image);
    case 7:
      return make<std::uint32_t, double>(image);
    case 10:
      return make<float, float>(image);
    default:
      return make<double, double>(image);
  }
}

}  // namespace palpate::cli
