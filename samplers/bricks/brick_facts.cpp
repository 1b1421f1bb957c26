#include "palpate/samplers/bricks/brick_facts.h"

#include <algorithm>
#include <bit>
#include <cinttypes>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <new>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>
#include <zstd.h>

#include <Eigen/LU>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/brick_codec.h"
#include "palpate/samplers/bricks/facts_reader.h"
#include "palpate/samplers/grid/data_ends.h"
#include "palpate/samplers/grid/make_volume.h"

namespace palpate {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::string_view kMagic = "PALPBRK1";
constexpr int kVersion = 1;
constexpr const char* kRemedy = "copy or write it again";
/// Longest JSON text of a manifest [bytes]. Limits the memory of the parser.
constexpr std::size_t kMostText = 1U << 16U;
/// Largest number of bricks of a level. Bounds the time of the writer, which visits each brick.
constexpr std::uint64_t kMostBricks = std::uint64_t{1} << 32U;
/// Largest number of bricks of the coarsest level, which a window always holds in memory.
constexpr std::uint64_t kFew = 8;
/// Largest growth of a level set's band per level, on each side [voxels of the coarser level].
constexpr std::int32_t kBand = 3;

static_assert(sizeof(BrickEntry) == 36 && std::is_trivially_copyable_v<BrickEntry>,
              "the manifest stores an entry in 36 bytes, as in memory");
static_assert(std::endian::native == std::endian::little, "bricks need a little-endian machine");

std::int32_t floorShift(std::int32_t v, int bits) noexcept {
  return v >> bits;
}

std::vector<BrickLevel> levelsOf(const Mat3& linear, const Vec3& origin,
                                 std::array<VoxelAt, 2> extent, bool level_set) {
  std::vector<BrickLevel> levels;
  BrickLevel level;
  level.linear = linear;
  level.origin = origin;
  for (;;) {
    for (std::size_t a = 0; a < 3; ++a) {
      level.first[a] = floorShift(extent[0][a], 6);
      level.count[a] = floorShift(extent[1][a], 6) - level.first[a] + 1;
    }
    levels.push_back(level);
    if (level.bricks() <= kFew) return levels;
    // The centre of a coarser voxel is the mean of the centres of its eight finer voxels.
    level.origin += 0.5 * level.linear * Vec3::Ones();
    level.linear *= 2.0;
    const std::int32_t more = level_set ? kBand : 0;
    for (std::size_t a = 0; a < 3; ++a) {
      extent[0][a] = floorShift(extent[0][a], 1) - more;
      extent[1][a] = floorShift(extent[1][a], 1) + more;
    }
  }
}

Json jsonOf(const Vec3& v) {
  return Json::array({v.x(), v.y(), v.z()});
}
Json jsonOf(const Mat3& m) {
  return Json::array({jsonOf(Vec3(m.row(0))), jsonOf(Vec3(m.row(1))), jsonOf(Vec3(m.row(2)))});
}

/// Converts JSON to text, and replaces bytes that are not UTF-8.
std::string textOf(const Json& json, int indent = -1) {
  return json.dump(indent, ' ', false, Json::error_handler_t::replace);
}

std::uint64_t hashOf(std::string_view text) noexcept {
  std::uint64_t hash = 0xCBF29CE484222325U;
  for (const char c : text) {
    hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001B3U;
  }
  return hash;
}

std::string hexOf(std::uint64_t number) {
  std::array<char, 17> text{};
  std::snprintf(text.data(), text.size(), "%016" PRIx64, number);
  return text.data();
}

GridClass classNamed(const std::string& word) {
  for (const GridClass one : {GridClass::kUnknown, GridClass::kLevelSet, GridClass::kFog}) {
    if (word == wordFor(one)) return one;
  }
  throw std::range_error("\"class\": the value " + jsonStart(word) + " is unknown");
}

bool isMap(const Mat3& linear, const Vec3& origin) {
  const double size = linear.colwise().norm().prod();
  return linear.allFinite() && origin.allFinite() && size > 0.0 &&
         std::abs(linear.determinant()) > 1e-9 * size;
}

bool isExtent(const VoxelAt& lower, const VoxelAt& upper) {
  double bricks = 1.0;
  for (std::size_t a = 0; a < 3; ++a) {
    if (lower[a] > upper[a] || lower[a] < -kFarthestVoxel || upper[a] > kFarthestVoxel)
      return false;
    bricks *= (static_cast<double>(upper[a]) - lower[a]) / kBrickSide + 2.0;
  }
  return bricks <= static_cast<double>(kMostBricks);
}

}  // namespace

