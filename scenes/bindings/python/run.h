#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "palpate/devices/simulated/path_device.h"
#include "palpate/engine/loop/haptic_loop.h"
#include "palpate/scenes/bindings/python/python_module.h"

namespace palpate::python {

/// A row of `palpate feel --trace`, without the loads of the modes.
struct TraceRow {
  double t;
  std::array<double, 3> probe;
  std::array<double, 3> proxy;
  std::array<double, 3> force;
  double error_bound;
  std::int64_t iterations;
  std::int64_t substeps;
  std::int64_t primitives;
  std::int64_t tick_ns;
  std::array<char32_t, 16> status;
  bool limited;
  double waiting;
};

[[nodiscard]] py::dtype traceType();

/// Stores a row for each of the first `most` ticks. Reserves all memory before the first tick.
class Rows final : public TickSink {
 public:
  explicit Rows(std::size_t most) { rows.reserve(most); }
  void take(const Telemetry& tick, const ProxyState& state) noexcept override;
  std::vector<TraceRow> rows;
};

/// Converts an array to a path: a position for each tick, or rows of t, x, y, z [s, m]. `rate` is
/// the tick rate [Hz]. Throws DeviceError.
[[nodiscard]] std::vector<PathPoint> pathOf(const Doubles& given, double rate);

}  // namespace palpate::python
