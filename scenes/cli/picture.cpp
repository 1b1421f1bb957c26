#include "scenes/cli/picture.h"

#include <algorithm>

#include "engine/error.h"

namespace palpate::cli {
namespace {

constexpr int kPixels = 180;  // along the longest side of a slice
constexpr std::size_t kMostFields = 2;
constexpr std::size_t kMostTicks = 20000;

/// A field as a function for pictures: the value, or a vector's magnitude.
std::function<double(const Vec3&)> reading(const FieldPtr& field) {
  auto cache = std::make_shared<FieldCache>();
  return std::visit(
      [&](const auto& f) -> std::function<double(const Vec3&)> {
        f->reset(*cache);
        return [f, cache](const Vec3& p) {
          const auto s = f->sample(p, *cache);
          if constexpr (std::is_same_v<std::decay_t<decltype(s)>, ScalarSample>) {
            return s.value;
          } else {
            return s.value.norm();
          }
        };
      },
      field);
}

OrderedJson slice(const FieldPtr& field, const Pose& pose, const Box& bounds, const Vec3& through,
                  int normal) {
  const auto read = reading(field);
  const int a = (normal + 1) % 3;
  const int b = (normal + 2) % 3;
  const double step = std::max(bounds.size()[a], bounds.size()[b]) / kPixels;
  const int columns = std::max(2, static_cast<int>(bounds.size()[a] / step));
  const int rows = std::max(2, static_cast<int>(bounds.size()[b] / step));
  OrderedJson json;
  json["axes"] = {a, b};
  json["at"] = through[normal];
  json["extent"] = {bounds.lower[a], bounds.upper[a], bounds.lower[b], bounds.upper[b]};
  json["values"] = OrderedJson::array();
  for (int j = 0; j < rows; ++j) {
    OrderedJson line = OrderedJson::array();
    for (int i = 0; i < columns; ++i) {
      Vec3 p = through;
      p[a] = bounds.lower[a] + (i + 0.5) / columns * bounds.size()[a];
      p[b] = bounds.lower[b] + (j + 0.5) / rows * bounds.size()[b];
      line.push_back(static_cast<float>(read(pose.toRest(p))));
    }
    json["values"].push_back(std::move(line));
  }
  return json;
}

/// A name that says what it will be.
std::string checked(const std::string& path) {
  if (std::filesystem::path(path).extension() == ".png") return path;
  throw Error(path, "it is not named .png", "give a file name that ends in .png");
}

}  // namespace

Picture::Picture(const std::string& path)
    : path_(path), file_(checked(path)), script_("feel_picture.py", "--picture") {}

void Picture::add(const Telemetry& tick) {
  if (seen_++ % stride_ != 0) return;
  ticks_.push_back(tick);
  if (ticks_.size() < kMostTicks) return;
  // As many as can be seen: half of them will do.
  for (std::size_t i = 0; 2 * i < ticks_.size(); ++i) ticks_[i] = ticks_[2 * i];
  ticks_.resize(ticks_.size() / 2);
  stride_ *= 2;
}

void Picture::draw(const SceneSpec& spec, const BuiltScene& built) {
  // Slices through the middle of what was touched; what moves as it is then.
  Vec3 middle = Vec3::Zero();
  double time = 0.0;
  int touched = 0;
  for (const Telemetry& tick : ticks_) {
    if (tick.report.force.norm() < 0.05) continue;
    middle += tick.report.proxy;
    time += tick.time;
    ++touched;
  }
  middle = touched == 0 ? built.bounds.centre() : Vec3(middle / touched);
  if (touched > 0) time /= touched;
  middle = middle.cwiseMax(built.bounds.lower).cwiseMin(built.bounds.upper);

  OrderedJson json;
  json["scene"] = spec.source;
  json["fields"] = OrderedJson::array();
  for (const auto& [name, field] : built.fields) {
    const auto& unused = built.scene->graph.unused;
    if (std::find(unused.begin(), unused.end(), name) != unused.end()) continue;
    if (json["fields"].size() == kMostFields) break;
    OrderedJson entry;
    entry["name"] = name;
    entry["slices"] = OrderedJson::array();
    const auto motion = built.motions.find(name);
    const Pose pose = motion == built.motions.end() ? Pose{} : motion->second->poseAt(time);
    for (int normal = 0; normal < 3; ++normal) {
      entry["slices"].push_back(slice(field, pose, built.bounds, middle, normal));
    }
    entry["levels"] = OrderedJson::array();
    for (const ModeSpec& mode : spec.graph.modes) {
      if (mode.kind == ModeKind::kIsosurface && mode.of == name) {
        entry["levels"].push_back(mode.value);
      }
    }
    json["fields"].push_back(std::move(entry));
  }
  OrderedJson& rows = json["ticks"] = OrderedJson::array();
  for (const Telemetry& t : ticks_) {
    rows.push_back({t.time, t.probe.x(), t.probe.y(), t.probe.z(), t.report.proxy.x(),
                    t.report.proxy.y(), t.report.proxy.z(), t.report.force.x(), t.report.force.y(),
                    t.report.force.z()});
  }
  script_.draw(json, file_, path_.string());
  file_.commit();
}

}  // namespace palpate::cli
