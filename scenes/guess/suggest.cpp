#include "palpate/scenes/guess/suggest.h"

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
#include "palpate/samplers/grid/volume_grid.h"
#include "palpate/scenes/guess/components.h"
#include "palpate/scenes/guess/look.h"

namespace palpate::guess {
namespace {

using Json = nlohmann::ordered_json;
using Knots = std::vector<std::pair<double, double>>;

constexpr std::size_t kMaxModes = 5;

std::string lowerCase(std::string text) {
  for (char& c : text) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return text;
}

/// Formats JSON on one line, with spaces.
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

/// Formats JSON for people, with small items on one line.
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

/// Layers for one, two or three nested surfaces. The outer ones yield, so that the hand reaches the
/// inner ones.
struct Layer {
  const char* word = "";
  double strength = 0.0;  ///< [N]
};
constexpr std::array<std::array<Layer, 3>, 3> kLayers{{
    {{{"surface", 2.0}, {}, {}}},
    {{{"outer", 1.5}, {"inner", 3.0}, {}}},
    {{{"outer", 1.0}, {"middle", 2.0}, {"inner", 3.5}}},
}};

/// Kind of a grid, from one analysis.
enum class Kind : std::uint8_t {
  kOther,  ///< Not usable.
  kConstant,
  kLevelSet,
  kHounsfield,
  kMagnetic,
  kLabels,
  kDistance,
  kScalar,  ///< Any other scalar.
  kDirections,
  kFlow,
};

/// A grid that may be used.
struct Candidate {
  const SuggestInput* input = nullptr;
  std::string grid;  ///< Name in the scene file.
  std::string name;  ///< Name in the scene.
  ScalarLook look;
  VectorLook flow;
  double score = 0.0;
  Kind kind = Kind::kOther;
  std::string seen;  ///< Reason for `kind`.
};

/// An item that is not in the scene.
struct LeftOut {
  std::string name;
  std::string why;
  std::string remedy;
};

/// Makes a curve, without inner knots that are so near to the one before that the strength would
/// depend on noise in the data.
Json curve(const Knots& knots) {
  constexpr double kNear = 0.02;  // of the curve's length
  const double near = kNear * std::abs(knots.back().first - knots.front().first);
  Json points = Json::array();
  double last = 0.0;
  for (std::size_t i = 0; i < knots.size(); ++i) {
    const auto& [in, out] = knots[i];
    const bool inner = i > 0 && i + 1 < knots.size();
    if (inner && (in - last < near || knots.back().first - in < near)) continue;
    points.push_back(Json::array({in, out}));
    last = in;
  }
  return Json{{"piecewise", points}};
}

/// Makes a mode with the keys of all modes, in reading order; `more` are the mode's own keys.
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
  Suggestion(GuessNames names, const std::vector<SuggestInput>& grids, GuessFor what)
      : of_(std::move(names)), for_(what), first_(of_.like) {
    nameGrids(grids);
  }

  Guess write() {
    for (Candidate& c : candidates_) see(c);
    leaveComponents();
    addLevelSets();
    addFibres();
    addFlow();
    addMaterials();
    addScalars();
    if (modes_.empty()) addUniform();
    if (modes_.empty()) {
      throw VolumeError(of_.file, "no scene can be suggested" + leftOut(" (", ")"),
                        remedy("import an array that varies"));
    }
    Guess out;
    std::string description =
        "A first guess by palpate: change values and strengths by what you feel.";
    description += leftOut(" Left out: ", ".");
    Json scene;
    scene["description"] = description;
    scene["palpate"] = 1;
    scene["coupling"] = Json{{"stiffness", 500}, {"damping", 0.5}};
    scene["volumes"] = volumes_;
    if (!fields_.empty()) scene["fields"] = fields_;
    scene["modes"] = modes_;
    out.scene = indented(scene) + "\n";
    for (const Candidate* c : shown_) out.seen.push_back(called(*c) + ": " + c->seen);
    for (const Json& mode : modes_) out.made.push_back(lineOf(mode));
    for (const LeftOut& left : left_out_) {
      const std::string why = left.why.empty() ? "others say more" : left.why;
      out.left.push_back(left.name + ": " + why + (left.remedy.empty() ? "" : ": " + left.remedy));
    }
    return out;
  }

