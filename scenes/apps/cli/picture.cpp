#include "palpate/scenes/apps/cli/picture.h"

#include <algorithm>
#include <iterator>
#include <optional>
#include <set>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/engine/version.h"
#include "palpate/scenes/apps/cli/again.h"
#include "palpate/scenes/apps/common/touch.h"
#include "palpate/scenes/guess/metadata.h"
#include "palpate/scenes/library/nearby.h"

namespace palpate::cli {
namespace {

constexpr int kPixels = 256;  // Values along the longest side of the drawn box
constexpr int kArrows = 18;
constexpr std::size_t kMostFields = 2;
// Fields with a smaller share of the impulse are not drawn, except the first.
constexpr double kLeastShare = 0.01;
constexpr std::size_t kMostTicks = 20000;
constexpr double kTouched = 0.05;          // [N]: smallest force of a contact
constexpr std::size_t kMostTouches = 500;  // Ticks that choose the fields, at most
constexpr std::size_t kMostParts = 12;
// Horizontal and vertical axis of each slice: x points to the right, z points up.
constexpr int kPlanes[3][2] = {{0, 1}, {0, 2}, {1, 2}};

/// Value of a field at a position in W; `vector` is in the field's rest pose.
struct Look {
  Vec3 vector = Vec3::Zero();
  double value = 0.0;  ///< Value of a scalar field, or the vector's magnitude.
  bool inside = false;
};
using Read = std::function<Look(const Vec3&)>;

Read reading(const FieldPtr& field) {
  auto cache = std::make_shared<FieldCache>();
  return std::visit(
      [&](const auto& f) -> Read {
        f->reset(*cache);
        return [f, cache](const Vec3& p) {
          const auto s = f->sample(p, *cache);
          if constexpr (std::is_same_v<std::decay_t<decltype(s)>, ScalarSample>) {
            return Look{Vec3::Zero(), s.value, s.inside};
          } else {
            return Look{s.value, s.value.norm(), s.inside};
          }
        };
      },
      field);
}

bool isVector(const FieldPtr& field) {
  return std::holds_alternative<std::shared_ptr<const VectorField>>(field);
}

struct Frame {
  Placement world;              ///< Transform from this frame to W.
  Box bounds;                   ///< Box around the drawn volumes, in this frame.
  Vec3 through = Vec3::Zero();  ///< Point in which the three slices meet, in this frame.
  /// "hand" for W, "file" for the world space of a file, or "patient" for one whose axes are a
  /// patient's: +x right, +y anterior, +z superior.
  std::string name = "hand";
  std::string unit = "mm";  ///< Unit of lengths in this frame; empty if unknown.

  [[nodiscard]] Vec3 of(const Vec3& p_W) const {
    return world.rotation.transpose() * (p_W - world.translate) / world.scale;
  }
  /// Extends `bounds` by a box whose corners `world_from_box` transforms to W.
  template <class Map>
  void take(const Box& box, const Map& world_from_box) {
    for (int corner = 0; corner < 8; ++corner) {
      Vec3 p;
      for (int a = 0; a < 3; ++a) p[a] = ((corner >> a) & 1) != 0 ? box.upper[a] : box.lower[a];
      bounds.extend(of(world_from_box(p)));
    }
  }
};

/// Returns the values on a slice, row by row, with `most` values along the longest side of the box.
template <class ValueAt>
OrderedJson rowsOf(const Frame& frame, int plane, int most, const ValueAt& value_at) {
  const auto [a, b] = kPlanes[plane];
  const Vec3 size = frame.bounds.size();
  const double step = size.maxCoeff() / most;
  const int columns = std::max(2, static_cast<int>(std::lround(size[a] / step)));
  const int rows = std::max(2, static_cast<int>(std::lround(size[b] / step)));
  OrderedJson json = OrderedJson::array();
  for (int j = 0; j < rows; ++j) {
    OrderedJson line = OrderedJson::array();
    for (int i = 0; i < columns; ++i) {
      Vec3 p = frame.through;
      p[a] = frame.bounds.lower[a] + (i + 0.5) / columns * size[a];
      p[b] = frame.bounds.lower[b] + (j + 0.5) / rows * size[b];
      line.push_back(value_at(frame.world(p)));
    }
    json.push_back(std::move(line));
  }
  return json;
}

/// Returns the parts whose bounds contain the proxy in the most ticks, at most kMostParts.
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

std::string nameOf(const GraphSpec& graph, std::size_t mode) {
  const std::string& name = graph.modes[mode].name;
  return name.empty() ? fmt::format("/modes/{}", mode) : name;
}

constexpr std::size_t kLongestText = 40;  // [characters]
std::string cut(const std::string& text) {
  return Legible(text, kLongestText).text();
}

std::string lastOf(const std::filesystem::path& path) {
  const auto name = path.filename();
  return (name.empty() ? path.parent_path().filename() : name).string();
}

/// Builds the JSON from which feel_picture.py draws a scene's picture.
class Drawing {
 public:
  Drawing(const SceneSpec& spec, const BuiltScene& built, const Felt& felt,
          const std::vector<Telemetry>& touches, const PictureOptions& options)
      : spec_(spec),
        built_(built),
        most_(felt.most()),
        names_(strongest(felt, touches)),
        options_(options) {
    setFrame();
    setThrough();
  }

