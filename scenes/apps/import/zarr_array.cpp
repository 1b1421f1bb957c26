#include "palpate/scenes/apps/import/zarr_array.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <new>
#include <optional>
#include <type_traits>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/half.h"
#include "palpate/scenes/apps/import/grids.h"
#include "palpate/scenes/apps/import/header_checks.h"
#include "palpate/scenes/library/text_file.h"

namespace palpate::importer {
namespace {

using Json = nlohmann::json;

constexpr const char* kCorrectMetadata =
    "correct the metadata, or export the array again as Zarr version 2";

struct ZarrType {
  const char* name;  ///< The dtype without its first character, the byte order.
  Type type;
};
constexpr std::array kZarrTypes{
    ZarrType{"b1", Type::kUint8},   ZarrType{"i1", Type::kInt8},    ZarrType{"u1", Type::kUint8},
    ZarrType{"i2", Type::kInt16},   ZarrType{"u2", Type::kUint16},  ZarrType{"i4", Type::kInt32},
    ZarrType{"u4", Type::kUint32},  ZarrType{"i8", Type::kInt64},   ZarrType{"u8", Type::kUint64},
    ZarrType{"f2", Type::kFloat32}, ZarrType{"f4", Type::kFloat32}, ZarrType{"f8", Type::kFloat64}};

/// Sets `to` to the number in `json`. null counts as 0, a boolean as 0 or 1, and a text such as
/// "NaN" as a float. Limits floats to the range of T. Returns false if T cannot hold the value.
template <class T>
bool numberFrom(const Json& json, T& to) {
  if (json.is_null()) {
    to = T{};
    return true;
  }
  if (json.is_boolean()) {
    to = static_cast<T>(json.get<bool>() ? 1 : 0);
    return true;
  }
  if constexpr (std::is_floating_point_v<T>) {
    if (json == "NaN") to = std::numeric_limits<T>::quiet_NaN();
    if (json == "Infinity") to = std::numeric_limits<T>::infinity();
    if (json == "-Infinity") to = -std::numeric_limits<T>::infinity();
    if (json.is_string()) return json == "NaN" || json == "Infinity" || json == "-Infinity";
    if (!json.is_number()) return false;
    const auto value = json.get<double>();
    to = static_cast<T>(std::clamp(value, static_cast<double>(std::numeric_limits<T>::lowest()),
                                   static_cast<double>(std::numeric_limits<T>::max())));
    return true;
  } else {
    const bool is_whole = json.is_number_integer();
    if (is_whole && !json.is_number_unsigned() && json.get<std::int64_t>() < 0) {
      const auto value = json.get<std::int64_t>();
      to = static_cast<T>(value);
      return std::is_signed_v<T> &&
             value >= static_cast<std::int64_t>(std::numeric_limits<T>::lowest());
    }
    if (is_whole) {
      const auto value = json.get<std::uint64_t>();
      to = static_cast<T>(value);
      return value <= static_cast<std::uint64_t>(std::numeric_limits<T>::max());
    }
    if (!json.is_number_float()) return false;
    const auto value = json.get<double>();         // such as 0.0
    constexpr double kExact = 9007199254740992.0;  // 2^53
    if (value != std::floor(value) || std::abs(value) > kExact) return false;
    to = static_cast<T>(static_cast<std::int64_t>(value));
    return static_cast<double>(to) == value;
  }
}

class ZarrayParser {
 public:
  ZarrayParser(const Json& json, const std::filesystem::path& file) : json_(json), file_(file) {}

  ZarrLayout parse() {
    if (at("zarr_format") != 2) {
      refuse("the key \"zarr_format\" is not 2", "export the array as Zarr version 2");
    }
    ZarrLayout layout;
    layout.shape = sizes("shape");
    layout.chunks = sizes("chunks");
    if (layout.shape.size() != layout.chunks.size()) {
      refuse("\"shape\" and \"chunks\" have different numbers of axes", kCorrectMetadata);
    }
    parseType(layout);
    checkSizes(layout);
    parseCodec(layout);
    parseFill(layout);
    const Json& order = at("order");
    if (order != "C" && order != "F") refuse("\"order\" is not C or F", kCorrectMetadata);
    layout.fortran = order == "F";
    if (json_.contains("dimension_separator")) {
      const Json& separator = json_["dimension_separator"];
      if (separator != "." && separator != "/") {
        refuse("\"dimension_separator\" is not . or /", kCorrectMetadata);
      }
      layout.separator = separator.get<std::string>()[0];
    }
    return layout;
  }

