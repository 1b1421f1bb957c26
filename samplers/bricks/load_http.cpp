#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/http_store.h"
#include "palpate/samplers/module.h"

namespace palpate {

std::unique_ptr<ObjectStore> makeHttpStore(const std::string& address, const StoreParams& params) {
  try {
    static auto* const make =
        functionOf<HttpFactory>({"palpate_http.so", "libcurl4-gnutls-dev"}, address);
    return make(address, params);
  } catch (const VolumeError&) {
    throw;
  } catch (const Error& error) {
    throw VolumeError(error.subject(), error.reason(), error.remedy());
  }
}

}  // namespace palpate
