/// A scene that several sites edit. An edit has a part of the scene, its present value and a stamp.
/// If two edits change one part, every site keeps the edit with the larger stamp. So the order and
/// the repetition of merges do not matter.
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

/// A part of a scene: {"modes", NAME, NUMBER}, {"modes", "", KIND, OF, NUMBER} for a mode without a
/// name, {"volumes", NAME}, {"fields", NAME} or {"play"}. NUMBER counts modes with the same key,
/// from "0".
using SharedKey = std::vector<std::string>;

/// Returns the parts in words, such as: mode "wall", play. Lists only the first parts.
[[nodiscard]] std::string wordsFor(const std::vector<SharedKey>& keys);

/// Logical time of an edit at its site. All parts of one edit have the same stamp.
struct SharedStamp {
  std::uint64_t count = 0;  ///< Larger than any count that its site had received.
  std::string site;         ///< The site that made the edit.
  [[nodiscard]] bool operator==(const SharedStamp&) const = default;
  /// The larger stamp is later.
  [[nodiscard]] bool operator<(const SharedStamp& other) const noexcept {
    return std::tie(count, site) < std::tie(other.count, other.site);
  }
};

struct SharedEdit {
  Json value;  ///< Null: the part was removed.
  SharedStamp stamp;
  [[nodiscard]] bool operator==(const SharedEdit&) const = default;
};
using SharedEdits = std::map<SharedKey, SharedEdit>;

/// Returns the parts that sites share, without data of the machine (files, grids, frames, windows)
/// and of the arm ("coupling", "accuracy"). `scene` must be valid by its schema.
[[nodiscard]] std::map<SharedKey, Json> sharedOf(const Json& scene);
[[nodiscard]] SharedEdits editsBetween(const Json& before, const Json& after,
                                       const SharedStamp& stamp);
/// Keeps the later edit of each part. Returns true if `into` has changed.
bool merge(SharedEdits& into, const SharedEdits& from);
/// Applies edits and keeps data of the machine. Throws SceneError if a volume does not exist here.
[[nodiscard]] Json withEdits(Json scene, const SharedEdits& edits);

struct SharedText {
  SharedEdits edits;
  std::map<SharedKey, std::string> rest;  ///< Digests of the parts without edits.
};
[[nodiscard]] std::string textOf(const SharedText& told);
/// Reads the untrusted text of another site. Throws Error if it is too long or malformed, or if it
/// has data that sites do not share.
[[nodiscard]] SharedText sharedTextFrom(const std::string& text);

/// The scene of one site: its file as last read, and all edits that the site knows.
class SharedScene {
 public:
  /// `text`: valid text of the scene's file. `site`: name of this site.
  SharedScene(std::string site, std::string text);

  /// Merges the text of another site. Returns lines for the user.
  [[nodiscard]] std::vector<std::string> hear(const std::string& from, const std::string& text);
  /// Makes an edit from the changes of the text, later than all known edits. Throws Error if the
  /// edit cannot be sent, and then leaves this object unchanged.
  void edit(const std::string& text);
  /// Adopts the state of `copy`, but keeps edits that arrived since the copy was made.
  void settle(const SharedScene& copy);
  /// Returns true, once, if edits arrived that felt() does not include.
  [[nodiscard]] bool takeNews() noexcept { return std::exchange(news_, false); }
  /// Requests a new attempt to apply the edits.
  void renew() noexcept { news_ = true; }
  [[nodiscard]] std::optional<std::string> takeTold();

  /// Returns the edits that differ from the file, in order of time. If there are more than `most`,
  /// the earliest are joined.
  [[nodiscard]] std::vector<SharedEdits> inOrder(std::size_t most) const;
  [[nodiscard]] std::string textWith(const SharedEdits& edits) const;
  /// Returns the edits of inOrder() that are in use.
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
  std::set<std::string> different_;  ///< Sites that were reported to have another scene.
  std::set<std::string> unread_;     ///< Sites that were reported for unusable texts.
};

}  // namespace palpate
