#include "palpate/samplers/grid/vdb_check.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <map>
#include <numeric>
#include <sstream>
#include <string_view>
#include <vector>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/openvdb_grids.h"

namespace palpate {
namespace {

static_assert(std::endian::native == std::endian::little,
              "palpate reads .vdb files only on little-endian machines");

/// Describes how the file stores a value of one type of grid.
struct ValueKind {
  std::string tree;
  std::uint64_t bytes;
  /// Bytes of a value in the nodes of a grid that is saved with 16 bits per number.
  std::uint64_t half_bytes;
  /// Bytes of a leaf after its mask, for bools and masks: the origin and, for bools, the values'
  /// bits. 0 for other types, which have an array of values.
  std::uint64_t leaf_bytes = 0;
};

const std::vector<ValueKind>& kinds() {
  static const std::vector<ValueKind> list{
      {openvdb::FloatTree::treeType(), 4, 2},         {openvdb::DoubleTree::treeType(), 8, 2},
      {openvdb::Vec3STree::treeType(), 12, 6},        {openvdb::Vec3DTree::treeType(), 24, 6},
      {openvdb::Int32Tree::treeType(), 4, 4},         {openvdb::Int64Tree::treeType(), 8, 8},
      {openvdb::BoolTree::treeType(), 1, 1, 12 + 64}, {openvdb::MaskTree::treeType(), 1, 1, 12}};
  return list;
}

const ValueKind* kindOf(const std::string& tree_type) {
  const auto found = std::find_if(kinds().begin(), kinds().end(),
                                  [&](const ValueKind& kind) { return kind.tree == tree_type; });
  return found == kinds().end() ? nullptr : &*found;
}

struct GridEntry {
  std::string name;
  std::string type;  ///< Type of the tree, without the suffix that marks 16-bit grids.
  /// Name of the grid that stores the tree of this grid; empty if the grid stores it itself.
  std::string parent;
  std::int64_t grid = 0;
  std::int64_t block = 0;
  std::int64_t end = 0;
};

using Origin = std::array<std::int32_t, 3>;

}  // namespace

class VdbCheck::Walk {
 public:
  Walk(const std::filesystem::path& file, const std::string& called)
      : path_(called), stream_(file, std::ios::binary), buffer_(kBuffer) {
    size_ = std::filesystem::file_size(file);
    limit_ = size_;
  }

  void file() {
    header();
    (void)metadata();
    const auto count = take<std::int32_t>();
    if (count < 0) damaged("its number of grids is negative");
    if (static_cast<std::uint64_t>(count) > left() / 36) tooLarge();
    for (std::int32_t i = 0; i < count; ++i) {
      const GridEntry d = descriptor();
      if (find(d.name) != nullptr) damaged("two of its grids are named " + nameOf(d.name));
      grids_.emplace(nameOf(d.name), d);
      grid(d, !has_offsets_);
    }
    for (const auto& [name, d] : grids_) (void)ownerOf(d);
  }

  std::uint64_t tree(const std::string& name) {
    // Without a table of contents, the constructor has already checked the trees.
    if (!has_offsets_) return size_;
    std::uint64_t bytes = 0;
    const auto [first, last] = grids_.equal_range(name);
    for (auto entry = first; entry != last; ++entry) {
      const GridEntry& d = entry->second;
      const GridEntry& owner = ownerOf(d);
      limit_ = size_;
      bounded_ = false;
      seek(static_cast<std::uint64_t>(owner.grid));
      grid(owner, true);
      bytes += static_cast<std::uint64_t>(owner.end - owner.grid);
    }
    return bytes;
  }

 private:
  static constexpr std::size_t kBuffer = 1U << 18U;

