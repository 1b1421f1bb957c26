/// Private to scenes: writes a .vdb, and reports a full disk.
#pragma once

#include <cerrno>
#include <cstring>
#include <exception>
#include <filesystem>
#include <fstream>
#include <string>
#include <system_error>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/scenes/library/new_file.h"

namespace palpate {

/// Writes grids with Blosc compression. Throws Error if the file cannot be written completely. The
/// class openvdb::io::File does not detect this, because it never checks its stream.
inline void writeGrids(const std::filesystem::path& file, const openvdb::GridCPtrVec& grids) {
  struct Archive final : openvdb::io::Archive {
    void put(std::ostream& out, const openvdb::GridCPtrVec& grids) const {
      openvdb::io::Archive::write(out, grids, /*seekable=*/true);
    }
  } archive;
  archive.setCompression(openvdb::io::COMPRESS_BLOSC | openvdb::io::COMPRESS_ACTIVE_MASK);
  std::string why;
  errno = 0;
  try {
    std::ofstream out(file, std::ios::binary | std::ios::trunc);
    if (out) archive.put(out, grids);
    out.close();
    if (out) return;
    why = errno == 0 ? "" : std::string(" (") + std::strerror(errno) + ")";
  } catch (const std::exception&) {
    // the error is reported below
  }
  // The path may be in /proc and lead to a partial file (new_file.h). The error names the file that
  // the caller wants.
  std::error_code no_link;
  const std::filesystem::path real = std::filesystem::read_symlink(file, no_link);
  throw Error(wholeOf(no_link ? file : real).string(), "it cannot be written" + why,
              "choose a writable folder, or free disk space");
}

}  // namespace palpate
