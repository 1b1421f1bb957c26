/// A site connects this program's hand over DDS with the hands of other programs in one scene
/// (docs/sites.md).
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "palpate/engine/loop/hand_links.h"

namespace palpate {

/// Identity of a site, and its peers. The site announces itself to the machines of `with`. The list
/// is not a filter: if the list is not empty, sites on other machines can connect too. Only `keys`
/// restricts the peers.
struct SiteParams {
  std::string name;               ///< Unique name: at most 31 letters, digits, - and _.
  int domain = 0;                 ///< DDS domain, 0 to 230. Only sites of the same domain link.
  std::vector<std::string> with;  ///< Numeric addresses of machines; empty: only this machine.
  std::string keys;               ///< Folder of this site's keys; empty: accepts all peers.
  bool scene = false;             ///< If true, sites also exchange their scenes.
};

/// Longest text of a scene that a site sends [bytes].
inline constexpr std::size_t kMostSceneText = 65536;

/// Parses NAME or NAME@DOMAIN, and checks the addresses `with` of other sites, which must be
/// numeric. Throws Error.
[[nodiscard]] SiteParams siteFrom(const std::string& words, const std::vector<std::string>& with);

[[nodiscard]] bool isSiteName(const std::string& name) noexcept;

struct SiteState {
  bool here = false;         ///< True while the site's messages arrive.
  std::uint64_t heard = 0;   ///< Number of received messages.
  std::uint64_t missed = 0;  ///< Number of lost messages since the site last joined.
  std::uint64_t lives = 0;   ///< Number of times the site has joined.
  double presence = 0.0;     ///< Link::presence
  double paid = 1.0;         ///< Link::paid
  double energy = 0.0;       ///< Link::energy [J]
};

/// Links a hand with other sites on its own thread, with up to 250 messages per second.
class Site {
 public:
  Site() = default;
  Site(const Site&) = delete;
  Site& operator=(const Site&) = delete;
  /// Leaves the domain. DDS informs the other sites at once.
  virtual ~Site() = default;

  /// Returns the events since the last call, one line each.
  [[nodiscard]] virtual std::vector<std::string> takeNews() = 0;
  [[nodiscard]] virtual std::map<std::string, SiteState> others() const = 0;

  /// Sets the text of this scene for all sites, also for late joiners. Sends only the newest text,
  /// at most 5 times per second, and none above kMostSceneText. Has no effect without
  /// SiteParams::scene.
  virtual void tellScene(std::string text) = 0;
  /// Returns the newest text of each site since the last call, by site. The texts are untrusted.
  [[nodiscard]] virtual std::map<std::string, std::string> takeScenes() = 0;
};

/// Joins the other sites. The first call loads the module palpate_sites.so, which uses Cyclone DDS.
/// Throws Error if the module, the address or the network is missing, or if the keys are unusable.
/// `links` must outlive the result.
[[nodiscard]] std::unique_ptr<Site> openSite(const SiteParams& params, HandLinks& links);
/// Type of the module's entry function.
using SiteFactory = std::unique_ptr<Site>(const SiteParams& params, HandLinks& links);

}  // namespace palpate