  /// Returns the name of a grid as users write it, such as density[1].
  static std::string nameOf(const std::string& unique) {
    return openvdb::io::GridDescriptor::nameAsString(unique);
  }
  /// Finds a grid by its name in the file. For users, a grid called density[0] and the first of two
  /// called density have the same name.
  [[nodiscard]] const GridEntry* find(const std::string& unique) const {
    const auto [first, last] = grids_.equal_range(nameOf(unique));
    const auto found =
        std::find_if(first, last, [&](const auto& entry) { return entry.second.name == unique; });
    return found == last ? nullptr : &found->second;
  }
  [[nodiscard]] const GridEntry& ownerOf(const GridEntry& d) const {
    if (d.parent.empty()) return d;
    const GridEntry* parent = find(d.parent);
    if (parent == nullptr || !parent->parent.empty() || parent->type != d.type) {
      damaged(
          "grid \"" + nameOf(d.name) +
          "\" shares the tree of a grid that does not exist, has another type or shares a tree");
    }
    return *parent;
  }

  [[noreturn]] void damaged(const std::string& why) const {
    throw VolumeError(path_, "it is damaged (" + why + ")", "copy or write it again");
  }
  [[noreturn]] void truncated() const {
    throw VolumeError(path_, "it is truncated", "copy or write it again");
  }

  [[noreturn]] void tooLarge() const {
    if (!bounded_) truncated();
    damaged("a part of a grid is larger than the grid's section of the file");
  }

  [[nodiscard]] std::uint64_t position() const { return read_ - (filled_ - cursor_); }
  /// Returns the number of bytes up to the end of the section.
  [[nodiscard]] std::uint64_t left() const { return limit_ - position(); }

  void need(std::uint64_t bytes) const {
    if (bytes > left()) tooLarge();
  }

  /// Returns the next `bytes` bytes, at most kBuffer. They are valid until the next call.
  const unsigned char* take(std::size_t bytes) {
    if (filled_ - cursor_ < bytes || left() < bytes) refill(bytes);
    const unsigned char* data = buffer_.data() + cursor_;
    cursor_ += bytes;
    return data;
  }

  void refill(std::size_t bytes) {
    need(bytes);
    std::copy(buffer_.begin() + static_cast<std::ptrdiff_t>(cursor_),
              buffer_.begin() + static_cast<std::ptrdiff_t>(filled_), buffer_.begin());
    filled_ -= cursor_;
    cursor_ = 0;
    // Does not read beyond the section, so a check of a small grid reads only the grid's own bytes.
    const std::uint64_t more = std::min<std::uint64_t>(kBuffer - filled_, limit_ - read_);
    stream_.read(reinterpret_cast<char*>(buffer_.data() + filled_),
                 static_cast<std::streamsize>(more));
    if (!stream_) {
      if (stream_.eof()) truncated();  // the file became shorter during the read
      throw VolumeError(path_, "it cannot be read",
                        "check the disk, and the limit of open files (ulimit -n)");
    }
    read_ += more;
    filled_ += static_cast<std::size_t>(more);
  }

  template <class T>
  T take() {
    T value;
    std::memcpy(&value, take(sizeof value), sizeof value);
    return value;
  }

  void skip(std::uint64_t bytes) {
    need(bytes);
    const std::uint64_t here = std::min<std::uint64_t>(bytes, filled_ - cursor_);
    cursor_ += static_cast<std::size_t>(here);
    if (here < bytes) seek(read_ + (bytes - here));
  }

  void seek(std::uint64_t place) {
    read_ = place;
    cursor_ = filled_ = 0;
    stream_.seekg(static_cast<std::streamoff>(place));
  }

  std::string string(std::uint32_t longest) {
    const auto bytes = take<std::uint32_t>();
    if (bytes > longest) {
      damaged("a name or a type has " + std::to_string(bytes) + " bytes, more than " +
              std::to_string(longest));
    }
    const unsigned char* data = take(bytes);
    return {reinterpret_cast<const char*>(data), bytes};
  }

  bool boolean() {
    const auto byte = take<std::uint8_t>();
    if (byte > 1) damaged("a boolean value in it is neither 0 nor 1");
    return byte == 1;
  }

