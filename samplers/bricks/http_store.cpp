#include "palpate/samplers/bricks/http_store.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cstdint>
#include <curl/curl.h>
#include <new>
#include <optional>
#include <string_view>
#include <utility>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/http_keys.h"
#include "palpate/samplers/module.h"

namespace palpate {
namespace {

struct EndsEasy {
  void operator()(CURL* easy) const noexcept { curl_easy_cleanup(easy); }
};
struct EndsMulti {
  void operator()(CURLM* multi) const noexcept { curl_multi_cleanup(multi); }
};

bool isAddress(std::string_view name) noexcept {
  for (const std::string_view scheme : {"http://", "https://"}) {
    if (!name.starts_with(scheme)) continue;
    const std::string_view rest = name.substr(scheme.size());
    // Names of objects are appended to the address, so it must not have a query or a fragment.
    return !rest.empty() && rest.front() != '/' &&
           rest.find_first_of("?#@") == std::string_view::npos;
  }
  return false;
}

struct HttpRequest final : ObjectRequest {
  std::unique_ptr<CURL, EndsEasy> easy;
  bool too_long = false;
  bool followed = false;  ///< True if the request has followed a redirection.
  bool keyed = false;     ///< True if the request sends a key.
};

std::optional<std::string_view> valueOf(std::string_view line, std::string_view name) noexcept {
  const auto same = [](unsigned char a, unsigned char b) { return a == std::tolower(b); };
  if (line.size() <= name.size() || line[name.size()] != ':' ||
      !std::equal(name.begin(), name.end(), line.begin(), same)) {
    return std::nullopt;
  }
  line.remove_prefix(name.size() + 1);
  while (!line.empty() && std::isspace(static_cast<unsigned char>(line.front())) != 0) {
    line.remove_prefix(1);
  }
  return line;
}

/// Removes a number from the start of `text`. Returns false if `text` does not start with a number.
bool takeNumber(std::string_view& text, std::uint64_t& number) noexcept {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  text.remove_prefix(static_cast<std::size_t>(end - text.data()));
  return error == std::errc();
}

/// Returns the body's length [bytes] if the header line states it; 0 for a range not from byte 0.
std::optional<std::uint64_t> statedLength(std::string_view line) noexcept {
  std::uint64_t first = 0;
  std::uint64_t number = 0;
  if (auto length = valueOf(line, "content-length")) {
    return takeNumber(*length, number) ? std::optional(number) : std::nullopt;
  }
  auto range = valueOf(line, "content-range");
  if (!range) return std::nullopt;
  constexpr std::string_view kUnit = "bytes ";
  if (!range->starts_with(kUnit)) return 0;
  range->remove_prefix(kUnit.size());
  if (!takeNumber(*range, first) || first != 0 || !range->starts_with('-')) return 0;
  range->remove_prefix(1);
  return takeNumber(*range, number) && number != UINT64_MAX ? number + 1 : 0;
}

/// For libcurl: reads a header line. Refuses the answer if the stated length is wrong.
std::size_t readHeader(const char* bytes, std::size_t size, std::size_t count, void* to) noexcept {
  auto& request = *static_cast<HttpRequest*>(to);
  const std::optional<std::uint64_t> length = statedLength({bytes, size * count});
  long code = 0;
  curl_easy_getinfo(request.easy.get(), CURLINFO_RESPONSE_CODE, &code);
  // A server without ranges states the length of the whole object.
  const bool asked = request.part ? code == 206 : code == 200;
  if (!length || !asked || (*length >= request.least && *length <= request.limit)) {
    return size * count;
  }
  request.announced = *length;
  return 0;
}

bool isRedirection(long code) noexcept {
  return code == 301 || code == 302 || code == 303 || code == 307 || code == 308;
}

/// For libcurl: appends received bytes, except those of a redirection. No exception may pass
/// through libcurl.
std::size_t receive(const char* bytes, std::size_t size, std::size_t count, void* to) noexcept {
  auto& request = *static_cast<HttpRequest*>(to);
  const std::size_t more = size * count;
  long code = 0;
  curl_easy_getinfo(request.easy.get(), CURLINFO_RESPONSE_CODE, &code);
  if (isRedirection(code)) return more;
  const std::size_t kept = std::min(more, request.limit - request.body.size());
  request.last = std::chrono::steady_clock::now();
  request.too_long = kept < more;
  try {
    const auto* first = reinterpret_cast<const std::byte*>(bytes);
    request.body.insert(request.body.end(), first, first + kept);
    return kept;
  } catch (const std::bad_alloc&) {
    request.why = kNoMemory;
    return 0;
  }
}

/// Initializes libcurl once per process, before any of its threads.
void beginCurl() {
  static const CURLcode begun = curl_global_init(CURL_GLOBAL_DEFAULT);
  if (begun != CURLE_OK)
    throw VolumeError("libcurl", "it cannot be initialized", "reinstall libcurl");
}

void conclude(HttpRequest& request, CURLcode how) noexcept {
  long code = 0;
  curl_easy_getinfo(request.easy.get(), CURLINFO_RESPONSE_CODE, &code);
  if (code == 404 || code == 410) {
    request.status = BrickStatus::kMissing;
  } else if (isRedirection(code)) {
    request.fail(
        request.followed
            ? "the server redirects twice, with status"
            : "the server redirects to an address that palpate does not follow, with status",
        code);
  } else if (code == 401) {
    request.fail(request.keyed ? "the server rejects the key in PALPATE_HTTP_KEYS, with status"
                               : "the server requires a key in PALPATE_HTTP_KEYS, with status",
                 code);
  } else if (code != 0 && code != 200 && !(request.part && code == 206)) {
    request.fail("the server answers with status", code);
  } else if (request.why != nullptr) {
    return;
  } else if (request.announced) {
    request.status = BrickStatus::kCut;
  } else if (request.too_long) {
    request.status = request.part ? BrickStatus::kArrived : BrickStatus::kCut;
  } else if (how != CURLE_OK) {
    request.fail(curl_easy_strerror(how));
  } else {
    request.status = BrickStatus::kArrived;
  }
}

class HttpStore final : public ObjectStore {
 public:
  HttpStore(std::string address, HttpOrigin origin, const StoreParams& params)
      : address_(std::move(address)),
        origin_(std::move(origin)),
        key_(findHttpKey(origin_)),
        params_(params),
        multi_(curl_multi_init()) {
    if (!multi_) throw VolumeError("libcurl", kNoMemory, "end other programs to free memory");
    // One more connection checks whether the volume exists.
    const long most = std::clamp(params.connections, 1, 32) + 1L;
    curl_multi_setopt(multi_.get(), CURLMOPT_MAX_TOTAL_CONNECTIONS, most);
  }

