#include "palpate/scenes/cli/picture.h"

#include <algorithm>
#include <iterator>
#include <set>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/engine/version.h"
#include "palpate/scenes/cli/touch.h"
#include "palpate/scenes/nearby.h"

namespace palpate::cli {
namespace {

constexpr int kPixels = 180;  // along the longest side of a slice
constexpr std::size_t kMostFields = 2;
constexpr std::size_t kMostTicks = 20000;
constexpr double kTouched = 0.05;          // [N]
constexpr std::size_t kMostTouches = 500;  // that are looked at to see what was felt
constexpr std::size_t kMostParts = 12;     // drawn as one

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

bool hasData(const FieldPtr& field, const Vec3& p) {
  FieldCache cache;
  return std::visit(
      [&](const auto& f) {
        f->reset(cache);
        return f->sample(p, cache).inside;
      },
      field);
}

/// The parts at these places, those with most of them first.
std::set<std::size_t> partsAt(const Scene& scene, const std::vector<Telemetry>& touches) {
  std::vector<std::pair<std::size_t, std::size_t>> counts;
  for (std::size_t i = 0; i < scene.parts.size(); ++i) {
    const Box& box = scene.parts[i].bounds;
    const auto count = std::count_if(touches.begin(), touches.end(), [&](const Telemetry& t) {
      return holds(box, t.report.proxy);
    });
    if (count > 0) counts.emplace_back(count, i);
  }
  std::sort(counts.rbegin(), counts.rend());
  std::set<std::size_t> parts;
  for (const auto& [count, part] : counts) {
    if (parts.size() < kMostParts) parts.insert(part);
  }
  return parts;
}

/// Names of fields, those first in whose data most of these places are.
std::vector<std::string> mostTouched(const BuiltScene& built,
                                     const std::vector<Telemetry>& touches) {
  std::vector<std::pair<std::ptrdiff_t, std::string>> counts;
  const auto& unused = built.scene->graph.unused;
  for (const auto& entry : built.fields) {
    const std::string& name = entry.first;
    const FieldPtr& field = entry.second;
    if (std::find(unused.begin(), unused.end(), name) != unused.end()) continue;
    const auto motion = built.motions.find(name);
    const auto count = std::count_if(touches.begin(), touches.end(), [&](const Telemetry& t) {
      const Pose pose = motion == built.motions.end() ? Pose{} : motion->second->poseAt(t.time);
      return hasData(field, pose.toRest(t.report.proxy));
    });
    counts.emplace_back(-count, name);
  }
  std::sort(counts.begin(), counts.end());
  std::vector<std::string> names(counts.size());
  std::transform(counts.begin(), counts.end(), names.begin(),
                 [](const auto& entry) { return entry.second; });
  return names;
}

}  // namespace

const std::string& pngName(const std::string& path) {
  if (std::filesystem::path(path).extension() == ".png") return path;
  throw Error(path, "it is not named .png", "give a file name that ends in .png");
}

Picture::Picture(const std::string& path)
    : path_(path), file_(pngName(path)), script_("feel_picture.py", "--picture") {}

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
  std::vector<Telemetry> touches;
  std::copy_if(ticks_.begin(), ticks_.end(), std::back_inserter(touches),
               [](const Telemetry& t) { return t.report.force.norm() >= kTouched; });
  const std::size_t every = touches.size() / kMostTouches + 1;
  std::size_t index = 0;
  std::erase_if(touches, [&](const Telemetry&) { return index++ % every != 0; });
  if (!built.scene->parts.empty()) {
    const std::set<std::size_t> parts = partsAt(*built.scene, touches);
    SceneSpec some;
    std::optional<BuiltScene> drawn;
    try {
      some = nearby(spec, built, parts);
      if (!parts.empty()) drawn = buildScene(some);
    } catch (const Error& e) {
      complain(fmt::format("picture: only what is no part is drawn: {}", e.what()));
    }
    if (drawn) {
      draw(some, *drawn);
      return;
    }
  }
  // Slices through the middle of what was touched; what moves as it is then.
  Vec3 middle = Vec3::Zero();
  double time = 0.0;
  int touched = 0;
  for (const Telemetry& tick : ticks_) {
    if (tick.report.force.norm() < kTouched) continue;
    middle += tick.report.proxy;
    time += tick.time;
    ++touched;
  }
  middle = touched == 0 ? built.bounds.centre() : Vec3(middle / touched);
  if (touched > 0) time /= touched;
  middle = middle.cwiseMax(built.bounds.lower).cwiseMin(built.bounds.upper);

  OrderedJson json;
  json["scene"] = spec.source;
  json["made_by"] = versionText();
  json["fields"] = OrderedJson::array();
  for (const std::string& name : mostTouched(built, touches)) {
    const FieldPtr& field = built.fields.at(name);
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