  void header() {
    if (take<std::int64_t>() != openvdb::OPENVDB_MAGIC)
      damaged("it does not begin with the signature of a .vdb file");
    const auto version = take<std::uint32_t>();
    if (version > openvdb::OPENVDB_FILE_VERSION) {
      throw VolumeError(path_, "it is of a newer format (" + std::to_string(version) + ")",
                        "write it again with an older OpenVDB");
    }
    if (version < openvdb::OPENVDB_FILE_VERSION_NODE_MASK_COMPRESSION) {
      throw VolumeError(path_, "it is of an old format (" + std::to_string(version) + ")",
                        "read and write it again with OpenVDB 3 or newer");
    }
    skip(8);  // version of the library
    has_offsets_ = boolean();
    skip(36);  // unique number of the file
  }

  /// Reads a map of metadata. Returns true if the grid is saved with 16 bits per number.
  bool metadata() {
    bool half = false;
    const auto count = take<std::uint32_t>();
    if (count > left() / 12) tooLarge();
    for (std::uint32_t i = 0; i < count; ++i) {
      const std::string name = string(kBuffer / 2);
      const std::string type = string(kBuffer / 2);
      const auto bytes = take<std::uint32_t>();
      need(bytes);
      const std::uint64_t end = position() + bytes;
      const bool saved_as_half = name == openvdb::GridBase::META_SAVE_HALF_FLOAT;
      if (type != openvdb::StringMetadata::staticTypeName() &&
          openvdb::Metadata::isRegisteredType(type)) {
        // OpenVDB reads as many bytes as the type has, so the stated size must be equal.
        if (openvdb::Metadata::createMetadata(type)->size() != bytes) {
          damaged("metadata of type " + type + " have the wrong size of " + std::to_string(bytes) +
                  " bytes");
        }
        if (type == openvdb::BoolMetadata::staticTypeName()) {
          const bool value = boolean();
          if (saved_as_half) half = value;
        }
      }
      if (saved_as_half && type != openvdb::BoolMetadata::staticTypeName()) {
        damaged("the metadata " + name + " of a grid are not a boolean");
      }
      skip(end - position());
    }
    return half;
  }

  GridEntry descriptor() {
    constexpr std::uint32_t kLongest = 1U << 12U;
    GridEntry d;
    d.name = string(kLongest);
    d.type = string(kLongest);
    d.parent = string(kLongest);
    // The character 0x1e separates the name of a grid from its number.
    const auto control = [](unsigned char c) { return (c < 0x20 && c != 0x1e) || c == 0x7f; };
    for (const std::string& text : {d.name, d.type, d.parent}) {
      if (std::any_of(text.begin(), text.end(), control)) {
        damaged("a grid's name or type contains control characters");
      }
    }
    constexpr std::string_view kHalf = "_HalfFloat";
    if (d.type.ends_with(kHalf)) d.type.resize(d.type.size() - kHalf.size());
    d.grid = take<std::int64_t>();
    d.block = take<std::int64_t>();
    d.end = take<std::int64_t>();
    return d;
  }

  void grid(const GridEntry& d, bool walk) {
    const ValueKind* kind = kindOf(d.type);
    const bool instance = !d.parent.empty();
    if (has_offsets_) {
      const auto size = static_cast<std::int64_t>(size_);
      if (d.grid > size || d.block > size || d.end > size) truncated();
      const std::int64_t block = instance ? d.grid : d.block;
      if (d.grid < static_cast<std::int64_t>(position()) || block < d.grid || d.end < block) {
        damaged("the parts of grid \"" + nameOf(d.name) + "\" are not in order");
      }
      skip(static_cast<std::uint64_t>(d.grid) - position());
      limit_ = static_cast<std::uint64_t>(d.end);
      bounded_ = true;
    } else if (kind == nullptr && !instance) {
      throw VolumeError(path_,
                        "its grid \"" + nameOf(d.name) + "\" has the unsupported type " + d.type +
                            ", and cannot be skipped without a table of contents",
                        "write the file with OpenVDB's io::File, or omit that grid");
    }

    const auto compression = take<std::uint32_t>();
    if (compression > 7) damaged("the compression of grid \"" + nameOf(d.name) + "\" is unknown");
    const bool half = metadata();
    transform();
    walk = walk && kind != nullptr;
    if (walk && !instance) tree(*kind, compression, half, d);

    if (has_offsets_) {
      // Trees that are not requested or not supported are never read: their errors do no harm.
      if (!walk) skip(left());
      if (left() > 0) damaged("grid \"" + nameOf(d.name) + "\" does not end where the file states");
      limit_ = size_;
      bounded_ = false;
    }
  }