 private:
  /// Names grids as files and scenes do: grids with equal names get numbers.
  void nameGrids(const std::vector<SuggestInput>& grids) {
    std::map<std::string, int> count;
    for (const SuggestInput& input : grids) ++count[input.name()];
    std::map<std::string, int> next;
    for (const SuggestInput& input : grids) {
      Candidate candidate;
      candidate.input = &input;
      candidate.grid = input.name();
      if (count[candidate.grid] > 1) {
        candidate.grid += fmt::format("[{}]", next[candidate.grid]++);
      }
      std::string plain;
      for (const char c : input.name()) {
        const bool usable = std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '-';
        if (usable || (!plain.empty() && plain.back() != '_')) plain += usable ? c : '_';
      }
      while (!plain.empty() && plain.back() == '_') plain.pop_back();
      candidate.name = unique(plain.empty() ? "volume" : plain);
      candidates_.push_back(std::move(candidate));
    }
  }

  /// Analyses a grid once and sets its kind.
  void see(Candidate& c) const {
    const SuggestInput& input = *c.input;
    const auto is = [&](Kind kind, std::string why) {
      c.kind = kind;
      c.seen = std::move(why);
    };
    if (isLevelSet(c)) return is(Kind::kLevelSet, "a level set, as its file says");
    if (input.apart) return is(Kind::kOther, "components with different transforms");
    if (input.isVector()) {
      c.flow = lookAtVector(input);
      const VectorLook& flow = c.flow;
      if (flow.constant) return is(Kind::kConstant, "nearly all values alike");
      if (for_ == GuessFor::kFibres) return is(Kind::kDirections, "directions, by --for fibres");
      if (input.axial) return is(Kind::kDirections, "directions without a sign, as its file says");
      constexpr double kNearlyAll = 0.99;
      if (flow.unit >= kNearlyAll && for_ != GuessFor::kCfd) {
        return is(Kind::kDirections,
                  "vectors of length 1: directions, whose sign means nothing (a flow: --for cfd)");
      }
      return is(Kind::kFlow,
                fmt::format("a flow: vectors of lengths from {} to {}{}",
                            c.flow.speed.empty() ? 0.0 : shown(flow.speed.front()),
                            c.flow.speed.empty() ? 0.0 : shown(flow.speed.back()), unit(c)));
    }
    if (!input.isScalar()) return is(Kind::kOther, "of type " + input.grid->valueType());
    c.look = lookAtScalar(input);
    const ScalarLook& look = c.look;
    if (!(look.range() > 0.0 && (!look.boundaries.empty() || drags(look)))) {
      return is(Kind::kConstant, "nearly all values alike");
    }
    seeScalar(c);
  }

  /// Classifies a scalar that varies.
  void seeScalar(Candidate& c) const {
    const ScalarLook& look = c.look;
    const auto is = [&](Kind kind, const std::string& why) {
      c.kind = kind;
      const bool whole = look.whole > kNearlyWhole;
      const auto end = [&](double value) { return whole ? value : look.round(value); };
      const std::string nothing =
          look.nothing ? fmt::format(", {} where there is no data", shown(*look.nothing)) : "";
      c.seen = fmt::format("{} from {} to {}{}{}: {}", whole ? "whole numbers" : "values",
                           end(look.low), end(look.high), unit(c), nothing, why);
    };
    // Raw values of scanners are almost never below 0.
    const bool has_air = look.low < -20.0;
    const std::string unit_name = lowerCase(c.input->value_unit);
    const bool other_unit = !unit_name.empty() && unit_name != "hu" && unit_name != "hounsfield";
    const bool as_ct = for_ == GuessFor::kCt || c.input->modality == Modality::kCt;
    if (for_ == GuessFor::kCfd) return is(Kind::kScalar, "a field, by --for cfd");
    if (for_ == GuessFor::kMri) return is(Kind::kMagnetic, "MR, by --for mri");
    if (for_ == GuessFor::kLabels && look.whole > kNearlyWhole && look.distinct.size() > 1) {
      return is(Kind::kLabels, fmt::format("{} labels, by --for labels", look.distinct.size()));
    }
    if (for_ == GuessFor::kCt && has_air) {
      return is(Kind::kHounsfield, "Hounsfield units, by --for ct");
    }
    if (for_ == GuessFor::kAnything || for_ == GuessFor::kFibres) {
      // Without a unit, air identifies the scale; raw values do not go below 0.
      if (!other_unit && (!unit_name.empty() || (as_ct && has_air))) {
        return is(Kind::kHounsfield, "Hounsfield units, as the file says");
      }
      if (c.input->modality == Modality::kMr) return is(Kind::kMagnetic, "MR, as the file says");
      if (!other_unit && isHounsfield(look)) {
        return is(Kind::kHounsfield,
                  "air near -1000 and tissue at 0 to 100: Hounsfield units (if not: --for cfd)");
      }
      if (look.distance) {
        return is(Kind::kDistance,
                  "they change by 1 a unit or voxel everywhere: the distance to a surface");
      }
      if (isOfLabels(look)) {
        return is(Kind::kLabels, fmt::format("{} values in constant pieces that touch in any "
                                             "order: labels",
                                             look.distinct.size()));
      }
    }
    is(Kind::kScalar, as_ct                     ? "CT, but no air at -1000: raw values of a scanner"
                      : look.boundaries.empty() ? "no boundary in them"
                      : look.boundaries.front().front ? "a sharp front"
                      : look.boundaries.size() == 1
                          ? "a boundary between materials"
                          : fmt::format("{} boundaries between materials", look.boundaries.size()));
  }

