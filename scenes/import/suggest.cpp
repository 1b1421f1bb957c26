#include "palpate/scenes/import/suggest.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <iterator>
#include <map>
#include <optional>
#include <set>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "palpate/engine/error.h"
#include "palpate/scenes/import/look.h"

namespace palpate::importer {
namespace {

using Json = nlohmann::ordered_json;
using Knots = std::vector<std::pair<double, double>>;

constexpr std::size_t kMaxModes = 5;

std::string lowerCase(std::string text) {
  for (char& c : text) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return text;
}

/// On one line, with spaces.
std::string inlined(const Json& json) {
  if (json.is_number_float()) return fmt::format("{}", json.get<double>());
  if (!json.is_structured()) return json.dump(-1, ' ', false, Json::error_handler_t::replace);
  std::string all;
  for (const auto& [key, value] : json.items()) {
    all += all.empty() ? "" : ", ";
    if (json.is_object()) all += inlined(key) + ": ";
    all += inlined(value);
  }
  return json.is_object() ? "{" + all + "}" : "[" + all + "]";
}

/// As a person would: small things on one line.
std::string indented(const Json& json, std::size_t depth = 0) {
  constexpr std::size_t kShort = 90;
  std::string line = inlined(json);
  if (!json.is_structured() || json.empty() || (depth > 1 && line.size() < kShort)) return line;
  const std::string margin(2 * depth, ' ');
  std::string all;
  for (const auto& [key, value] : json.items()) {
    all += (all.empty() ? "\n  " : ",\n  ") + margin;
    if (json.is_object()) all += inlined(key) + ": ";
    all += indented(value, depth + 1);
  }
  all += "\n" + margin;
  return json.is_object() ? "{" + all + "}" : "[" + all + "]";
}

/// Of one, two or three surfaces one within the other: the outer ones yield, so that the inner are
/// reached.
struct Layer {
  const char* word = "";
  double strength = 0.0;  ///< [N]
};
constexpr std::array<std::array<Layer, 3>, 3> kLayers{{
    {{{"surface", 2.0}, {}, {}}},
    {{{"outer", 1.5}, {"inner", 3.0}, {}}},
    {{{"outer", 1.0}, {"middle", 2.0}, {"inner", 3.5}}},
}};

/// A grid that may be used.
struct Candidate {
  const SuggestInput* input = nullptr;
  std::string grid;  ///< As the scene file names it.
  std::string name;  ///< In the scene.
  ScalarLook look;
  VectorLook flow;
  double score = 0.0;
};

Json curve(const Knots& knots) {
  Json points = Json::array();
  for (const auto& [in, out] : knots) points.push_back(Json::array({in, out}));
  return Json{{"piecewise", points}};
}

/// What all modes have, in the order that a person reads it; `more` are the mode's own keys.
Json makeMode(const std::string& name, const char* kind, const std::string& of, const Json& more,
              const Json& strength, const std::string& description) {
  Json mode;
  mode["name"] = name;
  mode["mode"] = kind;
  mode["of"] = of;
  mode.update(more);
  mode["strength"] = strength;
  mode["description"] = description;
  return mode;
}

Json isosurface(const std::string& name, const std::string& of, double value, bool above,
                double strength, const std::string& description) {
  const Json more{{"value", value}, {"solid", above ? "above" : "below"}};
  return makeMode(name, "isosurface", of, more, strength, description);
}

Json drag(const std::string& name, const std::string& of, const Knots& knots,
          const std::string& description) {
  return makeMode(name, "viscosity", of, Json::object(), curve(knots), description);
}

class Suggestion {
 public:
  Suggestion(std::string file, const std::vector<SuggestInput>& grids) : file_(std::move(file)) {
    nameGrids(grids);
  }

  std::string write() {
    addLevelSets();
    addFibres();
    addFlow();
    addScalars();
    if (modes_.empty()) {
      throw VolumeError(file_, "no scene can be suggested" + leftOut(" (", ")"),
                        "import an array that varies");
    }
    std::string description =
        "A first guess by palpate import: change values and strengths by what you feel.";
    description += leftOut(" Left out: ", ".");
    Json scene;
    scene["description"] = description;
    scene["palpate"] = 1;
    scene["coupling"] = Json{{"stiffness", 500}, {"damping", 0.5}};
    scene["volumes"] = volumes_;
    if (!fields_.empty()) scene["fields"] = fields_;
    scene["modes"] = modes_;
    return indented(scene) + "\n";
  }

