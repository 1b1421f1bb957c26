#include "palpate/scenes/library/scene_table.h"

#include <algorithm>
#include <utility>
#include <variant>

#include "palpate/engine/tick/step.h"

namespace palpate {
namespace {

using Curve = TransferFunction;

JsonType<Vec3> vectorType() {
  return jsonNumbers<3>().as<Vec3>([](const auto& v) { return Vec3(v[0], v[1], v[2]); });
}

// Transfer functions (section 2 of the paper).

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
  return jsonList(knot, "it is not a list of points", "write [[input, output], ...]")
      .where(ascend, "its inputs do not ascend", "sort the points by input")
      .as<Curve>([](std::vector<Curve::Knot> knots) { return Curve::piecewise(std::move(knots)); });
}

/// Returns the curves with their inputs: products of one factor.
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

/// A transfer function of a scalar, or a product of several.
JsonType<TransferSpec> curveType(JsonSchema& definitions) {
  std::vector<JsonObject<TransferSpec>> kinds = curves(definitions);
  const JsonType<TransferSpec> factor =
      jsonNumberOr(constantType(), JsonObject<TransferSpec>().chooseByKey(kinds).type())
          .says(
              "A number, or a transfer function of the scalar that its own \"by\" names, else as "
              "the mode's.")
          .defined("factor", definitions);
  kinds.push_back(JsonObject<TransferSpec>().need(
      "product",
      jsonList(factor, "it is not a list of factors", "write [0.5, {\"window\": ...}, ...]"),
      [](TransferSpec& to, const std::vector<TransferSpec>& product) {
        to.factors.clear();
        for (const TransferSpec& one : product) to.factors.push_back(one.factors[0]);
      }));
  return JsonObject<TransferSpec>()
      .chooseByKey(std::move(kinds))
      .type()
      .defined("curve", definitions);
}

// Places.

JsonType<double> unitType() {
  return jsonWord<double>({{"m", 1.0}, {"cm", 1e-2}, {"mm", 1e-3}, {"um", 1e-6}});
}

JsonType<std::array<double, 4>> rotationType() {
  return jsonNumbers<4>().says("Normalised when it is used.");
}

JsonObject<PlaceSpec> motionRows() {
  const JsonType<Keyframe> keyframe =
      JsonObject<Keyframe>()
          .need("time", jsonNumber().says("Since the scene began [s]."), &Keyframe::time)
          .may("rotation_wxyz", rotationType(), &Keyframe::rotation_wxyz)
          .may("translate", vectorType(), &Keyframe::translate)
          .type();
  const JsonType<WarpSpec> warp =
      JsonObject<WarpSpec>()
          .need("field",
                jsonName().says("The volume whose vectors are the displacement u, in its file's "
                                "unit of length: what is at x rests at x + u. A frame for each "
                                "grid of its name, or for each file that %04d in its name means."),
                &WarpSpec::field)
          .may("times",
               jsonList(jsonNumber(), "it is not a list of times", "write [0, 0.1, ...]")
                   .says("Of the frames, ascending [s]; held before the first and after the last. "
                         "Of a single frame none is needed."),
               &WarpSpec::times)
          .may("repeat",
               jsonFlag().says("Over and over; the last frame is the first again. Default false."),
               &WarpSpec::repeat)
          .type()
          .says("How the placed volume deforms, before the keyframes move it.");
  return JsonObject<PlaceSpec>()
      .may("warp", warp, [](PlaceSpec& place, WarpSpec value) { place.warp = std::move(value); })
      .may("keyframes",
           jsonList(keyframe, "it is not a list of keyframes", "write [{\"time\": 0, ...}, ...]")
               .says("How the placed volume moves: turned about the world's origin, then shifted; "
                     "evenly in between, held before the first and after the last. Times ascend."),
           &PlaceSpec::keyframes)
      .may("repeat",
           jsonFlag().says("Over and over; the last keyframe's pose is the first's. Default "
                           "false."),
           &PlaceSpec::repeat)
      .needs("repeat", "keyframes", "there are no keyframes to repeat", "add \"keyframes\"");
}

/// The three kinds of place that need no other volume.
std::vector<JsonObject<PlaceSpec>> placesWith(const JsonObject<PlaceSpec>& motion) {
  const auto put = [](PlaceSpec::Kind kind) {
    return [kind](PlaceSpec& place, double size) {
      place.kind = kind;
      (kind == PlaceSpec::Kind::kMap ? place.scale : place.size) = size;
    };
  };
  const auto centred = [&](JsonObject<PlaceSpec> rows) {
    return rows.with(motion).refuse({"rotation_wxyz", "translate"},
                                    "rotation_wxyz and translate need scale",
                                    "give scale, in metres per unit of the file, instead");
  };
  return {centred(JsonObject<PlaceSpec>().need(
              "fit", jsonPositive().says("Longest side of the active bounds [m], centred."),
              put(PlaceSpec::Kind::kFit))),
          centred(JsonObject<PlaceSpec>().need("unit", unitType().says("True size, centred."),
                                               put(PlaceSpec::Kind::kUnit))),
          JsonObject<PlaceSpec>()
              .need("scale", jsonPositive().says("Metres per unit of the file."),
                    put(PlaceSpec::Kind::kMap))
              .may("rotation_wxyz", rotationType(), &PlaceSpec::rotation_wxyz)
              .may("translate", vectorType(), &PlaceSpec::translate)
              .with(motion)};
}

JsonType<PlaceSpec> placeType() {
  std::vector<JsonObject<PlaceSpec>> kinds = placesWith(motionRows());
  kinds.push_back(
      JsonObject<PlaceSpec>()
          .need("like", jsonName().says("Moves with it, too."),
                [](PlaceSpec& place, std::string name) {
                  place.kind = PlaceSpec::Kind::kLike;
                  place.like = std::move(name);
                })
          .refuse({"keyframes", "repeat", "warp"}, "a volume placed like another moves with that",
                  "remove them, or place it by fit, unit or scale")
          .refuse({"rotation_wxyz", "translate"}, "rotation_wxyz and translate need scale",
                  "give scale, in metres per unit of the file, instead"));
  return JsonObject<PlaceSpec>()
      .chooseByKey(std::move(kinds))
      .type()
      .says("Default: {\"fit\": 0.1}.");
}

JsonType<PlaceSpec> instanceType() {
  return JsonObject<PlaceSpec>()
      .chooseByKey(placesWith({}))
      .refuse({"like", "keyframes", "repeat", "warp"},
              "an instance has a place of its own and stands still", "give fit, unit or scale")
      .type();
}

// Volumes and fields.

JsonType<FramesSpec> framesType() {
  const auto common =
      JsonObject<FramesSpec>()
          .may("repeat",
               jsonFlag().says("After the last frame the first comes, over and over. Default "
                               "false: the last one stays."),
               &FramesSpec::repeat)
          .may("budget_mb",
               jsonPositive().says("Of memory for frames [MB], which are fetched ahead of play; "
                                   "default 1024."),
               [](FramesSpec& to, double budget) { to.budget_mb = budget; });
  return JsonObject<FramesSpec>()
      .chooseByKey(
          {JsonObject<FramesSpec>()
               .need("rate", jsonPositive().says("Frames a second."), &FramesSpec::rate)
               .with(common),
           JsonObject<FramesSpec>()
               .need("times",
                     jsonList(jsonNumber(), "it is not a list of times", "write [0, 0.1, ...]")
                         .says("Of the frames, ascending [s]; repeated one more, when the first "
                               "comes again."),
                     &FramesSpec::times)
               .with(common)})
      .type()
      .says(
          "The volume is a sequence: a frame for each grid of its name, or for each file that "
          "%04d in its name means. Between two frames values are blended.");
}

JsonObject<SceneSpec> playRows() {
  const auto play = [](SceneSpec& spec) -> PlaySpec& {
    if (!spec.play) spec.play.emplace();
    return *spec.play;
  };
  return JsonObject<SceneSpec>()
      .remark("description")
      .may("speed", jsonNumber().says("Seconds of play a second; below 0: backwards. Default 1."),
           [play](SceneSpec& spec, double speed) { play(spec).speed = speed; })
      .may("paused", jsonFlag().says("It stands until a key lets it go. Default false."),
           [play](SceneSpec& spec, bool paused) { play(spec).paused = paused; })
      .may("from",
           jsonNumber().says("Play goes from there [s], forwards or backwards; default: from the "
                             "first sequence on, or from for ever where all repeat."),
           [play](SceneSpec& spec, double from) { play(spec).from = from; })
      .may("to",
           jsonNumber().says("Play goes to there [s]; default: with the last sequence, or never "
                             "where one repeats. Backwards it begins here."),
           [play](SceneSpec& spec, double to) { play(spec).to = to; })
      .may("repeat", jsonFlag().says("From one end it jumps to the other. Default false."),
           [play](SceneSpec& spec, bool repeat) { play(spec).repeat = repeat; });
}

JsonType<VolumeSpec> volumeType() {
  return JsonObject<VolumeSpec>()
      .remark("description")
      .need("file",
            jsonName().says("A .vdb, a folder of bricks (palpate brick), which is fetched as the "
                            "hand goes, or for frames a name with %04d for their number."),
            [](VolumeSpec& to, const std::string& name) { to.file = name; })
      .may("grid", jsonName(), &VolumeSpec::grid)
      .may("interpolation",
           jsonWordOf({Interpolation::kTrilinear, Interpolation::kNearest,
                       Interpolation::kQuadratic, Interpolation::kCubic}),
           [](VolumeSpec& to, Interpolation value) { to.sampling.interpolation = value; })
      .may("axial",
           jsonFlag().says("A vector without a sign, as a fibre's direction. Default false."),
           [](VolumeSpec& to, bool axial) { to.sampling.axial = axial; })
      .may("non_finite",
           jsonWord<NonFinite>({{"refuse", NonFinite::kRefuse}, {"fill", NonFinite::kFill}})
               .says("Values that are no numbers: refuse the grid (default), or make them "
                     "background, no data."),
           &VolumeSpec::non_finite)
      .may("smooth",
           jsonWhole(0, 16).says("OpenVDB's Gaussian at load: four box filters of so many voxels "
                                 "to each side. Default 0."),
           &VolumeSpec::smooth)
      .may("frames", framesType(),
           [](VolumeSpec& to, FramesSpec value) { to.frames = std::move(value); })
      .may("window",
           JsonObject<double>()
               .need("budget_mb",
                     jsonPositive().says("Of memory for bricks about the hands [MB]; default 256."),
                     [](double& to, double budget) { to = budget; })
               .type()
               .says("What of a volume in bricks is in memory."),
           [](VolumeSpec& to, double budget) { to.budget_mb = budget; })
      .may("place", placeType(), &VolumeSpec::place)
      .may("instances",
           jsonList(instanceType(), "it is not a list of places", "write [{\"scale\": ...}, ...]")
               .says("Instead of place: many, one after the other. Volumes that are placed like "
                     "this one stand there as well."),
           &VolumeSpec::instances)
      .either("instances", "place", "it has a place as well", "give one of place and instances")
      .type();
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

/// A mode, and the volume that sets a guide's units.
struct NamedMode {
  ModeSpec mode;
  std::string in;
};

using ModeRows = JsonObject<NamedMode>;

/// Returns the setter of a key for a NamedMode.
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
        .may("snap", jsonPositive().says("Acts within so many metres; default: always."),
             to(&GuideSpec::snap))
        .may("in",
             jsonName().says("The volume in whose own units at, along, snap and the distance that "
                             "its curves read are given."),
             [](NamedMode& named, std::string name) { named.in = std::move(name); });
  };
  const auto directed = [&](PrimitiveKind shape) {
    return rows(shape).need("along", vectorType().says("Of a line; a plane's outward normal."),
                            to(&GuideSpec::direction));
  };
  return ModeRows().choose(
      "shape",
      {{wordFor(PrimitiveKind::kPoint),
        rows(PrimitiveKind::kPoint).refuse({"along"}, "a point has no direction", "remove it")},
       {wordFor(PrimitiveKind::kLine), directed(PrimitiveKind::kLine)},
       {wordFor(PrimitiveKind::kPlane), directed(PrimitiveKind::kPlane)}});
}

