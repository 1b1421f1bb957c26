#include "palpate/samplers/module.h"
#include "palpate/scenes/network/sites/site.h"

namespace palpate {

std::unique_ptr<Site> openSite(const SiteParams& params, HandLinks& links) {
  static auto* const join =
      functionOf<SiteFactory>({"palpate_sites.so", "cyclonedds-dev"}, "--site");
  return join(params, links);
}

}  // namespace palpate