 private:
  /// How files and scenes name the grids: of equal names each has its number.
  void nameGrids(const std::vector<SuggestInput>& grids) {
    std::map<std::string, int> count;
    for (const SuggestInput& input : grids) ++count[input.grid->getName()];
    std::map<std::string, int> next;
    for (const SuggestInput& input : grids) {
      Candidate candidate;
      candidate.input = &input;
      candidate.grid = input.grid->getName();
      if (count[candidate.grid] > 1) {
        candidate.grid += fmt::format("[{}]", next[candidate.grid]++);
      }
      std::string plain;
      for (const char c : input.grid->getName()) {
        const bool usable = std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '-';
        if (usable || (!plain.empty() && plain.back() != '_')) plain += usable ? c : '_';
      }
      while (!plain.empty() && plain.back() == '_') plain.pop_back();
      candidate.name = unique(plain.empty() ? "volume" : plain);
      candidates_.push_back(std::move(candidate));
    }
  }

  std::string unique(const std::string& name) {
    std::string tried = name;
    for (int n = 2; !names_.insert(tried).second; ++n) tried = fmt::format("{}_{}", name, n);
    return tried;
  }

  void addVolume(const Candidate& candidate) {
    if (volumes_.contains(candidate.name)) return;
    Json volume{{"file", file_}};
    if (!candidate.grid.empty()) volume["grid"] = candidate.grid;
    if (candidate.input->axial) volume["axial"] = true;
    volume["place"] = first_.empty() ? Json{{"fit", 0.1}} : Json{{"like", first_}};
    if (first_.empty()) first_ = candidate.name;
    volumes_[candidate.name] = volume;
  }

  /// Under a name of its own.
  void addMode(Json mode) {
    const auto name = mode["name"].get<std::string>();
    std::string tried = name;
    for (int n = 2; !mode_names_.insert(tried).second; ++n) tried = fmt::format("{} {}", name, n);
    mode["name"] = tried;
    modes_.push_back(std::move(mode));
  }

  [[nodiscard]] std::size_t room() const { return kMaxModes - std::min(kMaxModes, modes_.size()); }

  [[nodiscard]] std::string leftOut(const char* before, const char* after) const {
    std::string all;
    for (const std::string& name : left_out_) all += (all.empty() ? "" : ", ") + name;
    return all.empty() ? "" : before + all + after;
  }
  void leaveOut(const Candidate& candidate, const std::string& why = "") {
    const std::string name = candidate.grid.empty() ? candidate.name : candidate.grid;
    left_out_.push_back(why.empty() ? name : name + " (" + why + ")");
  }

  void addLevelSets() {
    for (const Candidate& c : candidates_) {
      if (!isLevelSet(c)) continue;
      if (modes_.size() == 3) {
        leaveOut(c);
        continue;
      }
      addVolume(c);
      addMode(isosurface(c.name, c.name, 0.0, false, 3.0,
                         "The surface that the level set is the distance to."));
    }
  }

  static bool isLevelSet(const Candidate& c) {
    return c.input->grid->isType<openvdb::FloatGrid>() &&
           c.input->grid->getGridClass() == openvdb::GRID_LEVEL_SET;
  }

  /// An axial vector, the first that varies.
  void addFibres() {
    const Candidate* chosen = nullptr;
    for (Candidate& c : candidates_) {
      if (!c.input->axial || !c.input->grid->isType<openvdb::Vec3SGrid>()) continue;
      if (chosen != nullptr) {
        leaveOut(c);
        continue;
      }
      c.flow = lookAt(static_cast<const openvdb::Vec3SGrid&>(*c.input->grid), *c.input);
      if (c.flow.constant) {
        leaveOut(c, "nearly all values alike");
      } else {
        chosen = &c;
      }
    }
    if (chosen == nullptr) return;
    addVolume(*chosen);
    const std::string name = "along " + chosen->name;
    if (const Candidate* by = anisotropyOf(*chosen)) {
      addVolume(*by);
      used_.insert(by);
      addMode(makeMode(name, "follow", chosen->name, {{"by", by->name}},
                       curve({{0.15, 0}, {0.4, 1}, {0.7, 2}}),
                       "Free along the fibres, held across them: the more, the clearer their "
                       "direction. Below an anisotropy of 0.15 there is none."));
    } else {
      addMode(makeMode(name, "follow", chosen->name, Json::object(), bySpeed(chosen->flow),
                       "Free along the direction, held across it. A first guess, by the vectors' "
                       "lengths."));
    }
  }