  std::unique_ptr<ObjectRequest> make() override {
    auto request = std::make_unique<HttpRequest>();
    request->easy.reset(curl_easy_init());
    if (!request->easy)
      throw VolumeError("libcurl", kNoMemory, "end other programs to free memory");
    CURL* const of = request->easy.get();
    curl_easy_setopt(of, CURLOPT_PROTOCOLS_STR, "http,https");
    curl_easy_setopt(of, CURLOPT_FOLLOWLOCATION, 0L);
    curl_easy_setopt(of, CURLOPT_DISALLOW_USERNAME_IN_URL, 1L);
    // With HTTP/2 all requests would share one connection, even after it has failed.
    curl_easy_setopt(of, CURLOPT_HTTP_VERSION, static_cast<long>(CURL_HTTP_VERSION_1_1));
    curl_easy_setopt(of, CURLOPT_NOSIGNAL, 1L);
    curl_easy_setopt(of, CURLOPT_USERAGENT, "palpate");
    curl_easy_setopt(of, CURLOPT_HEADERFUNCTION, &readHeader);
    curl_easy_setopt(of, CURLOPT_HEADERDATA, request.get());
    curl_easy_setopt(of, CURLOPT_SUPPRESS_CONNECT_HEADERS, 1L);  // ignore the headers of a proxy
    curl_easy_setopt(of, CURLOPT_WRITEFUNCTION, &receive);
    curl_easy_setopt(of, CURLOPT_WRITEDATA, request.get());
    curl_easy_setopt(of, CURLOPT_PRIVATE, request.get());
    curl_easy_setopt(of, CURLOPT_CONNECTTIMEOUT_MS, static_cast<long>(params_.connect.count()));
#if LIBCURL_VERSION_NUM >= 0x075700
    curl_easy_setopt(of, CURLOPT_QUICK_EXIT, 1L);  // the end does not wait for a name look-up
#endif
    return request;
  }

  void get(const std::string& name, ObjectRequest& of) noexcept override {
    auto& request = static_cast<HttpRequest&>(of);
    CURL* const easy = request.easy.get();
    // A transfer may last long while bytes arrive, but all tries share one deadline.
    const auto deadline = request.last + params_.opened;
    const auto perform = [&] {
      const auto left =
          std::chrono::ceil<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now());
      curl_easy_setopt(easy, CURLOPT_TIMEOUT_MS, std::max(1L, static_cast<long>(left.count())));
      return curl_easy_perform(easy);
    };
    const auto seconds = std::chrono::ceil<std::chrono::seconds>(params_.stalled).count();
    curl_easy_setopt(easy, CURLOPT_LOW_SPEED_LIMIT, 1'000L);
    curl_easy_setopt(easy, CURLOPT_LOW_SPEED_TIME, std::max(1L, static_cast<long>(seconds)));
    if (!aim(name, request)) return;
    CURLcode how = perform();
    if (follow(request)) how = perform();
    conclude(request, how);
  }

  bool begin(const std::string& name, ObjectRequest& of) noexcept override {
    auto& request = static_cast<HttpRequest&>(of);
    if (!aim(name, request)) return false;
    const CURLMcode how = curl_multi_add_handle(multi_.get(), request.easy.get());
    if (how != CURLM_OK) request.fail(curl_multi_strerror(how));
    return how == CURLM_OK;
  }

  void drop(ObjectRequest& of) noexcept override {
    curl_multi_remove_handle(multi_.get(), static_cast<HttpRequest&>(of).easy.get());
  }

