/// Private to samplers, for .cpp files only: reads grids of .vdb files by their positions.
#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <unordered_map>

#include <openvdb/io/Archive.h>
#include <openvdb/io/GridDescriptor.h>
#include <openvdb/openvdb.h>

namespace palpate {

/// Returns the memory that a grid of numbers takes at least [bytes], by its metadata; 0: unknown.
[[nodiscard]] std::uint64_t leastMemoryOf(const openvdb::GridBase& header);

/// Drops the pages of OpenVDB's memory maps of a file, so that memory does not hold both the file
/// and the grid. Skips writable maps. Uses MADV_PAGEOUT, and does nothing on systems without it.
/// MADV_DONTNEED could lose data, if another thread maps data at the address after the list was
/// read.
/// @param path  Absolute path. If it is empty, the function does nothing.
void dropMapped(const std::string& path);

/// Reads grids through a stream, at the positions in the file's table of contents. Without a table,
/// the reader has no grids. OpenVDB's own reader searches all grids of a name for each grid. If a
/// file ends too early, a stream throws an exception; a memory map would end the program.
class VdbReader : private openvdb::io::Archive {
 public:
  /// Reads the table of contents. The file must be a .vdb file.
  explicit VdbReader(const std::filesystem::path& file);

  /// Returns true if the table has a grid of this name, as users write it.
  [[nodiscard]] bool has(const std::string& name) const { return by_name_.count(name) != 0; }
  /// Returns OpenVDB's type of a grid that the table has.
  [[nodiscard]] const std::string& type(const std::string& name) const {
    return by_name_.at(name)->gridType();
  }
  /// Returns true if the grid has its own tree, and if OpenVDB's reader finds this grid by `name`.
  [[nodiscard]] bool plain(const std::string& name) const;

  /// Reads a grid that the table has.
  [[nodiscard]] openvdb::GridBase::Ptr read(const std::string& name);
  /// Reads a grid without its tree.
  [[nodiscard]] openvdb::GridBase::Ptr readMetadata(const std::string& name);

 private:
  openvdb::GridBase::Ptr readOwn(const openvdb::io::GridDescriptor& d);
  openvdb::GridBase::Ptr begin(const openvdb::io::GridDescriptor& d);

  std::ifstream stream_;
  /// Grids by their unique names in the file.
  std::unordered_map<std::string, openvdb::io::GridDescriptor> grids_;
  /// Grids by their names as users write them.
  std::unordered_map<std::string, const openvdb::io::GridDescriptor*> by_name_;
  /// For each name, the number of grids that the name may denote.
  std::unordered_map<std::string, int> alike_;
};

}  // namespace palpate