  [[nodiscard]] const Candidate* anisotropyOf(const Candidate& fibres) const {
    std::string prefix = fibres.input->grid->getName();
    const std::string ending = "direction";
    if (prefix.size() >= ending.size() &&
        prefix.compare(prefix.size() - ending.size(), ending.size(), ending) == 0) {
      prefix.resize(prefix.size() - ending.size());
    } else {
      prefix += "_";
    }
    for (const Candidate& c : candidates_) {
      if (c.input->grid->getName() == prefix + "anisotropy" &&
          c.input->grid->isType<openvdb::FloatGrid>()) {
        return &c;
      }
    }
    return nullptr;
  }

  /// 0 at the 10th percentile, 1 N at the median, 2 N at the 95th; still voxels have no part.
  static Json bySpeed(const VectorLook& flow) {
    const double slow = percentile(flow.speed, 10.0);
    const double middle = percentile(flow.speed, 50.0);
    const double fast = percentile(flow.speed, 95.0);
    // Where all are as fast, only what stands still is told apart.
    if (fast < 1.05 * slow) {
      return curve({{rounded(0.5 * middle, middle), 0}, {rounded(0.9 * middle, middle), 1.5}});
    }
    return curve({{rounded(slow, fast), 0}, {rounded(middle, fast), 1}, {rounded(fast, fast), 2}});
  }

  /// The first vector that is a velocity by its name, else the first.
  void addFlow() {
    std::vector<const Candidate*> vectors;
    for (Candidate& c : candidates_) {
      if (c.input->axial || !c.input->grid->isType<openvdb::Vec3SGrid>()) continue;
      c.flow = lookAt(static_cast<const openvdb::Vec3SGrid&>(*c.input->grid), *c.input);
      if (c.flow.constant) {
        leaveOut(c, "nearly all values alike");
      } else {
        vectors.push_back(&c);
      }
    }
    if (vectors.empty()) return;
    auto chosen = std::find_if(vectors.begin(), vectors.end(), isVelocity);
    if (chosen == vectors.end()) chosen = vectors.begin();
    flow_ = *chosen;
    for (const Candidate* c : vectors) {
      if (c != flow_) leaveOut(*c);
    }
    addVolume(*flow_);

    const VectorLook& flow = flow_->flow;
    const std::string speed = unique("speed");
    fields_[speed] = Json{{"magnitude", flow_->name}};
    const double median = percentile(flow.speed, 50.0);
    addMode(makeMode(
        "along " + flow_->name, "follow", flow_->name, {{"by", speed}}, bySpeed(flow),
        fmt::format("Free along the stream, held across it, the more the faster. The median speed "
                    "is {}{}. A first guess.",
                    rounded(median, median), unit(*flow_))));

    // Shear turns with 0.5, a vortex with 1; below 0.1 the flow has no curl to speak of.
    constexpr double kTurning = 0.1;
    const double middle = percentile(flow.curl, 50.0);
    const double most = percentile(flow.curl, 95.0);
    if (flow.turning < kTurning || !(rounded(most, most) > rounded(middle, most))) return;
    const std::string vorticity = unique("vorticity");
    fields_[vorticity] = Json{{"curl", flow_->name}};
    addMode(drag("vortices", vorticity, {{rounded(middle, most), 0}, {rounded(most, most), 0.3}},
                 "A drag where the stream turns or shears: from the median of the vorticity on. At "
                 "the edge of the data it is a difference to nothing."));
  }

  static bool isVelocity(const Candidate* c) {
    const std::string name = lowerCase(c->input->grid->getName());
    return name.rfind("vel", 0) == 0 || name.find("velocity") != std::string::npos || name == "v" ||
           name == "u" || name.rfind("flow", 0) == 0 || name.rfind("wind", 0) == 0;
  }

  static std::string unit(const Candidate& c) {
    return c.input->value_unit.empty() ? "" : " " + c.input->value_unit;
  }

