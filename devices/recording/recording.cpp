#include "palpate/devices/recording/recording.h"

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <fcntl.h>
#include <optional>
#include <sys/mman.h>
#include <sys/stat.h>
#include <type_traits>
#include <unistd.h>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "palpate/devices/recording/crc32c.h"
#include "palpate/devices/recording/device_json.h"
#include "palpate/engine/error.h"
#include "palpate/engine/loop/haptic_loop.h"

namespace palpate {
namespace {

using OrderedJson = nlohmann::ordered_json;

static_assert(std::endian::native == std::endian::little,
              "a recording stores ticks in their layout in memory");

constexpr int kVersion = 5;
constexpr const char* kRemedy = "give a file of palpate feel --record";
constexpr const char* kDamaged = "copy the file again, or record again";
constexpr std::int64_t kChunk = -1;  // value of RecordedTick::tick in a chunk's mark
constexpr std::int64_t kText = -2;   // value of RecordedTick::tick in a piece of text
constexpr std::array<char, 8> kMagic{'p', 'a', 'l', 'p', 'a', 't', 'e', '\n'};
constexpr char kBegins[] = "{\"palpate_recording\":";

enum class ChunkKind : std::uint64_t { kTicks, kScene };

/// The record that precedes each chunk.
struct ChunkMark {
  std::int64_t tick;
  std::array<char, 8> magic;
  std::uint64_t kind;
  std::uint64_t count;  ///< Number of records that follow.
  std::int64_t first;   ///< For ticks: number of the first tick.
  std::uint64_t scene;  ///< For a scene: its id.
  std::uint64_t bytes;  ///< For a scene: length of its text.
  /// CRC-32C of this record with crc = 0, and of the records that follow.
  std::uint64_t crc;
  std::array<char, sizeof(RecordedTick) - 64> zero;
};
static_assert(sizeof(ChunkMark) == sizeof(RecordedTick));

struct TextPiece {
  std::int64_t tick;  ///< kText.
  std::array<char, sizeof(RecordedTick) - 8> text;
};
static_assert(sizeof(TextPiece) == sizeof(RecordedTick));

template <class T>
std::span<const std::byte> bytesOf(const T& value) noexcept {
  return std::as_bytes(std::span(&value, 1));
}

std::string asText(std::span<const std::byte> bytes) {
  std::string text(bytes.size(), '\0');
  std::memcpy(text.data(), bytes.data(), bytes.size());
  return text;
}

std::string chunkOf(ChunkMark mark, std::span<const std::byte> records) {
  mark.tick = kChunk;
  mark.magic = kMagic;
  mark.count = records.size() / sizeof(RecordedTick);
  mark.crc = crc32c(records, crc32c(bytesOf(mark)));
  return asText(bytesOf(mark)) + asText(records);
}

// Fields of a record: name in RecordedTick, member of Telemetry, unit, and RecordedField::output.
// clang-format off
#define PALPATE_EACH_FIELD(FIELD)                       \
  FIELD(tick, tick, "", false)                          \
  FIELD(scene, scene, "", false)                        \
  FIELD(tick_ns, tick_ns, "ns", false)                  \
  FIELD(wake_ns, wake_ns, "ns", false)                  \
  FIELD(late_ticks, late_ticks, "", false)              \
  FIELD(time, time, "s", false)                         \
  FIELD(dt, input.dt, "s", false)                       \
  FIELD(play, input.play, "s", false)                   \
  FIELD(play_rate, input.play_rate, "s/s", false)       \
  FIELD(pull, input.pull, "N", false)                   \
  FIELD(hand, input.hand.position, "m", false)          \
  FIELD(velocity, input.hand.velocity, "m/s", false)    \
  FIELD(drives, input.hand.drives, "", false)           \
  FIELD(age, input.hand.age, "s", false)                \
  FIELD(still, input.hand.still, "s", false)            \
  FIELD(max_speed, input.hand.max_speed, "m/s", false)  \
  FIELD(orientation, input.hand.handle.orientation, "", false) \
  FIELD(measured_velocity, input.hand.handle.velocity, "m/s", false) \
  FIELD(gripper, input.hand.handle.gripper, "rad or m", false) \
  FIELD(joints, input.hand.handle.joints, "rad or m", false) \
  FIELD(given, input.given, "", false)                  \
  FIELD(force, report.force, "N", true)                 \
  FIELD(wanted, report.wanted, "N", true)               \
  FIELD(proxy, report.proxy, "m", true)                 \
  FIELD(waiting, report.waiting, "m", true)             \
  FIELD(stiffness, report.stiffness, "N/m", true)       \
  FIELD(error_bound, report.error_bound, "m", true)     \
  FIELD(injected, report.injected, "J", true)           \
  FIELD(missing, report.missing, "N", true)             \
  FIELD(moving, report.moving, "", true)                \
  FIELD(share, report.share, "", true)                  \
  FIELD(energy, report.energy, "J", true)               \
  FIELD(left, report.left, "", true)                    \
  FIELD(iterations, report.iterations, "", true)        \
  FIELD(substeps, report.substeps, "", true)            \
  FIELD(samples, report.samples, "", true)              \
  FIELD(traced, report.traced, "", true)                \
  FIELD(walked, report.walked, "", true)                \
  FIELD(primitives, report.primitives, "", true)        \
  FIELD(parts, report.parts, "", true)                  \
  FIELD(left_out, report.left_out, "", true)            \
  FIELD(buttons, input.hand.handle.buttons, "", false)   \
  FIELD(fresh, report.fresh, "", false)                 \
  FIELD(ready, input.hand.ready, "", false)             \
  FIELD(reported, input.hand.fault, "", false)          \
  FIELD(too_fast, input.hand.too_fast, "", false)       \
  FIELD(cleared, input.cleared, "", false)              \
  FIELD(wrong, input.wrong, "", false)                  \
  FIELD(order, input.order, "", false)                  \
  FIELD(unsent, input.unsent, "", false)                \
  FIELD(solver, report.solver, "", true)                \
  FIELD(status, report.status, "", true)                \
  FIELD(limited, report.limited, "", true)              \
  FIELD(missed, missed, "", false)                      \
  FIELD(fault, fault, "", true)                         \
  FIELD(coarse, report.coarse, "", false)
// clang-format on

// put() copies a field to a record. take() copies the field back, and converts any byte to a valid
// enum value.
template <class T>
void put(T& to, T from) noexcept {
  to = from;
}
void put(std::uint8_t& to, bool from) noexcept {
  to = from ? 1 : 0;
}
template <class Enum>
requires std::is_enum_v<Enum>
void put(std::uint8_t& to, Enum from) noexcept {
  to = static_cast<std::uint8_t>(from);
}
template <std::size_t N, class Matrix>
requires(Matrix::SizeAtCompileTime == N) void put(std::array<double, N>& to,
                                                  const Matrix& from) noexcept {
  std::copy_n(from.data(), N, to.begin());
}
template <class T>
void take(T& to, T from) noexcept {
  to = from;
}
void take(bool& to, std::uint8_t from) noexcept {
  to = from != 0;
}
void take(Fault& to, std::uint8_t from) noexcept {
  to = from < kFaults ? static_cast<Fault>(from) : Fault::kNotFinite;
}
void take(SolverKind& to, std::uint8_t from) noexcept {
  to = static_cast<SolverKind>(std::min<std::uint8_t>(from, 2));
}
void take(StepStatus& to, std::uint8_t from) noexcept {
  to = static_cast<StepStatus>(std::min<std::uint8_t>(from, kStepStatuses - 1));
}
template <std::size_t N, class Matrix>
requires(Matrix::SizeAtCompileTime == N) void take(Matrix& to,
                                                   const std::array<double, N>& from) noexcept {
  std::copy_n(from.begin(), N, to.data());
}

/// Count of the numbers in a field of type T, and their type in numpy's notation.
template <class T>
struct Kept {
  static constexpr std::size_t count = 1;
  static constexpr const char* type = std::is_same_v<T, double>          ? "<f8"
                                      : std::is_same_v<T, std::int64_t>  ? "<i8"
                                      : std::is_same_v<T, std::uint64_t> ? "<u8"
                                      : std::is_same_v<T, std::int32_t>  ? "<i4"
                                      : std::is_same_v<T, std::uint32_t> ? "<u4"
                                                                         : "u1";
};
template <class T, std::size_t N>
struct Kept<std::array<T, N>> {
  static constexpr std::size_t count = N;
  static constexpr const char* type = Kept<T>::type;
};

#define PALPATE_KEPT(name, told, unit, output)             \
  RecordedField{#name,                                     \
                Kept<decltype(RecordedTick::name)>::type,  \
                Kept<decltype(RecordedTick::name)>::count, \
                offsetof(RecordedTick, name),              \
                unit,                                      \
                output},
constexpr std::array kFields{PALPATE_EACH_FIELD(PALPATE_KEPT) PALPATE_KEPT(zero, , "", false)};
#undef PALPATE_KEPT

/// Returns true if the fields cover every byte of a record exactly once.
constexpr bool whole() noexcept {
  std::size_t at = 0;
  for (const RecordedField& field : kFields) {
    if (field.offset != at) return false;
    at += sizeOf(field);
  }
  return at == sizeof(RecordedTick);
}
static_assert(whole());

/// Parses a header. Rejects JSON that is nested deeper than any header that palpate writes.
OrderedJson parsed(const std::string& line, const std::string& file) {
  constexpr int kDeepest = 16;
  return OrderedJson::parse(line, [&](int depth, auto, OrderedJson&) {
    if (depth > kDeepest) {
      throw Error(file, fmt::format("its header is nested deeper than {} levels", kDeepest),
                  kDamaged);
    }
    return true;
  });
}

/// Copies a file to memory. If another program truncated a mapped file, the next access would raise
/// SIGBUS. A recording that is truncated during the copy counts as torn.
std::span<const std::byte> copied(const std::filesystem::path& file) {
  const auto fail = [&](int error) {
    throw Error(file.string(), fmt::format("it cannot be read ({})", std::strerror(error)),
                error == ENOMEM ? "free some memory" : "check the path and its permissions");
  };
  const int descriptor = ::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (descriptor < 0) fail(errno);
  struct stat facts {};
  const bool regular = ::fstat(descriptor, &facts) == 0 && S_ISREG(facts.st_mode);
  const auto size = static_cast<std::size_t>(facts.st_size);
  void* at = nullptr;
  if (regular && size > 0) {
    at = ::mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  }
  int error = at == MAP_FAILED ? errno : 0;
  std::size_t got = 0;
  while (error == 0 && at != nullptr && got < size) {
    const ssize_t more = ::read(descriptor, static_cast<char*>(at) + got, size - got);
    if (more < 0 && errno != EINTR) error = errno;
    if (more == 0) break;
    if (more > 0) got += static_cast<std::size_t>(more);
  }
  ::close(descriptor);
  if (!regular) throw Error(file.string(), "it is not a file", kRemedy);
  if (error != 0) {
    if (at != MAP_FAILED) ::munmap(at, size);
    fail(error);
  }
  if (got < size) at = got > 0 ? ::mremap(at, size, got, 0) : (::munmap(at, size), nullptr);
  return {static_cast<const std::byte*>(at), got};
}

void unmap(std::span<const std::byte> bytes) noexcept {
  if (bytes.empty()) return;
  void* at = const_cast<std::byte*>(bytes.data());  // NOLINT(cppcoreguidelines-pro-type-const-cast)
  ::munmap(at, bytes.size());
}

template <class T>
T at(std::span<const std::byte> bytes, std::size_t offset) noexcept {
  T value;
  std::memcpy(&value, bytes.data() + offset, sizeof(T));
  return value;
}

/// Returns true if there are ticks, and if their numbers rise from above `last` to at most kMost.
bool comesAfter(std::span<const std::byte> records, std::int64_t last) noexcept {
  constexpr std::int64_t kMost = std::int64_t{1} << 53U;  // about 30,000 years at 10 kHz
  for (std::size_t from = 0; from < records.size(); from += sizeof(RecordedTick)) {
    const auto tick = at<std::int64_t>(records, from);
    if (tick <= last || tick > kMost) return false;
    last = tick;
  }
  return !records.empty();
}

/// Returns the header without its line end. Throws Error if the file has no header.
std::string headerLine(std::span<const std::byte> bytes, const std::string& file) {
  const auto* begin = reinterpret_cast<const char*>(bytes.data());
  const std::size_t start = sizeof(kBegins) - 1;
  const void* end = nullptr;
  if (bytes.size() > start && std::memcmp(begin, kBegins, start) == 0) {
    end = std::memchr(begin, '\n', bytes.size());
  }
  if (end == nullptr) {
    throw Error(file, "it is not a recording", kRemedy);
  }
  return {begin, static_cast<const char*>(end)};
}

/// Returns true if the records have the layout of RecordedTick, as in versions 4 and 5. In version
/// 4, the byte of `coarse` belonged to `zero`.
bool hasKnownFields(const OrderedJson& header) {
  OrderedJson dtype = OrderedJson::parse(recordingHeader({})).at("dtype");
  const OrderedJson& version = header.at("palpate_recording");
  if (version == 4) {
    dtype.erase(dtype.size() - 2);  // coarse
    dtype.back().back() = sizeof(RecordedTick::zero) + sizeof(RecordedTick::coarse);
  } else if (version != kVersion) {
    return false;
  }
  return header.at("dtype") == dtype;
}

/// Throws Error if the ticks do not begin at the header's end, or if the rate is not valid.
void checkHeader(const std::string& file, std::size_t offset, std::size_t end, double rate) {
  std::string why;
  if (offset != end) {
    why = fmt::format("its header ends at byte {}, but states {}", end, offset);
  } else if (!(rate > 0.0) || !std::isfinite(rate)) {
    why = fmt::format("its header states a rate of {} Hz", rate);
  }
  if (!why.empty()) throw Error(file, why, kDamaged);
}

}  // namespace

RecordedTick recordedTick(const Telemetry& tick) noexcept {
  RecordedTick out{};
#define PALPATE_PUT(name, told, unit, output) put(out.name, tick.told);
  PALPATE_EACH_FIELD(PALPATE_PUT)
#undef PALPATE_PUT
  return out;
}

Telemetry telemetryOf(const RecordedTick& tick) noexcept {
  Telemetry out;
#define PALPATE_TAKE(name, told, unit, output) take(out.told, tick.name);
  PALPATE_EACH_FIELD(PALPATE_TAKE)
#undef PALPATE_TAKE
  out.probe = out.input.hand.position;
  return out;
}

std::span<const RecordedField> recordedFields() noexcept {
  return kFields;
}

std::string recordingHeader(const RecordedSetting& setting) {
  OrderedJson json;
  json["palpate_recording"] = kVersion;
  json["offset"] = 0;  // the final value is set below
  json["record"] = sizeof(RecordedTick);
  OrderedJson units;
  for (const RecordedField& field : kFields) {
    OrderedJson entry{field.name, field.type};
    if (field.count > 1) entry.push_back(field.count);
    json["dtype"].push_back(entry);
    if (field.unit[0] != '\0') units[field.name] = field.unit;
  }
  json["units"] = units;
  json["rate"] = setting.rate;
  json["device"] = deviceToJson(setting.device);
  json["about"] = OrderedJson::parse(setting.about.empty() ? "{}" : setting.about);
  const auto line = [&] {
    return json.dump(-1, ' ', false, OrderedJson::error_handler_t::replace);
  };
  constexpr std::size_t kDigits = 20;  // room for the digits of the offset itself
  const std::size_t records = (line().size() + kDigits) / sizeof(RecordedTick) + 1;
  json["offset"] = records * sizeof(RecordedTick);
  std::string text = line();
  text.resize(records * sizeof(RecordedTick), ' ');
  text.back() = '\n';
  return text;
}

std::string recordingChunk(std::span<const RecordedTick> ticks) {
  // One wrong bit destroys a whole chunk, so chunks are small.
  constexpr std::size_t kMost = 1024;
  std::string before;
  for (; ticks.size() > kMost; ticks = ticks.subspan(kMost)) {
    before += recordingChunk(ticks.first(kMost));
  }
  ChunkMark mark{};
  mark.kind = static_cast<std::uint64_t>(ChunkKind::kTicks);
  mark.first = ticks.front().tick;
  return before + chunkOf(mark, std::as_bytes(ticks));
}

std::string recordingChunk(const RecordedScene& scene) {
  ChunkMark mark{};
  mark.kind = static_cast<std::uint64_t>(ChunkKind::kScene);
  mark.scene = scene.id;
  mark.bytes = scene.text.size();
  std::vector<TextPiece> pieces;
  constexpr std::size_t kPiece = sizeof(TextPiece::text);
  for (std::size_t from = 0; from < scene.text.size(); from += kPiece) {
    TextPiece& piece = pieces.emplace_back();
    piece.tick = kText;
    piece.text = {};
    scene.text.copy(piece.text.data(), kPiece, from);
  }
  return chunkOf(mark, std::as_bytes(std::span(pieces)));
}

bool isRecording(const std::filesystem::path& file) noexcept {
  std::array<char, sizeof(kBegins) - 1> begin{};
  const int descriptor = ::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (descriptor < 0) return false;
  const auto read = ::read(descriptor, begin.data(), begin.size());
  ::close(descriptor);
  return read == static_cast<ssize_t>(begin.size()) &&
         std::memcmp(begin.data(), kBegins, begin.size()) == 0;
}

Recording::Recording(const std::filesystem::path& file) : bytes_(copied(file)) {
  const std::string name = file.string();
  std::size_t offset = 0;
  try {
    const std::string line = headerLine(bytes_, name);
    const OrderedJson json = parsed(line, name);
    if (!hasKnownFields(json)) {
      throw Error(name, "it is a recording of another version of palpate",
                  "convert it to CSV with that version (palpate convert)");
    }
    offset = json.at("offset").get<std::size_t>();
    setting_.rate = json.at("rate").get<double>();
    setting_.device = deviceFromJson(json.at("device"));
    setting_.about = json.at("about").dump();
    checkHeader(name, offset, line.size() + 1, setting_.rate);
    static_cast<void>(limitsInLoop(setting_.device, setting_.rate));
  } catch (const nlohmann::json::exception& error) {
    unmap(bytes_);
    throw Error(name, fmt::format("its header is damaged ({})", error.what()), kDamaged);
  } catch (const DeviceError& error) {
    unmap(bytes_);
    throw Error(name, fmt::format("its header is damaged ({})", error.reason()), kDamaged);
  } catch (const Error&) {
    unmap(bytes_);
    throw;
  }
  constexpr std::size_t kRecord = sizeof(RecordedTick);
  std::size_t last_whole = offset;  // end of the last complete chunk
  // Start of a chunk that continues beyond the file's end.
  std::optional<std::size_t> cut;
  // bytes of invalid chunks that the search may still check
  std::size_t patience = 4 * bytes_.size();
  std::int64_t last_tick = 0;
  while (offset < bytes_.size() && bytes_.size() - offset >= kRecord) {
    ChunkMark mark = at<ChunkMark>(bytes_, offset);
    const std::size_t room = (bytes_.size() - offset) / kRecord - 1;
    const bool marked = mark.tick == kChunk && mark.magic == kMagic;
    if (marked && mark.count > room && !cut) cut = offset;
    const std::size_t count = marked && mark.count <= room ? mark.count : 0;
    const auto records = bytes_.subspan(offset + kRecord, count * kRecord);
    const std::uint64_t crc = std::exchange(mark.crc, 0);
    const bool good = marked && mark.count == count &&
                      crc32c(records, crc32c(bytesOf(mark))) == crc &&
                      (mark.kind != static_cast<std::uint64_t>(ChunkKind::kTicks) ||
                       comesAfter(records, last_tick));
    if (!good) {
      // The chunk is damaged. Searches for the next chunk, record by record.
      offset += kRecord;
      patience -= std::min(patience, records.size());
      if (patience == 0) break;
      continue;
    }
    damaged_ += offset - last_whole;
    cut.reset();
    if (mark.kind == static_cast<std::uint64_t>(ChunkKind::kTicks)) {
      chunks_.push_back({size_, offset + kRecord});
      size_ += static_cast<std::int64_t>(mark.count);
      last_tick = at<RecordedTick>(records, records.size() - kRecord).tick;
    } else if (mark.kind == static_cast<std::uint64_t>(ChunkKind::kScene)) {
      RecordedScene& scene = scenes_.emplace_back();
      scene.id = mark.scene;
      for (std::size_t i = 0; i < mark.count; ++i) {
        const auto piece = at<TextPiece>(records, i * kRecord);
        scene.text.append(piece.text.data(), piece.text.size());
      }
      scene.text.resize(std::min<std::size_t>(scene.text.size(), mark.bytes));
    }
    offset += kRecord * (1 + mark.count);
    last_whole = offset;
  }
  // An incomplete chunk at the file's end counts as torn; complete but wrong data count as damaged.
  const std::size_t rest = bytes_.size() - std::min(last_whole, bytes_.size());
  torn_ = cut ? bytes_.size() - *cut : rest % kRecord;
  damaged_ += rest - torn_;
  if (size_ > 0) lost_ = tick(size_ - 1).tick - tick(0).tick + 1 - size_;
}

Recording::~Recording() {
  unmap(bytes_);
}

std::string Recording::incomplete() const {
  std::vector<std::string> words;
  if (damaged_ > 0) words.push_back(fmt::format("{} bytes are damaged and skipped", damaged_));
  if (torn_ > 0) {
    words.push_back(
        fmt::format("it is cut off after {} ticks: {} bytes are skipped", size_, torn_));
  }
  if (lost_ > 0) {
    words.push_back(fmt::format("{} ticks between its first and its last are missing", lost_));
  }
  return fmt::format("{}", fmt::join(words, "; "));
}

RecordedTick Recording::tick(std::int64_t i) const noexcept {
  const auto after = std::upper_bound(chunks_.begin(), chunks_.end(), i,
                                      [](std::int64_t a, const Chunk& c) { return a < c.first; });
  const Chunk& chunk = *(after - 1);
  return at<RecordedTick>(
      bytes_, chunk.at + static_cast<std::size_t>(i - chunk.first) * sizeof(RecordedTick));
}

}  // namespace palpate