 private:
  [[noreturn]] void refuse(const std::string& why, const std::string& remedy) const {
    throw VolumeError(file_.string(), why, remedy);
  }

  [[nodiscard]] const Json& at(const char* key) const {
    const auto found = json_.find(key);
    if (found == json_.end()) refuse(fmt::format("\"{}\" is missing", key), kCorrectMetadata);
    return *found;
  }

  std::vector<int> sizes(const char* key) const {
    const Json& list = at(key);
    constexpr std::size_t kMostAxes = 8;
    if (!list.is_array() || list.empty() || list.size() > kMostAxes) {
      refuse(fmt::format("\"{}\" is not a list of 1 to {} sizes", key, kMostAxes),
             kCorrectMetadata);
    }
    std::vector<int> out;
    for (const Json& size : list) {
      constexpr double kMost = std::numeric_limits<int>::max();
      const double value = size.is_number_integer() ? size.get<double>() : 0.0;
      if (!(value >= 1.0 && value <= kMost)) {
        refuse(fmt::format("a size in \"{}\" is not a whole number from 1 to {:.0f}", key, kMost),
               kCorrectMetadata);
      }
      out.push_back(static_cast<int>(value));
    }
    return out;
  }

  void parseType(ZarrLayout& layout) const {
    const Json& dtype = at("dtype");
    const std::string name = dtype.is_string() ? dtype.get<std::string>() : "a structure";
    const auto* known =
        std::find_if(kZarrTypes.begin(), kZarrTypes.end(), [&](const ZarrType& type) {
          return name.size() == 3 && name.substr(1) == type.name &&
                 (name[0] == '<' || name[0] == '>' || (name[0] == '|' && type.name[1] == '1'));
        });
    if (known == kZarrTypes.end()) {
      refuse(fmt::format("the type of the values (dtype) is {}, which palpate does not read", name),
             "convert the values to integers of 8 to 64 bits, or to floats of 16 to 64 bits");
    }
    layout.type = known->type;
    layout.half = name.ends_with("f2");
    layout.big_endian = name[0] == '>';
  }

  void checkSizes(const ZarrLayout& layout) const {
    const auto width = static_cast<double>(bytesOf(layout.type));
    (void)bytesOf(file_, {layout.shape.begin(), layout.shape.end()}, width);
    const double chunk = bytesOf(file_, {layout.chunks.begin(), layout.chunks.end()}, width);
    // The same limit as in numcodecs, the compressors of zarr-python.
    constexpr double kMostBytes = std::numeric_limits<int>::max();
    if (chunk > kMostBytes) {
      refuse(fmt::format("a chunk has {:.3g} bytes, more than the limit of 2 GiB", chunk),
             "write the array with smaller chunks");
    }
  }

  void parseCodec(ZarrLayout& layout) const {
    if (json_.contains("filters") && !json_["filters"].is_null() && !json_["filters"].empty()) {
      std::vector<std::string> names;
      for (const Json& filter : json_["filters"]) names.push_back(idOf(filter));
      refuse(fmt::format("the array has filters, which palpate does not read: {}",
                         fmt::join(names, ", ")),
             "write the array without filters");
    }
    const Json& compressor = at("compressor");
    if (compressor.is_null()) return;
    const std::string id = idOf(compressor);
    if (id == "zlib" || id == "gzip") {
      layout.codec = ZarrCodec::kDeflate;
    } else if (id == "zstd") {
      layout.codec = ZarrCodec::kZstd;
    } else if (id == "blosc") {
      layout.codec = ZarrCodec::kBlosc;
    } else {
      refuse(fmt::format("the chunks are compressed by {}, which palpate does not read", id),
             "write the array with zstd, Blosc, gzip or zlib, or not compressed");
    }
  }

  static std::string idOf(const Json& codec) {
    const bool has_id = codec.is_object() && codec.contains("id") && codec["id"].is_string();
    return has_id ? codec["id"].get<std::string>() : "an unnamed method";
  }

