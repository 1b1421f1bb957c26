/// Writes the trace of a run as CSV.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "palpate/engine/loop/telemetry.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {

/// Writes a CSV row for each tick, or does nothing without a file.
class Trace {
 public:
  /// Throws Error if `path` cannot be written. An empty path: no file. Each carrier gets a column.
  Trace(const std::string& path, std::span<const std::string> carriers);
  /// Adds a row for a tick. `loads` contains the force of each carrier [N].
  void add(const Telemetry& tick, std::span<const double> loads);
  /// Completes the file. Without this call the file does not appear.
  void commit();

 private:
  void flush();
  std::optional<WholeFile> file_;
  std::string text_;
};

}  // namespace palpate::cli