  [[nodiscard]] OrderedJson json(const std::vector<Telemetry>& ticks) const {
    OrderedJson json;
    json["title"] = options_.title ? Legible(*options_.title).text() : usualTitle();
    json["made_by"] = versionText();
    json["space"] = {{"name", frame_.name},
                     {"unit", frame_.unit},
                     {"hand_mm", 1e3 * frame_.world.scale},
                     {"heights", heights()}};
    json["through"] = toJson(frame_.through);
    const bool felt = most_.force > 0.0;
    json["strongest"] = felt ? toJson(frame_.of(most_.proxy)) : OrderedJson();
    const bool moves = std::any_of(names_.begin(), names_.end(), [this](const std::string& name) {
      return built_.motions.count(name) != 0;
    });
    json["stands_at"] = moves ? OrderedJson(most_.time) : OrderedJson();
    json["first_frame"] = std::any_of(names_.begin(), names_.end(), [this](const auto& name) {
      return built_.sequences.count(name) != 0;
    });
    json["extent"] = {toJson(frame_.bounds.lower), toJson(frame_.bounds.upper)};
    json["fields"] = OrderedJson::array();
    for (const std::string& name : names_) json["fields"].push_back(fieldOf(name));
    OrderedJson& rows = json["ticks"] = OrderedJson::array();
    for (const Telemetry& t : ticks) {
      const Vec3 proxy = frame_.of(t.report.proxy);
      const Vec3 force = frame_.world.rotation.transpose() * t.report.force;
      rows.push_back({t.time, proxy.x(), proxy.y(), proxy.z(), force.x(), force.y(), force.z()});
    }
    return json;
  }

 private:
  /// Returns what the import of the first field states about heights, as "heights times 20"; empty
  /// if it states nothing.
  [[nodiscard]] std::string heights() const {
    const auto volume = names_.empty() ? nullptr : volumeOf(names_.front());
    const std::string about = volume ? volume->info().description : "";
    const std::size_t at = about.find("heights times ");
    return at == std::string::npos ? "" : cut(about.substr(at, about.find(',', at) - at));
  }

  /// Returns the volume from which a field is derived, directly or not; empty if the volume is
  /// missing.
  [[nodiscard]] std::string sourceOf(std::string name) const {
    while (built_.fields.count(name) == 0) {
      const auto derived = spec_.graph.fields.find(name);
      if (derived == spec_.graph.fields.end()) return {};
      name = derived->second.of;
    }
    return name;
  }

  /// Returns the volume whose metadata apply to a field, or null.
  [[nodiscard]] std::shared_ptr<const Volume> volumeOf(const std::string& name) const {
    const auto computed = built_.computed.find(name);
    const auto volume =
        built_.volumes.find(computed == built_.computed.end() ? name : computed->second.from);
    return volume == built_.volumes.end() ? nullptr : volume->second;
  }