  ObjectRequest* ended(std::chrono::milliseconds patience) noexcept override {
    int running = 0;
    curl_multi_perform(multi_.get(), &running);
    HttpRequest* const request = nextEnded();
    if (request != nullptr || patience.count() == 0) return request;
    curl_multi_poll(multi_.get(), nullptr, 0, static_cast<int>(patience.count()), nullptr);
    curl_multi_perform(multi_.get(), &running);
    return nextEnded();
  }

  void wake() noexcept override {
    curl_multi_wakeup(multi_.get());
  }

 private:
  [[nodiscard]] bool aim(const std::string& name, HttpRequest& request) noexcept {
    request.too_long = false;
    request.followed = false;
    try {
      const std::string range = "0-" + std::to_string(std::max<std::size_t>(request.limit, 1) - 1);
      CURL* const easy = request.easy.get();
      curl_easy_setopt(easy, CURLOPT_URL, (address_ + "/" + name).c_str());
      setKey(request, key_.has_value());
      curl_easy_setopt(easy, CURLOPT_RANGE, request.part ? range.c_str() : nullptr);
      return true;
    } catch (const std::bad_alloc&) {
      request.fail(kNoMemory);
      return false;
    }
  }

  /// Sets whether a request sends the key.
  void setKey(HttpRequest& request, bool sent) noexcept {
    CURL* const easy = request.easy.get();
    request.keyed = sent;
    const bool token = sent && !key_->token.empty();
    curl_easy_setopt(easy, CURLOPT_HTTPAUTH, token ? CURLAUTH_BEARER : CURLAUTH_BASIC);
    curl_easy_setopt(easy, CURLOPT_XOAUTH2_BEARER, token ? key_->token.c_str() : nullptr);
    curl_easy_setopt(easy, CURLOPT_USERNAME, sent && !token ? key_->name.c_str() : nullptr);
    curl_easy_setopt(easy, CURLOPT_PASSWORD, sent && !token ? key_->password.c_str() : nullptr);
    // A proxy would see a key that is sent over http. Such a key is for this machine, so the
    // request needs no proxy.
    curl_easy_setopt(easy, CURLOPT_PROXY, sent && origin_.scheme == "http" ? "" : nullptr);
  }

  /// If the answer redirects an ended request to the same host, for the first time, prepares the
  /// request for the new address and returns true. Sends the key only to the key's own server. Does
  /// not follow a redirection from https to http.
  [[nodiscard]] bool follow(HttpRequest& request) noexcept {
    CURL* const easy = request.easy.get();
    long code = 0;
    char* to = nullptr;
    curl_easy_getinfo(easy, CURLINFO_RESPONSE_CODE, &code);
    curl_easy_getinfo(easy, CURLINFO_REDIRECT_URL, &to);
    if (!isRedirection(code) || request.followed || to == nullptr) return false;
    try {
      const std::string address = to;
      const std::optional<HttpOrigin> origin = httpOriginOf(address);
      if (!origin || origin->host != origin_.host) return false;
      if (origin_.scheme == "https" && origin->scheme != "https") return false;
      curl_easy_setopt(easy, CURLOPT_URL, address.c_str());
      setKey(request, key_.has_value() && *origin == origin_);
    } catch (const std::bad_alloc&) {
      request.why = kNoMemory;
      return false;
    }
    request.followed = true;
    return true;
  }

  [[nodiscard]] HttpRequest* nextEnded() noexcept {
    int left = 0;
    while (const CURLMsg* message = curl_multi_info_read(multi_.get(), &left)) {
      if (message->msg != CURLMSG_DONE) continue;
      CURL* const easy = message->easy_handle;
      const CURLcode how = message->data.result;
      HttpRequest* request = nullptr;
      curl_easy_getinfo(easy, CURLINFO_PRIVATE, &request);
      curl_multi_remove_handle(multi_.get(), easy);
      if (follow(*request) && curl_multi_add_handle(multi_.get(), easy) == CURLM_OK) continue;
      conclude(*request, how);
      return request;
    }
    return nullptr;
  }

  std::string address_;
  HttpOrigin origin_;
  std::optional<HttpKey> key_;
  StoreParams params_;
  std::unique_ptr<CURLM, EndsMulti> multi_;
};

std::unique_ptr<ObjectStore> openHttp(const std::string& address, const StoreParams& params) {
  const std::optional<HttpOrigin> origin = httpOriginOf(address);
  if (!isAddress(address) || !origin) {
    throw VolumeError(address, "it is not an address of a folder",
                      "give http://host/folder or https://host/folder, without @, ? or #; give a "
                      "password by PALPATE_HTTP_KEYS (docs/servers.md)");
  }
  beginCurl();
  std::string folder = address;
  while (folder.back() == '/') folder.pop_back();
  return std::make_unique<HttpStore>(std::move(folder), *origin, params);
}

}  // namespace
}  // namespace palpate

// NOLINTNEXTLINE(readability-identifier-naming): the name of the symbol in module.map.
extern "C" const palpate::ModuleEntry<palpate::HttpFactory> palpate_module{&palpate::openHttp};