void BrickStatistics::join(const BrickStatistics& other) noexcept {
  if (other.active == 0) return;
  if (active == 0) {
    *this = other;
    return;
  }
  active += other.active;
  sum += other.sum;
  lowest = std::min(lowest, other.lowest);
  highest = std::max(highest, other.highest);
  for (std::size_t a = 0; a < 3; ++a) {
    lower[a] = std::min(lower[a], other.lower[a]);
    upper[a] = std::max(upper[a], other.upper[a]);
  }
}

BrickFacts::BrickFacts(const BrickInput& input, const BrickOptions& options) {
  const auto refuse = [&](const std::string& why, const std::string& remedy) {
    throw VolumeError("\"" + input.name + "\"", why, remedy);
  };
  if (input.grid_class == GridClass::kStaggered) {
    refuse("it is staggered, and bricks store vectors only at the voxels' centres",
           "resample the vectors to the voxels' centres, or make bricks of each component");
  }
  if (!isMap(input.linear, input.origin)) {
    refuse("its transform is singular or not finite",
           "give finite voxel edges that are not in one plane");
  }
  if (!isExtent(input.lower, input.upper)) {
    refuse("its extent is empty, more than 2^30 voxels from the origin, or above 2^32 bricks",
           "move the grid to the origin, or remove distant voxels");
  }
  for (std::size_t c = 0; c < 3; ++c) {
    float& v = manifest_.background_[c];
    v = c < input.format.components() ? input.background[c] : 0.0F;
    if (input.format.half) v = floatOfHalf(halfOfFloat(v));
    if (!std::isfinite(v)) {
      refuse("its background is not a finite number, or is too large for 16 bits (65504)",
             "give a finite background, or store 32 bits (omit --half)");
    }
  }
  if (options.compression < 1 || options.compression > 19) {
    refuse("its compression level is " + std::to_string(options.compression), "give 1 to 19");
  }
  manifest_.format_ = input.format;
  manifest_.extent_ = {input.lower, input.upper};
  manifest_.levels_ = levelsOf(input.linear, input.origin, manifest_.extent_,
                               input.grid_class == GridClass::kLevelSet && !input.format.vector);
  manifest_.entries_.resize(manifest_.levels_.size());

  facts_["bricks"] = kVersion;
  facts_["name"] = input.name;
  facts_["class"] = wordFor(input.grid_class);
  facts_["type"] = input.format.half ? "half" : "float";
  facts_["components"] = input.format.components();
  facts_["background"] = Json::array();
  for (std::size_t c = 0; c < input.format.components(); ++c) {
    facts_["background"].push_back(manifest_.background_[c]);
  }
  facts_["lower"] = input.lower;
  facts_["upper"] = input.upper;
  facts_["linear"] = jsonOf(input.linear);
  facts_["origin"] = jsonOf(input.origin);
  facts_["source"] = input.source;
  facts_["metadata"] = Json::parse(input.metadata);
  facts_["values"] = input.identity;
  facts_["zstd"] = {{"level", options.compression}, {"version", ZSTD_versionString()}};
  // A hash of all facts, so every option that changes the bytes also changes the identity.
  manifest_.identity_ = hashOf(textOf(facts_));
  facts_["identity"] = hexOf(manifest_.identity_);
  Json levels = Json::array();
  for (const BrickLevel& level : manifest_.levels_) {
    levels.push_back({{"linear", jsonOf(level.linear)},
                      {"origin", jsonOf(level.origin)},
                      {"first", level.first},
                      {"count", level.count}});
  }
  facts_["levels"] = std::move(levels);
  // Room for the statistics, which setStatistics() adds later [bytes].
  constexpr std::size_t kStatistics = 1U << 12U;
  if (textOf(facts_).size() > kMostText - kStatistics) {
    refuse("its name, source and metadata are more than 60 kB", "shorten them");
  }
}

void BrickFacts::setEntries(std::int32_t level, std::vector<BrickEntry> entries) {
  manifest_.entries_[static_cast<std::size_t>(level)] = std::move(entries);
}

