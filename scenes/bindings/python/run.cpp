#include "palpate/scenes/bindings/python/run.h"

#include <cmath>
#include <string>

#include "palpate/engine/error.h"
#include "palpate/engine/tick/step.h"

namespace palpate::python {
namespace {

constexpr double kFarthest = 1e6;  ///< Limit of hapticStep for a coordinate of the hand [m].

TraceRow rowOf(const Telemetry& tick) {
  const StepReport& r = tick.report;
  TraceRow row{};
  const auto put = [](std::array<double, 3>& to, const Vec3& v) { to = {v.x(), v.y(), v.z()}; };
  row.t = tick.time;
  put(row.probe, tick.probe);
  put(row.proxy, r.proxy);
  put(row.force, r.force);
  row.error_bound = r.error_bound;
  row.iterations = r.iterations;
  row.substeps = r.substeps;
  row.primitives = r.primitives;
  row.tick_ns = tick.tick_ns;
  const char* word = wordFor(r.status);
  for (std::size_t i = 0; word[i] != '\0'; ++i) row.status[i] = static_cast<unsigned char>(word[i]);
  row.limited = r.limited;
  row.waiting = r.stiffness * r.waiting.norm();
  return row;
}

}  // namespace

py::dtype traceType() {
  py::list names;
  py::list formats;
  py::list offsets;
  const auto add = [&](const std::string& name, const char* format, std::size_t offset) {
    names.append(name);
    formats.append(format);
    offsets.append(offset);
  };
  const auto add3 = [&](const std::string& name, std::size_t offset) {
    for (const char* axis : {"_x", "_y", "_z"}) {
      add(name + axis, "f8", offset);
      offset += sizeof(double);
    }
  };
  add("t", "f8", offsetof(TraceRow, t));
  add3("probe", offsetof(TraceRow, probe));
  add3("proxy", offsetof(TraceRow, proxy));
  add3("force", offsetof(TraceRow, force));
  add("error_bound", "f8", offsetof(TraceRow, error_bound));
  add("iterations", "i8", offsetof(TraceRow, iterations));
  add("substeps", "i8", offsetof(TraceRow, substeps));
  add("primitives", "i8", offsetof(TraceRow, primitives));
  add("tick_ns", "i8", offsetof(TraceRow, tick_ns));
  add("status", "U16", offsetof(TraceRow, status));
  add("limited", "?", offsetof(TraceRow, limited));
  add("waiting", "f8", offsetof(TraceRow, waiting));
  return {names, formats, offsets, sizeof(TraceRow)};
}

void Rows::take(const Telemetry& tick, const ProxyState& /*state*/) noexcept {
  if (rows.size() < rows.capacity()) rows.push_back(rowOf(tick));
}

std::vector<PathPoint> pathOf(const Doubles& given, double rate) {
  const py::ssize_t width = given.ndim() == 2 ? given.shape(1) : 0;
  if ((width != 3 && width != 4) || given.shape(0) == 0) {
    throw DeviceError("path", "its shape is neither (n, 3) nor (n, 4), or it has no rows",
                      "give one position x, y, z per tick, or rows of t, x, y, z");
  }
  std::vector<PathPoint> path;
  const double* row = given.data();
  for (py::ssize_t i = 0; i < given.shape(0); ++i, row += width) {
    const double* p = row + (width - 3);
    const double t = width == 4 ? row[0] : static_cast<double>(i) / rate;
    const PathPoint point{t, {p[0], p[1], p[2]}};
    if (!std::isfinite(t) || !point.p.allFinite() || point.p.cwiseAbs().maxCoeff() >= kFarthest) {
      throw DeviceError("path row " + std::to_string(i) + " (counted from 0)",
                        "a number is not finite, or a coordinate is 1,000 km or more",
                        "give finite seconds, and coordinates in metres below 1,000 km");
    }
    if (!path.empty() && !(t > path.back().t)) {
      throw DeviceError("path row " + std::to_string(i) + " (counted from 0)",
                        "the time does not increase", "sort the rows by t and drop equal times");
    }
    path.push_back(point);
  }
  return path;
}

}  // namespace palpate::python
