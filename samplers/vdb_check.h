/// Private to samplers: is a .vdb file whole, before OpenVDB reads it? Include it in .cpp files
/// only.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

namespace palpate {

/// True for the grid types that can be felt, by OpenVDB's name of the tree. Trees of other types
/// are never read: nobody checks them.
[[nodiscard]] bool isFeltType(const std::string& tree_type);

/// Walks a file's structure as OpenVDB would read it, without building anything: every count, size
/// and position must fit, every node must end where the next begins. OpenVDB believes what it
/// reads: a cut file is full of zeros to it, a flipped bit asks for gigabytes or crashes it. What
/// passes can be read; its values may still be anything, the format has no checksum. Reads what it
/// walks once, in pieces: some 64 bytes of memory a leaf. Everything throws VolumeError: truncated,
/// damaged, or written by an OpenVDB too old or too new.
class VdbCheck {
 public:
  /// Walks what stands before the trees; a file without a table of contents from end to end. Call
  /// openvdb::initialize() before.
  /// @param called  What the file is called in errors.
  VdbCheck(const std::filesystem::path& file, const std::string& called);
  VdbCheck(const VdbCheck&) = delete;
  VdbCheck& operator=(const VdbCheck&) = delete;
  ~VdbCheck();

  /// Walks the tree of a grid, by its name as users call it, or the one that it shares; returns how
  /// much of the file is read for it [bytes]. Costs what the tree takes, however many grids there
  /// are.
  std::uint64_t tree(const std::string& grid);

 private:
  class Walk;
  std::unique_ptr<Walk> walk_;
};

}  // namespace palpate
