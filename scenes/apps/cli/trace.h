/// Writes the trace of a run as CSV.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "palpate/engine/loop/telemetry.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {

/// Writes one row for each tick; inactive if no file is requested.
class Trace {
 public:
  /// An empty path requests no file. `carriers`: names of the loads, a column each. Throws Error if
  /// the file cannot be written.
  Trace(const std::string& path, std::span<const std::string> carriers);
  /// `loads`: one for each carrier [N].
  void add(const Telemetry& tick, std::span<const double> loads);
  /// Completes the file; without this call no file appears.
  void commit();

 private:
  void flush();
  std::optional<WholeFile> file_;
  std::string text_;
};

}  // namespace palpate::cli
