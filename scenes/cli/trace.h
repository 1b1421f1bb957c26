/// The trace of a run as CSV.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "palpate/engine/telemetry.h"
#include "palpate/scenes/cli/common.h"

namespace palpate::cli {

/// Row by row, a tick each; a file that is not asked for costs nothing.
class Trace {
 public:
  /// An empty path asks for none. `carriers`: of the loads, a column each. Throws Error where it
  /// cannot be written.
  Trace(const std::string& path, std::span<const std::string> carriers);
  /// `loads`: of the carriers [N].
  void add(const Telemetry& tick, std::span<const double> loads);
  /// All of it is there, or nothing.
  void commit();

 private:
  void flush();
  std::optional<WholeFile> file_;
  std::string text_;
};

}  // namespace palpate::cli
