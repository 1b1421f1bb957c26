#include "palpate/scenes/scene_file.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <initializer_list>
#include <set>
#include <sstream>

#include <fmt/format.h>

#include "palpate/devices/json_node.h"
#include "palpate/engine/error.h"
#include "palpate/samplers/volume.h"
#include "palpate/scenes/scene_schema.h"

namespace palpate {
namespace {

using Node = JsonNode<SceneError>;

/// The curve of a window or of points.
TransferFunction readCurve(const Node& node) {
  if (node.has("window") == node.has("piecewise")) {
    node.fail("it is neither a number nor one curve",
              "write a number, {\"window\": ...} or {\"piecewise\": ...}");
  }
  if (node.has("window")) {
    const Node window = node.child("window").object({"level", "width", "max"});
    return TransferFunction::window(window.need("level").number(), window.need("width").positive(),
                                    window.need("max").notNegative());
  }
  const Node curve = node.child("piecewise");
  if (!curve.json().is_array() || curve.json().empty()) {
    curve.fail("it is not a list of points", "write [[input, output], ...]");
  }
  std::vector<TransferFunction::Knot> knots;
  for (std::size_t i = 0; i < curve.json().size(); ++i) {
    const Node point = curve.element(i);
    const auto knot = point.numbers<2>();
    (void)point.element(1).notNegative();
    knots.emplace_back(knot[0], knot[1]);
  }
  const auto ascending = [](const auto& a, const auto& b) { return a.first < b.first; };
  if (!std::is_sorted(knots.begin(), knots.end(), ascending)) {
    curve.fail("its inputs do not ascend", "sort the points by input");
  }
  return TransferFunction::piecewise(std::move(knots));
}

/// A number, or a curve that may say what it reads.
TransferSpec::Factor readFactor(const Node& node) {
  if (node.json().is_number()) return {node.notNegative(), ""};
  node.object({"window", "piecewise", "by"});
  return {readCurve(node), node.has("by") ? node.child("by").name() : ""};
}

/// A material property: a factor, or a product of several.
TransferSpec readTransfer(const Node& node) {
  std::vector<TransferSpec::Factor> factors;
  if (!node.json().is_object() || !node.json().contains("product")) {
    factors.push_back(readFactor(node));
    return TransferSpec(std::move(factors));
  }
  node.object({"product"});
  const Node product = node.child("product");
  if (!product.json().is_array() || product.json().empty()) {
    product.fail("it is not a list of factors", "write [0.5, {\"window\": ...}, ...]");
  }
  for (std::size_t i = 0; i < product.json().size(); ++i) {
    factors.push_back(readFactor(product.element(i)));
  }
  return TransferSpec(std::move(factors));
}

Vec3 readVec3(const Node& node) {
  const auto v = node.numbers<3>();
  return {v[0], v[1], v[2]};
}

/// How a volume moves; what its keyframes say is checked when the scene is built.
void readKeyframes(const Node& node, PlaceSpec& place) {
  const Node list = node.child("keyframes");
  if (!list.json().is_array() || list.json().empty()) {
    list.fail("it is not a list of keyframes", "write [{\"time\": 0, ...}, ...]");
  }
  for (std::size_t i = 0; i < list.json().size(); ++i) {
    const Node key = list.element(i).object({"time", "rotation_wxyz", "translate"});
    Keyframe& keyframe = place.keyframes.emplace_back();
    keyframe.time = key.need("time").number();
    if (key.has("rotation_wxyz")) keyframe.rotation_wxyz = key.child("rotation_wxyz").numbers<4>();
    if (key.has("translate")) keyframe.translate = readVec3(key.child("translate"));
  }
  if (node.has("repeat")) place.repeat = node.child("repeat").flag();
}

PlaceSpec readPlace(const Node& node) {
  node.object(
      {"fit", "unit", "scale", "rotation_wxyz", "translate", "like", "keyframes", "repeat"});
  PlaceSpec place;
  const int kinds = static_cast<int>(node.has("fit")) + static_cast<int>(node.has("unit")) +
                    static_cast<int>(node.has("scale")) + static_cast<int>(node.has("like"));
  if (kinds != 1)
    node.fail("it has none or several of its kinds", "give one of fit, unit, scale, like");
  if (!node.has("scale") && (node.has("rotation_wxyz") || node.has("translate"))) {
    node.fail("rotation_wxyz and translate need scale",
              "give scale, in metres per unit of the file, instead of the other");
  }
  if (node.has("fit")) {
    place.size = node.child("fit").positive();
  } else if (node.has("unit")) {
    place.kind = PlaceSpec::Kind::kUnit;
    place.size =
        node.child("unit").word<double>({{"m", 1.0}, {"cm", 1e-2}, {"mm", 1e-3}, {"um", 1e-6}});
  } else if (node.has("like")) {
    place.kind = PlaceSpec::Kind::kLike;
    place.like = node.child("like").name();
  } else {
    place.kind = PlaceSpec::Kind::kMap;
    place.scale = node.child("scale").positive();
    if (node.has("rotation_wxyz")) place.rotation_wxyz = node.child("rotation_wxyz").numbers<4>();
    if (node.has("translate")) place.translate = readVec3(node.child("translate"));
  }
  if (node.has("like") && node.has("keyframes")) {
    node.child("keyframes")
        .fail("a volume placed like another moves with that",
              "remove them, or place it by fit, unit or scale");
  }
  if (node.has("repeat") && !node.has("keyframes")) {
    node.child("repeat").fail("there are no keyframes to repeat", "add \"keyframes\"");
  }
  if (node.has("keyframes")) readKeyframes(node, place);
  return place;
}

/// Places of one volume, each still and its own.
std::vector<PlaceSpec> readInstances(const Node& node) {
  if (!node.json().is_array() || node.json().empty()) {
    node.fail("it is not a list of places", "write [{\"scale\": ...}, ...]");
  }
  std::vector<PlaceSpec> places;
  places.reserve(node.json().size());
  for (std::size_t i = 0; i < node.json().size(); ++i) {
    const Node place = node.element(i);
    for (const char* key : {"like", "keyframes"}) {
      if (place.json().is_object() && place.has(key)) {
        place.child(key).fail("an instance has a place of its own and stands still",
                              "give fit, unit or scale");
      }
    }
    places.push_back(readPlace(place));
  }
  return places;
}

VolumeSpec readVolume(const Node& node, const std::filesystem::path& folder) {
  node.object({"file", "grid", "place", "instances", "interpolation", "axial", "non_finite",
               "smooth", "description"});
  VolumeSpec volume;
  volume.file = folder / node.need("file").name();
  if (node.has("grid")) volume.grid = node.child("grid").name();
  if (node.has("place")) volume.place = readPlace(node.child("place"));
  if (node.has("instances")) {
    if (node.has("place")) {
      node.child("instances").fail("it has a place as well", "give one of place and instances");
    }
    volume.instances = readInstances(node.child("instances"));
  }
  if (node.has("interpolation")) {
    volume.sampling.interpolation = node.child("interpolation")
                                        .wordOf({Interpolation::kTrilinear, Interpolation::kNearest,
                                                 Interpolation::kQuadratic, Interpolation::kCubic});
  }
  if (node.has("axial")) volume.sampling.axial = node.child("axial").flag();
  if (node.has("non_finite")) {
    volume.non_finite =
        node.child("non_finite")
            .word<NonFinite>({{"refuse", NonFinite::kRefuse}, {"fill", NonFinite::kFill}});
  }
  if (node.has("smooth")) volume.smooth = node.child("smooth").whole(0, 16);
  return volume;
}

DerivedSpec readField(const Node& node) {
  node.object(
      {"magnitude", "gradient", "curl", "divergence", "unit", "q", "lambda2", "description"});
  DerivedSpec derived;
  int count = 0;
  for (const Derivation kind : kDerivations) {
    if (!node.has(wordFor(kind))) continue;
    ++count;
    derived.derivation = kind;
    derived.of = node.child(wordFor(kind)).name();
  }
  if (count != 1) {
    node.fail("it has none or several of its kinds",
              "give one of magnitude, gradient, curl, divergence, unit, q, lambda2");
  }
  return derived;
}

GuideSpec readGuide(const Node& node) {
  GuideSpec guide;
  guide.shape = node.need("shape").wordOf(
      {PrimitiveKind::kPoint, PrimitiveKind::kLine, PrimitiveKind::kPlane});
  guide.position = readVec3(node.need("at"));
  const bool point = guide.shape == PrimitiveKind::kPoint;
  if (point && node.has("along")) {
    node.child("along").fail("a point has no direction", "remove it");
  }
  if (!point) guide.direction = readVec3(node.need("along"));
  if (node.has("snap")) guide.snap = node.child("snap").positive();
  return guide;
}

/// Which keys a mode has beside those of all.
std::vector<const char*> keysOf(ModeKind kind) {
  switch (kind) {
    case ModeKind::kForce:
      return {"of", "sense"};
    case ModeKind::kSurface:
      return {"of", "solid", "friction", "viscosity"};
    case ModeKind::kIsosurface:
      return {"of", "solid", "friction", "viscosity", "value", "depth"};
    case ModeKind::kFrontShape:
      return {"of", "two_sided", "snap_drag"};
    case ModeKind::kGuide:
      return {"shape", "at", "along", "snap", "in"};
    case ModeKind::kViscosity:
    case ModeKind::kFollow:
    case ModeKind::kTransverseDamping:
    case ModeKind::kVortexTube:
    case ModeKind::kUser:
      break;
  }
  return {"of"};
}

ModeSpec readMode(const Node& node) {
  node.object({"name", "description", "mode", "strength", "by", "of", "value", "solid", "depth",
               "sense", "friction", "viscosity", "two_sided", "snap_drag", "shape", "at", "along",
               "snap", "in"});
  ModeSpec mode;
  mode.kind = node.need("mode").wordOf({ModeKind::kForce, ModeKind::kViscosity, ModeKind::kSurface,
                                        ModeKind::kIsosurface, ModeKind::kFollow,
                                        ModeKind::kTransverseDamping, ModeKind::kFrontShape,
                                        ModeKind::kVortexTube, ModeKind::kGuide});
  const std::vector<const char*> own = keysOf(mode.kind);
  for (const auto& [key, value] : node.json().items()) {
    const auto is = [&key = key](const char* known) { return key == known; };
    const std::initializer_list<const char*> common = {"name", "description", "mode", "strength",
                                                       "by"};
    if (std::any_of(common.begin(), common.end(), is)) continue;
    if (std::any_of(own.begin(), own.end(), is)) continue;
    node.child(key).fail(std::string("mode ") + wordFor(mode.kind) + " has no such key",
                         "remove it");
  }
  if (mode.kind == ModeKind::kGuide) {
    mode.guide = readGuide(node);
  } else {
    mode.of = node.need("of").name();
  }
  mode.strength = readTransfer(node.need("strength"));
  if (node.has("friction")) mode.friction = readTransfer(node.child("friction"));
  if (node.has("viscosity")) mode.viscosity = readTransfer(node.child("viscosity"));
  if (node.has("name")) mode.name = node.child("name").text();
  if (node.has("by")) mode.by = node.child("by").name();
  if (mode.kind == ModeKind::kIsosurface) mode.value = node.need("value").number();
  if (node.has("depth")) mode.depth_voxels = node.child("depth").positive();
  if (node.has("two_sided")) mode.two_sided = node.child("two_sided").flag();
  if (node.has("snap_drag")) mode.snap_voxels = node.child("snap_drag").positive();
  if (node.has("solid")) {
    mode.solid =
        node.child("solid").word<Solid>({{"above", Solid::kAbove}, {"below", Solid::kBelow}});
  }
  if (node.has("sense")) {
    mode.sense =
        node.child("sense").word<Sense>({{"attract", Sense::kAttract}, {"repel", Sense::kRepel}});
  }
  return mode;
}

/// The mode or modes that suit a grid.
void addSuitableModes(const GridInfo& info, const std::string& name, std::vector<ModeSpec>& modes) {
  ModeSpec mode;
  mode.of = name;
  if (info.vector) {
    mode.name = "follow " + name;
    mode.kind = ModeKind::kFollow;
    mode.strength = info.highest > 0.0
                        ? TransferFunction::window(0.5 * info.highest, info.highest, 2.0)
                        : TransferFunction(0.0);
    modes.push_back(mode);
    return;
  }
  if (info.grid_class == GridClass::kLevelSet) {
    mode.name = name;
    mode.kind = ModeKind::kIsosurface;
    mode.solid = Solid::kBelow;
    mode.value = 0.0;
    mode.strength = 3.0;
    modes.push_back(mode);
    return;
  }
  // Full strength at four times the mean's height over the lowest value: much of a fog is thin.
  const double span = std::min(info.highest - info.lowest, 4.0 * (info.mean - info.lowest));
  const auto over = [&](double max) {
    return span > 0.0 ? TransferFunction::window(info.lowest + 0.5 * span, span, max)
                      : TransferFunction(max);
  };
  mode.name = "surface of " + name;
  mode.kind = ModeKind::kSurface;
  mode.strength = over(2.0);
  modes.push_back(mode);
  mode.name = "viscosity of " + name;
  mode.kind = ModeKind::kViscosity;
  mode.strength = over(0.5);
  modes.push_back(mode);
}

}  // namespace

const std::string& sceneSchema() {
  static const std::string schema(kSceneSchema);
  return schema;
}

SceneSpec parseScene(const std::string& text, const std::string& source,
                     const std::filesystem::path& folder) {
  const Json json = parseJson<SceneError>(text, source);
  const Node root(json, source, "");
  root.object(
      {"$schema", "description", "palpate", "coupling", "accuracy", "volumes", "fields", "modes"});
  if (root.need("palpate").number() != 1.0) {
    root.child("palpate").fail(json["palpate"].dump() + " is a version this program does not know",
                               "write 1");
  }
  SceneSpec spec;
  spec.any_stiffness = true;
  spec.source = source;
  if (root.has("coupling")) {
    const Node node = root.child("coupling").object({"stiffness", "damping", "description"});
    if (node.has("stiffness")) {
      if (node.child("stiffness").json().is_object()) {
        spec.graph.stiffness = readTransfer(node.child("stiffness"));
      } else {
        spec.coupling.stiffness = node.child("stiffness").positive();
        spec.any_stiffness = false;
      }
    }
    if (node.has("damping")) spec.coupling.damping = node.child("damping").notNegative();
  }
  if (root.has("accuracy")) {
    const Node node =
        root.child("accuracy").object({"tolerance_voxels", "max_substeps", "description"});
    if (node.has("tolerance_voxels")) {
      const Node tolerance = node.child("tolerance_voxels");
      spec.step.tolerance_voxels = tolerance.positive();
      if (spec.step.tolerance_voxels > kMostTolerance) {
        tolerance.fail("it is more than a voxel", "give a share of a voxel, as 0.01");
      }
    }
    if (node.has("max_substeps")) {
      spec.step.max_substeps = node.child("max_substeps").whole(1, 64);
    }
  }
  const Node volumes = root.need("volumes");
  if (!volumes.json().is_object() || volumes.json().empty()) {
    volumes.fail("there is no volume", "write {\"name\": {\"file\": ...}}");
  }
  for (const auto& [name, value] : volumes.json().items()) {
    spec.volumes[name] = readVolume(volumes.child(name), folder);
  }
  if (root.has("fields")) {
    const Node fields = root.child("fields");
    if (!fields.json().is_object()) fields.fail("it is not an object", "write { ... }");
    for (const auto& [name, value] : fields.json().items()) {
      spec.graph.fields[name] = readField(fields.child(name));
    }
  }
  const Node modes = root.need("modes");
  if (!modes.json().is_array()) modes.fail("it is not a list", "write [ ... ]");
  if (modes.json().empty()) modes.fail("there is no mode, so nothing can be felt", "add one");
  for (std::size_t i = 0; i < modes.json().size(); ++i) {
    spec.graph.modes.push_back(readMode(modes.element(i)));
    const Node mode = modes.element(i);
    if (mode.has("in")) spec.guide_volumes[i] = mode.child("in").name();
  }
  validateJson<SceneError>(json, sceneSchema(), "scene.schema.json", source);
  return spec;
}

SceneSpec readSceneFile(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::ostringstream text;
  if (in) text << in.rdbuf();
  if (!in) throw SceneError(file.string(), "it cannot be read", "check the path");
  return parseScene(text.str(), file.string(), file.parent_path());
}

SceneSpec sceneFromVdb(const std::filesystem::path& path, const Progress& progress) {
  std::vector<std::filesystem::path> files;
  if (std::filesystem::is_directory(path)) {
    for (const auto& entry : std::filesystem::directory_iterator(path)) {
      if (entry.path().extension() == ".vdb") files.push_back(entry.path());
    }
    std::sort(files.begin(), files.end());
    if (files.empty()) {
      throw VolumeError(path.string(), "there is no .vdb in it", "give a folder of .vdb files");
    }
  } else {
    files.push_back(path);
  }

  SceneSpec spec;
  spec.any_stiffness = true;
  spec.source = path.string();
  if (std::error_code error; std::filesystem::exists(path / "scene.json", error)) {
    spec.notes.push_back(
        (path / "scene.json").string() +
        ": it is not read: only the volumes of this folder are; name it to feel it");
  }
  const std::vector<FileResult> loaded = loadFiles(files, progress);
  std::vector<std::pair<std::size_t, std::size_t>> grids;  // of which file, and which there
  for (std::size_t f = 0; f < files.size(); ++f) {
    for (std::size_t g = 0; g < loaded[f].names.size(); ++g) grids.emplace_back(f, g);
    try {
      if (loaded[f].error) std::rethrow_exception(loaded[f].error);
    } catch (const VolumeError& e) {
      if (files.size() == 1) throw;
      spec.notes.push_back(std::string(e.what()) + "; it is left out");
    }
  }
  std::string first;
  for (const auto& [f, g] : grids) {
    const LoadResult& result = loaded[f].volumes[g];
    VolumeSpec volume;
    volume.file = files[f];
    volume.grid = loaded[f].names[g];
    volume.volume = result.volume;
    try {
      if (result.error) std::rethrow_exception(result.error);
    } catch (const VolumeError& e) {
      spec.notes.emplace_back(e.what());
      continue;
    }
    std::string name = volume.grid.empty() ? "grid" : volume.grid;
    if (files.size() > 1) name.insert(0, volume.file.stem().string() + ".");
    if (!first.empty()) {
      volume.place.kind = PlaceSpec::Kind::kLike;
      volume.place.like = first;
    } else {
      first = name;
    }
    addSuitableModes(volume.volume->info(), name, spec.graph.modes);
    spec.volumes[name] = std::move(volume);
  }
  if (spec.volumes.empty()) {
    // With one grid its own trouble is the message, with several each is one.
    std::string why = "none of its grids can be felt";
    for (const std::string& note : spec.notes) why += " (" + note + ")";
    throw VolumeError(path.string(), why, "write a grid that can, or choose another file");
  }
  return spec;
}

SceneSpec openScene(const std::filesystem::path& path, const Progress& progress) {
  std::error_code error;
  if (!std::filesystem::exists(path, error)) {
    throw SceneError(path.string(), "no such file", "check the path");
  }
  const bool folder = std::filesystem::is_directory(path, error);
  if (folder || path.extension() == ".vdb" || isVdb(path)) return sceneFromVdb(path, progress);
  return readSceneFile(path);
}

}  // namespace palpate