void BrickFacts::setStatistics(const BrickStatistics& s) {
  Json json;
  json["active_voxels"] = s.active;
  if (s.active > 0) {
    json["active_lower"] = s.lower;
    json["active_upper"] = s.upper;
    json["lowest"] = s.lowest;
    json["highest"] = s.highest;
    json["mean"] = s.sum / static_cast<double>(s.active);
  }
  facts_["statistics"] = std::move(json);
}

std::string BrickFacts::attributes() const {
  return textOf(Json{{"palpate", facts_}}, 2) + "\n";
}

std::string BrickFacts::array(std::int32_t level, int compression) const {
  const BrickFormat& format = manifest_.format_;
  const auto& background = manifest_.background_;
  Json json;
  json["zarr_format"] = 2;
  json["shape"] = manifest_.levels_[static_cast<std::size_t>(level)].count;
  json["chunks"] = {1, 1, 1};
  for (const char* key : {"shape", "chunks"}) {
    json[key].push_back(format.slabs());
    json[key].push_back(kBrickEdge);
    json[key].push_back(kBrickEdge);
    if (format.vector) json[key].push_back(3);
  }
  json["dtype"] = format.half ? "<f2" : "<f4";
  json["compressor"] = {{"id", "zstd"}, {"level", compression}};
  // Zarr has one fill value for all components of a vector.
  const bool same =
      !format.vector || (background[1] == background[0] && background[2] == background[0]);
  json["fill_value"] = same ? background[0] : 0.0F;
  json["order"] = "C";
  json["filters"] = nullptr;
  json["dimension_separator"] = ".";
  return json.dump(2) + "\n";
}

std::vector<std::byte> BrickFacts::file() const {
  std::vector<std::byte> bytes;
  const auto add = [&](const void* from, std::size_t size) {
    const std::size_t at = bytes.size();
    bytes.resize(at + size);
    if (size > 0) std::memcpy(bytes.data() + at, from, size);
  };
  const auto number = [&](auto v) { add(&v, sizeof v); };
  const std::string facts = textOf(facts_);
  add(kMagic.data(), kMagic.size());
  number(static_cast<std::uint32_t>(facts.size()));
  add(facts.data(), facts.size());
  for (const auto& entries : manifest_.entries_) {
    number(std::uint64_t{entries.size()});
    add(entries.data(), entries.size() * sizeof(BrickEntry));
  }
  number(brickChecksum(bytes));
  return bytes;
}

namespace {

/// Parses JSON. Limits the depth of nesting, so that recursion does not exhaust the stack.
template <class... Text>
Json parseText(Text... text) {
  constexpr int kDeepest = 64;
  return Json::parse(text..., [](int depth, Json::parse_event_t /*event*/, Json& /*parsed*/) {
    if (depth > kDeepest) throw std::range_error("its JSON has more than 64 levels");
    return true;
  });
}

/// Checks a manifest's magic number and checksum, and reads it in order. Throws VolumeError.
class ManifestReader {
 public:
  ManifestReader(std::span<const std::byte> bytes, const std::string& called) : called_(called) {
    checkMagic(bytes);
    std::uint32_t checksum = 0;
    // The shortest manifest has the magic number, the length of the JSON text and the checksum.
    if (bytes.size() < kMagic.size() + 2 * sizeof checksum) refuse("it is cut off");
    rest_ = bytes.first(bytes.size() - sizeof checksum);
    std::memcpy(&checksum, bytes.data() + rest_.size(), sizeof checksum);
    if (brickChecksum(rest_) != checksum) refuse("it is cut off or damaged");
    (void)take(kMagic.size());
  }
  [[noreturn]] void refuse(const std::string& why) const {
    throw VolumeError(called_, why, kRemedy);
  }
  void checkEnd() const {
    if (rest_.empty()) return;
    refuse("it is damaged (" + std::to_string(rest_.size()) + " bytes follow the last entry)");
  }
  std::span<const std::byte> take(std::uint64_t count, std::size_t bytes_each = 1) {
    if (count > rest_.size() / bytes_each) refuse("it is damaged (it ends before its last entry)");
    const auto taken = rest_.first(count * bytes_each);
    rest_ = rest_.subspan(taken.size());
    return taken;
  }
  template <class Number>
  Number takeNumber() {
    Number number = 0;
    std::memcpy(&number, take(sizeof number).data(), sizeof number);
    return number;
  }
  std::string_view takeText() {
    const auto size = takeNumber<std::uint32_t>();
    if (size > kMostText) refuse("its description is longer than 64 kB");
    return {reinterpret_cast<const char*>(take(size).data()), size};  // NOLINT: text
  }