  void parseFill(ZarrLayout& layout) const {
    const Json& fill = at("fill_value");
    const Values one(layout.type, 1, 1, std::shared_ptr<void>(layout.fill.data(), [](void*) {}));
    if (!visit(one, [&](auto* value) { return numberFrom(fill, *value); })) {
      const std::string text =
          fill.is_structured()
              ? "a structure"
              : fill.dump(-1, ' ', true, Json::error_handler_t::replace).substr(0, 40);
      refuse(fmt::format("\"fill_value\" is {}, which is not a value of the array's type", text),
             kCorrectMetadata);
    }
    layout.fill_text = visit(one, [](const auto* value) { return fmt::format("{}", *value); });
  }

  const Json& json_;
  const std::filesystem::path& file_;
};

/// Returns the distance between neighbours along each axis, in values.
std::vector<std::ptrdiff_t> stridesOf(const std::vector<int>& counts, bool fortran) {
  std::vector<std::ptrdiff_t> strides(counts.size());
  std::ptrdiff_t product = 1;
  for (std::size_t n = 0; n < counts.size(); ++n) {
    const std::size_t axis = fortran ? n : counts.size() - 1 - n;
    strides[axis] = product;
    product *= counts[axis];
  }
  return strides;
}

template <std::size_t bytes>
void copyRow(const char* from, std::ptrdiff_t stride, char* to, int count) {
  for (int i = 0; i < count; ++i, from += stride, to += bytes) std::memcpy(to, from, bytes);
}

/// Copies a box of values. The strides are in bytes; rows of `to` are contiguous.
struct BoxCopy {
  int bytes = 1;  ///< Size of a value.
  std::vector<int> count;
  std::vector<std::ptrdiff_t> from_stride;
  std::vector<std::ptrdiff_t> to_stride;

