#include "palpate/scenes/library/brick_places.h"

#include <array>
#include <string>
#include <string_view>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/http_store.h"
#ifdef PALPATE_RADOS
#include "palpate/samplers/bricks/rados_store.h"
#endif

namespace palpate {
namespace {

struct Scheme {
  std::string_view begin;
  std::unique_ptr<ObjectStore> (*open)(const std::string& address, const StoreParams& params);
};

constexpr std::array kSchemes{
    Scheme{"http://", &makeHttpStore},
    Scheme{"https://", &makeHttpStore},
#ifdef PALPATE_RADOS
    Scheme{"rados://", &makeRadosStore},
#else
    Scheme{"rados://", nullptr},
#endif
};

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
    throw VolumeError(address, "this palpate was built without librados",
                      "copy the folder to this machine, or build palpate with this library");
  }
  return std::make_unique<FarBricks>(address, scheme->open(address, {}));
}

}  // namespace palpate
