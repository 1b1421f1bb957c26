#include "palpate/scenes/library/brick_places.h"

#include <array>
#include <string>
#include <string_view>

#include "palpate/engine/error.h"
#ifdef PALPATE_HTTP
#include "palpate/samplers/bricks/http_store.h"
#endif
#ifdef PALPATE_RADOS
#include "palpate/samplers/bricks/rados_store.h"
#endif

namespace palpate {
namespace {

struct Scheme {
  std::string_view begin;
  const char* library;
  std::unique_ptr<ObjectStore> (*open)(const std::string& address, const StoreParams& params);
};

constexpr std::array kSchemes{
#ifdef PALPATE_HTTP
    Scheme{"http://", "libcurl", &makeHttpStore},
    Scheme{"https://", "libcurl", &makeHttpStore},
#else
    Scheme{"http://", "libcurl", nullptr},
    Scheme{"https://", "libcurl", nullptr},
#endif
#ifdef PALPATE_RADOS
    Scheme{"rados://", "librados", &makeRadosStore},
#else
    Scheme{"rados://", "librados", nullptr},
#endif
};

/// Returns null if the name is not an address.
const Scheme* schemeOf(const std::string& name) noexcept {
  for (const Scheme& scheme : kSchemes) {
    if (name.starts_with(scheme.begin)) return &scheme;
  }
  return nullptr;
}

}  // namespace

bool isRemote(const std::filesystem::path& place) noexcept {
  return schemeOf(place.native()) != nullptr;
}

std::filesystem::path absolutePlace(const std::filesystem::path& place) {
  return isRemote(place) ? place : std::filesystem::absolute(place);
}

bool isBrickPlace(const std::filesystem::path& place) noexcept {
  return isRemote(place) || isBricks(place);
}

std::unique_ptr<BrickSource> openBricks(const std::filesystem::path& place) {
  const std::string& address = place.native();
  const Scheme* const scheme = schemeOf(address);
  if (scheme == nullptr) return std::make_unique<PosixBricks>(place);
  if (scheme->open == nullptr) {
    throw VolumeError(address, std::string("this palpate was built without ") + scheme->library,
                      "copy the folder to this machine, or build palpate with this library");
  }
  return std::make_unique<FarBricks>(address, scheme->open(address, {}));
}

}  // namespace palpate