  static constexpr double kNearlyWhole = 0.95;

  /// Returns true if air (-1000, and its padding) and tissue (0 to 100) are where Hounsfield's
  /// scale has them, with values up to bone. If the numbers are not whole (a resampled or smoothed
  /// CT), more voxels of both are required.
  static bool isHounsfield(const ScalarLook& look) {
    constexpr double kHigh = 800.0;
    if (look.values.empty() || look.values.back() < kHigh ||
        percentile(look.values, 99.9) > 32768.0 || look.low < -3100.0) {
      return false;
    }
    const double least = look.whole > kNearlyWhole ? 0.005 : 0.05;
    const bool air_about = look.outside && *look.outside > -1100.0 && *look.outside < -900.0;
    const double tissue = look.shareWithin(0.0, 100.0);
    return (air_about || look.shareWithin(-1100.0, -900.0) > least) && tissue > least &&
           tissue > 2.0 * look.shareWithin(150.0, 250.0) &&
           tissue > 2.0 * look.shareWithin(-500.0, -400.0);
  }

  /// Returns true for labels. Values of an image lie in order from one material to the next; labels
  /// do not. An isosurface between two labels thus runs about others as well.
  static bool isOfLabels(const ScalarLook& look) {
    constexpr double kConstantPieces = 0.5;
    constexpr double kAnyOrder = 0.1;
    return look.whole > 0.999 && look.distinct.size() > 2 && look.alike > kConstantPieces &&
           look.skips > kAnyOrder;
  }

  static double shown(double value) {
    return value == std::round(value) ? value : rounded(value, std::abs(value));
  }

  [[nodiscard]] std::string called(const Candidate& c) const {
    return c.grid.empty() ? c.name : c.grid;
  }

  /// Returns a mode's name and kind, and its reason.
  static std::string lineOf(const Json& mode) {
    std::string line = mode["name"].get<std::string>() + ": " + mode["mode"].get<std::string>() +
                       " of " + mode["of"].get<std::string>();
    if (mode.contains("value")) line += " at " + inlined(mode["value"]);
    return line + ": " + mode["description"].get<std::string>();
  }

  std::string unique(const std::string& name) {
    std::string tried = of_.prefix + name;
    for (int n = 2; !names_.insert(tried).second; ++n) {
      tried = fmt::format("{}{}_{}", of_.prefix, name, n);
    }
    return tried;
  }

  void addVolume(const Candidate& candidate) {
    if (volumes_.contains(candidate.name)) return;
    Json volume{{"file", of_.file}};
    if (!candidate.grid.empty()) volume["grid"] = candidate.grid;
    volume["description"] = candidate.seen;
    if (candidate.kind == Kind::kDirections) volume["axial"] = true;
    shown_.push_back(&candidate);
    volume["place"] = first_.empty() ? Json{{"fit", 0.1}} : Json{{"like", first_}};
    if (first_.empty()) first_ = candidate.name;
    volumes_[candidate.name] = volume;
  }

  /// Adds a mode under a unique name.
  void addMode(Json mode) {
    auto name = mode["name"].get<std::string>();
    if (name.find(of_.prefix) == std::string::npos) name.insert(0, of_.prefix);
    std::string tried = name;
    for (int n = 2; !mode_names_.insert(tried).second; ++n) tried = fmt::format("{} {}", name, n);
    mode["name"] = tried;
    modes_.push_back(std::move(mode));
  }