  [[nodiscard]] Pose poseOf(const std::string& name, const Vec3& p_W, double time) const {
    const auto motion = built_.motions.find(name);
    return motion == built_.motions.end() ? Pose{} : motion->second->poseAbout(p_W, time);
  }

  /// Returns at most kMostFields fields: those of the modes with the largest impulse. If no mode
  /// gave a force, returns the field that contained the proxy in the most ticks of `touches`.
  [[nodiscard]] std::vector<std::string> strongest(const Felt& felt,
                                                   const std::vector<Telemetry>& touches) const {
    const std::map<std::string, double> impulses = felt.impulses();
    std::map<std::string, double> force;
    double all = 0.0;
    for (std::size_t i = 0; i < spec_.graph.modes.size(); ++i) {
      const std::string mode = nameOf(spec_.graph, i);
      auto found = impulses.find(mode);
      // A mode of a part, such as "wall[7]", uses the impulse of this mode in all parts of the
      // group.
      if (found == impulses.end()) found = impulses.find(mode.substr(0, mode.rfind('[')));
      const std::string source = sourceOf(spec_.graph.modes[i].of);
      if (found == impulses.end() || source.empty()) continue;
      force[source] += found->second;
      all += found->second;
    }
    struct Entry {
      double force;
      std::ptrdiff_t touches;
      std::string name;
    };
    std::vector<Entry> entries;
    const auto& unused = built_.scene->graph.unused;
    for (const auto& entry : built_.fields) {
      const std::string& name = entry.first;
      if (std::find(unused.begin(), unused.end(), name) != unused.end()) continue;
      const Read read = reading(entry.second);
      const auto count = std::count_if(touches.begin(), touches.end(), [&](const Telemetry& t) {
        return read(poseOf(name, t.report.proxy, t.time).toRest(t.report.proxy)).inside;
      });
      entries.push_back({force[name], count, name});
    }
    std::stable_sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) {
      return a.force != b.force ? a.force > b.force : a.touches > b.touches;
    });
    std::vector<std::string> names;
    for (const Entry& entry : entries) {
      if (names.size() == kMostFields) break;
      if (names.empty() || entry.force > kLeastShare * all) names.push_back(entry.name);
    }
    return names;
  }

  /// Returns true if the drawn fields are volumes at rest with one placement, which differs from
  /// the hand's space.
  [[nodiscard]] bool sharePlacement() const {
    const Placement& first = built_.placements.at(names_.front());
    return !(first == Placement{}) &&
           std::all_of(names_.begin(), names_.end(), [&](const std::string& name) {
             return volumeOf(name) && built_.motions.count(name) == 0 &&
                    built_.placements.at(name) == first;
           });
  }

  /// Selects the frame: that of the strongest field's file if the file is a patient's and does not
  /// move, or if all drawn fields share its placement; otherwise W.
  void setFrame() {
    frame_.world.scale = 1e-3;
    const std::string name = names_.empty() ? "" : names_.front();
    const auto volume = volumeOf(name);
    const Metadata said = volume ? metadataOf(*volume) : Metadata{};
    if (said.ras && built_.motions.count(name) == 0) {
      frame_.name = "patient";
    } else if (volume && sharePlacement()) {
      frame_.name = "file";
    }
    if (frame_.name == "hand") {
      frame_.take(built_.bounds, [](const Vec3& p) { return p; });
    } else {
      frame_.unit = cut(said.length_unit);
      frame_.world = built_.placements.at(name);
      // Uses the boxes in the files, because boxes in W are larger if W is not aligned with the
      // file's axes.
      for (const std::string& drawn : names_) {
        frame_.take(volumeOf(drawn)->info().bounds, built_.placements.at(drawn));
      }
    }
  }

