/// Replaces site.cpp if the DDS library is missing.
#include "palpate/engine/error.h"
#include "palpate/scenes/network/sites/site.h"

namespace palpate {

class Site::Carrier {};

Site::Site(const SiteParams& /*params*/, HandLinks& /*links*/) {
  throw Error("--site", "this palpate was built without Cyclone DDS",
              "install cyclonedds-dev and build again");
}
Site::~Site() = default;

std::vector<std::string> Site::takeNews() {
  return {};
}

std::map<std::string, SiteState> Site::others() const {
  return {};
}

void Site::tellScene(std::string /*text*/) {}

std::map<std::string, std::string> Site::takeScenes() {
  return {};
}

}  // namespace palpate