  /// Returns the number of free modes. Level sets take at most three.
  [[nodiscard]] std::size_t room() const {
    const std::size_t taken = modes_.size() - level_sets_ + std::min<std::size_t>(level_sets_, 3);
    return kMaxModes - std::min(kMaxModes, taken);
  }

  [[nodiscard]] std::string leftOut(const char* before, const char* after) const {
    std::string all;
    for (const LeftOut& left : left_out_) {
      all += (all.empty() ? "" : ", ") + left.name;
      if (!left.why.empty()) all += " (" + left.why + ")";
    }
    return all.empty() ? "" : before + all + after;
  }
  /// Returns the first remedy for an omission, if there is one.
  [[nodiscard]] std::string remedy(const std::string& otherwise) const {
    for (const LeftOut& left : left_out_) {
      if (!left.remedy.empty()) return left.remedy;
    }
    return otherwise;
  }
  void leaveOut(const Candidate& c, const std::string& why = "", const std::string& remedy = "") {
    left_out_.push_back({called(c), why, remedy});
    used_.insert(&c);
  }
  [[nodiscard]] bool isFree(const Candidate& c, Kind kind) const {
    return c.kind == kind && used_.count(&c) == 0;
  }

  /// Grids stay separate: a scene cannot join three of them to a vector; a file can, by names.
  void leaveComponents() {
    std::vector<std::string> names;
    std::vector<const Candidate*> scalars;
    for (const Candidate& c : candidates_) {
      if (!c.input->isScalar() || c.kind == Kind::kLevelSet) continue;
      names.push_back(c.grid);
      scalars.push_back(&c);
    }
    for (const Components& found : findComponents(names)) {
      std::array<const Candidate*, 3> parts{};
      for (std::size_t i = 0; i < 3; ++i) parts[i] = scalars[found.parts[i]];
      const auto fits = [&](const Candidate* part) {
        return part->input->grid->transform() == parts[0]->input->grid->transform();
      };
      if (!std::all_of(parts.begin(), parts.end(), fits)) continue;
      for (const Candidate* part : parts) used_.insert(part);
      left_out_.push_back(
          {fmt::format("{}, {}, {}", parts[0]->grid, parts[1]->grid, parts[2]->grid),
           "a vector's components, which are felt as a vector only",
           fmt::format("name them {0}.x, {0}.y and {0}.z in the .vdb, or import the original: "
                       "palpate import joins them",
                       found.name)});
    }
  }

  void addLevelSets() {
    for (const Candidate& c : candidates_) {
      if (!isFree(c, Kind::kLevelSet)) continue;
      if (level_sets_ == kMostLevelSets) {
        leaveOut(c);
        continue;
      }
      addVolume(c);
      addMode(isosurface(c.name, c.name, 0.0, false, 3.0,
                         "The surface that the level set is the distance to."));
      ++level_sets_;
    }
  }

  static bool isLevelSet(const Candidate& c) {
    return c.input->isScalar() && c.input->grid->getGridClass() == openvdb::GRID_LEVEL_SET;
  }

