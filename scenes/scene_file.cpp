#include "palpate/scenes/scene_file.h"

#include <algorithm>

#include "palpate/engine/error.h"
#include "palpate/samplers/volume.h"
#include "palpate/scenes/scene_table.h"
#include "palpate/scenes/text_file.h"

namespace palpate {
namespace {

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
  static const std::string schema = sceneTableSchema().dump(2) + "\n";
  return schema;
}

SceneSpec parseScene(const std::string& text, const std::string& source,
                     const std::filesystem::path& folder) {
  const Json json = parseJson(text, source, raiseAs<SceneError>);
  SceneSpec spec;
  spec.any_stiffness = true;
  spec.source = source;
  sceneTable().read({json, source, "", raiseAs<SceneError>}, spec);
  for (auto& [name, volume] : spec.volumes) volume.file = folder / volume.file;
  return spec;
}

SceneSpec readSceneFile(const std::filesystem::path& file) {
  return parseScene(readText<SceneError>(file, "check the path"), file.string(),
                    file.parent_path());
}

SceneSpec sceneFromVdb(const std::filesystem::path& path, const Progress& progress) {
  std::vector<std::filesystem::path> files;
  std::error_code error;
  if (std::filesystem::is_directory(path, error)) {
    std::filesystem::directory_iterator entry(path, error);
    for (; !error && entry != std::filesystem::directory_iterator(); entry.increment(error)) {
      if (entry->path().extension() == ".vdb") files.push_back(entry->path());
    }
    if (error) {
      throw VolumeError(path.string(), "it cannot be read (" + error.message() + ")",
                        "check its permissions");
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
  if (std::filesystem::exists(path / "scene.json", error)) {
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
  const auto status = std::filesystem::status(path, error);
  if (status.type() == std::filesystem::file_type::not_found) {
    throw SceneError(path.string(), "no such file", "check the path");
  }
  if (std::filesystem::is_directory(status)) return sceneFromVdb(path, progress);
  checkRegular<SceneError>(path, "give a scene file, a .vdb or a folder of them");
  if (path.extension() == ".vdb" || isVdb(path)) return sceneFromVdb(path, progress);
  return readSceneFile(path);
}

}  // namespace palpate
