#include "palpate/scenes/library/scene_table.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/engine/tick/step.h"
#include "palpate/scenes/library/label_modes.h"
#include "palpate/scenes/library/place_table.h"
#include "palpate/scenes/library/smooth_text.h"
#include "palpate/scenes/library/spec_lookup.h"

namespace palpate {
namespace {

using Curve = TransferFunction;

// Transfer functions (paper of Lundin et al., section 2).

struct Window {
  double level = 0.0;
  double width = 0.0;
  double max = 0.0;
};

JsonType<Curve> windowType() {
  return JsonObject<Window>()
      .need("level", jsonNumber(), &Window::level)
      .need("width", jsonPositive(), &Window::width)
      .need("max", jsonNotNegative(), &Window::max)
      .type()
      .as<Curve>([](const Window& w) { return Curve::window(w.level, w.width, w.max); });
}

JsonType<Curve> piecewiseType() {
  const JsonType<Curve::Knot> knot =
      jsonNumbers<2>({jsonNumber(), jsonNotNegative()}).as<Curve::Knot>([](const auto& point) {
        return Curve::Knot(point[0], point[1]);
      });
  const auto ascend = [](const std::vector<Curve::Knot>& knots) {
    return std::is_sorted(knots.begin(), knots.end(),
                          [](const auto& a, const auto& b) { return a.first < b.first; });
  };
  return jsonList(knot, "it is not a list of points, or is empty", "write [[input, output], ...]")
      .where(ascend, "the inputs do not ascend", "sort the points by input")
      .as<Curve>([](std::vector<Curve::Knot> knots) { return Curve::piecewise(std::move(knots)); });
}

/// Returns the keys of all kinds of curves. Each kind makes a product with one factor.
std::vector<JsonObject<TransferSpec>> curves(JsonSchema& definitions) {
  const auto rows = [&](const char* key, const JsonType<Curve>& type) {
    return JsonObject<TransferSpec>()
        .need(key, type.defined(key, definitions),
              [](TransferSpec& to, Curve curve) { to.factors[0].curve = std::move(curve); })
        .may("by", jsonName(),
             [](TransferSpec& to, std::string by) { to.factors[0].by = std::move(by); });
  };
  return {rows("window", windowType()), rows("piecewise", piecewiseType())};
}

JsonType<TransferSpec> constantType() {
  return jsonNotNegative().as<TransferSpec>([](double number) { return TransferSpec(number); });
}

/// Returns the type of a transfer function: a curve of one scalar, or a product of several curves.
JsonType<TransferSpec> curveType(JsonSchema& definitions) {
  std::vector<JsonObject<TransferSpec>> kinds = curves(definitions);
  const JsonType<TransferSpec> factor =
      jsonNumberOr(constantType(), JsonObject<TransferSpec>().chooseByKey(kinds).type())
          .says(
              "A number, or a transfer function of the scalar that its own \"by\" names. Without "
              "\"by\" it reads the input of the mode.")
          .defined("factor", definitions);
  kinds.push_back(JsonObject<TransferSpec>().need(
      "product",
      jsonList(factor, "it is not a list of factors, or is empty",
               "write [0.5, {\"window\": ...}, ...]"),
      [](TransferSpec& to, const std::vector<TransferSpec>& product) {
        to.factors.clear();
        for (const TransferSpec& one : product) to.factors.push_back(one.factors[0]);
      }));
  return JsonObject<TransferSpec>()
      .chooseByKey(std::move(kinds))
      .type()
      .defined("curve", definitions);
}

// Volumes and derived fields.

JsonType<FramesSpec> framesType() {
  const auto common =
      JsonObject<FramesSpec>()
          .may("repeat",
               jsonFlag().says("If true, the first frame follows the last one. If false, the "
                               "default, the last frame stays."),
               &FramesSpec::repeat)
          .may("budget_mb",
               jsonPositive().says(
                   "Memory for frames, which are loaded ahead of play [MiB]. The default is 1024."),
               [](FramesSpec& to, double budget) { to.budget_mb = budget; });
  return JsonObject<FramesSpec>()
      .chooseByKey(
          {JsonObject<FramesSpec>()
               .need("rate", jsonPositive().says("Frames per second."), &FramesSpec::rate)
               .with(common),
           JsonObject<FramesSpec>()
               .need("times",
                     jsonList(jsonNumber(), "it is not a list of times, or is empty",
                              "write [0, 0.1, ...]")
                         .says("Times of the frames, ascending [s]. If the sequence repeats, one "
                               "more time follows: the return of the first frame."),
                     &FramesSpec::times)
               .with(common)})
      .type()
      .says(
          "Makes the volume a sequence. The frames are the grids of one name in its file, or "
          "numbered files (%04d in \"file\"). Values between two frames are blended.");
}

JsonObject<SceneSpec> playRows() {
  const auto play = [](SceneSpec& spec) -> PlaySpec& {
    if (!spec.play) spec.play.emplace();
    return *spec.play;
  };
  return JsonObject<SceneSpec>()
      .remark("description")
      .may("speed",
           jsonNumber().says("Speed of play: seconds of the sequence per second. A negative speed "
                             "plays backwards. The default is 1."),
           [play](SceneSpec& spec, double speed) { play(spec).speed = speed; })
      .may("paused",
           jsonFlag().says(
               "If true, play starts paused; the space bar resumes it. The default is false."),
           [play](SceneSpec& spec, bool paused) { play(spec).paused = paused; })
      .may("from",
           jsonNumber().says(
               "Earliest time of play [s], for both directions of play. The default is the start "
               "of the first sequence. If all sequences repeat, but the play does not, the default "
               "is no limit."),
           [play](SceneSpec& spec, double from) { play(spec).from = from; })
      .may("to",
           jsonNumber().says(
               "Latest time of play [s]. Backward play begins here. The default is the end of the "
               "last sequence. If a sequence repeats, the default is no limit."),
           [play](SceneSpec& spec, double to) { play(spec).to = to; })
      .may("repeat",
           jsonFlag().says("If true, play continues at the other end when it reaches an end. The "
                           "default is false."),
           [play](SceneSpec& spec, bool repeat) { play(spec).repeat = repeat; });
}

/// A volume, and facts about its key "smooth" that putVolumes() needs.
struct ReadVolume : VolumeSpec {
  double smooth_unit = 0.0;   ///< Metres per unit of the width; 0: voxels or file.
  bool whole_smooth = false;  ///< True if "smooth" is written as a whole number.
};

/// A width as the scene file states it.
struct ReadWidth {
  SmoothWidth width;
  double unit = 0.0;
  bool whole = false;
};

JsonType<ReadWidth> smoothType() {
  const JsonType<double> number = jsonNotNegativeUpTo(kMostSmooth, "voxels");
  const JsonType<std::string> text =
      jsonMatching(kSmoothPattern, "it is not a width",
                   "give voxels, such as 1.5, or a length, such as \"1 mm\"");
  return {{{"oneOf", JsonSchema::array({number.schema, text.schema})}},
          [number = number.read, text = text.read](const JsonNode& node) -> ReadWidth {
            if (!node.json().is_string()) {
              return {{number(node), false}, 0.0, node.json().is_number_integer()};
            }
            const SmoothText read = readSmoothText(text(node)).value_or(SmoothText{});
            return {{read.size, true}, read.metres, false};
          }};
}

JsonType<ReadVolume> volumeType() {
  return JsonObject<ReadVolume>()
      .remark("description")
      .need("file",
            jsonName().says(
                "A .vdb file, or a folder of bricks (made by `palpate brick`), which are "
                "loaded as the hand moves. For frames in several files, the name has %04d in "
                "the place of the frame's number."),
            [](ReadVolume& to, const std::string& name) { to.file = name; })
      .may("grid", jsonName(), &VolumeSpec::grid)
      .may("interpolation",
           jsonWordOf({Interpolation::kTrilinear, Interpolation::kNearest,
                       Interpolation::kQuadratic, Interpolation::kCubic}),
           [](VolumeSpec& to, Interpolation value) { to.sampling.interpolation = value; })
      .may(
          "axial",
          jsonFlag().says(
              "If true, the vectors have no sign, like a fibre's direction. The default is false."),
          [](VolumeSpec& to, bool axial) { to.sampling.axial = axial; })
      .may(
          "non_finite",
          jsonWord<NonFinite>({{"refuse", NonFinite::kRefuse}, {"fill", NonFinite::kFill}})
              .says("Treatment of values that are NaN, infinite or above 1e100. The default, "
                    "\"refuse\", rejects the grid; \"fill\" replaces the values by the background, "
                    "which has no data."),
          &VolumeSpec::non_finite)
      .may("smooth",
           smoothType().says(
               "Standard deviation of a Gaussian at load: a number of voxels, or a length such as "
               "\"1.5 mm\" in m, cm, mm, um or the file's unit (\"file\"). The Gaussian includes "
               "inactive voxels and the background. The default is 0."),
           [](ReadVolume& to, const ReadWidth& read) {
             to.smooth = read.width;
             to.smooth_unit = read.unit;
             to.whole_smooth = read.whole;
           })
      .may("frames", framesType(),
           [](VolumeSpec& to, FramesSpec value) { to.frames = std::move(value); })
      .may("window",
           JsonObject<double>()
               .need("budget_mb",
                     jsonPositive().says("Memory for the bricks near the hands [MiB]. Without the "
                                         "key \"window\": 256."),
                     [](double& to, double budget) { to = budget; })
               .type()
               .says("The bricks near the hands, which are in memory."),
           [](VolumeSpec& to, double budget) { to.budget_mb = budget; })
      .may("place", placeType(), &VolumeSpec::place)
      .may("instances",
           jsonList(instanceType(), "it is not a list of places, or is empty",
                    "write [{\"scale\": ...}, ...]")
               .says("Several places, instead of \"place\". Volumes that are placed like this one "
                     "stand in the same places."),
           &VolumeSpec::instances)
      .either("instances", "place", "the volume also has \"place\"",
              "remove \"place\" or \"instances\"")
      .type();
}

/// Returns the metres per unit of a volume's file. Throws SceneError if the scene does not define
/// this number.
double metresPerUnit(const std::map<std::string, ReadVolume>& volumes, const std::string& name,
                     const std::string& path) {
  const ReadVolume* volume = &volumes.at(name);
  // A chain of `like` that is longer than the number of volumes is a circle.
  for (std::size_t n = 0; n < volumes.size() && volume->instances.empty(); ++n) {
    const PlaceSpec& place = volume->place;
    if (place.kind == PlaceSpec::Kind::kUnit) return place.size;
    if (place.kind == PlaceSpec::Kind::kMap) return place.scale;
    if (place.kind != PlaceSpec::Kind::kLike) break;
    const auto leader = volumes.find(place.like);
    if (leader == volumes.end()) {
      throw SceneError(path,
                       "a width in m, cm, mm or um needs the place of \"" + place.like +
                           "\", but the scene has no such volume",
                       "correct \"like\", or give the width in voxels");
    }
    volume = &leader->second;
  }
  if (!volume->instances.empty()) {
    throw SceneError(path, "a width in m, cm, mm or um needs one \"place\", not \"instances\"",
                     "give the width in voxels or in the file's unit, such as \"1.5 file\"");
  }
  throw SceneError(path, "a width in m, cm, mm or um needs a \"place\" by unit or scale",
                   "give such a place, or the width in voxels or in the file's unit, such as "
                   "\"1.5 file\"");
}

/// Puts the volumes into a scene. Adds a note about each width that had another meaning in older
/// versions.
void putVolumes(SceneSpec& spec, const std::map<std::string, ReadVolume>& volumes) {
  constexpr double kMostReach = 16.0;  // the largest width of the older versions
  for (const auto& [name, read] : volumes) {
    const std::string path = pathIn(spec, "/volumes/" + name + "/smooth");
    VolumeSpec volume = read;
    double& sigma = volume.smooth.sigma;
    if (read.smooth_unit > 0.0 && sigma > 0.0) {
      sigma *= read.smooth_unit / metresPerUnit(volumes, name, path);
    }
    if (read.whole_smooth && sigma >= 1.0 && sigma <= kMostReach) {
      spec.notes.push_back(fmt::format(
          "{}: {} is now the standard deviation [voxels]; palpate 0.3 and older smoothed as "
          "{:.2f} does now: write {:.2f} for the older result, or {:.1f} to keep {} without this "
          "note",
          path, sigma, std::sqrt(4.0 * sigma * (sigma + 1.0) / 3.0),
          std::sqrt(4.0 * sigma * (sigma + 1.0) / 3.0), sigma, sigma));
    }
    spec.volumes[name] = std::move(volume);
  }
}

JsonType<DerivedSpec> fieldType() {
  std::vector<JsonObject<DerivedSpec>> kinds;
  kinds.reserve(kDerivations.size());
  for (const Derivation kind : kDerivations) {
    kinds.push_back(JsonObject<DerivedSpec>()
                        .need(wordFor(kind), jsonName(), &DerivedSpec::of)
                        .always([kind](DerivedSpec& field) { field.derivation = kind; }));
  }
  return JsonObject<DerivedSpec>().remark("description").chooseByKey(std::move(kinds)).type();
}

// Modes.

/// A mode, the volume that defines the units of a guide, and the mask of a mode of a label.
struct NamedMode {
  ModeSpec mode;
  std::string in;
  std::optional<MaskSpec> mask;
};

using ModeRows = JsonObject<NamedMode>;

template <class Member>
auto to(Member ModeSpec::*member) {
  return [member](NamedMode& named, auto value) { named.mode.*member = std::move(value); };
}
template <class Member>
auto to(Member GuideSpec::*member) {
  return [member](NamedMode& named, auto value) { named.mode.guide.*member = std::move(value); };
}

ModeRows guideRows() {
  const auto rows = [](PrimitiveKind shape) {
    return ModeRows()
        .always([shape](NamedMode& named) { named.mode.guide.shape = shape; })
        .need("at", vectorType(), to(&GuideSpec::position))
        .may("snap",
             jsonPositive().says("Distance within which the guide acts [m, or units of \"in\"]. By "
                                 "default it always acts."),
             to(&GuideSpec::snap))
        .may("in",
             jsonName().says("The volume that the guide moves with. \"at\", \"along\", \"snap\" "
                             "and the distance that the curves read are in its units."),
             [](NamedMode& named, std::string name) { named.in = std::move(name); });
  };
  const auto directed = [&](PrimitiveKind shape) {
    return rows(shape).need("along",
                            vectorType().says("Direction of a line, or outward normal of a plane."),
                            to(&GuideSpec::direction));
  };
  return ModeRows().choose(
      "shape", {{wordFor(PrimitiveKind::kPoint),
                 rows(PrimitiveKind::kPoint)
                     .refuse({"along"}, "a point has no direction", "remove \"along\"")},
                {wordFor(PrimitiveKind::kLine), directed(PrimitiveKind::kLine)},
                {wordFor(PrimitiveKind::kPlane), directed(PrimitiveKind::kPlane)}});
}

/// Returns the rows of an isosurface at a value, and those of the surface of a label.
std::vector<ModeRows> surfaceRows() {
  return {
      ModeRows().need("value", jsonNumber(), to(&ModeSpec::value)),
      ModeRows()
          .always([](NamedMode& named) { named.mask.emplace(); })
          .need("label",
                labelType().says("Instead of \"value\": the label whose surface the mode has, or "
                                 "several labels. A label is the value of its voxels, or its name "
                                 "in the file."),
                [](NamedMode& named, std::vector<LabelKey> labels) {
                  named.mask->labels = std::move(labels);
                })
          .may("smooth",
               jsonNotNegativeUpTo(kMostSmooth, "voxels")
                   .says("Standard deviation of the Gaussian that smooths the label's surface "
                         "[voxels]. The default is 1."),
               [](NamedMode& named, double sigma) { named.mask->smooth = sigma; })};
}

/// Returns the type of a mode: a row for each kind, and the common keys name, strength and by.
JsonType<NamedMode> modeType(const JsonType<TransferSpec>& transfer) {
  const auto of = [] { return ModeRows().need("of", jsonName(), to(&ModeSpec::of)); };
  const auto solid = [&] {
    return of()
        .may("solid", jsonWord<Solid>({{"above", Solid::kAbove}, {"below", Solid::kBelow}}),
             to(&ModeSpec::solid))
        .may("friction",
             transfer.says("Coulomb's coefficient of friction: sliding starts when the tangential "
                           "force exceeds this fraction of the load. The default is 0."),
             to(&ModeSpec::friction))
        .may("viscosity",
             transfer.says(
                 "Drag where the surface acts, or in an isosurface's solid [N]. The default is 0."),
             to(&ModeSpec::viscosity));
  };
  const std::vector<std::pair<ModeKind, ModeRows>> modes{
      {ModeKind::kForce, of().may("sense",
                                  jsonWord<std::optional<Sense>>(
                                      {{"attract", Sense::kAttract}, {"repel", Sense::kRepel}}),
                                  to(&ModeSpec::sense))},
      {ModeKind::kViscosity, of()},
      {ModeKind::kSurface, solid()},
      {ModeKind::kIsosurface,
       solid()
           .may("depth",
                jsonPositive().says(
                    "After the isosurface has yielded, its plane pulls the proxy back until the "
                    "proxy is this far past the surface [voxels]. The default is 3."),
                to(&ModeSpec::depth_voxels))
           .chooseByKey(surfaceRows())},
      {ModeKind::kFollow, of()},
      {ModeKind::kTransverseDamping, of()},
      {ModeKind::kFrontShape,
       of().may("two_sided",
                jsonFlag().says("If true, the default, the front holds both ways along its normal. "
                                "If false, it holds only against the vectors."),
                to(&ModeSpec::two_sided))
           .may("snap_drag",
                jsonPositive().says(
                    "Distance from its front at which the proxy changes to the next front "
                    "[voxels]. By default the front moves along with the proxy."),
                to(&ModeSpec::snap_voxels))},
      {ModeKind::kVortexTube, of()},
      {ModeKind::kGuide, guideRows()},
  };
  std::vector<std::pair<const char*, ModeRows>> choices;
  for (const auto& [kind, rows] : modes) {
    choices.emplace_back(wordFor(kind), rows);
    choices.back().second.always([kind = kind](NamedMode& named) { named.mode.kind = kind; });
  }
  return ModeRows()
      .may("name", jsonText(), to(&ModeSpec::name))
      .remark("description")
      .choose("mode", std::move(choices))
      .need("strength", transfer.says("Strength [N]."), to(&ModeSpec::strength))
      .may("by", jsonName(), to(&ModeSpec::by))
      .type();
}

// The table of a whole scene file.

struct Table {
  JsonSchema definitions;
  JsonObject<SceneSpec> scene;
};

JsonObject<SceneSpec> couplingRows(const JsonType<TransferSpec>& curve) {
  using Stiffness = std::variant<double, TransferSpec>;
  const auto either = [](auto value) { return Stiffness(std::move(value)); };
  return JsonObject<SceneSpec>()
      .remark("description")
      .may(
          "stiffness",
          jsonNumberOr<Stiffness>(jsonPositive().as<Stiffness>(either), curve.as<Stiffness>(either))
              .says("Stiffness k [N/m]. The default is 500. If it is a transfer function, the "
                    "stiffness changes at a limited rate and adds no energy."),
          [](SceneSpec& spec, Stiffness stiffness) {
            if (auto* varying = std::get_if<TransferSpec>(&stiffness)) {
              spec.graph.stiffness = std::move(*varying);
              return;
            }
            spec.coupling.stiffness = std::get<double>(stiffness);
            spec.any_stiffness = false;
          })
      .may("damping", jsonNotNegative().says("Damping D [N s/m]. The default is 0."),
           [](SceneSpec& spec, double damping) { spec.coupling.damping = damping; });
}

JsonObject<SceneSpec> accuracyRows() {
  return JsonObject<SceneSpec>()
      .remark("description")
      .may("tolerance_voxels",
           jsonPositiveUpTo(kMostTolerance, "it is more than one voxel",
                            "give a fraction of a voxel, such as 0.01")
               .says("Largest distance by which the proxy's motion may leave the surface or stream "
                     "that it follows [voxels]. The default is 0.01."),
           [](SceneSpec& spec, double voxels) { spec.step.tolerance_voxels = voxels; })
      .may("slope_reach",
           jsonPositiveUpTo(1.0, "it is more than one voxel", "give 0.5 or 1")
               .says(
                   "Step to each side of the finite differences for the gradient of a trilinear "
                   "scalar [voxels]. The default is 0.5. The value 1 smooths rough surfaces more."),
           [](SceneSpec& spec, double voxels) { spec.slope_reach = voxels; })
      .may("max_substeps",
           jsonWhole(1, 64).says(
               "Largest number of sub-steps in a tick while a primitive holds the proxy. The rest "
               "of the path then waits for the next tick. The default is 16."),
           [](SceneSpec& spec, int most) { spec.step.max_substeps = most; })
      .may("max_iterations",
           jsonWhole(1, 1000000)
               .says("Largest number of iterations of the balance in a tick. After these the tick "
                     "ends early, and the rest of the path waits for the next tick. The default is "
                     "130."),
           [](SceneSpec& spec, int most) { spec.step.max_iterations = most; });
}

const Table& table() {
  static const Table made = [] {
    Table t;
    const JsonType<TransferSpec> curve = curveType(t.definitions);
    const JsonType<TransferSpec> transfer =
        jsonNumberOr(constantType(), curve)
            .says("A number, a transfer function of a scalar, or a product of several factors.")
            .defined("transfer", t.definitions);
    t.scene.remark("$schema")
        .remark("description")
        .version("palpate", 1, "Version of this format.")
        .mayHold("coupling", couplingRows(curve), "The virtual coupling: eq. (3) of Lundin et al.")
        .mayHold("accuracy", accuracyRows(),
                 "Limits of the work in a tick, and the accuracy of a tick.")
        .mayHold("play", playRows(), "Common playback of the scene's sequences.")
        .need("volumes",
              jsonMap(volumeType().defined("volume", t.definitions), 1,
                      "the scene has no volume, or \"volumes\" is not an object",
                      "write {\"name\": {\"file\": ...}}"),
              putVolumes)
        .may("fields",
             jsonMap(fieldType().defined("field", t.definitions), 0, "it is not an object",
                     "write { ... }"),
             [](SceneSpec& spec, std::map<std::string, DerivedSpec> fields) {
               spec.graph.fields = std::move(fields);
             })
        .need("modes",
              jsonList(modeType(transfer).defined("mode", t.definitions),
                       "it is not a list of at least one mode", "write [{...}, ...]"),
              [](SceneSpec& spec, std::vector<NamedMode> modes) {
                for (NamedMode& named : modes) {
                  if (!named.in.empty()) spec.guide_volumes[spec.graph.modes.size()] = named.in;
                  spec.graph.modes.push_back(std::move(named.mode));
                  if (!named.mask) continue;
                  named.mask->of = spec.graph.modes.back().of;
                  addMask(spec, spec.graph.modes.size() - 1, std::move(*named.mask));
                }
              });
    return t;
  }();
  return made;
}

}  // namespace

const JsonObject<SceneSpec>& sceneTable() {
  return table().scene;
}

JsonSchema sceneTableSchema() {
  return jsonFileSchema("palpate scene, version 1",
                        "Volumes placed in the hand's world (metres, newtons), fields derived from "
                        "the volumes, and the haptic modes that turn their values into forces.",
                        table().scene.schema(), table().definitions);
}

}  // namespace palpate
