/// Private to samplers, for .cpp files only: checks a .vdb file before OpenVDB reads it.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

namespace palpate {

/// Returns true if trees of this type can be read: floats, doubles and vectors of them as volumes;
/// integers, bools and masks only to describe them. Trees of other types are never read.
/// @param tree_type  OpenVDB's name of the type.
[[nodiscard]] bool isReadType(const std::string& tree_type);

/// Reads a file's structure as OpenVDB would, without building a tree. Every count, size and
/// position must fit. OpenVDB itself does not check them. It reads zeros beyond the end of a
/// truncated file, and after a flipped bit it can allocate gigabytes or crash. OpenVDB can read a
/// file that passes these checks. Values may be wrong, because the format has no checksum. Memory:
/// 64 bytes per leaf of a tree. Members throw VolumeError if the file is truncated, damaged or
/// unreadable, or if its version is not supported.
class VdbCheck {
 public:
  /// Checks everything except the trees. A file without a table of contents is checked completely;
  /// throws VolumeError if one of its trees has an unsupported type. Call openvdb::initialize()
  /// first.
  /// @param called  Name of the file in error messages.
  VdbCheck(const std::filesystem::path& file, const std::string& called);
  VdbCheck(const VdbCheck&) = delete;
  VdbCheck& operator=(const VdbCheck&) = delete;
  ~VdbCheck();

  /// Checks the tree of a grid, which may be shared with another grid. `grid` is the name as users
  /// write it. Returns the number of bytes that OpenVDB reads; for a file without a table of
  /// contents, the size of the file. The cost depends on the tree only.
  std::uint64_t tree(const std::string& grid);

 private:
  class Walk;
  std::unique_ptr<Walk> walk_;
};

}  // namespace palpate