  void run(const char* from, char* to, std::size_t axis = 0) const {
    if (axis + 1 < count.size()) {
      for (int i = 0; i < count[axis]; ++i) {
        run(from + i * from_stride[axis], to + i * to_stride[axis], axis + 1);
      }
      return;
    }
    const std::ptrdiff_t stride = from_stride[axis];
    if (stride == bytes) {
      std::memcpy(to, from,
                  static_cast<std::size_t>(count[axis]) * static_cast<std::size_t>(bytes));
    } else if (bytes == 1) {
      copyRow<1>(from, stride, to, count[axis]);
    } else if (bytes == 2) {
      copyRow<2>(from, stride, to, count[axis]);
    } else if (bytes == 4) {
      copyRow<4>(from, stride, to, count[axis]);
    } else {
      copyRow<8>(from, stride, to, count[axis]);
    }
  }
};

/// Converts floats of 16 bits to floats of 32 bits.
std::vector<char> widened(const std::vector<char>& halves) {
  std::vector<char> out(2 * halves.size());
  for (std::size_t i = 0; i + 1 < halves.size(); i += 2) {
    std::uint16_t half = 0;
    std::memcpy(&half, halves.data() + i, sizeof half);
    const float value = floatOfHalf(half);
    std::memcpy(out.data() + 2 * i, &value, sizeof value);
  }
  return out;
}

/// Largest number of chunks in a box, and of chunks whose sizes are kept.
constexpr double kMostChunks = 4e6;

/// Advances `index` to the next one in `box`, the last axis fastest.
void advance(std::vector<int>& index, const ZarrBox& box) {
  for (std::size_t a = index.size(); a-- > 0;) {
    if (++index[a] < box.first[a] + box.count[a] || a == 0) break;
    index[a] = box.first[a];
  }
}

double productOf(const std::vector<int>& counts) {
  double product = 1.0;
  for (const int count : counts) product *= count;
  return product;
}

}  // namespace

Json readZarrJson(const std::filesystem::path& file) {
  constexpr const char* kRemedy = "check the path and its permissions";
  constexpr std::uintmax_t kMostBytes = 1U << 24U;
  checkRegular<VolumeError>(file, kRemedy);
  std::error_code error;
  if (std::filesystem::file_size(file, error) > kMostBytes) {
    throw VolumeError(file.string(), "the metadata have more than 16 MiB", kCorrectMetadata);
  }
  const std::string text = readText<VolumeError>(file, kRemedy);
  try {
    // Limits the depth of nesting, so that recursion does not exhaust the stack.
    Json json = Json::parse(text, [&](int depth, Json::parse_event_t /*event*/, Json& /*parsed*/) {
      constexpr int kDeepest = 64;
      if (depth > kDeepest) {
        throw VolumeError(file.string(),
                          fmt::format("the metadata have more than {} levels", kDeepest),
                          kCorrectMetadata);
      }
      return true;
    });
    if (json.is_object()) return json;
  } catch (const Json::parse_error& e) {
    throw VolumeError(file.string(), fmt::format("the metadata are not JSON (byte {})", e.byte),
                      kCorrectMetadata);
  } catch (const Json::out_of_range&) {
    throw VolumeError(file.string(), "a number is too large for a double", kCorrectMetadata);
  }
  throw VolumeError(file.string(), "the metadata are not a JSON object", kCorrectMetadata);
}

ZarrLayout parseZarray(const Json& json, const std::filesystem::path& file) {
  return ZarrayParser(json, file).parse();
}

ZarrArray::ZarrArray(const Request& request, const std::filesystem::path& folder, bool has_coarser)
    : header_(folder / ".zarray"),
      follow_(request.follow),
      is_sliced_(request.slices != nullptr),
      has_coarser_(has_coarser),
      layout_(parseZarray(readZarrJson(header_), header_)) {}

void ZarrArray::refuse(const std::string& why, const std::string& remedy) const {
  throw VolumeError(header_.string(), why, remedy);
}

double ZarrArray::chunkBytes() const {
  return productOf(layout_.chunks) * static_cast<double>(layout_.storedBytes());
}

std::filesystem::path ZarrArray::nameOf(const std::vector<int>& index) const {
  return header_.parent_path() /
         fmt::format("{}", fmt::join(index, std::string_view(&layout_.separator, 1)));
}

/// Returns the size of a chunk's file [bytes]; 0: the chunk is missing.
std::size_t ZarrArray::heldBy(const std::filesystem::path& chunk) const {
  std::error_code error;
  // A link to a missing file is an error, not a missing chunk.
  const auto status = std::filesystem::symlink_status(chunk, error);
  if (status.type() == std::filesystem::file_type::not_found) return 0;
  const double held = sizeOfData(header_, chunk, follow_);
  checkChunkSize(header_, chunk, layout_.codec, held, chunkBytes());
  return static_cast<std::size_t>(held);
}

/// Returns a remedy. If the image has a coarser level, adds the option --level as an alternative.
std::string ZarrArray::orCoarser(const std::string& remedy) const {
  return has_coarser_ ? remedy + ", or choose a coarser level with --level" : remedy;
}

/// Returns the indices of the chunks that have values of a box.
ZarrBox ZarrArray::chunksOf(const ZarrBox& box) const {
  ZarrBox chunks;
  for (std::size_t a = 0; a < box.count.size(); ++a) {
    const int side = layout_.chunks[a];
    chunks.first.push_back(box.first[a] / side);
    const std::int64_t last = std::int64_t{box.first[a]} + box.count[a] - 1;
    chunks.count.push_back(box.count[a] == 0 ? 0
                                             : static_cast<int>(last / side) - chunks.first[a] + 1);
  }
  return chunks;
}

/// Finds the files of a box's chunks, or returns an earlier result. Throws VolumeError, before
/// values are allocated, if the files are too small for the values that the header states.
const ZarrArray::Found& ZarrArray::findChunks(const ZarrBox& whole) {
  const auto key = std::pair(whole.first, whole.count);
  if (const auto known = found_.find(key); known != found_.end()) return known->second;
  const ZarrBox chunks = chunksOf(whole);
  const double count = productOf(chunks.count);
  if (count > kMostChunks) {
    refuse(fmt::format("the image has {:.3g} chunks, more than the limit of {:.0g}", count,
                       kMostChunks),
           orCoarser("write the array with larger chunks"));
  }
  Found found;
  found.held.resize(static_cast<std::size_t>(count));
  std::vector<int> index = chunks.first;
  for (std::size_t& held : found.held) {
    held = heldBy(nameOf(index));
    found.missing += held == 0 ? 1 : 0;
    advance(index, chunks);
  }
  const double bytes = productOf(whole.count) * static_cast<double>(bytesOf(layout_.type));
  // A sparse image may lack most chunks. This limit rejects a header that states a huge image
  // without its chunks.
  constexpr double kAlways = 1U << 28U;  // [bytes]
  constexpr double kLeastShare = 1e-3;
  const std::size_t there = found.held.size() - found.missing;
  if (bytes > kAlways && static_cast<double>(there) < kLeastShare * count) {
    refuse(fmt::format("the image needs {:.3g} bytes, but the folder has only {} of its {:.0f} "
                       "chunks",
                       bytes, there, count),
           orCoarser("copy the whole folder again"));
  }
  double kept = count;
  for (const auto& [box, other] : found_) kept += static_cast<double>(other.held.size());
  if (kept > kMostChunks) found_.clear();  // limits the memory: an image may have many steps
  return found_.emplace(key, std::move(found)).first->second;
}

/// Copies the values of a chunk that are in `part`.
/// @param values  All values of the chunk; null: all have the fill value.
void ZarrArray::copyChunk(const std::vector<int>& index, const char* values, const ZarrBox& part,
                          char* to) const {
  const std::size_t axes = layout_.shape.size();
  const auto bytes = static_cast<int>(bytesOf(layout_.type));
  BoxCopy copy;
  copy.bytes = bytes;
  copy.from_stride = stridesOf(layout_.chunks, layout_.fortran);
  copy.to_stride = stridesOf(part.count, false);
  const char* from = values == nullptr ? layout_.fill.data() : values;
  for (std::size_t a = 0; a < axes; ++a) {
    copy.from_stride[a] *= values == nullptr ? 0 : bytes;
    copy.to_stride[a] *= bytes;
    const std::int64_t origin = std::int64_t{index[a]} * layout_.chunks[a];
    const std::int64_t first = std::max<std::int64_t>(origin, part.first[a]);
    const std::int64_t end = std::min<std::int64_t>(origin + layout_.chunks[a],
                                                    std::int64_t{part.first[a]} + part.count[a]);
    copy.count.push_back(static_cast<int>(end - first));
    from += (first - origin) * copy.from_stride[a];
    to += (first - part.first[a]) * copy.to_stride[a];
  }
  copy.run(from, to);
}

Values ZarrArray::read(const ZarrBox& whole, const ZarrBox& part, const Progress& progress) {
  if (!is_sliced_ && productOf(part.count) > kMostVoxels) {
    refuse(fmt::format("the image has {:.3g} values, more than the limit of {:.0g}",
                       productOf(part.count), kMostVoxels),
           orCoarser("add --bricks, without --iso and --voxel, to read a part at a time"));
  }
  const Found& found = findChunks(whole);
  checked_ += found.held.size();
  missing_ += found.missing;
  const ZarrBox all = chunksOf(whole);
  const ZarrBox needed = chunksOf(part);
  const std::vector<std::ptrdiff_t> strides = stridesOf(all.count, false);
  try {
    Values values(layout_.type, 1, static_cast<std::size_t>(productOf(part.count)));
    std::vector<char> buffer;
    const double count = productOf(needed.count);
    std::vector<int> index = needed.first;
    for (double done = 0.0; done < count; ++done, advance(index, needed)) {
      if (progress) progress(done / count);
      std::ptrdiff_t n = 0;
      for (std::size_t a = 0; a < index.size(); ++a) n += strides[a] * (index[a] - all.first[a]);
      const std::size_t held = found.held[static_cast<std::size_t>(n)];
      if (held == 0) {
        copyChunk(index, nullptr, part, values.as<char>());
        continue;
      }
      buffer.resize(static_cast<std::size_t>(chunkBytes()));
      readChunk(header_, nameOf(index), layout_.codec, held, buffer);
      if (layout_.big_endian != (std::endian::native == std::endian::big)) {
        const auto width = layout_.storedBytes();
        swapBytes(buffer.data(), buffer.size() / width, width);
      }
      if (layout_.half) buffer = widened(buffer);
      copyChunk(index, buffer.data(), part, values.as<char>());
    }
    return values;
  } catch (const std::bad_alloc&) {
    refuse("the values need more memory than is free",
           orCoarser(is_sliced_ ? "end other programs, or export a smaller part"
                                : "add --bricks, without --iso and --voxel, to read a part at a "
                                  "time"));
  }
}

}  // namespace palpate::importer
