/// Private to samplers: is a .vdb file whole, before OpenVDB reads it? Include it in .cpp files
/// only.
#pragma once

#include <filesystem>
#include <optional>
#include <string>

namespace palpate {

/// True for the grid types that can be felt, by OpenVDB's name of the tree. Trees of other types
/// are never read: nobody checks them.
[[nodiscard]] bool isFeltType(const std::string& tree_type);

/// Walks the file's structure as OpenVDB would read it, without building anything: every count,
/// size and position must fit, every node must end where the next begins. OpenVDB believes what it
/// reads: a cut file is full of zeros to it, a flipped bit asks for gigabytes or crashes it. What
/// passes can be read; its values may still be anything, the format has no checksum. Throws
/// VolumeError: truncated, damaged, or written by an OpenVDB too old or too new. Reads what it
/// walks once, in pieces: some 64 bytes of memory a leaf. Call openvdb::initialize() before.
/// @param called  What the file is called in errors.
/// @param grid    Whose tree is to be read, as users call it; none: only what stands before the
///                trees. A file without a table of contents is walked from end to end.
void checkVdb(const std::filesystem::path& file, const std::string& called,
              const std::optional<std::string>& grid);

}  // namespace palpate