  /// The two scalars with the best scores, not two that say the same.
  void addScalars() {
    std::vector<Candidate*> scalars;
    for (Candidate& c : candidates_) {
      if (used_.count(&c) != 0 || isLevelSet(c)) continue;
      if (c.input->grid->isType<openvdb::Vec3SGrid>()) continue;
      if (!c.input->grid->isType<openvdb::FloatGrid>()) {
        leaveOut(c, "of type " + c.input->grid->valueType());
        continue;
      }
      const auto& grid = static_cast<const openvdb::FloatGrid&>(*c.input->grid);
      c.look = lookAt(grid, *c.input);
      const ScalarLook& look = c.look;
      const bool varies = look.range() > 0.0 && (!look.boundaries.empty() || drags(look));
      if (!varies) {
        leaveOut(c, "nearly all values alike");
        continue;
      }
      // Evenly spread values before a few peaks, objects and what people look for before others.
      c.score = look.entropy + (look.boundaries.empty() ? 0.0 : 0.3) + (isFamiliar(c) ? 0.2 : 0.0);
      scalars.push_back(&c);
    }
    std::stable_sort(scalars.begin(), scalars.end(),
                     [](const Candidate* a, const Candidate* b) { return a->score > b->score; });
    std::vector<const Candidate*> chosen;
    for (const Candidate* c : scalars) {
      if (chosen.size() == std::min<std::size_t>(2, room())) {
        leaveOut(*c);
        continue;
      }
      const auto& grid = static_cast<const openvdb::FloatGrid&>(*c->input->grid);
      const auto same = [&](const Candidate* o) { return isLike(grid, *o->input->grid); };
      const Candidate* like = flow_ != nullptr && same(flow_) ? flow_ : nullptr;
      const auto found = std::find_if(chosen.begin(), chosen.end(), same);
      if (found != chosen.end()) like = *found;
      if (like != nullptr) {
        leaveOut(*c, "much like " + like->name);
      } else {
        chosen.push_back(c);
      }
    }
    // The first may use all the room but one mode for the second.
    for (std::size_t i = 0; i < chosen.size(); ++i) {
      const bool more = i + 1 < chosen.size();
      addVolume(*chosen[i]);
      const std::size_t most = std::min<std::size_t>(4, room() - (more ? 1 : 0));
      for (const Json& mode : modesOf(*chosen[i], most)) addMode(mode);
    }
  }

  static bool isFamiliar(const Candidate& c) {
    const std::string name = lowerCase(c.input->grid->getName());
    return name.find("temp") != std::string::npos || name.find("pres") != std::string::npos ||
           name.find("dens") != std::string::npos;
  }

  static bool drags(const ScalarLook& look) {
    return look.round(percentile(look.values, 95.0)) > look.round(percentile(look.values, 5.0));
  }

  /// At most `most`, the important ones first to stay.
  [[nodiscard]] std::vector<Json> modesOf(const Candidate& c, std::size_t most) const {
    std::vector<Json> modes = hounsfield(c);
    if (modes.empty() && c.input->modality == Modality::kMr) modes = magneticResonance(c);
    if (modes.empty()) modes = surfaces(c, most);
    if (modes.empty()) modes.push_back(byValue(c));
    if (modes.size() > most) modes.resize(most);
    return modes;
  }

  /// Skin, bone and what is between, by Hounsfield's scale: air -1000, fat -100, water 0.
  static std::vector<Json> hounsfield(const Candidate& c) {
    if (c.input->modality != Modality::kCt) return {};
    const ScalarLook& look = c.look;
    const std::string unit = lowerCase(c.input->value_unit);
    // Without a unit the scale shows by its air; raw values have none below 0.
    if (!unit.empty() ? unit != "hu" && unit != "hounsfield" : look.low > -200.0) return {};
    constexpr double kSkin = -300.0;
    constexpr double kFew = 1e-4;
    const bool air = look.low < -500.0;
    const bool flesh = look.shareAbove(-200.0) > kFew;
    std::vector<Json> modes;
    if (air && flesh) {
      modes.push_back(isosurface("skin", c.name, kSkin, true, 1.5,
                                 "Between air (-1000 HU) and skin (about 0). It yields to a firm "
                                 "push."));
    }
    constexpr double kBone = 300.0;
    if (look.shareAbove(kBone + 100.0) > kFew) {
      double bone = kBone;
      std::string how = "Bone is above 300 HU, contrast agent too.";
      for (const Boundary& b : look.boundaries) {
        if (b.value < 150.0 || b.value > 500.0) continue;
        bone = b.value;
        how = fmt::format("Bone: values change fastest about {} HU. A first guess.",
                          look.round(bone));
        break;
      }
      modes.push_back(isosurface("bone", c.name, look.round(bone), true, 3.5, how));
    }
    if (flesh && look.low < -100.0) {
      modes.push_back(drag("soft tissue", c.name, {{-300, 0}, {-100, 0.1}, {50, 0.2}, {300, 0.3}},
                           "A drag that grows from lung over fat (-100 HU) and muscle (50) to "
                           "bone."));
    }
    return modes;
  }

