/// A scene that several sites edit. An edit has the key of a part of the scene, the new value and a
/// stamp. If two edits change one part, every site keeps the edit with the larger stamp; for equal
/// stamps, the edit with the greater text. So edits may arrive in any order and repeatedly.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "palpate/devices/json/json_node.h"

namespace palpate {

/// Key of a part of the scene: {"modes", NAME, NUMBER}, {"modes", "", KIND, OF, NUMBER} for a mode
/// without a name, {"volumes", NAME}, {"fields", NAME} or {"play"}. NUMBER counts modes that have
/// otherwise equal keys, from "0".
using SharedKey = std::vector<std::string>;

/// Returns the parts in words, such as: mode "wall", play. Lists the first four parts, and counts
/// the others.
[[nodiscard]] std::string wordsFor(const std::vector<SharedKey>& keys);

/// Logical time of an edit. All parts of one edit have the same stamp.
struct SharedStamp {
  std::uint64_t count = 0;  ///< At most 2^53; larger than all counts the site knew at the edit.
  std::string site;         ///< The site that has made the edit.
  [[nodiscard]] bool operator==(const SharedStamp&) const = default;
  /// Returns true if this stamp is earlier than `other`.
  [[nodiscard]] bool operator<(const SharedStamp& other) const noexcept {
    return std::tie(count, site) < std::tie(other.count, other.site);
  }
};

struct SharedEdit {
  Json value;  ///< New value of the part; null: the part was removed.
  SharedStamp stamp;
  [[nodiscard]] bool operator==(const SharedEdit&) const = default;
};
using SharedEdits = std::map<SharedKey, SharedEdit>;

/// Returns the parts that sites share, without descriptions, data of the machine (files, grids,
/// frames, windows) and data of the arm ("coupling", "accuracy"). `scene` must be valid by the
/// schema.
[[nodiscard]] std::map<SharedKey, Json> sharedOf(const Json& scene);
[[nodiscard]] SharedEdits editsBetween(const Json& before, const Json& after,
                                       const SharedStamp& stamp);
/// Keeps the later edit of each part in `into`. Returns true if `into` has changed.
bool merge(SharedEdits& into, const SharedEdits& from);
/// Applies edits, and keeps the machine's data. Throws SceneError if this site lacks a volume.
[[nodiscard]] Json withEdits(Json scene, const SharedEdits& edits);

struct SharedText {
  SharedEdits edits;
  std::map<SharedKey, std::string> rest;  ///< Digests of the parts without edits.
};
[[nodiscard]] std::string textOf(const SharedText& told);
/// Reads the untrusted text of another site. Throws Error if it is too long, malformed, or has data
/// that sites do not share.
[[nodiscard]] SharedText sharedTextFrom(const std::string& text);

/// The scene of one site: its file as last read, and all edits that the site has received or made.
class SharedScene {
 public:
  /// `text`: valid text of the scene's file. `site`: name of this site.
  SharedScene(std::string site, std::string text);

  /// Merges the text of the site `from`. Returns lines for the user.
  [[nodiscard]] std::vector<std::string> hear(const std::string& from, const std::string& text);
  /// Makes an edit, later than all known edits, from the changes of the file's text. Throws Error
  /// if the text is not JSON, if all edits together are too long for a message, or if other sites
  /// would reject the edit. This object then stays unchanged.
  void edit(const std::string& text);
  /// Adopts the state of `copy`, but keeps edits that arrived since the copy was made. If all edits
  /// together are too long for a message, keeps only the edits of `copy`.
  void settle(const SharedScene& copy);
  /// Returns true if edits have arrived since the last call.
  [[nodiscard]] bool takeNews() noexcept { return std::exchange(news_, false); }
  /// Makes the next call of takeNews() return true, so that the caller tries the edits again.
  void renew() noexcept { news_ = true; }
  [[nodiscard]] std::optional<std::string> takeTold();

  /// Returns the edits that differ from the file, the earliest first. If there are more than
  /// `most`, joins the earliest edits into one entry.
  [[nodiscard]] std::vector<SharedEdits> inOrder(std::size_t most) const;
  [[nodiscard]] std::string textWith(const SharedEdits& edits) const;
  /// Returns the edits of inOrder() that the running scene includes.
  [[nodiscard]] const SharedEdits& felt() const noexcept { return felt_; }
  void feel(SharedEdits edits) { felt_ = std::move(edits); }
  [[nodiscard]] const std::string& site() const noexcept { return site_; }
  [[nodiscard]] const SharedEdits& edits() const noexcept { return edits_; }

 private:
  [[nodiscard]] std::uint64_t newest() const noexcept;
  [[nodiscard]] SharedText told() const;

  std::string site_;
  std::string text_;
  Json file_;
  SharedEdits edits_;
  SharedEdits felt_;
  bool news_ = false;
  bool untold_ = true;
  std::set<std::string> different_;  ///< Sites whose different scene was reported.
  std::set<std::string> unread_;     ///< Sites whose unusable text was reported.
};

}  // namespace palpate