  void transform(bool within_frustum = false) {
    using namespace openvdb::math;
    const std::string type = string(256);
    const auto is = [&](const openvdb::Name& name) { return type == name; };
    if (is(TranslationMap::mapType())) {
      numbers(3);
    } else if (is(ScaleMap::mapType()) || is(UniformScaleMap::mapType())) {
      numbers(3);
      skip(12 * sizeof(double));  // values that OpenVDB computes from the scales
    } else if (is(ScaleTranslateMap::mapType()) || is(UniformScaleTranslateMap::mapType())) {
      numbers(6);
      skip(12 * sizeof(double));
    } else if (is(AffineMap::mapType()) || is(UnitaryMap::mapType())) {
      const auto m = numbers(16);
      if (m[3] != 0.0 || m[7] != 0.0 || m[11] != 0.0 || m[15] != 1.0) {
        damaged("a transform is not affine");
      }
    } else if (is(NonlinearFrustumMap::mapType()) && !within_frustum) {
      numbers(8);
      transform(true);
    } else {
      damaged("a transform is of unknown type");
    }
  }

  /// Reads numbers of a transform. Rejects finite numbers above 1e30, which could overflow in later
  /// computations. Later checks reject transforms that are singular or not finite.
  std::array<double, 16> numbers(std::size_t count) {
    std::array<double, 16> values{};
    for (std::size_t i = 0; i < count; ++i) {
      values[i] = take<double>();
      const double size = std::abs(values[i]);
      if (std::isfinite(size) && size > 1e30) {
        damaged("a transform holds a number above 1e30 in size");
      }
    }
    return values;
  }

  struct Storage {
    std::uint64_t value;   ///< Size of a single value [bytes].
    std::uint64_t packed;  ///< Size of a value in the array of a node [bytes].
    bool half;
    bool zip;
    bool blosc;
    bool active_only;
  };
  struct Branch {
    Origin origin;
    std::size_t first;
    std::size_t last;
  };
  using LeafMask = std::array<std::uint64_t, 8>;

  template <std::size_t Words>
  static std::uint64_t countOn(const std::array<std::uint64_t, Words>& mask) {
    return std::accumulate(mask.begin(), mask.end(), std::uint64_t{0},
                           [](std::uint64_t sum, std::uint64_t word) {
                             return sum + static_cast<std::uint64_t>(std::popcount(word));
                           });
  }

  void tree(const ValueKind& kind, std::uint32_t compression, bool half, const GridEntry& d) {
    using namespace openvdb::io;
    const bool blosc = (compression & COMPRESS_BLOSC) != 0;
    half = half && kind.half_bytes < kind.bytes;  // 16 bits are only for floating-point numbers
    const Storage storage{kind.bytes, half ? kind.half_bytes : kind.bytes,
                          half,       !blosc && (compression & COMPRESS_ZIP) != 0,
                          blosc,      (compression & COMPRESS_ACTIVE_MASK) != 0};
    leaves_.clear();
    std::vector<Branch> branches = topology(storage);
    if (has_offsets_ && static_cast<std::int64_t>(position()) != d.block) {
      damaged("a tree's nodes do not end where its values begin");
    }
    // OpenVDB reads the values in the order of the children's origins, not of the nodes in the
    // file.
    std::sort(branches.begin(), branches.end(),
              [](const Branch& a, const Branch& b) { return a.origin < b.origin; });
    for (const Branch& branch : branches) {
      for (std::size_t i = branch.first; i < branch.last; ++i) {
        if (take<LeafMask>() != leaves_[i]) damaged("a leaf has two different masks");
        if (kind.leaf_bytes > 0) {
          skip(kind.leaf_bytes);
        } else {
          values<8>(storage, countOn(leaves_[i]));
        }
      }
    }
  }

