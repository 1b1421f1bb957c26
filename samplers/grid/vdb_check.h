/// Private to samplers: checks that a .vdb file is whole before OpenVDB reads it. Include it in
/// .cpp files only.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

namespace palpate {

/// Returns whether a grid type is supported, by OpenVDB's name of the tree. Trees of other types
/// are never read, because they are not checked.
[[nodiscard]] bool isFeltType(const std::string& tree_type);

/// Walks a file's structure as OpenVDB would read it, without building a tree. Every count, size
/// and position must fit, and every node must end where the next begins. OpenVDB does not check
/// the file: it reads zeros beyond the end of a truncated file, and a flipped bit makes it allocate
/// gigabytes or crash. A file that passes can be read; its values may still be wrong, because the
/// format has no checksum. Reads each part that it walks once, in pieces: some 64 bytes of memory
/// per leaf. All members throw VolumeError if the file is truncated, damaged, or written by an
/// OpenVDB too old or too new.
class VdbCheck {
 public:
  /// Walks all that precedes the trees; a file without a table of contents is walked from end to
  /// end. Call openvdb::initialize() before.
  /// @param called  The file's name in errors.
  VdbCheck(const std::filesystem::path& file, const std::string& called);
  VdbCheck(const VdbCheck&) = delete;
  VdbCheck& operator=(const VdbCheck&) = delete;
  ~VdbCheck();

  /// Walks the tree of a grid, or the tree that it shares. `grid` is its name as users call it.
  /// Returns how much of the file is read for it [bytes]. The cost depends on the tree, not on the
  /// number of grids.
  std::uint64_t tree(const std::string& grid);

 private:
  class Walk;
  std::unique_ptr<Walk> walk_;
};

}  // namespace palpate
