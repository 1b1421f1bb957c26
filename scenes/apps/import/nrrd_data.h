/// Private to the importer: reads NRRD data with teem. This code checks sizes first, because teem
/// does not compare the header with the size of the file. It also decompresses gzip, because teem
/// does not verify the checksum.
#pragma once

#include <cstddef>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <set>
#include <string>
#include <teem/nrrd.h>
#include <vector>

#include "palpate/scenes/apps/import/nrrd_header.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

struct CloseNrrdFile {
  void operator()(std::FILE* file) const { std::fclose(file); }
};
using NrrdFile = std::unique_ptr<std::FILE, CloseNrrdFile>;

/// Returns the last line of teem's messages, which states the cause, and clears all messages.
[[nodiscard]] std::string teemError();

class NrrdData {
 public:
  /// Checks, before memory is allocated, that the files are large enough for the values that the
  /// header states. Data in bzip2 or ZRL encoding may have any size. Throws VolumeError. The parsed
  /// header, `nrrd` and `state`, must outlive this object.
  NrrdData(const Request& request, std::vector<NrrdPart> parts, Nrrd* nrrd, NrrdIoState* state);

  /// Reads the values [first, first + count) of all parts in sequence, in the byte order of this
  /// machine. Throws VolumeError.
  void read(std::size_t first, std::size_t count, char* to);

 private:
  [[noreturn]] void refuse(const std::string& why, const std::string& remedy) const;
  void checkWords(std::FILE* in) const;
  void unpackPart(const NrrdPart& part, long offset, long skip, std::size_t first,
                  std::size_t bytes, char* to);
  void readPart(const NrrdPart& part, std::size_t first, std::size_t count, char* to);

  const Request& request_;
  std::vector<NrrdPart> parts_;
  Nrrd* nrrd_;
  NrrdIoState* state_;
  std::size_t part_values_ = 0;
  std::set<std::filesystem::path> sound_;  ///< Gzipped files whose checksum was verified.
};

}  // namespace palpate::importer