  /// Reads the nodes of a tree without the leaves' values. Stores the leaves' masks in leaves_.
  std::vector<Branch> topology(const Storage& storage) {
    if (take<std::int32_t>() != 1) damaged("a tree does not have exactly one buffer");
    skip(storage.value);  // value of the background
    const auto tiles = take<std::uint32_t>();
    const auto children = take<std::uint32_t>();
    if (tiles > left() / (13 + storage.value) || children > left() / (12 + 8192)) tooLarge();
    std::vector<Origin> origins;
    const auto origin = [&] {
      origins.push_back(take<Origin>());
      for (const std::int32_t i : origins.back()) {
        if (i % 4096 != 0 || i < -1000001536 || i > 1000001536)
          damaged("the origin of a node is not a multiple of 4096 within +-1000001536");
      }
      return origins.back();
    };
    for (std::uint32_t i = 0; i < tiles; ++i) {
      (void)origin();
      skip(storage.value);
      (void)boolean();
    }
    std::vector<Branch> branches;
    for (std::uint32_t i = 0; i < children; ++i) {
      branches.push_back({origin(), leaves_.size(), 0});
      upperNode(storage);
      branches.back().last = leaves_.size();
    }
    std::sort(origins.begin(), origins.end());
    if (std::adjacent_find(origins.begin(), origins.end()) != origins.end()) {
      damaged("two nodes are at the same place");
    }
    return branches;
  }

  void upperNode(const Storage& storage) {
    const std::uint64_t children = innerNode<512>(storage);
    for (std::uint64_t i = 0; i < children; ++i) {
      const std::uint64_t leaves = innerNode<64>(storage);
      for (std::uint64_t j = 0; j < leaves; ++j) leaves_.push_back(take<LeafMask>());
    }
  }

  /// Reads the masks and the tiles of a node. Returns the number of children that follow.
  template <std::size_t Words>
  std::uint64_t innerNode(const Storage& storage) {
    const auto child = take<std::array<std::uint64_t, Words>>();
    const auto value = take<std::array<std::uint64_t, Words>>();
    for (std::size_t i = 0; i < Words; ++i) {
      if ((child[i] & value[i]) != 0) damaged("an entry of a node is both a child and a tile");
    }
    values<Words>(storage, countOn(value), true);
    return countOn(child);
  }

  /// Reads a node's values, with a mask of `Words` words, like OpenVDB's readCompressedValues().
  template <std::size_t Words>
  void values(const Storage& storage, std::uint64_t active, bool unpack = false) {
    // For a `kind` of 3 to 5, a selection mask follows. For 2 and 4, one inactive value follows;
    // for 5, two inactive values. For 6, all values are stored.
    const auto kind = take<std::uint8_t>();
    if (kind > 6) damaged("the storage type of a node is " + std::to_string(kind) + ", not 0 to 6");
    if (kind == 2 || kind == 4) skip(storage.value);
    if (kind == 5) skip(2 * storage.value);
    if (kind >= 3 && kind <= 5) skip(Words * 8);
    const std::uint64_t count = storage.active_only && kind != 6 ? active : Words * 64;
    const std::uint64_t bytes = count * storage.packed;
    if (!storage.zip && !storage.blosc) {
      skip(bytes);
    } else if (count > 0 || !storage.half) {  // a 16-bit grid has no chunk for an empty array
      chunk(storage, bytes, unpack);
    }
  }

