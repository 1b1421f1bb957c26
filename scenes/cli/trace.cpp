#include "palpate/scenes/cli/trace.h"

#include <fmt/format.h>

#include "palpate/engine/step_report.h"

namespace palpate::cli {

Trace::Trace(const std::string& path) {
  if (path.empty()) return;
  file_.emplace(path);
  text_ =
      "t,probe_x,probe_y,probe_z,proxy_x,proxy_y,proxy_z,force_x,force_y,force_z,error_bound,"
      "iterations,substeps,primitives,tick_ns,status,limited\n";
}

void Trace::add(const Telemetry& tick) {
  if (!file_) return;
  const StepReport& r = tick.report;
  const auto vector = [&](const Vec3& v) {
    for (int a = 0; a < 3; ++a) text_ += number(v[a]) + ",";
  };
  text_ += number(tick.time) + ",";
  vector(tick.probe);
  vector(r.proxy);
  vector(r.force);
  text_ += fmt::format("{},{},{},{},{},{},{}\n", number(r.error_bound), r.iterations, r.substeps,
                       r.primitives, tick.tick_ns, wordFor(r.status), r.limited ? 1 : 0);
  if (text_.size() > 1U << 20U) flush();
}

void Trace::commit() {
  if (!file_) return;
  flush();
  file_->commit();
}

void Trace::flush() {
  file_->write(text_);
  text_.clear();
}

}  // namespace palpate::cli
