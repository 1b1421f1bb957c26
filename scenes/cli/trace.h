/// The trace of a run as CSV.
#pragma once

#include <optional>
#include <string>

#include "palpate/engine/telemetry.h"
#include "palpate/scenes/cli/common.h"

namespace palpate::cli {

/// Row by row, a tick each; a file that is not asked for costs nothing.
class Trace {
 public:
  /// An empty path asks for none. Throws Error where it cannot be written.
  explicit Trace(const std::string& path);
  void add(const Telemetry& tick);
  /// All of it is there, or nothing.
  void commit();

 private:
  void flush();
  std::optional<WholeFile> file_;
  std::string text_;
};

}  // namespace palpate::cli
