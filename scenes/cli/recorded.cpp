#include "palpate/scenes/cli/recorded.h"

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <set>
#include <span>
#include <system_error>
#include <utility>

#include <fmt/format.h>

#include "palpate/devices/crc32c.h"
#include "palpate/engine/error.h"
#include "palpate/samplers/volume.h"
#include "palpate/scenes/cli/common.h"
#include "palpate/scenes/cli/dials.h"
#include "palpate/scenes/scene_cache.h"
#include "palpate/scenes/scene_file.h"

namespace palpate::cli {
namespace {

namespace fs = std::filesystem;

/// The size and the checksum of a file; null where it cannot be read.
OrderedJson stateOf(const fs::path& file) {
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

/// The text of a scene's file; empty for a .vdb, or a folder.
std::string textOfScene(const std::string& file) {
  std::error_code error;
  if (fs::path(file).extension() == ".vdb" || !fs::is_regular_file(file, error) || isVdb(file)) {
    return {};
  }
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

/// A scene out of a recording, with its dials as they were; notes: which files are not what they
/// were. Throws Error: its files are gone, or it is no scene of this version.
ToFeel toFeel(const RecordedScene& scene) {
  ToFeel out;
  try {
    const OrderedJson json = OrderedJson::parse(scene.text);
    out.file = json.at("file").get<std::string>();
    if (json.at("text").is_null()) {
      out.spec = openScene(out.file, showProgress("loading"));
    } else {
      out.text = json.at("text").get<std::string>();
      out.spec = parseScene(out.text, out.file, fs::path(out.file).parent_path());
    }
    std::vector<LiveDial> dials;
    for (const OrderedJson& turned : json.at("dials")) {
      dials.push_back({turned.at(0).get<std::uint32_t>(), turned.at(1).get<float>()});
    }
    if (!dials.empty()) dial(out.spec, dials);
    for (const OrderedJson& volume : json.at("volumes")) {
      const auto file = volume.at("file").get<std::string>();
      if (stateOf(file) == volume.at("state")) continue;
      complain(file + ": it is not the file that was recorded: what is felt differs with it");
    }
  } catch (const nlohmann::json::exception& error) {
    throw Error("the recording's scene", fmt::format("it cannot be read ({})", error.what()),
                "give the scene's file instead");
  }
  return out;
}

/// Adds the files that a scene is made of. Text that is none adds nothing: toFeel tells.
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

ToFeel sceneToFeel(const std::string& scene) {
  if (!isRecording(scene)) return openWithText(scene, showProgress("loading"));
  const Recording recording(scene);
  if (recording.scenes().empty()) {
    throw Error(scene, "there is no scene in it", "give the scene's file");
  }
  ToFeel first = toFeel(recording.scenes().front());
  for (const RecordedScene& each : recording.scenes()) addFiles(each, first.files);
  return first;
}

std::optional<ToFeel> sceneAsItIs(const Recording& recording, std::uint64_t id) {
  for (const RecordedScene& scene : recording.scenes()) {
    if (scene.id != id) continue;
    const OrderedJson json = OrderedJson::parse(scene.text, nullptr, false);
    if (!json.is_object() || !json.value("dials", OrderedJson::array()).empty())
      return std::nullopt;
    ToFeel out = toFeel(scene);
    if (out.text != textOfScene(out.file)) return std::nullopt;
    return out;
  }
  return std::nullopt;
}

ToFeel openWithText(const std::string& file, const Progress& progress) {
  ToFeel out{openScene(file, progress), file, textOfScene(file), {}};
  if (!out.text.empty()) out.spec = parseScene(out.text, file, fs::path(file).parent_path());
  return out;
}

std::string recordedScene(const std::string& file, const std::string& text, const SceneSpec& spec,
                          const std::vector<LiveDial>& dials) {
  OrderedJson json;
  json["file"] = fs::absolute(fs::path(file)).string();
  json["text"] = text.empty() ? OrderedJson() : OrderedJson(text);
  json["dials"] = OrderedJson::array();
  for (const LiveDial& dial : dials) json["dials"].push_back({dial.mode, dial.factor});
  json["volumes"] = OrderedJson::array();
  std::set<fs::path> files;
  for (const auto& [name, volume] : spec.volumes) {
    if (volume.file.empty() || !files.insert(volume.file).second) continue;
    OrderedJson of = {{"file", fs::absolute(volume.file).string()}};
    of["state"] = stateOf(volume.file);
    json["volumes"].push_back(of);
  }
  return json.dump(-1, ' ', false, OrderedJson::error_handler_t::replace);
}

ScenesById scenesOf(const Recording& recording, std::shared_ptr<const Scene> first,
                    SceneCache& cache) {
  ScenesById scenes;
  for (const RecordedScene& scene : recording.scenes()) {
    if (scenes.contains(scene.id)) continue;
    if (scenes.empty()) {
      scenes.emplace(scene.id, SceneAgain{first, scene.text});
      continue;
    }
    SceneSpec spec = toFeel(scene).spec;
    static_cast<void>(fitCoupling(spec, recording.setting().device));
    scenes.emplace(scene.id,
                   SceneAgain{buildScene(spec, showProgress("loading"), &cache).scene, scene.text});
  }
  return scenes;
}

}  // namespace palpate::cli
