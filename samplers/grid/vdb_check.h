/// Private to samplers: checks that a .vdb file is complete and consistent before OpenVDB reads it.
/// Include it in .cpp files only.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

namespace palpate {

/// Returns true if trees of this type can be read: floats, doubles and vectors of these, for a
/// hand; whole numbers, bools and masks, for their description. `tree_type` is OpenVDB's name of
/// the type. Trees of other types are not checked, and therefore never read.
[[nodiscard]] bool isReadType(const std::string& tree_type);

/// Reads the structure of a file as OpenVDB would, without building a tree. Every count, size and
/// position must fit, and every node must end where the next one begins. OpenVDB itself does not
/// check the file. It reads zeros beyond the end of a truncated file, and a flipped bit can make it
/// allocate gigabytes or crash. OpenVDB can read every file that passes this check. Values may
/// still be wrong, because the format has no checksum. Each part is read once, in pieces. The
/// memory is some 64 bytes per leaf. All members throw VolumeError if the file is truncated or
/// damaged, or if its version of the format is too old or too new.
class VdbCheck {
 public:
  /// Checks everything before the trees. A file without a table of contents is checked completely.
  /// Call openvdb::initialize() first.
  /// @param called  Name of the file in error messages.
  VdbCheck(const std::filesystem::path& file, const std::string& called);
  VdbCheck(const VdbCheck&) = delete;
  VdbCheck& operator=(const VdbCheck&) = delete;
  ~VdbCheck();

  /// Checks the tree of a grid, or the tree of another grid that it shares. `grid` is the name as
  /// users write it. Returns the number of bytes that OpenVDB reads for the grid. The cost depends
  /// on the tree, not on the number of grids in the file.
  std::uint64_t tree(const std::string& grid);

 private:
  class Walk;
  std::unique_ptr<Walk> walk_;
};

}  // namespace palpate
