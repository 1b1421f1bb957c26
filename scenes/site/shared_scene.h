/// A scene that several sites edit: what of its file they share, and which of two edits counts.
///
/// Edits are a map from a part of the scene to what it is now, with a stamp. Of two that are of one
/// part the larger counts, everywhere: so merging knows no order, and twice is once. Sites that
/// have heard of the same edits, in whatever order and however often, have the same map.
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

#include "palpate/devices/json_node.h"

namespace palpate {

/// A part of a scene: {"modes", NAME, NUMBER}, {"modes", "", KIND, OF, NUMBER} of one without a
/// name, {"volumes", NAME}, {"fields", NAME} or {"play"}. NUMBER: of such modes, from "0" on.
using SharedKey = std::vector<std::string>;

/// As people say them: mode "wall", play. Of many the first.
[[nodiscard]] std::string wordsFor(const std::vector<SharedKey>& keys);

/// When an edit was made, among all that its site knew of. All parts of one edit have the same.
struct SharedStamp {
  std::uint64_t count = 0;  ///< Larger than any that its site had heard of.
  std::string site;         ///< Where it was made.
  [[nodiscard]] bool operator==(const SharedStamp&) const = default;
  /// The larger is later.
  [[nodiscard]] bool operator<(const SharedStamp& other) const noexcept {
    return std::tie(count, site) < std::tie(other.count, other.site);
  }
};

/// What a part has become.
struct SharedEdit {
  Json value;  ///< Null: it was removed.
  SharedStamp stamp;
  [[nodiscard]] bool operator==(const SharedEdit&) const = default;
};
using SharedEdits = std::map<SharedKey, SharedEdit>;

/// The parts of a scene that are shared, without what is of the machine: files, grids, frames,
/// windows, descriptions; "coupling" and "accuracy" are the arm's and its machine's. `scene`: as
/// its schema has it.
[[nodiscard]] std::map<SharedKey, Json> sharedOf(const Json& scene);
/// What was edited from one scene to another.
[[nodiscard]] SharedEdits editsBetween(const Json& before, const Json& after,
                                       const SharedStamp& stamp);
/// Of each part the later one, from either. True where `into` has changed.
bool merge(SharedEdits& into, const SharedEdits& from);
/// The scene with edits; what is of the machine stays. Throws SceneError: a volume is not here.
[[nodiscard]] Json withEdits(Json scene, const SharedEdits& edits);

/// What a site tells of its scene.
struct SharedText {
  SharedEdits edits;
  std::map<SharedKey, std::string> rest;  ///< Digests of the parts that nobody has edited.
};
/// As it goes over the network.
[[nodiscard]] std::string textOf(const SharedText& told);
/// Reads that of a stranger. Throws Error: it is too long, no such text, a part has what is not
/// shared, a name is too long.
[[nodiscard]] SharedText sharedTextFrom(const std::string& text);

/// The scene of one site: its file as it was read last, and all edits that it has heard of.
class SharedScene {
 public:
  /// `text`: of the scene's file, which is good. `site`: this one's name.
  SharedScene(std::string site, std::string text);

  /// Takes what another site tells; lines for the user.
  [[nodiscard]] std::vector<std::string> hear(const std::string& from, const std::string& text);
  /// The file says this now: what is new in it is an edit of this site, later than all it knows.
  /// Throws Error where that cannot be told, and changes nothing.
  void edit(const std::string& text);
  /// Takes what became of a copy of this one; what was heard meanwhile is kept.
  void settle(const SharedScene& copy);
  /// Edits were heard that felt() does not know of yet; asked once.
  [[nodiscard]] bool takeNews() noexcept { return std::exchange(news_, false); }
  /// They are to be tried again.
  void renew() noexcept { news_ = true; }
  /// What is to be told, where that has changed.
  [[nodiscard]] std::optional<std::string> takeTold();

  /// Edits that differ from the file, each whole, the earlier ones first; at most `most`: more are
  /// put together.
  [[nodiscard]] std::vector<SharedEdits> inOrder(std::size_t most) const;
  /// The file's text with edits.
  [[nodiscard]] std::string textWith(const SharedEdits& edits) const;
  /// Those that are felt, of inOrder().
  [[nodiscard]] const SharedEdits& felt() const noexcept { return felt_; }
  void feel(SharedEdits edits) { felt_ = std::move(edits); }
  /// This one's name.
  [[nodiscard]] const std::string& site() const noexcept { return site_; }
  /// All that is known of.
  [[nodiscard]] const SharedEdits& edits() const noexcept { return edits_; }

 private:
  [[nodiscard]] std::uint64_t newest() const noexcept;  ///< Of all stamps.
  [[nodiscard]] SharedText told() const;

  std::string site_;
  std::string text_;
  Json file_;
  SharedEdits edits_;
  SharedEdits felt_;
  bool news_ = false;
  bool untold_ = true;
  std::set<std::string> different_;  ///< Sites of which it was told that they feel another scene,
  std::set<std::string> unread_;     ///< and that what they tell cannot be taken.
};

}  // namespace palpate