/// One row for each mode: its keys other than name, strength and by.
JsonType<NamedMode> modeType(const JsonType<TransferSpec>& transfer) {
  const auto of = [] { return ModeRows().need("of", jsonName(), to(&ModeSpec::of)); };
  const auto solid = [&] {
    return of()
        .may("solid", jsonWord<Solid>({{"above", Solid::kAbove}, {"below", Solid::kBelow}}),
             to(&ModeSpec::solid))
        .may("friction",
             transfer.says("Coulomb's coefficient: slip starts at so much of the load. Default 0."),
             to(&ModeSpec::friction))
        .may("viscosity",
             transfer.says("Newtons of drag where the surface acts, or in an isosurface's solid. "
                           "Default 0."),
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
           .need("value", jsonNumber(), to(&ModeSpec::value))
           .may("depth", jsonPositive().says("Voxels; default 3."), to(&ModeSpec::depth_voxels))},
      {ModeKind::kFollow, of()},
      {ModeKind::kTransverseDamping, of()},
      {ModeKind::kFrontShape,
       of().may("two_sided", jsonFlag().says("Default true; else only against the vectors."),
                to(&ModeSpec::two_sided))
           .may("snap_drag",
                jsonPositive().says("Voxels that the proxy can be pulled off its front before the "
                                    "next one takes over; default: the front comes along."),
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
      .need("strength", transfer.says("Newtons."), to(&ModeSpec::strength))
      .may("by", jsonName(), to(&ModeSpec::by))
      .type();
}

// The whole table.

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
              .says("k [N/m]; default 500. A transfer function changes at a limited rate, and "
                    "passively."),
          [](SceneSpec& spec, Stiffness stiffness) {
            if (auto* varying = std::get_if<TransferSpec>(&stiffness)) {
              spec.graph.stiffness = std::move(*varying);
              return;
            }
            spec.coupling.stiffness = std::get<double>(stiffness);
            spec.any_stiffness = false;
          })
      .may("damping", jsonNotNegative().says("D [N s/m]; default 0."),
           [](SceneSpec& spec, double damping) { spec.coupling.damping = damping; });
}

JsonObject<SceneSpec> accuracyRows() {
  return JsonObject<SceneSpec>()
      .remark("description")
      .may("tolerance_voxels",
           jsonPositiveUpTo(kMostTolerance, "it is more than a voxel",
                            "give a share of a voxel, as 0.01")
               .says("How far the proxy may be off its surface or stream by its motion [voxels]; "
                     "default 0.01."),
           [](SceneSpec& spec, double voxels) { spec.step.tolerance_voxels = voxels; })
      .may("slope_reach",
           jsonPositiveUpTo(1.0, "it is more than a voxel", "give 0.5 or 1")
               .says("How far from a place the gradient of a trilinear scalar takes its "
                     "differences [voxels]; default 0.5. 1 smooths rough surfaces more."),
           [](SceneSpec& spec, double voxels) { spec.slope_reach = voxels; })
      .may("max_substeps",
           jsonWhole(1, 64).says("Most readings a tick while something holds the proxy, which "
                                 "moves at most a voxel between them; default 16."),
           [](SceneSpec& spec, int most) { spec.step.max_substeps = most; })
      .may(
          "max_iterations",
          jsonWhole(1, 1000000)
              .says("Most iterations of the balance a tick: after so many nothing more is read and "
                    "the rest of the path waits for the next tick; default 130."),
          [](SceneSpec& spec, int most) { spec.step.max_iterations = most; });
}

const Table& table() {
  static const Table made = [] {
    Table t;
    const JsonType<TransferSpec> curve = curveType(t.definitions);
    const JsonType<TransferSpec> transfer =
        jsonNumberOr(constantType(), curve)
            .says("A number, a transfer function of a scalar, or a product of several.")
            .defined("transfer", t.definitions);
    t.scene.remark("$schema")
        .remark("description")
        .version("palpate", 1, "Version of this format.")
        .mayHold("coupling", couplingRows(curve), "The virtual coupling, Lundin et al. eq. (3).")
        .mayHold("accuracy", accuracyRows(), "What a tick may take, and how exact it is.")
        .mayHold("play", playRows(), "How the scene's sequences are played, all together.")
        .need("volumes",
              jsonMap(volumeType().defined("volume", t.definitions), 1, "there is no volume",
                      "write {\"name\": {\"file\": ...}}"),
              &SceneSpec::volumes)
        .may("fields",
             jsonMap(fieldType().defined("field", t.definitions), 0, "it is not an object",
                     "write { ... }"),
             [](SceneSpec& spec, std::map<std::string, DerivedSpec> fields) {
               spec.graph.fields = std::move(fields);
             })
        .need("modes",
              jsonList(modeType(transfer).defined("mode", t.definitions),
                       "it is not a list of one mode or more, so nothing can be felt",
                       "write [{...}, ...]"),
              [](SceneSpec& spec, std::vector<NamedMode> modes) {
                for (NamedMode& named : modes) {
                  if (!named.in.empty()) spec.guide_volumes[spec.graph.modes.size()] = named.in;
                  spec.graph.modes.push_back(std::move(named.mode));
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
                        "them, and the haptic modes that make them felt.",
                        table().scene.schema(), table().definitions);
}

}  // namespace palpate
