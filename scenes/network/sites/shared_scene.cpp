#include "palpate/scenes/network/sites/shared_scene.h"

#include <algorithm>
#include <array>
#include <string_view>

#include <fmt/format.h>

#include "palpate/devices/arm/arm.h"
#include "palpate/engine/error.h"
#include "palpate/scenes/network/sites/site.h"

namespace palpate {
namespace {

constexpr std::size_t kLongestName = 200;
/// Largest amount by which a received sequence number may exceed the newest known one. Without this
/// limit, a site could send the largest possible number, and no later edit could replace its edit.
constexpr std::uint64_t kMostAhead = std::uint64_t{1} << 20U;
/// Largest SharedStamp::count; a double represents all whole numbers up to this limit exactly.
constexpr std::uint64_t kMostCount = std::uint64_t{1} << 53U;
constexpr std::size_t kMostNames = 64;  ///< Largest number of reported sites.

/// Returns true for keys that sites share. Of volumes, these are the keys in kOfVolumes; of other
/// parts, all keys except the description.
bool isShared(const std::string& kind, const std::string& key) {
  constexpr std::array<std::string_view, 6> kOfVolumes{"axial",      "instances", "interpolation",
                                                       "non_finite", "place",     "smooth"};
  if (kind != "volumes") return key != "description";
  return std::find(kOfVolumes.begin(), kOfVolumes.end(), key) != kOfVolumes.end();
}

/// Returns the part of an object with the keys that sites share, or the part with all other keys.
Json halfOf(const std::string& kind, const Json& object, bool shared) {
  Json half = Json::object();
  for (const auto& [key, value] : object.items()) {
    if (isShared(kind, key) == shared) half[key] = value;
  }
  return half;
}

std::string textAt(const Json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_string() ? found->get<std::string>() : "";
}

SharedKey keyOfMode(const Json& mode) {
  const std::string name = textAt(mode, "name");
  if (!name.empty()) return {"modes", name};
  return {"modes", "", textAt(mode, "mode"), textAt(mode, "of")};
}

std::vector<SharedKey> keysOfModes(const Json& modes) {
  std::map<SharedKey, std::size_t> counts;
  std::vector<SharedKey> keys;
  for (const Json& mode : modes) {
    SharedKey key = keyOfMode(mode);
    const std::size_t number = counts[key]++;
    key.push_back(std::to_string(number));
    keys.push_back(std::move(key));
  }
  return keys;
}

/// Returns true if edit `a` replaces edit `b`. For equal stamps, the edit with the greater text
/// replaces the other edit. Comparing values is not enough, because 2 and 2.0 are equal.
bool isLater(const SharedEdit& a, const SharedEdit& b) {
  if (a.stamp != b.stamp) return b.stamp < a.stamp;
  return a.value.dump() > b.value.dump();
}

std::string wordsForOne(const SharedKey& key) {
  if (key[0] == "play") return "play";
  if (key[0] == "volumes") return fmt::format("volume \"{}\"", key[1]);
  if (key[0] == "fields") return fmt::format("field \"{}\"", key[1]);
  if (!key[1].empty()) return fmt::format("mode \"{}\"", key[1]);
  return key[3].empty() ? key[2] : fmt::format("{} of \"{}\"", key[2], key[3]);
}

const char* const kSubject = "its message about the scene";

[[noreturn]] void refuse(const std::string& why) {
  throw Error(kSubject, why, "check the sender's program and its version");
}

bool isName(const std::string& name) {
  const auto is_control = [](unsigned char c) { return c < 0x20 || c == 0x7f; };
  return name.size() <= kLongestName && std::none_of(name.begin(), name.end(), is_control);
}

void checkName(const std::string& name) {
  if (!isName(name)) {
    refuse(fmt::format("a name has more than {} bytes, or a control character", kLongestName));
  }
}

void checkNames(const Json& value) {
  if (value.is_string()) checkName(value.get_ref<const std::string&>());
  if (!value.is_structured()) return;
  for (const auto& [key, part] : value.items()) {
    if (value.is_object()) checkName(key);
    checkNames(part);
  }
}

/// Returns true if `key` is the key of a part that sites may exchange.
bool isTold(const SharedKey& key) {
  if (key.empty() || !std::all_of(key.begin(), key.end(), isName)) return false;
  if (key[0] == "play") return key.size() == 1;
  if (key.size() < 2) return false;
  if (key[0] == "modes") return key.size() == (key[1].empty() ? 5U : 3U);
  return (key[0] == "volumes" || key[0] == "fields") && key.size() == 2 && !key[1].empty();
}

SharedKey keyFrom(const Json& json) {
  if (!json.is_array()) refuse("the key of an object is not a list");
  SharedKey key;
  for (const Json& word : json) key.push_back(word.is_string() ? word.get<std::string>() : "\n");
  if (!std::all_of(key.begin(), key.end(), isName)) {
    refuse(fmt::format(
        "the key of an object has a word that is not a text of at most {} bytes without control "
        "characters",
        kLongestName));
  }
  if (!isTold(key)) refuse("the key of an object names no volume, field, mode or play");
  return key;
}

/// Throws Error if the value of an edit has keys that sites do not share, or does not match `key`.
void checkValue(const SharedKey& key, const Json& value) {
  if (value.is_null()) return;
  if (!value.is_object()) refuse(wordsForOne(key) + " is not an object");
  for (const auto& [name, part] : value.items()) {
    if (!isShared(key[0], name)) {
      refuse(fmt::format("{} has \"{}\", which sites do not share", wordsForOne(key), name));
    }
  }
  checkNames(value);
  if (key[0] != "modes") return;
  const SharedKey own = keyOfMode(value);
  if (own.size() + 1 != key.size() || !std::equal(own.begin(), own.end(), key.begin())) {
    refuse(wordsForOne(key) + " has another name, kind or \"of\" than its key");
  }
}

/// Returns true at the first call for each name. Returns false for new names if `known` already has
/// kMostNames names.
bool isNew(std::set<std::string>& known, const std::string& name) {
  return known.size() < kMostNames && known.insert(name).second;
}

}  // namespace

std::string wordsFor(const std::vector<SharedKey>& keys) {
  constexpr std::size_t kShown = 4;
  std::string all;
  for (std::size_t i = 0; i < std::min(keys.size(), kShown); ++i) {
    all += (i == 0 ? "" : ", ") + wordsForOne(keys[i]);
  }
  if (keys.size() > kShown) all += fmt::format(" and {} more", keys.size() - kShown);
  return all;
}

std::map<SharedKey, Json> sharedOf(const Json& scene) {
  std::map<SharedKey, Json> parts;
  for (const char* kind : {"volumes", "fields"}) {
    if (!scene.contains(kind)) continue;
    for (const auto& [name, value] : scene.at(kind).items()) {
      parts.emplace(SharedKey{kind, name}, halfOf(kind, value, true));
    }
  }
  if (scene.contains("play"))
    parts.emplace(SharedKey{"play"}, halfOf("play", scene.at("play"), true));
  const Json& modes = scene.at("modes");
  std::vector<SharedKey> keys = keysOfModes(modes);
  for (std::size_t i = 0; i < keys.size(); ++i) {
    parts.emplace(std::move(keys[i]), halfOf("modes", modes[i], true));
  }
  return parts;
}

SharedEdits editsBetween(const Json& before, const Json& after, const SharedStamp& stamp) {
  const std::map<SharedKey, Json> then = sharedOf(before);
  const std::map<SharedKey, Json> now = sharedOf(after);
  SharedEdits edits;
  for (const auto& [key, value] : now) {
    const auto old = then.find(key);
    if (old == then.end() || old->second != value) edits.emplace(key, SharedEdit{value, stamp});
  }
  for (const auto& [key, value] : then) {
    if (!now.contains(key)) edits.emplace(key, SharedEdit{nullptr, stamp});
  }
  return edits;
}

bool merge(SharedEdits& into, const SharedEdits& from) {
  bool changed = false;
  for (const auto& [key, edit] : from) {
    const auto [known, fresh] = into.try_emplace(key, edit);
    if (!fresh && isLater(edit, known->second)) {
      known->second = edit;
      changed = true;
    }
    changed = changed || fresh;
  }
  return changed;
}

Json withEdits(Json scene, const SharedEdits& edits) {
  Json modes = Json::array();
  std::set<SharedKey> kept;
  const std::vector<SharedKey> keys = keysOfModes(scene.at("modes"));
  for (std::size_t i = 0; i < keys.size(); ++i) {
    Json& mode = scene["modes"][i];
    const auto edit = edits.find(keys[i]);
    kept.insert(keys[i]);
    if (edit == edits.end()) {
      modes.push_back(std::move(mode));
    } else if (!edit->second.value.is_null()) {
      modes.push_back(edit->second.value);
    }
  }
  for (const auto& [key, edit] : edits) {
    const Json& value = edit.value;
    if (key[0] == "modes") {
      if (!value.is_null() && !kept.contains(key)) modes.push_back(value);
      continue;
    }
    Json& where = key[0] == "play" ? scene : scene[key[0]];
    const std::string& name = key.back();
    if (value.is_null()) {
      if (where.is_object()) where.erase(name);
      continue;
    }
    if (key[0] == "volumes" && !where.contains(name)) {
      throw SceneError(wordsForOne(key), "the scene of this site does not have it",
                       "add it to this site's scene file");
    }
    // Keeps the keys that sites do not share, such as files.
    Json whole = where.contains(name) ? halfOf(key[0], where[name], false) : Json::object();
    whole.update(value);
    where[name] = std::move(whole);
  }
  if (scene.contains("fields") && scene["fields"].is_null()) scene.erase("fields");
  scene["modes"] = std::move(modes);
  return scene;
}

std::string textOf(const SharedText& told) {
  Json json = {{"palpate_edits", 1}, {"edits", Json::array()}, {"rest", Json::array()}};
  for (const auto& [key, edit] : told.edits) {
    json["edits"].push_back(
        {{"of", key}, {"at", {edit.stamp.count, edit.stamp.site}}, {"is", edit.value}});
  }
  for (const auto& [key, digest] : told.rest) json["rest"].push_back({key, digest});
  return json.dump();
}

SharedText sharedTextFrom(const std::string& text) {
  if (text.size() > kMostSceneText) {
    refuse(fmt::format("it has {} bytes, more than {}", text.size(), kMostSceneText));
  }
  const Json json = parseJson(text, kSubject, raiseAs<Error>);
  const auto is_list = [](const Json& object, const char* key) {
    return object.is_object() && object.contains(key) && object.at(key).is_array();
  };
  if (!is_list(json, "edits") || !is_list(json, "rest") ||
      json.value("palpate_edits", Json()) != 1) {
    refuse("it is not a list of edits in version 1 of the format");
  }
  SharedText told;
  for (const Json& one : json.at("edits")) {
    if (!is_list(one, "of") || !is_list(one, "at") || !one.contains("is"))
      refuse("an edit has no list \"of\", no list \"at\" or no value \"is\"");
    const Json& at = one.at("at");
    if (at.size() != 2 || !at[0].is_number_unsigned() || !at[1].is_string()) {
      refuse("\"at\" of an edit is not a number and the name of a site");
    }
    const SharedStamp stamp{at[0].get<std::uint64_t>(), at[1].get<std::string>()};
    if (stamp.count == 0 || stamp.count > kMostCount) {
      refuse(
          fmt::format("an edit has the sequence number {}, not 1 to {}", stamp.count, kMostCount));
    }
    if (!isSiteName(stamp.site))
      refuse("the name of the site in an edit is not 1 to 31 letters, digits, - and _");
    const SharedKey key = keyFrom(one.at("of"));
    checkValue(key, one.at("is"));
    merge(told.edits, {{key, {one.at("is"), stamp}}});
  }
  for (const Json& one : json.at("rest")) {
    if (!one.is_array() || one.size() != 2 || !one[1].is_string())
      refuse("an entry of \"rest\" is not a key and a digest");
    told.rest.emplace(keyFrom(one[0]), one[1].get<std::string>());
  }
  return told;
}

SharedScene::SharedScene(std::string site, std::string text)
    : site_(std::move(site)), text_(std::move(text)), file_(parseJson(text_, "", raiseAs<Error>)) {}

std::vector<std::string> SharedScene::hear(const std::string& from, const std::string& text) {
  try {
    const SharedText other = sharedTextFrom(text);
    SharedEdits all = edits_;
    const std::uint64_t most = newest() + kMostAhead;
    for (const auto& [key, edit] : other.edits) {
      if (edit.stamp.count > most) {
        refuse(fmt::format("an edit has the sequence number {}, above the limit of {}",
                           edit.stamp.count, most));
      }
    }
    if (merge(all, other.edits)) {
      if (textOf({all, {}}).size() > kMostSceneText) {
        throw Error(kSubject,
                    fmt::format("all edits together have more than {} bytes", kMostSceneText),
                    "start all sites again from one scene file with these edits");
      }
      edits_ = std::move(all);
      news_ = untold_ = true;
    }
    // Finds parts without an edit that differ between the two sites.
    const SharedText own = told();
    std::vector<SharedKey> differ;
    for (const auto& [key, digest] : own.rest) {
      const auto theirs = other.rest.find(key);
      if (theirs == other.rest.end() || theirs->second != digest) differ.push_back(key);
    }
    for (const auto& [key, digest] : other.rest) {
      if (!own.rest.contains(key) && !edits_.contains(key)) differ.push_back(key);
    }
    if (other.rest.empty() || own.rest.empty() || differ.empty() || !isNew(different_, from)) {
      return {};
    }
    return {
        fmt::format("site {}: its scene differs from this site's scene: {}: copy one scene file to "
                    "the other site, or edit these parts again",
                    from, wordsFor(differ))};
  } catch (const Error& error) {
    if (!isNew(unread_, from)) return {};
    return {fmt::format("site {}: {}: the message is ignored", from, error.what())};
  }
}

void SharedScene::edit(const std::string& text) {
  Json file = parseJson(text, "", raiseAs<Error>);
  const SharedStamp stamp{std::min(newest() + 1, kMostCount), site_};
  SharedEdits own = editsBetween(file_, file, stamp);
  // A value that equals the newest known edit of its part is not a new edit.
  std::erase_if(own, [&](const auto& one) {
    const auto known = edits_.find(one.first);
    return known != edits_.end() && known->second.value == one.second.value;
  });
  SharedEdits all = edits_;
  merge(all, own);
  if (textOf({all, {}}).size() > kMostSceneText) {
    throw Error("the edit",
                fmt::format("with it, all edits together have more than {} bytes", kMostSceneText),
                "start all sites again from one scene file with these edits, or start with "
                "--own-scene");
  }
  try {
    (void)sharedTextFrom(textOf({all, {}}));
  } catch (const Error& error) {
    throw Error("the edit", "other sites would reject it (" + error.reason() + ")",
                "shorten or correct the edit, or start with --own-scene");
  }
  text_ = text;
  file_ = std::move(file);
  edits_ = std::move(all);
  untold_ = true;
}

std::uint64_t SharedScene::newest() const noexcept {
  std::uint64_t count = 0;
  for (const auto& [key, edit] : edits_) count = std::max(count, edit.stamp.count);
  return count;
}

void SharedScene::settle(const SharedScene& copy) {
  SharedEdits all = edits_;
  merge(all, copy.edits_);
  // Other sites send dropped edits again. hear() then rejects these edits. At the first rejection
  // of each site, it returns a line for the user.
  if (textOf({all, {}}).size() > kMostSceneText) all = copy.edits_;
  edits_ = std::move(all);
  text_ = copy.text_;
  file_ = copy.file_;
  felt_ = copy.felt_;
  untold_ = untold_ || copy.untold_;
}

SharedText SharedScene::told() const {
  SharedText text{edits_, {}};
  for (const auto& [key, value] : sharedOf(file_)) {
    if (isTold(key) && !edits_.contains(key))
      text.rest.emplace(key, fmt::format("{:016x}", fingerprintOf(value.dump())));
  }
  return text;
}

std::optional<std::string> SharedScene::takeTold() {
  if (!std::exchange(untold_, false)) return std::nullopt;
  std::string text = textOf(told());
  // If the text is too long for a message, sends the edits without the digests.
  if (text.size() > kMostSceneText) text = textOf({edits_, {}});
  return text;
}

std::vector<SharedEdits> SharedScene::inOrder(std::size_t most) const {
  const std::map<SharedKey, Json> file = sharedOf(file_);
  std::map<SharedStamp, SharedEdits> by_stamp;
  for (const auto& [key, edit] : edits_) {
    const auto here = file.find(key);
    if (here == file.end() ? edit.value.is_null() : here->second == edit.value) continue;
    by_stamp[edit.stamp].emplace(key, edit);
  }
  std::vector<SharedEdits> groups;
  std::size_t left = by_stamp.size();
  for (auto& [stamp, group] : by_stamp) {
    if (groups.empty() || left < most) {
      groups.push_back(std::move(group));
    } else {
      groups.back().merge(group);
    }
    --left;
  }
  return groups;
}

std::string SharedScene::textWith(const SharedEdits& edits) const {
  return edits.empty() ? text_ : withEdits(file_, edits).dump(2) + "\n";
}

}  // namespace palpate
