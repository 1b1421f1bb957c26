/// A scene that several sites edit: its shared parts, and the order of edits.
///
/// Edits map a part of the scene to its present value, with a stamp. Of two edits of one part the
/// one with the larger stamp counts, at every site. The order of merges therefore does not matter,
/// and a repeated merge changes no edit. Sites that received the same edits, in any order and any
/// number of times, have the same map.
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

/// Returns the parts in words: mode "wall", play. Of many parts, only the first are listed.
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

/// New state of a part.
struct SharedEdit {
  Json value;  ///< Null: the part was removed.
  SharedStamp stamp;
  [[nodiscard]] bool operator==(const SharedEdit&) const = default;
};
using SharedEdits = std::map<SharedKey, SharedEdit>;

/// Returns the shared parts of a scene, without data of the machine: files, grids, frames, windows,
/// descriptions. "coupling" and "accuracy" belong to the arm and its machine. `scene` must be valid
/// by its schema.
[[nodiscard]] std::map<SharedKey, Json> sharedOf(const Json& scene);
/// Returns the edits from one scene to another.
[[nodiscard]] SharedEdits editsBetween(const Json& before, const Json& after,
                                       const SharedStamp& stamp);
/// Keeps the later edit of each part. Returns true if `into` has changed.
bool merge(SharedEdits& into, const SharedEdits& from);
/// Returns the scene with edits; data of the machine stay. Throws SceneError if a volume does not
/// exist here.
[[nodiscard]] Json withEdits(Json scene, const SharedEdits& edits);

/// Message of a site about its scene.
struct SharedText {
  SharedEdits edits;
  std::map<SharedKey, std::string> rest;  ///< Digests of the parts without edits.
};
/// Returns the text for the network.
[[nodiscard]] std::string textOf(const SharedText& told);
/// Reads the untrusted text of another site. Throws Error if it is too long or malformed, a part
/// has data that are not shared, or a name is too long.
[[nodiscard]] SharedText sharedTextFrom(const std::string& text);

/// The scene of one site: its file as last read, and all edits that the site knows.
class SharedScene {
 public:
  /// `text`: valid text of the scene's file. `site`: name of this site.
  SharedScene(std::string site, std::string text);

  /// Merges the text of another site; returns lines for the user.
  [[nodiscard]] std::vector<std::string> hear(const std::string& from, const std::string& text);
  /// Compares the file's new text with the last one. The differences are an edit of this site,
  /// later than all known edits. Throws Error if the edit cannot be sent, and then leaves this
  /// object unchanged.
  void edit(const std::string& text);
  /// Adopts the state of `copy`, but keeps edits that arrived since it was made.
  void settle(const SharedScene& copy);
  /// Returns true, once, if edits arrived that felt() does not include yet.
  [[nodiscard]] bool takeNews() noexcept { return std::exchange(news_, false); }
  /// Requests a new attempt to apply the edits.
  void renew() noexcept { news_ = true; }
  /// Returns the text to send, if it has changed.
  [[nodiscard]] std::optional<std::string> takeTold();

  /// Returns the edits that differ from the file, each whole, in order of time. If there are more
  /// than `most`, the earliest are joined.
  [[nodiscard]] std::vector<SharedEdits> inOrder(std::size_t most) const;
  /// Returns the file's text with edits.
  [[nodiscard]] std::string textWith(const SharedEdits& edits) const;
  /// Returns the edits of inOrder() that are in use.
  [[nodiscard]] const SharedEdits& felt() const noexcept { return felt_; }
  void feel(SharedEdits edits) { felt_ = std::move(edits); }
  /// Returns the name of this site.
  [[nodiscard]] const std::string& site() const noexcept { return site_; }
  /// Returns all known edits.
  [[nodiscard]] const SharedEdits& edits() const noexcept { return edits_; }

 private:
  [[nodiscard]] std::uint64_t newest() const noexcept;  ///< The largest count of all stamps.
  [[nodiscard]] SharedText told() const;

  std::string site_;
  std::string text_;
  Json file_;
  SharedEdits edits_;
  SharedEdits felt_;
  bool news_ = false;
  bool untold_ = true;
  std::set<std::string> different_;  ///< Sites already reported for another scene.
  std::set<std::string> unread_;     ///< Sites already reported for unusable texts.
};

}  // namespace palpate
