#include "palpate/samplers/grid/vdb_reader.h"

#include <algorithm>
#include <array>
#include <cinttypes>
#include <cstdio>
#include <sys/mman.h>
#include <utility>

namespace palpate {

std::uint64_t leastMemoryOf(const openvdb::GridBase& header) {
  using openvdb::GridBase;
  using openvdb::Int64Metadata;
  const auto memory = header.getMetadata<Int64Metadata>(GridBase::META_FILE_MEM_BYTES);
  const auto voxels = header.getMetadata<Int64Metadata>(GridBase::META_FILE_VOXEL_COUNT);
  if (memory == nullptr || voxels == nullptr) return 0;
  // Takes the smaller of two numbers: the tree's memory, and the active voxels' values. In tiles,
  // many voxels take little memory.
  const std::string type = header.valueType();
  const double size = (type.ends_with('d') || type == "double" ? 8.0 : 4.0) *
                      (type.starts_with("vec3") ? 3.0 : 1.0);
  const double least =
      std::min(static_cast<double>(memory->value()), size * static_cast<double>(voxels->value()));
  return static_cast<std::uint64_t>(std::clamp(least, 0.0, 1e18));
}

void dropMapped(const std::string& path) {
  if (path.empty()) return;
  std::ifstream maps("/proc/self/maps");
  for (std::string line; std::getline(maps, line);) {
    // Format of a line: begin-end permissions offset device inode path
    const std::size_t slash = line.find('/');
    if (slash == std::string::npos || line.compare(slash, std::string::npos, path) != 0) continue;
    std::uintptr_t begin = 0;
    std::uintptr_t end = 0;
    std::array<char, 5> permissions{};
    if (std::sscanf(line.c_str(), "%" SCNxPTR "-%" SCNxPTR " %4s", &begin, &end,
                    permissions.data()) != 3 ||
        permissions[1] == 'w') {
      continue;
    }
#ifdef MADV_PAGEOUT
    madvise(reinterpret_cast<void*>(begin), end - begin, MADV_PAGEOUT);  // NOLINT: an address
#endif
  }
}

VdbReader::VdbReader(const std::filesystem::path& file) {
  stream_.exceptions(std::ios::failbit | std::ios::badbit | std::ios::eofbit);
  stream_.open(file, std::ios::binary);
  readHeader(stream_);
  setFormatVersion(stream_);
  setLibraryVersion(stream_);
  setDataCompression(stream_);
  openvdb::MetaMap().readMeta(stream_);
  const std::int32_t count = inputHasGridOffsets() ? readGridCount(stream_) : 0;
  for (std::int32_t i = 0; i < count; ++i) {
    openvdb::io::GridDescriptor d;
    (void)d.read(stream_);
    const auto& [name, kept] = *grids_.emplace(d.uniqueName(), d).first;
    const std::string called = openvdb::io::GridDescriptor::nameAsString(name);
    const std::string stem = openvdb::io::GridDescriptor::stripSuffix(name);
    by_name_.emplace(called, &kept);
    ++alike_[called];
    if (stem != called) ++alike_[stem];
    d.seekToEnd(stream_);
  }
}

bool VdbReader::plain(const std::string& name) const {
  const openvdb::io::GridDescriptor& d = *by_name_.at(name);
  return !d.isInstance() && alike_.at(name) == 1 &&
         openvdb::io::GridDescriptor::stringAsUniqueName(name) == d.uniqueName();
}

openvdb::GridBase::Ptr VdbReader::read(const std::string& name) {
  const openvdb::io::GridDescriptor& d = *by_name_.at(name);
  openvdb::GridBase::Ptr grid = readOwn(d);
  // VdbCheck has checked that the parent grid stores its own tree.
  if (d.isInstance()) {
    grid->setTree(readOwn(grids_.at(d.instanceParentName()))->baseTreePtr());
  }
  return grid;
}

openvdb::GridBase::Ptr VdbReader::readMetadata(const std::string& name) {
  openvdb::GridBase::Ptr grid = begin(*by_name_.at(name));
  readGridCompression(stream_);
  grid->readMeta(stream_);
  grid->readTransform(stream_);
  return grid;
}

openvdb::GridBase::Ptr VdbReader::readOwn(const openvdb::io::GridDescriptor& d) {
  openvdb::GridBase::Ptr grid = begin(d);
  readGrid(grid, d, stream_);
  return grid;
}

openvdb::GridBase::Ptr VdbReader::begin(const openvdb::io::GridDescriptor& d) {
  d.seekToGrid(stream_);
  openvdb::GridBase::Ptr grid = openvdb::GridBase::createGrid(d.gridType());
  grid->setSaveFloatAsHalf(d.saveFloatAsHalf());
  return grid;
}

}  // namespace palpate
