#include "palpate/scenes/apps/cli/trace.h"

#include <set>

#include <fmt/format.h>

#include "palpate/engine/tick/step_report.h"

namespace palpate::cli {

namespace {

/// Returns unique column names without characters that end a field or a row.
std::vector<std::string> columnsOf(std::span<const std::string> carriers) {
  std::vector<std::string> columns;
  std::set<std::string> taken;
  for (const std::string& carrier : carriers) {
    std::string name = "load_" + carrier;
    for (char& c : name) {
      const auto byte = static_cast<unsigned char>(c);
      if (c == ',' || c == '"' || byte < ' ' || byte == 0x7f) c = '_';
    }
    std::string tried = name;
    for (int n = 2; !taken.insert(tried).second; ++n) tried = fmt::format("{}_{}", name, n);
    columns.push_back(tried);
  }
  return columns;
}

}  // namespace

Trace::Trace(const std::string& path, std::span<const std::string> carriers) {
  if (path.empty()) return;
  file_.emplace(path);
  text_ =
      "t,probe_x,probe_y,probe_z,proxy_x,proxy_y,proxy_z,force_x,force_y,force_z,error_bound,"
      "iterations,substeps,primitives,tick_ns,status,limited,waiting";
  for (const std::string& column : columnsOf(carriers)) text_ += "," + column;
  text_ += "\n";
}

void Trace::add(const Telemetry& tick, std::span<const double> loads) {
  if (!file_) return;
  const StepReport& r = tick.report;
  const auto vector = [&](const Vec3& v) {
    for (int a = 0; a < 3; ++a) text_ += number(v[a]) + ",";
  };
  text_ += number(tick.time) + ",";
  vector(tick.probe);
  vector(r.proxy);
  vector(r.force);
  text_ += fmt::format("{},{},{},{},{},{},{},{}", number(r.error_bound), r.iterations, r.substeps,
                       r.primitives, tick.tick_ns, wordFor(r.status), r.limited ? 1 : 0,
                       number(r.stiffness * r.waiting.norm()));
  for (const double load : loads) text_ += "," + number(load);
  text_ += "\n";
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