 private:
  void checkMagic(std::span<const std::byte> bytes) const {
    constexpr std::size_t kName = kMagic.size() - 1;  // the version number follows the name
    if (bytes.size() < kMagic.size() || std::memcmp(bytes.data(), kMagic.data(), kName) != 0) {
      refuse("it is not a manifest of bricks");
    }
    if (bytes[kName] != static_cast<std::byte>(kMagic.back())) {
      throw VolumeError(called_, "it was written by another version of palpate",
                        "read it with that version, or write it again");
    }
  }

  const std::string& called_;
  std::span<const std::byte> rest_;
};

BrickFormat readFormat(const FactsReader& facts) {
  const std::string type = facts.text("type");
  if (type != "half" && type != "float")
    throw std::range_error("\"type\": the value " + jsonStart(type) + " is not half or float");
  const std::int32_t components = facts.whole("components");
  if (components != 1 && components != 3) {
    throw std::range_error("\"components\": the value " + std::to_string(components) +
                           " is not 1 or 3");
  }
  return {components == 3, type == "half"};
}

std::array<float, 3> readBackground(const FactsReader& facts, std::size_t components) {
  const std::vector<double> numbers = facts.numbers("background", components);
  std::array<float, 3> background{};
  std::transform(numbers.begin(), numbers.end(), background.begin(),
                 [](double number) { return static_cast<float>(number); });
  return background;
}

Box boundsOfVoxels(const BrickLevel& level, const VoxelAt& lower, const VoxelAt& upper) {
  Box bounds;
  for (int corner = 0; corner < 8; ++corner) {
    Vec3 p_I;
    for (int a = 0; a < 3; ++a) {
      const auto n = static_cast<std::size_t>(a);
      p_I[a] = ((corner >> a) & 1) != 0 ? upper[n] : lower[n];
    }
    bounds.extend(level.toFile(p_I));
  }
  return bounds;
}

void readStatistics(const FactsReader& statistics, const BrickLevel& finest, GridInfo& info,
                    std::array<VoxelAt, 2>& active_box) {
  const double active = statistics.number("active_voxels");
  if (!(active >= 0.0 && active <= 1e19))
    throw std::range_error("\"statistics/active_voxels\": it is not a number from 0 to 1e19");
  info.active_voxels = static_cast<std::uint64_t>(active);
  if (info.active_voxels == 0) {
    info.refusal = "it has no active voxel: write it with its values active";
    return;
  }
  active_box = {statistics.voxel("active_lower"), statistics.voxel("active_upper")};
  info.bounds = boundsOfVoxels(finest, active_box[0], active_box[1]);
  info.lowest = statistics.number("lowest");
  info.highest = statistics.number("highest");
  info.mean = statistics.number("mean");
}

/// Returns false if the brick is outside of the pyramid, its kind is unknown, a value is not
/// finite, or its size contradicts its kind.
bool isValidEntry(const BrickEntry& entry, const BrickId& id, const BrickManifest& manifest) {
  if (!manifest.has(id) || entry.kind > BrickKind::kStored) return false;
  const auto is_finite = [](float v) { return std::isfinite(v); };
  return std::all_of(entry.value.begin(), entry.value.end(), is_finite) &&
         (entry.kind == BrickKind::kStored) == (entry.bytes > 0);
}

/// Reads the entries of a level. Throws VolumeError if one is invalid, or if they are not in the
/// order of BrickId.
std::vector<BrickEntry> readEntries(ManifestReader& reader, const BrickManifest& manifest,
                                    std::int32_t level) {
  const auto count = reader.takeNumber<std::uint64_t>();
  const auto rows = reader.take(count, sizeof(BrickEntry));
  std::vector<BrickEntry> entries(count);
  if (count > 0) std::memcpy(entries.data(), rows.data(), rows.size());
  for (std::size_t n = 0; n < entries.size(); ++n) {
    if (!isValidEntry(entries[n], {level, entries[n].at}, manifest) ||
        (n > 0 && entries[n - 1].at >= entries[n].at)) {
      reader.refuse("it is damaged (entry " + std::to_string(n + 1) + " of level " +
                    std::to_string(level) + " is invalid or not in order)");
    }
  }
  return entries;
}

}  // namespace

