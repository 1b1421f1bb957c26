#include "palpate/scenes/apps/cli/recorded.h"

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <set>
#include <span>
#include <system_error>
#include <utility>

#include <fmt/format.h>

#include "palpate/devices/recording/crc32c.h"
#include "palpate/engine/error.h"
#include "palpate/scenes/apps/cli/dials.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/library/brick_places.h"
#include "palpate/scenes/library/frames.h"
#include "palpate/scenes/library/scene_cache.h"
#include "palpate/scenes/library/scene_file.h"

namespace palpate::cli {
namespace {

namespace fs = std::filesystem;

/// Returns the size and the checksum of a file; null if the file cannot be read.
OrderedJson stateOf(const fs::path& file) {
  std::error_code error;
  if (!fs::is_regular_file(file, error)) return nullptr;  // reading a pipe could block forever
  std::ifstream in(file, std::ios::binary);
  if (!in) return nullptr;
  std::vector<char> piece(std::size_t{1} << 20U);
  std::uint32_t crc = 0;
  std::uint64_t bytes = 0;
  while (in) {
    in.read(piece.data(), static_cast<std::streamsize>(piece.size()));
    const auto got = static_cast<std::size_t>(in.gcount());
    crc = crc32c(std::as_bytes(std::span(piece.data(), got)), crc);
    bytes += got;
  }
  return {{"bytes", bytes}, {"crc32c", crc}};
}

OrderedJson stateOf(const BrickManifest& manifest) {
  return {{"identity", fmt::format("{:016x}", manifest.identity())}};
}

/// Returns the present state of a file or of remote bricks. Returns null if the state cannot be
/// read; then loading the scene reports the error.
OrderedJson stateNow(const fs::path& place) {
  if (!isRemote(place)) return stateOf(place);
  try {
    return stateOf(openBricks(place)->manifest());
  } catch (const Error&) {
    return nullptr;
  }
}

OrderedJson jsonOf(const RecordedScene& scene) {
  OrderedJson json = OrderedJson::parse(scene.text, nullptr, false);
  const auto good = [&] {
    const auto list = [&](const char* key) { return json.contains(key) && json[key].is_array(); };
    return json.is_object() && json.contains("text") && json.contains("file") &&
           json["file"].is_string() && list("dials") && list("volumes");
  };
  if (!good()) {
    throw Error("the recording's scene",
                "its description is not valid JSON, or a key in it is missing or wrong",
                "give the scene's file instead of the recording");
  }
  return json;
}

/// Returns the present state of each file that differs from its recorded state.
std::map<std::string, OrderedJson> changedFiles(const OrderedJson& json) {
  std::map<std::string, OrderedJson> changed;
  for (const OrderedJson& volume : json["volumes"]) {
    const auto file = volume.at("file").get<std::string>();
    OrderedJson now = stateNow(file);
    if (now != volume.at("state")) changed.emplace(file, std::move(now));
  }
  return changed;
}

SceneInput parseSceneInput(const OrderedJson& json) {
  SceneInput out;
  out.file = json["file"].get<std::string>();
  if (json["text"].is_null()) {
    out.spec = openScene(out.file, showProgress("loading"));
  } else {
    out.text = json["text"].get<std::string>();
    out.spec = parseScene(out.text, out.file, fs::path(out.file).parent_path());
  }
  std::vector<LiveDial> dials;
  for (const OrderedJson& turned : json["dials"]) {
    dials.push_back({turned.at(0).get<std::uint32_t>(), turned.at(1).get<float>()});
  }
  if (!dials.empty()) dial(out.spec, dials);
  return out;
}

/// Restores a recorded scene. Reports files that have changed since the recording.
SceneInput sceneInputOf(const RecordedScene& scene) {
  try {
    const OrderedJson json = jsonOf(scene);
    SceneInput out = parseSceneInput(json);
    for (const auto& [file, now] : changedFiles(json)) {
      if (now.is_null()) continue;
      complain(file + ": the file has changed since the recording: the forces may differ");
    }
    return out;
  } catch (const nlohmann::json::exception& error) {
    throw Error("the recording's scene",
                fmt::format("its description has a missing or wrong value ({})", error.what()),
                "give the scene's file instead of the recording");
  }
}

/// Returns the scene of the first tick that has a scene, or else the first recorded scene. Throws
/// Error if the recording lacks this scene.
const RecordedScene& firstFelt(const Recording& recording, const std::string& file) {
  const auto& scenes = recording.scenes();
  std::uint64_t id = firstScene(recording);
  if (id == 0 && !scenes.empty()) id = scenes.front().id;
  const auto found = std::find_if(scenes.begin(), scenes.end(),
                                  [&](const RecordedScene& scene) { return scene.id == id; });
  if (found == scenes.end()) {
    const std::string words = recording.incomplete();
    throw Error(file,
                words.empty() ? "the scene of its first ticks is missing"
                              : "the scene of its first ticks is missing: " + words,
                "give the scene's file instead of the recording");
  }
  return *found;
}

/// Adds the files of a recorded scene. Ignores a scene that parseSceneInput will reject.
void addFiles(const RecordedScene& scene, std::vector<fs::path>& files) {
  const OrderedJson json = OrderedJson::parse(scene.text, nullptr, false);
  if (!json.is_object() || !json.contains("file") || !json["file"].is_string()) return;
  files.emplace_back(json["file"].get<std::string>());
  if (!json.contains("volumes") || !json["volumes"].is_array()) return;
  for (const OrderedJson& volume : json["volumes"]) {
    if (volume.is_object() && volume.contains("file") && volume["file"].is_string()) {
      files.emplace_back(volume["file"].get<std::string>());
    }
  }
}

}  // namespace

std::uint64_t firstScene(const Recording& recording) {
  for (std::int64_t i = 0; i < recording.size(); ++i) {
    if (const std::uint64_t id = recording.tick(i).scene; id != 0) return id;
  }
  return 0;
}

SceneInput openSceneInput(const std::string& scene) {
  if (!isRecording(scene)) return openWithText(scene, showProgress("loading"));
  const Recording recording(scene);
  SceneInput first = sceneInputOf(firstFelt(recording, scene));
  for (const RecordedScene& each : recording.scenes()) addFiles(each, first.files);
  return first;
}

SceneInput openWithText(const std::string& file, const Progress& progress) {
  SceneInput out;
  out.file = file;
  out.spec = openScene(file, progress, &out.text);
  return out;
}

void refuseRecording(const std::string& file) {
  if (!isRecording(file)) return;
  throw Error(file, "it is a recording",
              "run palpate convert for its ticks, or palpate feel with --device replay:FILE");
}

std::optional<SceneInput> sceneAsItIs(const Recording& recording, std::uint64_t id) {
  for (const RecordedScene& scene : recording.scenes()) {
    if (scene.id != id) continue;
    const OrderedJson json = jsonOf(scene);
    if (!json["dials"].empty() || !changedFiles(json).empty()) return std::nullopt;
    SceneInput now = openWithText(json["file"].get<std::string>(), showProgress("loading"));
    if (!json["text"].is_null() && json["text"] != now.text) return std::nullopt;
    return now;
  }
  return std::nullopt;
}

std::string recordedScene(const std::string& file, const std::string& text, const SceneSpec& spec,
                          const std::vector<LiveDial>& dials, const Windows& windows) {
  OrderedJson json;
  json["file"] = absolutePlace(file).string();
  json["text"] = text.empty() ? OrderedJson() : OrderedJson(text);
  json["dials"] = OrderedJson::array();
  for (const LiveDial& dial : dials) json["dials"].push_back({dial.mode, dial.factor});
  json["volumes"] = OrderedJson::array();
  std::set<fs::path> files;
  const auto add = [&](const fs::path& at, const auto& of) {
    if (!files.insert(at).second) return;
    json["volumes"].push_back({{"file", absolutePlace(at).string()}, {"state", stateOf(of)}});
  };
  for (const auto& [name, volume] : spec.volumes) {
    for (const fs::path& at : filesOf(volume)) add(at, at);
    // The brick window already has the manifest, so the manifest is not fetched again.
    const auto window = windows.find(name);
    if (isRemote(volume.file) && window != windows.end()) {
      add(volume.file, window->second->manifest());
    }
  }
  return json.dump(-1, ' ', false, OrderedJson::error_handler_t::replace);
}

ScenesById scenesOf(const Recording& recording, std::shared_ptr<const Scene> first,
                    SceneCache& cache) {
  ScenesById scenes;
  const std::uint64_t felt = recording.scenes().empty() ? 0 : firstFelt(recording, {}).id;
  for (const RecordedScene& scene : recording.scenes()) {
    if (scenes.contains(scene.id)) continue;
    if (scene.id == felt) {
      scenes.emplace(scene.id, SceneAgain{first, scene.text});
      continue;
    }
    SceneSpec spec = sceneInputOf(scene).spec;
    static_cast<void>(fitCoupling(spec, recording.setting().device));
    spec.waits = true;
    scenes.emplace(scene.id,
                   SceneAgain{buildScene(spec, showProgress("loading"), &cache).scene, scene.text});
  }
  return scenes;
}

}  // namespace palpate::cli