  /// Selects the point in which the slices meet. If the user's point is outside the drawn volumes,
  /// uses the nearest point inside, and reports this.
  void setThrough() {
    const std::optional<Vec3> asked = numbersOf(options_.slices);
    const Vec3 usual = most_.force > 0.0 ? frame_.of(most_.proxy) : frame_.bounds.centre();
    const Box& box = frame_.bounds;
    frame_.through = asked.value_or(usual).cwiseMax(box.lower).cwiseMin(box.upper);
    if (!asked || frame_.through == *asked) return;
    complain(
        fmt::format("--slices: {} is outside the drawn volumes, {} to {} {}: the slices meet at {}",
                    placeWords(*asked), placeWords(box.lower), placeWords(box.upper), frame_.unit,
                    placeWords(frame_.through)));
  }

  [[nodiscard]] std::string usualTitle() const {
    const char* const place = !options_.slices.empty() ? "the chosen place"
                              : most_.force > 0.0      ? "the place of the largest force"
                                                       : "the middle";
    return fmt::format("{}: slices through {}", cut(lastOf(spec_.source)), place);
  }

  [[nodiscard]] OrderedJson fieldOf(const std::string& name) const {
    const FieldPtr& field = built_.fields.at(name);
    const bool axial = isAxial(name);
    OrderedJson json;
    json["name"] = cut(name);
    json["kind"] = !isVector(field) ? "scalar" : axial ? "axial" : "vector";
    const std::string ground = axial ? scalarBeside(name) : name;
    const bool magnitude = isVector(built_.fields.at(ground));
    const auto computed = built_.computed.find(ground);
    // The text of a label's mask has no room at the colour scale.
    const bool shown = computed != built_.computed.end() &&
                       Legible(computed->second.as).text().size() <= kLongestText;
    const std::string called = shown ? computed->second.as : ground;
    json["label"] = magnitude ? fmt::format("|{}|", cut(called)) : cut(called);
    json["unit"] = cut(unitOf(ground));
    json["vector_unit"] = cut(unitOf(name));
    json["levels"] = OrderedJson::array();
    for (std::size_t i = 0; i < spec_.graph.modes.size(); ++i) {
      const ModeSpec& mode = spec_.graph.modes[i];
      if (mode.kind == ModeKind::kIsosurface && mode.of == name) {
        json["levels"].push_back({{"mode", cut(nameOf(spec_.graph, i))}, {"value", mode.value}});
      }
    }
    json["slices"] = OrderedJson::array();
    for (int plane = 0; plane < 3; ++plane) {
      OrderedJson slice;
      slice["axes"] = {kPlanes[plane][0], kPlanes[plane][1]};
      slice["values"] = values(ground, plane);
      if (isVector(field)) slice["vectors"] = vectors(name, plane);
      json["slices"].push_back(std::move(slice));
    }
    return json;
  }

  [[nodiscard]] OrderedJson values(const std::string& name, int plane) const {
    const Read read = reading(built_.fields.at(name));
    const auto volume = volumeOf(name);
    const bool all = !volume || !metadataOf(*volume).mesh;
    return rowsOf(frame_, plane, kPixels, [&](const Vec3& p_W) {
      const Look look = read(poseOf(name, p_W, most_.time).toRest(p_W));
      return look.inside || all ? OrderedJson(static_cast<float>(look.value)) : OrderedJson();
    });
  }

  /// Returns the vectors' components in the slice's plane; null at points without data.
  [[nodiscard]] OrderedJson vectors(const std::string& name, int plane) const {
    const Read read = reading(built_.fields.at(name));
    return rowsOf(frame_, plane, kArrows, [&](const Vec3& p_W) {
      const Pose pose = poseOf(name, p_W, most_.time);
      const Look look = read(pose.toRest(p_W));
      if (!look.inside || look.value == 0.0) return OrderedJson();
      const Vec3 vector = frame_.world.rotation.transpose() * pose.vector(look.vector);
      return OrderedJson{static_cast<float>(vector[kPlanes[plane][0]]),
                         static_cast<float>(vector[kPlanes[plane][1]])};
    });
  }

  /// Returns true if vectors v and -v mean the same in this field.
  [[nodiscard]] bool isAxial(const std::string& name) const {
    const auto sampling = built_.samplings.find(name);
    if (sampling != built_.samplings.end() && sampling->second.axial) return true;
    const auto volume = volumeOf(name);
    return built_.computed.count(name) == 0 && volume && metadataOf(*volume).axial;
  }