std::size_t BrickFacts::headOf(std::span<const std::byte> manifest) noexcept {
  std::uint32_t size = 0;
  constexpr std::size_t kBefore = kMagic.size() + sizeof size;
  if (manifest.size() < kBefore) return manifest.size();
  std::memcpy(&size, manifest.data() + kMagic.size(), sizeof size);
  return kBefore + size;
}

std::uint64_t BrickFacts::identityIn(const std::string& attributes) noexcept {
  try {
    const Json facts = parseText(attributes);
    return FactsReader(facts.at("palpate")).hexadecimal("identity");
  } catch (const std::exception&) {
    return 0;
  }
}

void BrickFacts::readFacts(const Json& json, BrickManifest& manifest) {
  const FactsReader facts(json);
  if (facts.whole("bricks") != kVersion) {
    throw std::range_error("\"bricks\": the version differs from that in the first 8 bytes");
  }
  GridInfo& info = manifest.info_;
  info.name = facts.text("name");
  info.grid_class = classNamed(facts.text("class"));
  info.source = facts.text("source");
  manifest.format_ = readFormat(facts);
  manifest.background_ = readBackground(facts, manifest.format_.components());
  manifest.extent_ = {facts.voxel("lower"), facts.voxel("upper")};
  const Mat3 linear = facts.matrix("linear");
  const Vec3 origin = facts.vec("origin");
  if (!isMap(linear, origin)) throw std::range_error("\"linear\": the transform is singular");
  if (!isExtent(manifest.extent_[0], manifest.extent_[1])) {
    throw std::range_error(
        "\"lower\", \"upper\": the extent is empty, beyond 2^30 voxels, or above 2^32 bricks");
  }
  const Json& metadata = facts.at("metadata");
  if (!metadata.is_object()) throw std::range_error("\"metadata\": it is not an object");
  manifest.metadata_ = metadata.dump();
  const Json missing = {{"bool", true}};
  const Json mesh = {{"string", "mesh"}};
  manifest.inactive_ =
      inactiveVoxels(metadata.value(kMetaImportedFrom, Json()) == mesh ? "mesh" : "",
                     metadata.value(kMetaInactiveIsMissing, Json()) == missing);
  manifest.identity_ = facts.hexadecimal("identity");
  const bool level_set = info.grid_class == GridClass::kLevelSet && !manifest.format_.vector;
  manifest.levels_ = levelsOf(linear, origin, manifest.extent_, level_set);

  info.vector = manifest.format_.vector;
  info.half = manifest.format_.half;
  info.type = info.vector ? "vec3s" : "float";
  info.voxel = linear.colwise().norm().transpose();
  const Vec3 background(manifest.background_[0], manifest.background_[1], manifest.background_[2]);
  info.background = info.vector ? background.norm() : background.x();
  readStatistics(FactsReader(facts.at("statistics"), "statistics/"), manifest.levels_.front(), info,
                 manifest.active_box_);
}

BrickManifest BrickFacts::parse(std::span<const std::byte> bytes, const std::string& called) {
  ManifestReader reader(bytes, called);
  const std::string_view text = reader.takeText();
  BrickManifest manifest;
  try {
    readFacts(parseText(text.begin(), text.end()), manifest);
  } catch (const std::bad_alloc&) {
    throw VolumeError(called, "the system has too little memory",
                      "end other programs to free memory");
  } catch (const std::exception& e) {
    std::string why = e.what();
    std::replace(why.begin(), why.end(), '\n', ' ');
    throw VolumeError(called, "it is damaged (" + why + ")", kRemedy);
  }
  manifest.entries_.resize(manifest.levels_.size());
  for (std::size_t l = 0; l < manifest.levels_.size(); ++l) {
    manifest.entries_[l] = readEntries(reader, manifest, static_cast<std::int32_t>(l));
  }
  for (const BrickEntry& entry : manifest.entries_.front()) {
    if (entry.kind == BrickKind::kStored) manifest.info_.memory += manifest.format_.bytes();
  }
  reader.checkEnd();
  return manifest;
}

}  // namespace palpate
