/// A site: this program's hand in one scene with hands elsewhere, by DDS (docs/cluster.md).
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "palpate/engine/hand_links.h"

namespace palpate {

/// Who one is, and with whom.
struct SiteParams {
  std::string name;               ///< Letters, digits, - and _, at most 31; each site has its own.
  int domain = 0;                 ///< DDS's, 0 to 230: sites of other ones do not meet.
  std::vector<std::string> with;  ///< Addresses of machines, numeric; none: this machine alone.
  std::string keys;    ///< The folder of its keys; empty: none, and whoever comes is met.
  bool scene = false;  ///< Sites tell each other of their scenes, too.
};

/// Longest text that a site tells of its scene [bytes].
inline constexpr std::size_t kMostSceneText = 65536;

/// NAME or NAME@DOMAIN. Throws Error.
[[nodiscard]] SiteParams siteFrom(const std::string& words, const std::vector<std::string>& with);

/// Whether a site can be called so.
[[nodiscard]] bool isSiteName(const std::string& name) noexcept;

/// What is known of a site elsewhere.
struct SiteState {
  bool here = false;         ///< It is heard.
  std::uint64_t heard = 0;   ///< Messages,
  std::uint64_t missed = 0;  ///< and so many more that were sent.
  std::uint64_t lives = 0;   ///< How often it has come.
  double presence = 0.0;     ///< Link::presence
  double paid = 1.0;         ///< Link::paid
  double energy = 0.0;       ///< Link::energy [J]
};

/// Carries a loop's links, on a thread of its own: up to 250 messages a second of some 250 bytes,
/// fewer where the hand rests.
class Site {
 public:
  /// Throws Error: built without DDS, no such address, no such network.
  /// @param links  Must outlive the site.
  Site(const SiteParams& params, HandLinks& links);
  Site(const Site&) = delete;
  Site& operator=(const Site&) = delete;
  /// Takes leave: others know at once.
  ~Site();

  /// What has happened since the last call, a line each.
  [[nodiscard]] std::vector<std::string> takeNews();
  /// Each site that was heard, by its name.
  [[nodiscard]] std::map<std::string, SiteState> others() const;

  /// What others hear of this scene from now on, those who come later as well; at most 5 times a
  /// second the newest is sent.
  void tellScene(std::string text);
  /// The newest of each site, by its name, that has come since the last call: a stranger's text.
  [[nodiscard]] std::map<std::string, std::string> takeScenes();

 private:
  class Carrier;
  std::unique_ptr<Carrier> carrier_;
};

}  // namespace palpate
