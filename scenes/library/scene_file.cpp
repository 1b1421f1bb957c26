#include "palpate/scenes/library/scene_file.h"

#include <algorithm>
#include <fstream>
#include <iterator>
#include <utility>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/bricks.h"
#include "palpate/samplers/grid/volume.h"
#include "palpate/scenes/library/brick_places.h"
#include "palpate/scenes/library/scene_table.h"
#include "palpate/scenes/library/text_file.h"

namespace palpate {
namespace {

std::vector<std::filesystem::path> vdbFilesOf(const std::filesystem::path& path) {
  std::error_code error;
  if (!std::filesystem::is_directory(path, error)) return {path};
  std::vector<std::filesystem::path> files;
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
    throw VolumeError(path.string(), "the folder has no .vdb file",
                      "give a folder of .vdb files; import DICOM, slices, Zarr and OpenFOAM first: "
                      "palpate import FOLDER OUT.vdb");
  }
  return files;
}

/// Returns true for a .json file, an empty or unreadable file, and a file whose first character
/// after spaces and line breaks is a brace.
bool mayBeScene(const std::filesystem::path& file) {
  if (file.extension() == ".json") return true;
  std::ifstream in(file, std::ios::binary);
  in >> std::ws;
  const int first = in.peek();
  return first == std::ifstream::traits_type::eof() || first == '{';
}

/// Returns the usable grids. Adds the errors of all other grids to `notes`.
std::vector<GuessVolume> feltOf(const FileResult& loaded, std::vector<std::string>& notes) {
  std::vector<GuessVolume> volumes;
  for (std::size_t g = 0; g < loaded.names.size(); ++g) {
    const LoadResult& result = loaded.volumes[g];
    try {
      if (result.error) std::rethrow_exception(result.error);
      volumes.push_back({loaded.names[g], result.volume});
    } catch (const VolumeError& e) {
      notes.emplace_back(e.what());
    }
  }
  return volumes;
}

[[noreturn]] void throwNoneFelt(const std::filesystem::path& path,
                                const std::vector<std::string>& notes) {
  std::string why = "none of its grids is usable";
  for (const std::string& note : notes) why += " (" + note + ")";
  throw VolumeError(path.string(), why, "correct these grids, or choose another file");
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
  for (auto& [name, volume] : spec.volumes) {
    if (!volume.mask && !isRemote(volume.file)) volume.file = folder / volume.file;
  }
  return spec;
}

SceneSpec readSceneFile(const std::filesystem::path& file, std::string* text) {
  checkRegular<SceneError>(file, "check the path and its permissions");
  if (!mayBeScene(file)) (void)gridNames(file);  // throws if the file is not a .vdb
  std::string read = readText<SceneError>(file, "check the path and its permissions");
  if (read.starts_with("{\"palpate_recording\":")) {
    throw SceneError(file.string(), "the file is a recording, not a scene",
                     "give a scene file, or use palpate feel, view, compare or convert");
  }
  SceneSpec spec = parseScene(read, file.string(), file.parent_path());
  if (text != nullptr) *text = std::move(read);
  return spec;
}

GuessVolume coarselyOf(const std::filesystem::path& place) {
  const std::unique_ptr<BrickSource> source = openBricks(place);
  const BrickManifest& manifest = source->manifest();
  const auto coarsest = static_cast<std::int32_t>(manifest.levels().size() - 1);
  return {manifest.info().name, loadBricks(*source, coarsest, place.string()), true};
}

std::filesystem::path withoutSlash(const std::filesystem::path& folder) {
  return folder.has_filename() ? folder : folder.parent_path();
}

SceneSpec sceneFromBricks(const std::filesystem::path& place) {
  const std::filesystem::path path = isRemote(place) ? place : withoutSlash(place);
  const std::filesystem::path name = isRemote(path) ? path : path.filename();
  const Guess guess = guessScene({name.string(), "", ""}, {coarselyOf(path)});
  SceneSpec spec = parseScene(guess.scene, path.string(), path.parent_path());
  spec.any_stiffness = true;
  for (const std::string& left : guess.left) {
    spec.notes.push_back(path.string() + ": skipped: " + left);
  }
  return spec;
}

SceneSpec sceneFromVdb(const std::filesystem::path& path, const Progress& progress) {
  const std::vector<std::filesystem::path> files = vdbFilesOf(path);
  SceneSpec spec;
  spec.any_stiffness = true;
  spec.source = path.string();
  std::error_code error;
  if (std::filesystem::exists(path / "scene.json", error)) {
    spec.notes.push_back((path / "scene.json").string() +
                         ": this file is not read, only the volumes of the folder; open the file "
                         "itself to load the scene");
  }
  const std::vector<FileResult> loaded = loadFiles(files, progress);
  GuessNames names;
  for (std::size_t f = 0; f < files.size(); ++f) {
    try {
      if (loaded[f].error) std::rethrow_exception(loaded[f].error);
      const std::vector<GuessVolume> volumes = feltOf(loaded[f], spec.notes);
      if (volumes.empty()) continue;
      names.file = files[f].filename().string();
      if (files.size() > 1) names.prefix = files[f].stem().string() + ".";
      const Guess guess = guessScene(names, volumes);
      SceneSpec one = parseScene(guess.scene, files[f].string(), files[f].parent_path());
      for (const std::string& left : guess.left) {
        spec.notes.push_back(files[f].string() + ": skipped: " + left);
      }
      for (auto& [name, volume] : one.volumes) {
        if (volume.mask) continue;  // made of a volume at load
        const auto is_it = [&grid = volume.grid](const GuessVolume& v) { return v.grid == grid; };
        const auto found = std::find_if(volumes.begin(), volumes.end(), is_it);
        if (found != volumes.end()) volume.volume = found->volume;
        if (volume.place.kind != PlaceSpec::Kind::kLike) names.like = name;
      }
      std::move(one.graph.modes.begin(), one.graph.modes.end(),
                std::back_inserter(spec.graph.modes));
      spec.graph.fields.merge(one.graph.fields);
      spec.volumes.merge(one.volumes);
      spec.coupling = one.coupling;
    } catch (const VolumeError& e) {
      if (files.size() == 1) throw;
      spec.notes.push_back(std::string(e.what()) + "; the file is skipped");
    }
  }
  if (spec.volumes.empty()) throwNoneFelt(path, spec.notes);
  return spec;
}

Guess guessVdb(const std::filesystem::path& file, GuessFor what, const Progress& progress) {
  if (isBrickPlace(file)) {
    return guessScene({withoutSlash(file).string(), "", ""}, {coarselyOf(file)}, what);
  }
  checkRegular<SceneError>(file, "give a .vdb file or a folder of bricks");
  const std::vector<FileResult> loaded = loadFiles({file}, progress);
  if (loaded[0].error) std::rethrow_exception(loaded[0].error);
  std::vector<std::string> notes;
  const std::vector<GuessVolume> volumes = feltOf(loaded[0], notes);
  if (volumes.empty()) throwNoneFelt(file, notes);
  Guess guess = guessScene({file.string(), "", ""}, volumes, what);
  guess.left.insert(guess.left.begin(), notes.begin(), notes.end());
  return guess;
}

SceneSpec openScene(const std::filesystem::path& path, const Progress& progress,
                    std::string* text) {
  if (text != nullptr) text->clear();
  if (isRemote(path)) return sceneFromBricks(path);
  std::error_code error;
  const auto status = std::filesystem::status(path, error);
  if (status.type() == std::filesystem::file_type::not_found) {
    throw SceneError(path.string(), "no such file", "check the path");
  }
  if (isBricks(path)) return sceneFromBricks(path);
  if (std::filesystem::is_directory(status)) return sceneFromVdb(path, progress);
  checkRegular<SceneError>(path,
                           "give a scene file, a .vdb file, or a folder of .vdb files or bricks");
  if (path.extension() == ".vdb" || isVdb(path)) return sceneFromVdb(path, progress);
  return readSceneFile(path, text);
}

}  // namespace palpate