  /// Reads a compressed array of `bytes` bytes. If `unpack`, also decompresses the array to check
  /// it. Arrays of tiles need this check: if OpenVDB cannot decompress one, it leaks a child of the
  /// root node and all nodes below.
  void chunk(const Storage& storage, std::uint64_t bytes, bool unpack) {
    const auto size = take<std::int64_t>();
    if (size <= 0) {  // the array is stored without compression
      if (0 - static_cast<std::uint64_t>(size) != bytes) {
        damaged("the values of a node do not have the expected size of " + std::to_string(bytes) +
                " bytes");
      }
      skip(bytes);
      return;
    }
    const auto packed = static_cast<std::uint64_t>(size);
    need(packed);
    std::uint64_t rest = packed;
    std::string data(reinterpret_cast<const char*>(&size), sizeof size);
    if (storage.blosc) {
      const unsigned char* header = bloscHeader(packed, bytes);
      if (unpack) data.append(reinterpret_cast<const char*>(header), 16);
      rest -= 16;
    } else if (packed > bytes + bytes / 1000 + 64) {
      damaged("a compressed part has " + std::to_string(packed) + " bytes, more than its " +
              std::to_string(bytes) + " uncompressed bytes allow");
    }
    if (!unpack) {
      skip(rest);
      return;
    }
    while (rest > 0) {
      const auto piece = static_cast<std::size_t>(std::min<std::uint64_t>(rest, kBuffer));
      data.append(reinterpret_cast<const char*>(take(piece)), piece);
      rest -= piece;
    }
    try {
      std::istringstream stream(data);
      std::vector<char> unpacked(bytes + 1);
      if (storage.blosc) openvdb::io::bloscFromStream(stream, unpacked.data(), bytes);
      if (storage.zip) openvdb::io::unzipFromStream(stream, unpacked.data(), bytes);
    } catch (const openvdb::Exception&) {
      damaged("a compressed part cannot be decompressed");
    }
  }

  /// Reads the first 16 bytes of a blosc chunk, and checks the three sizes in it.
  const unsigned char* bloscHeader(std::uint64_t packed, std::uint64_t bytes) {
    if (packed < 16) {
      damaged("a compressed part has " + std::to_string(packed) + " bytes, fewer than 16");
    }
    const unsigned char* header = take(16);
    const unsigned flags = header[2];
    const unsigned type = header[3];
    std::array<std::uint32_t, 3> sizes{};
    std::memcpy(sizes.data(), header + 4, sizeof sizes);
    const std::uint64_t unpacked = sizes[0];
    const std::uint64_t block = sizes[1];
    if (unpacked != bytes || sizes[2] != packed) {
      damaged("a compressed part does not have the expected size");
    }
    if (unpacked == 0) return header;
    if (type == 0 || block == 0 || block > unpacked) {
      damaged("a compressed part has blocks of an invalid size");
    }
    // The data are stored without compression, or with one offset for each block.
    const std::uint64_t blocks = (unpacked + block - 1) / block;
    const bool stored = (flags & 2U) != 0;
    if (stored ? packed != unpacked + 16 : packed < 16 + 4 * blocks) {
      damaged("the size of a compressed part does not fit its blocks");
    }
    return header;
  }

  std::string path_;
  std::ifstream stream_;
  std::vector<unsigned char> buffer_;
  std::size_t cursor_ = 0;  ///< Position in the buffer.
  std::size_t filled_ = 0;
  std::uint64_t read_ = 0;  ///< Position in the file at which the buffer ends.
  std::uint64_t size_ = 0;
  std::uint64_t limit_ = 0;  ///< End of the section that is being read.
  /// True if the file states where the section ends. If false, the section ends with the file.
  bool bounded_ = false;
  bool has_offsets_ = true;  ///< True if the file states where its grids begin and end.
  std::multimap<std::string, GridEntry> grids_;
  std::vector<LeafMask> leaves_;
};

bool isReadType(const std::string& tree_type) {
  return kindOf(tree_type) != nullptr;
}

VdbCheck::VdbCheck(const std::filesystem::path& file, const std::string& called)
    : walk_(std::make_unique<Walk>(file, called)) {
  walk_->file();
}

VdbCheck::~VdbCheck() = default;

std::uint64_t VdbCheck::tree(const std::string& grid) {
  return walk_->tree(grid);
}

}  // namespace palpate