  /// Returns the scalar field that sets the strength of a mode of `name`; `name` if there is none.
  [[nodiscard]] std::string scalarBeside(const std::string& name) const {
    for (const ModeSpec& mode : spec_.graph.modes) {
      if (sourceOf(mode.of) != name) continue;
      std::vector<std::string> candidates{mode.by};
      for (const auto& factor : mode.strength.factors) candidates.push_back(factor.by);
      for (const std::string& candidate : candidates) {
        const auto field = built_.fields.find(candidate);
        if (field != built_.fields.end() && !isVector(field->second)) return candidate;
      }
    }
    return name;
  }

  [[nodiscard]] std::string unitOf(const std::string& name) const {
    const auto derived = spec_.graph.fields.find(name);
    if (derived != spec_.graph.fields.end()) {
      return derived->second.derivation == Derivation::kMagnitude ? unitOf(derived->second.of) : "";
    }
    const auto volume = volumeOf(name);
    return volume ? metadataOf(*volume).value_unit : "";
  }

  const SceneSpec& spec_;
  const BuiltScene& built_;
  const Most most_;
  const std::vector<std::string> names_;
  const PictureOptions& options_;
  Frame frame_;
};

}  // namespace

const std::string& pngName(const std::string& path) {
  if (std::filesystem::path(path).extension() == ".png") return path;
  throw Error(path, "it is not named .png", "give a file name that ends in .png");
}

std::string formatOf(const std::string& path) {
  const std::string ending = std::filesystem::path(path).extension().string();
  for (const char* known : {".png", ".pdf", ".svg"}) {
    if (ending == known) return ending.substr(1);
  }
  throw Error(path, "it is not named .png, .pdf or .svg",
              "give a file name with one of these endings");
}

void addPictureOptions(CLI::App& verb, PictureOptions& options, const std::string& description) {
  verb.add_option("--picture", options.file, description);
  verb.add_option("--slices", options.slices,
                  "With --picture: x,y,z, where the slices meet, in the picture's coordinates "
                  "(default: the place of the largest force; without a force, the middle)");
  verb.add_option("--title", options.title, "With --picture: the title");
}

void checkPicture(const PictureOptions& options) {
  if (!options.file.empty()) static_cast<void>(formatOf(options.file));
  const char* const option = !options.slices.empty() ? "--slices" : "--title";
  if (options.file.empty() && (!options.slices.empty() || options.title)) {
    throw Error(option, "it has no effect without --picture",
                fmt::format("add --picture P.png, or leave out {}", option));
  }
  if (!options.slices.empty() && !numbersOf(options.slices)) {
    throw Error("--slices", fmt::format("\"{}\" is not x,y,z", Legible(options.slices).text()),
                "give three numbers in the picture's coordinates, such as 0,0,50");
  }
}

Picture::Picture(const PictureOptions& options)
    : options_(options),
      path_(options.file),
      format_(formatOf(options.file)),
      file_(options.file),
      script_("feel_picture.py", "--picture") {}

void Picture::add(const Telemetry& tick) {
  if (seen_++ % stride_ != 0) return;
  ticks_.push_back(tick);
  if (ticks_.size() < kMostTicks) return;
  // Keeps every second tick, which is enough for a picture.
  for (std::size_t i = 0; 2 * i < ticks_.size(); ++i) ticks_[i] = ticks_[2 * i];
  ticks_.resize(ticks_.size() / 2);
  stride_ *= 2;
}

void Picture::draw(const SceneSpec& spec, const BuiltScene& built, const Felt& felt,
                   const OrderedJson& press) {
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
      complain(fmt::format("picture: the parts are not drawn: {}", e.what()));
    }
    if (drawn) {
      draw(some, *drawn, felt, press);
      return;
    }
  }
  const Drawing drawing(spec, built, felt, touches, options_);
  OrderedJson json = drawing.json(ticks_);
  json["press"] = press;
  script_.draw(json, file_, path_.string(), {format_});
  file_.commit();
}

}  // namespace palpate::cli