  /// Adds the first directions that vary.
  void addFibres() {
    const Candidate* chosen = nullptr;
    for (const Candidate& c : candidates_) {
      if (c.kind == Kind::kConstant && c.input->axial) leaveOut(c, c.seen);
      if (!isFree(c, Kind::kDirections)) continue;
      if (chosen != nullptr) {
        leaveOut(c);
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
      addMode(byAnisotropy(name, *chosen, *by));
    } else {
      addMode(makeMode(name, "follow", chosen->name, Json::object(), bySpeed(chosen->flow),
                       "Free along the direction, both ways, held across it. A first guess, by "
                       "the vectors' lengths."));
    }
  }

  /// Makes a mode by fractional anisotropy, or by the spread of values for other measures.
  static Json byAnisotropy(const std::string& name, const Candidate& fibres, const Candidate& by) {
    const std::string free =
        "Free along the fibres, held across them: the more, the clearer their direction. ";
    const ScalarLook& look = by.look;
    if (look.low >= 0.0 && look.high <= 1.001 && look.high > 0.4) {
      return makeMode(name, "follow", fibres.name, {{"by", by.name}},
                      curve({{0.15, 0}, {0.4, 1}, {0.7, 2}}),
                      free + "Below an anisotropy of 0.15 there is none.");
    }
    const auto at = [&](double percent) { return look.round(percentile(look.values, percent)); };
    return makeMode(name, "follow", fibres.name, {{"by", by.name}},
                    curve({{at(25.0), 0}, {at(60.0), 1}, {at(95.0), 2}}),
                    free + fmt::format("By the values of {}, from the 25th percentile on: they "
                                       "are no fractional anisotropy as usual.",
                                       by.name));
  }

  [[nodiscard]] const Candidate* anisotropyOf(const Candidate& fibres) const {
    std::string prefix = lowerCase(fibres.input->name());
    const std::string ending = "direction";
    if (prefix.ends_with(ending)) {
      prefix.resize(prefix.size() - ending.size());
    } else {
      prefix += "_";
    }
    for (const Candidate& c : candidates_) {
      const std::string name = lowerCase(c.input->name());
      if (c.kind != Kind::kLevelSet && c.look.range() > 0.0 &&
          (name == prefix + "anisotropy" || name == prefix + "fa" || name == "fa" ||
           name == "anisotropy")) {
        return &c;
      }
    }
    return nullptr;
  }

  /// Returns a curve of the speed: 0 at the 10th percentile, 1 N at the median, 2 N at the 95th;
  /// still voxels do not count.
  static Json bySpeed(const VectorLook& flow) {
    const double slow = percentile(flow.speed, 10.0);
    const double middle = percentile(flow.speed, 50.0);
    const double fast = percentile(flow.speed, 95.0);
    // If all speeds are equal, separate only still places from moving ones.
    if (fast < 1.05 * slow) {
      return curve({{rounded(0.5 * middle, middle), 0}, {rounded(0.9 * middle, middle), 1.5}});
    }
    return curve({{rounded(slow, fast), 0}, {rounded(middle, fast), 1}, {rounded(fast, fast), 2}});
  }

  /// Adds the first vector that is a velocity by its name, else the first vector.
  void addFlow() {
    std::vector<const Candidate*> vectors;
    for (const Candidate& c : candidates_) {
      if (c.kind == Kind::kConstant && c.input->isVector() && used_.count(&c) == 0) {
        uniform_.push_back(&c);
        leaveOut(c, c.seen);
      }
      if (c.kind == Kind::kOther && c.input->isVector()) leaveOut(c, c.seen);
      if (isFree(c, Kind::kFlow)) vectors.push_back(&c);
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

    // `turning` is 0.5 in shear and 1 in a vortex; below 0.1 the flow has almost no curl.
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
    const std::string name = lowerCase(c->input->name());
    return name.rfind("vel", 0) == 0 || name.find("velocity") != std::string::npos || name == "v" ||
           name == "u" || name.rfind("flow", 0) == 0 || name.rfind("wind", 0) == 0;
  }

  static std::string unit(const Candidate& c) {
    return c.input->value_unit.empty() ? "" : " " + c.input->value_unit;
  }

  /// A uniform vector shows no places, but the hand can follow it.
  void addUniform() {
    for (const Candidate* c : uniform_) {
      if (c->flow.speed.empty()) continue;
      std::erase_if(left_out_, [&](const LeftOut& left) { return left.name == called(*c); });
      addVolume(*c);
      addMode(makeMode("along " + c->name, "follow", c->name, Json::object(), 1.0,
                       "Free along the one direction that all vectors have, held across it."));
      return;
    }
  }

  /// Adds materials: several scalars that add up to 1 everywhere, the composition of each place.
  /// The hand moves in the outermost one.
  void addMaterials() {
    if (for_ != GuessFor::kAnything && for_ != GuessFor::kCfd) return;
    std::vector<const Candidate*> fractions;
    for (const Candidate& c : candidates_) {
      if (isFree(c, Kind::kScalar) && c.look.low >= -0.01 && c.look.high <= 1.01) {
        fractions.push_back(&c);
      }
    }
    SumLook sum = lookAtSum(inputsOf(fractions));
    if (sum.other) {
      const auto other = static_cast<std::ptrdiff_t>(*sum.other);
      fractions.erase(fractions.begin() + other);
      sum.at_faces.erase(sum.at_faces.begin() + other);
      sum.throughout.erase(sum.throughout.begin() + other);
    }
    // Mixed gases add up to 1 as well.
    if (!sum.is_one || !sum.apart) return;
    const auto is_void = [](const Candidate* c) {
      const std::string name = lowerCase(c->input->name());
      const auto has = [&](const char* word) { return name.find(word) != std::string::npos; };
      return has("void") || has("vacuum") || has("empty") || has("background");
    };
    auto outermost = std::find_if(fractions.begin(), fractions.end(), is_void);
    if (outermost == fractions.end()) {
      const auto most = std::max_element(sum.at_faces.begin(), sum.at_faces.end());
      outermost = fractions.begin() + (most - sum.at_faces.begin());
    }
    std::vector<std::pair<double, const Candidate*>> materials;
    for (std::size_t i = 0; i < fractions.size(); ++i) {
      if (fractions[i] != *outermost) materials.emplace_back(sum.throughout[i], fractions[i]);
    }
    leaveOut(**outermost, "what the materials leave of each place: the hand moves in it");
    std::stable_sort(materials.begin(), materials.end(),
                     [](const auto& a, const auto& b) { return a.first > b.first; });
    for (const auto& [share, c] : materials) {
      if (room() == 0) {
        leaveOut(*c, "a smaller material");
        continue;
      }
      used_.insert(c);
      Candidate& material = candidates_[static_cast<std::size_t>(c - candidates_.data())];
      material.seen = fmt::format("the fraction of a material: {} grids from 0 to 1 add up to 1",
                                  fractions.size());
      addVolume(material);
      addMode(isosurface(c->name, c->name, 0.5, true, 3.0,
                         fmt::format("The material's surface: where it is half of what is there. "
                                     "It is {} % of all.",
                                     shown(100.0 * share))));
    }
  }

  static std::vector<const SuggestInput*> inputsOf(const std::vector<const Candidate*>& all) {
    std::vector<const SuggestInput*> inputs;
    inputs.reserve(all.size());
    for (const Candidate* c : all) inputs.push_back(c->input);
    return inputs;
  }

  /// Adds at most two scalars, the best scores first; skips those like the flow or one before.
  void addScalars() {
    std::vector<Candidate*> scalars;
    for (Candidate& c : candidates_) {
      if (used_.count(&c) != 0 || c.kind == Kind::kLevelSet || c.input->isVector()) continue;
      if (c.kind == Kind::kOther || c.kind == Kind::kConstant) {
        leaveOut(c, c.seen);
        continue;
      }
      const ScalarLook& look = c.look;
      // Prefer evenly spread values to a few peaks, and objects and familiar quantities to others.
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
      const auto same = [&](const Candidate* o) { return isLike(*c->input, *o->input); };
      const Candidate* like = flow_ != nullptr && same(flow_) ? flow_ : nullptr;
      const auto found = std::find_if(chosen.begin(), chosen.end(), same);
      if (found != chosen.end()) like = *found;
      if (like != nullptr) {
        leaveOut(*c, "much like " + like->name);
      } else {
        chosen.push_back(c);
      }
    }
    // Let the first use all the room except for one mode of the second.
    for (std::size_t i = 0; i < chosen.size(); ++i) {
      const bool more = i + 1 < chosen.size();
      addVolume(*chosen[i]);
      const std::size_t most = std::min<std::size_t>(4, room() - (more ? 1 : 0));
      for (const Json& mode : modesOf(*chosen[i], most)) addMode(mode);
      const std::vector<float>& all = chosen[i]->look.distinct;
      if (chosen[i]->kind == Kind::kLabels && all.size() > 3) {
        left_out_.push_back(
            {fmt::format("labels {} to {} of {} each alone", shown(all[1]),
                         shown(all[all.size() - 2]), called(*chosen[i])),
             "an isosurface between two labels runs about others too",
             "write a grid for each, 1 where the label is and 0 elsewhere, and feel it at 0.5"});
      }
    }
  }

  static bool isFamiliar(const Candidate& c) {
    const std::string name = lowerCase(c.input->name());
    return name.find("temp") != std::string::npos || name.find("pres") != std::string::npos ||
           name.find("dens") != std::string::npos;
  }

  static bool drags(const ScalarLook& look) {
    return look.round(percentile(look.values, 95.0)) > look.round(percentile(look.values, 5.0));
  }

  /// Returns at most `most` modes; keeps the important ones.
  [[nodiscard]] std::vector<Json> modesOf(const Candidate& c, std::size_t most) const {
    std::vector<Json> modes;
    if (c.kind == Kind::kHounsfield) modes = hounsfield(c);
    if (c.kind == Kind::kMagnetic) modes = magneticResonance(c);
    if (c.kind == Kind::kLabels) modes = labels(c);
    if (c.kind == Kind::kDistance) {
      modes.push_back(isosurface(c.name, c.name, 0.0, false, 3.0,
                                 "The surface that the values are the distance to, solid where "
                                 "they are below 0."));
    }
    if (modes.empty()) modes = surfaces(c, most);
    if (modes.empty()) modes.push_back(byValue(c));
    if (modes.size() > most) modes.resize(most);
    return modes;
  }

  /// Adds skin, bone and the tissue between, on Hounsfield's scale: air -1000, fat -100, water 0.
  static std::vector<Json> hounsfield(const Candidate& c) {
    const ScalarLook& look = c.look;
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

  /// Returns modes for the labels that an isosurface separates from all others: the lowest and
  /// highest.
  std::vector<Json> labels(const Candidate& c) const {
    const std::vector<float>& all = c.look.distinct;
    const auto between = [&](std::size_t i) { return 0.5 * (double{all[i - 1]} + all[i]); };
    const std::size_t last = all.size() - 1;
    std::vector<Json> modes;
    const bool lowest_is_outside = !c.look.outside || *c.look.outside <= double{all[0]};
    if (lowest_is_outside) {
      const char* how = last == 1 ? "Half way between the two labels."
                                  : "All labels as one, but {0}, which is about them: half way "
                                    "between {0} and the next. What is between two of them is not "
                                    "felt.";
      modes.push_back(isosurface(c.name + (last == 1 ? "" : " all labels"), c.name, between(1),
                                 true, last == 1 ? 2.0 : 1.5,
                                 fmt::format(fmt::runtime(how), shown(all[0]))));
    } else {
      modes.push_back(isosurface(fmt::format("{} label {}", c.name, shown(all[0])), c.name,
                                 between(1), false, 3.0,
                                 "The lowest label, alone: no other is below."));
    }
    if (last > 1) {
      modes.push_back(isosurface(fmt::format("{} label {}", c.name, shown(all[last])), c.name,
                                 between(last), true, 3.0,
                                 "The highest label, alone: no other is above."));
    }
    return modes;
  }

  /// Returns the skin of an MR image, and a drag by its signal: a bright place is not a hard place.
  static std::vector<Json> magneticResonance(const Candidate& c) {
    const ScalarLook& look = c.look;
    const double outside = look.outside.value_or(look.low);
    for (const Boundary& b : look.boundaries) {
      if (b.value <= outside) continue;
      std::vector<float> inside(
          std::upper_bound(look.values.begin(), look.values.end(), static_cast<float>(b.foot)),
          look.values.end());
      // Noise in air has Rayleigh's distribution: all but a thousandth of it is below 3.2 times its
      // median.
      // (Gudbjartsson and Patz, The Rician distribution of noisy MRI data, 1995)
      const std::vector<float> air(
          look.values.begin(),
          std::lower_bound(look.values.begin(), look.values.end(), static_cast<float>(b.foot)));
      const double zero = look.low < 0.0 ? outside : 0.0;
      const double noise = std::max(0.0, percentile(air, 50.0) - zero);
      const double foot = std::clamp(zero + 3.2 * noise, b.foot, b.value);
      const double middle = look.round(percentile(inside, 50.0));
      const double bright = look.round(percentile(inside, 95.0));
      return {
          isosurface("skin", c.name, look.round(foot), true, 1.5,
                     fmt::format("Where the signal has risen above the air's, at {}: low, so "
                                 "that what is dark stays inside. A first guess.",
                                 look.round(foot))),
          drag("tissue", c.name, {{look.round(foot), 0}, {middle, 0.15}, {bright, 0.3}},
               "A drag that grows with the signal: its median and its 95th percentile within.")};
    }
    return {};
  }

  /// Returns the boundaries from outside to inside, then a drag on the side of the greatest
  /// boundary.
  static std::vector<Json> surfaces(const Candidate& c, std::size_t most) {
    const ScalarLook& look = c.look;
    std::vector<Boundary> found = look.boundaries;
    if (found.empty()) return {};
    // If there is little room, keep the greatest.
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
      // End at the inner surface, or at the value of the enclosed material.
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
    if (b.front) {
      return fmt::format(
          "A front, as a shock: from {} to {} values change within a few voxels wherever they "
          "occur. This is the middle, {}. A first guess.",
          value(b.lower), value(b.upper), value(b.value));
    }
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

  /// For scalars without a boundary.
  static Json byValue(const Candidate& c) {
    const double low = c.look.round(percentile(c.look.values, 5.0));
    const double high = c.look.round(percentile(c.look.values, 95.0));
    return drag(c.name + " drag", c.name, {{low, 0}, {high, 0.4}},
                fmt::format("A drag that grows with the value, from its 5th to its 95th "
                            "percentile ({} to {}{}): no clear boundary was found.",
                            low, high, unit(c)));
  }

  GuessNames of_;
  GuessFor for_;
  std::vector<Candidate> candidates_;
  std::set<std::string> names_;
  std::string first_;
  const Candidate* flow_ = nullptr;
  std::vector<const Candidate*> uniform_;
  std::vector<const Candidate*> shown_;
  std::size_t level_sets_ = 0;
  std::set<const Candidate*> used_;
  std::vector<LeftOut> left_out_;
  Json volumes_ = Json::object();
  Json fields_ = Json::object();
  std::set<std::string> mode_names_;
  std::vector<Json> modes_;
};

/// Returns the grid of a loaded volume with facts from its metadata. If components have another
/// transform than the first, sets `apart`, because the analysis reads them by voxel.
SuggestInput inputFrom(const GuessVolume& given) {
  SuggestInput input;
  const std::vector<Volume::Grid::Part>& parts = given.volume->grid().parts;
  const auto base = [&](std::size_t i) {
    return std::visit([](const auto& grid) { return openvdb::GridBase::ConstPtr(grid); },
                      parts[i].data);
  };
  input.called = given.grid;
  input.grid = base(0);
  if (parts.size() == 3) {
    input.y = base(1);
    input.z = base(2);
    const auto& transform = input.grid->transform();
    input.apart = input.y->transform() != transform || input.z->transform() != transform;
  }
  const auto text = [&](const char* key) {
    const auto meta = input.grid->getMetadata<openvdb::StringMetadata>(key);
    return meta ? meta->value() : std::string();
  };
  input.value_unit = text("value_unit");
  if (text(kMetaModality) == "CT") input.modality = Modality::kCt;
  if (text(kMetaModality) == "MR") input.modality = Modality::kMr;
  if (const auto axial = input.grid->getMetadata<openvdb::BoolMetadata>(kMetaAxial)) {
    input.axial = axial->value();
  }
  input.inactive_is_data = text(kMetaFrom) != "mesh";
  const openvdb::CoordBBox box = input.grid->evalActiveVoxelBoundingBox();
  if (const auto size = input.grid->getMetadata<openvdb::Vec3IMetadata>(kMetaImageSize)) {
    const openvdb::Vec3i voxels = size->value();
    input.extent = openvdb::CoordBBox(0, 0, 0, voxels[0] - 1, voxels[1] - 1, voxels[2] - 1);
  } else if (constexpr double kFull = 0.98; static_cast<double>(input.grid->activeVoxelCount()) >=
                                            kFull * static_cast<double>(box.volume())) {
    input.extent = box;  // a block of data that ends at its faces
  }
  return input;
}

}  // namespace

bool SuggestInput::isVector() const {
  return (y && z) || grid->isType<openvdb::Vec3SGrid>() || grid->isType<openvdb::Vec3DGrid>();
}

bool SuggestInput::isScalar() const {
  return !isVector() && (grid->isType<openvdb::FloatGrid>() || grid->isType<openvdb::DoubleGrid>());
}

Guess suggest(const GuessNames& names, const std::vector<SuggestInput>& grids, GuessFor what) {
  return Suggestion(names, grids, what).write();
}

std::string suggestScene(const std::string& vdb_file, const std::vector<SuggestInput>& grids) {
  return suggest({vdb_file, "", ""}, grids).scene;
}

}  // namespace palpate::guess

namespace palpate {

Guess guessScene(const GuessNames& names, const std::vector<GuessVolume>& volumes, GuessFor what) {
  std::vector<guess::SuggestInput> inputs;
  inputs.reserve(volumes.size());
  for (const GuessVolume& volume : volumes) inputs.push_back(guess::inputFrom(volume));
  return guess::suggest(names, inputs, what);
}

}  // namespace palpate
