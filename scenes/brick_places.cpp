#include "palpate/scenes/brick_places.h"

#include "palpate/engine/error.h"
#ifdef PALPATE_HTTP
#include "palpate/samplers/http_bricks.h"
#endif

namespace palpate {

bool isRemote(const std::filesystem::path& place) noexcept {
  const std::string& name = place.native();
  return name.starts_with("http://") || name.starts_with("https://");
}

std::filesystem::path absolutePlace(const std::filesystem::path& place) {
  return isRemote(place) ? place : std::filesystem::absolute(place);
}

bool isBrickPlace(const std::filesystem::path& place) noexcept {
  return isRemote(place) || isBricks(place);
}

std::unique_ptr<BrickSource> openBricks(const std::filesystem::path& place) {
  if (!isRemote(place)) return std::make_unique<PosixBricks>(place);
#ifdef PALPATE_HTTP
  return std::make_unique<HttpBricks>(place.native());
#else
  throw VolumeError(place.string(), "this palpate was built without libcurl",
                    "copy the folder here, or build it with libcurl");
#endif
}

}  // namespace palpate