  /// The skin of an MR image, and a drag by its signal: what is bright is not what is hard.
  static std::vector<Json> magneticResonance(const Candidate& c) {
    const ScalarLook& look = c.look;
    const double outside = look.outside.value_or(look.low);
    for (const Boundary& b : look.boundaries) {
      if (b.value <= outside) continue;
      std::vector<float> inside(
          std::upper_bound(look.values.begin(), look.values.end(), static_cast<float>(b.foot)),
          look.values.end());
      const double middle = look.round(percentile(inside, 50.0));
      const double bright = look.round(percentile(inside, 95.0));
      return {
          isosurface("skin", c.name, look.round(b.foot), true, 1.5,
                     fmt::format("Where the signal has risen above the air's, at {}: low, so "
                                 "that what is dark stays inside. A first guess.",
                                 look.round(b.foot))),
          drag("tissue", c.name, {{look.round(b.foot), 0}, {middle, 0.15}, {bright, 0.3}},
               "A drag that grows with the signal: its median and its 95th percentile within.")};
    }
    return {};
  }

  /// The boundaries from outside to inside, then a drag within the greatest side.
  static std::vector<Json> surfaces(const Candidate& c, std::size_t most) {
    const ScalarLook& look = c.look;
    std::vector<Boundary> found = look.boundaries;
    if (found.empty()) return {};
    // With little room the greatest.
    std::stable_sort(found.begin(), found.end(),
                     [](const Boundary& a, const Boundary& b) { return a.share > b.share; });
    if (found.size() > most) found.resize(most);
    const double outside = look.outside.value_or(look.low);
    const bool main_above = found.front().value > outside;
    std::stable_sort(found.begin(), found.end(), [outside](const auto& a, const auto& b) {
      return std::abs(a.value - outside) < std::abs(b.value - outside);
    });

    std::vector<Json> modes;
    std::optional<Json> between;
    for (const bool above : {main_above, !main_above}) {
      std::vector<Boundary> side;
      std::copy_if(found.begin(), found.end(), std::back_inserter(side),
                   [&](const Boundary& b) { return (b.value > outside) == above; });
      if (side.empty()) continue;
      for (std::size_t i = 0; i < side.size(); ++i) {
        const Layer layer = kLayers.at(side.size() - 1).at(i);
        const char* dark = !above && side.size() < found.size() ? " dark " : " ";
        modes.push_back(isosurface(c.name + dark + layer.word, c.name, look.round(side[i].value),
                                   above, layer.strength, describe(side[i], c)));
      }
      if (above != main_above) continue;
      const Boundary& outer = side.front();
      const Boundary& inner = side.back();
      const double edge = look.round(outer.value);
      // Up to the inner surface, or to what it encloses.
      const double end = look.round(side.size() > 1 ? inner.value
                                    : above         ? inner.upper
                                                    : inner.lower);
      if (edge == end) continue;
      Knots knots{{edge, 0}, {end, 0.2}};
      if (!above) std::swap(knots[0], knots[1]);
      const char* within = side.size() > 1 ? "Between the surfaces" : "Within the surface";
      between = drag(c.name + " drag", c.name, knots,
                     std::string(within) +
                         ": a drag that grows with the way from one material to "
                         "the next.");
    }
    if (between) modes.push_back(*between);
    return modes;
  }

  static std::string describe(const Boundary& b, const Candidate& c) {
    const auto value = [&](double v) { return fmt::format("{}{}", c.look.round(v), unit(c)); };
    if (b.lower_known && b.upper_known) {
      return fmt::format(
          "Values change fastest between {} and {}: this is the middle, {}. A first "
          "guess.",
          value(b.lower), value(b.upper), value(b.value));
    }
    return fmt::format(
        "At {} values leave those of a material, {}, and change fast from there on, "
        "to no other material. A first guess.",
        value(b.value), value(b.lower_known ? b.lower : b.upper));
  }

  /// For what has no boundary.
  static Json byValue(const Candidate& c) {
    const double low = c.look.round(percentile(c.look.values, 5.0));
    const double high = c.look.round(percentile(c.look.values, 95.0));
    return drag(c.name + " drag", c.name, {{low, 0}, {high, 0.4}},
                fmt::format("A drag that grows with the value, from its 5th to its 95th "
                            "percentile ({} to {}{}): no clear boundary was found.",
                            low, high, unit(c)));
  }

  std::string file_;
  std::vector<Candidate> candidates_;
  std::set<std::string> names_;
  std::string first_;
  const Candidate* flow_ = nullptr;
  std::set<const Candidate*> used_;
  std::vector<std::string> left_out_;
  Json volumes_ = Json::object();
  Json fields_ = Json::object();
  std::set<std::string> mode_names_;
  std::vector<Json> modes_;
};

}  // namespace

std::string suggestScene(const std::string& vdb_file, const std::vector<SuggestInput>& grids) {
  return Suggestion(vdb_file, grids).write();
}

}  // namespace palpate::importer
