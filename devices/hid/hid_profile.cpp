#include "palpate/devices/hid/hid_profile.h"

#include <algorithm>
#include <fstream>
#include <iterator>
#include <set>
#include <sstream>
#include <string_view>
#include <system_error>
#include <utility>

#include "palpate/devices/arm/user_folder.h"
#include "palpate/devices/hid/check_profile.h"
#include "palpate/devices/hid/hid_data.h"
#include "palpate/devices/hid/profile_table.h"
#include "palpate/engine/error.h"

namespace palpate {

HidProfile parseHidProfile(const std::string& text, const std::string& source) {
  const Json json = parseJson(text, source, raiseAs<DeviceError>);
  const JsonNode root(json, source, "", raiseAs<DeviceError>);
  ProfileFile file;
  profileTable().read(root, file);
  HidProfile profile = checkedProfile(std::move(file), root);
  profile.source = source;
  profile.fingerprint = fingerprintOf(json.dump());
  return profile;
}

HidProfile readHidProfile(const std::filesystem::path& file) {
  std::ifstream in(file);
  std::ostringstream text;
  text << in.rdbuf();
  if (!in) {
    throw DeviceError(file.string(), "it cannot be read", "check the path and its permissions");
  }
  return parseHidProfile(text.str(), file.string());
}

namespace {

/// Returns all values of "name" in a file that may be invalid JSON: the names of the profile and of
/// its buttons.
std::set<std::string> namesIn(const std::filesystem::path& file) {
  constexpr const char* kKey = "\"name\"";
  std::ifstream in(file);
  std::ostringstream text;
  text << in.rdbuf();
  const std::string all = text.str();
  std::set<std::string> names;
  for (std::size_t at = all.find(kKey); at != std::string::npos; at = all.find(kKey, at + 1)) {
    const std::size_t begin = all.find('"', all.find(':', at));
    const std::size_t end = begin == std::string::npos ? begin : all.find('"', begin + 1);
    if (end != std::string::npos) names.insert(all.substr(begin + 1, end - begin - 1));
  }
  return names;
}

}  // namespace

std::vector<HidProfile> hidProfiles(const std::filesystem::path& folder,
                                    std::vector<std::string>& notes) {
  std::vector<HidProfile> profiles;
  std::error_code error;
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder, error)) {
    if (entry.path().extension() == ".json") files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  std::set<std::string> broken;
  for (const auto& file : files) {
    try {
      HidProfile profile = readHidProfile(file);
      const auto taken = std::find_if(profiles.begin(), profiles.end(),
                                      [&](const HidProfile& p) { return p.name == profile.name; });
      if (taken != profiles.end()) {
        notes.push_back(file.string() + ": /name: another file in this folder has the name " +
                        profile.name + " (" + taken->source +
                        "): change \"name\" in one of the two files");
        continue;
      }
      const bool hides = std::any_of(
          std::begin(kHidProfiles), std::end(kHidProfiles),
          [&](const auto& own) { return std::string_view(own.first) == profile.name + ".json"; });
      if (hides && file.stem() != profile.name) {
        notes.push_back(file.string() + ": /name: this file replaces palpate's own profile " +
                        profile.name + ": change \"name\" in this file to keep both");
      }
      profiles.push_back(std::move(profile));
    } catch (const DeviceError& e) {
      notes.emplace_back(e.what());
      broken.insert(file.stem());
      broken.merge(namesIn(file));
    }
  }
  for (const auto& [name, text] : kHidProfiles) {
    HidProfile profile = parseHidProfile(text, std::string("palpate's own ") + name);
    const bool replaced = std::any_of(profiles.begin(), profiles.end(),
                                      [&](const HidProfile& p) { return p.name == profile.name; });
    // The user's invalid file of this name is meant to replace palpate's profile.
    if (!replaced && broken.count(profile.name) == 0) profiles.push_back(std::move(profile));
  }
  return profiles;
}

std::filesystem::path hidProfileFolder() {
  return userFolder("XDG_CONFIG_HOME", ".config") / "palpate/arms";
}

const std::string& hidProfileSchema() {
  static const std::string schema = profileTableSchema().dump(2) + "\n";
  return schema;
}

std::vector<KnownArm> knownArms() {
  const Json json = Json::parse(kKnownArms);
  std::vector<KnownArm> arms;
  for (const Json& arm : json.at("arms")) {
    arms.push_back({arm.at("name"), arm.at("force"), arm.at("stiffness"), arm.at("damping"),
                    arm.at("workspace_radius"), arm.at("transport"), arm.at("source")});
  }
  return arms;
}

}  // namespace palpate
