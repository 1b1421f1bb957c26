#include "palpate/samplers/http_bricks.h"

#include <algorithm>
#include <atomic>
#include <cassert>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <curl/curl.h>
#include <mutex>
#include <new>
#include <thread>
#include <utility>

#include "palpate/engine/error.h"
#include "palpate/samplers/brick_codec.h"
#include "palpate/samplers/brick_facts.h"
#include "palpate/samplers/wishes.h"

namespace palpate {
namespace {

using Clock = std::chrono::steady_clock;

/// No manifest is longer [bytes]: 36 bytes a brick, of 30 million.
constexpr std::size_t kLongestManifest = std::size_t{1} << 30U;
/// By so much of its manifest a volume is known again [bytes]: what it says of itself.
constexpr std::size_t kLongestHead = std::size_t{64} << 10U;
/// What cannot be compressed is longer by no more than this [bytes].
constexpr std::size_t kMostAround = std::size_t{64} << 10U;
/// A delay is smoothed over so many bricks.
constexpr double kDelays = 8.0;
/// How long the thread sleeps where nothing wakes it.
constexpr int kTurnMs = 100;

constexpr const char* kNoMemory = "there is no memory for it";

/// A request: where its answer goes, and how it went.
struct Request {
  std::vector<std::byte> body;
  std::size_t limit = 0;        ///< Longer answers are cut off.
  bool too_long = false;        ///< It was.
  long code = 0;                ///< Of HTTP; 0: there was no answer.
  const char* error = nullptr;  ///< Why there was none, or not all of it.
  Clock::time_point last;       ///< When something came, or it was asked for.

  void begin(std::size_t at_most) noexcept {
    body.clear();
    limit = at_most;
    too_long = false;
    code = 0;
    error = nullptr;
    last = Clock::now();
  }
  [[nodiscard]] bool isWhole() const noexcept {
    return code == 200 && !too_long && error == nullptr;
  }
};

/// libcurl's: nothing is thrown through it.
std::size_t receive(const char* bytes, std::size_t size, std::size_t count, void* to) noexcept {
  auto& request = *static_cast<Request*>(to);
  const std::size_t more = size * count;
  const std::size_t kept = std::min(more, request.limit - request.body.size());
  request.last = Clock::now();
  request.too_long = kept < more;
  try {
    const auto* first = reinterpret_cast<const std::byte*>(bytes);
    request.body.insert(request.body.end(), first, first + kept);
    return kept;
  } catch (const std::bad_alloc&) {
    request.error = kNoMemory;
    return 0;
  }
}

struct EndsEasy {
  void operator()(CURL* easy) const noexcept { curl_easy_cleanup(easy); }
};
struct EndsMulti {
  void operator()(CURLM* multi) const noexcept { curl_multi_cleanup(multi); }
};
using Easy = std::unique_ptr<CURL, EndsEasy>;
using Multi = std::unique_ptr<CURLM, EndsMulti>;

/// Once a process, before any of its threads.
void beginCurl() {
  static const CURLcode begun = curl_global_init(CURL_GLOBAL_DEFAULT);
  if (begun != CURLE_OK) throw VolumeError("libcurl", "it does not begin", "check the system");
}

Easy makeEasy(const HttpParams& params) {
  Easy easy(curl_easy_init());
  if (!easy) throw VolumeError("libcurl", "there is no memory for it", "give it less");
  CURL* const of = easy.get();
  curl_easy_setopt(of, CURLOPT_PROTOCOLS_STR, "http,https");
  curl_easy_setopt(of, CURLOPT_FOLLOWLOCATION, 0L);
  curl_easy_setopt(of, CURLOPT_DISALLOW_USERNAME_IN_URL, 1L);
  // By HTTP/2 all would go by one connection, also after it has died.
  curl_easy_setopt(of, CURLOPT_HTTP_VERSION, static_cast<long>(CURL_HTTP_VERSION_1_1));
  curl_easy_setopt(of, CURLOPT_NOSIGNAL, 1L);
  curl_easy_setopt(of, CURLOPT_USERAGENT, "palpate");
  curl_easy_setopt(of, CURLOPT_WRITEFUNCTION, &receive);
  curl_easy_setopt(of, CURLOPT_CONNECTTIMEOUT_MS, static_cast<long>(params.connect.count()));
  curl_easy_setopt(of, CURLOPT_TIMEOUT_MS, static_cast<long>(params.longest.count()));
#if LIBCURL_VERSION_NUM >= 0x075700
  curl_easy_setopt(of, CURLOPT_QUICK_EXIT, 1L);  // also while a name is looked up
#endif
  return easy;
}

void aim(CURL* easy, const std::string& url, Request& request) {
  curl_easy_setopt(easy, CURLOPT_URL, url.c_str());
  curl_easy_setopt(easy, CURLOPT_WRITEDATA, &request);
}

void conclude(CURL* easy, CURLcode how, Request& request) {
  curl_easy_getinfo(easy, CURLINFO_RESPONSE_CODE, &request.code);
  if (how == CURLE_OK || request.too_long || request.error != nullptr) return;
  request.error = curl_easy_strerror(how);  // lasts
}

/// What an answer is worth as a brick's object.
BrickVerdict verdictOf(const Request& of) {
  if (of.isWhole()) return {};
  if (of.code == 404 || of.code == 410) return {BrickStatus::kMissing, "it is missing"};
  if (of.code != 0 && of.code != 200) {
    return {BrickStatus::kUnreadable, "the server answers " + std::to_string(of.code)};
  }
  if (of.too_long) return {BrickStatus::kCut, "it is longer than its manifest says"};
  return {BrickStatus::kUnreadable, std::string("it does not come (") + of.error + ")"};
}

}  // namespace

struct HttpBricks::State {
  State(const std::string& to, const HttpParams& how);
  ~State() {
    stop = true;
    wakeThread();
    if (thread.joinable()) thread.join();
  }

  /// A brick on its way, or come; used over and over.
  struct Fetch {
    BrickId id;
    BrickEntry entry;
    Request request;
    Clock::time_point begun;
    Easy easy;
  };
  using FetchPtr = std::unique_ptr<Fetch>;

  /// How long a brick's object may be, whatever its manifest says [bytes].
  [[nodiscard]] std::size_t longest(const BrickEntry& entry) const {
    return std::min<std::size_t>(entry.bytes, manifest->format().bytes() + kMostAround);
  }
  [[nodiscard]] std::string url(const std::string& object) const { return address + "/" + object; }
  void wakeThread() { curl_multi_wakeup(multi.get()); }
  [[nodiscard]] Request get(const std::string& object, std::size_t limit);
  void run();
  void beginFetches();
  void send(Fetch& fetch, const std::string& object, std::size_t limit);
  void endFetches();
  void endStalled();
  void probe();
  void answer();
  void come(FetchPtr fetch);
  [[nodiscard]] BrickCodec takeCodec();
  [[nodiscard]] BrickArrival arrivalOf(const BrickId& id, BrickVerdict verdict) const;
  [[nodiscard]] BrickArrival decode(const Fetch& fetch, std::span<std::byte> slot);

  std::string address;
  HttpParams params;
  Multi multi;
  std::optional<BrickManifest> manifest;
  std::vector<std::byte> head;  ///< Of the manifest, as it was.
  std::string range;            ///< Of it.

  mutable std::mutex mutex;  ///< Guards all down to the thread's own; not held while a brick is
                             ///< fetched or decoded.
  std::condition_variable arrived;
  Wishes wishes;
  std::vector<FetchPtr> free;      ///< As many as connections in all, here and there.
  std::vector<FetchPtr> here;      ///< Come, and not yet taken.
  std::vector<BrickCodec> codecs;  ///< Of threads that are not in here now.
  std::vector<Easy> idle;          ///< Likewise.
  HttpState counts;

  // The thread's own.
  std::vector<FetchPtr> away;
  Fetch asker;  ///< Whether the volume is there.

  std::atomic<bool> there{true};
  std::atomic<bool> ask{false};
  std::atomic<std::int64_t> asked{0};  ///< Since when it has not answered [ns]; 0: it is not asked.
  std::atomic<bool> stop{false};
  std::thread thread;
};

HttpBricks::State::State(const std::string& to, const HttpParams& how) : address(to), params(how) {
  if (!isAddress(address)) {
    throw VolumeError(address, "it is no address", "give http://host/folder");
  }
  while (address.back() == '/') address.pop_back();
  params.connections = std::clamp(params.connections, 1, 32);
  beginCurl();
  multi.reset(curl_multi_init());
  curl_multi_setopt(multi.get(), CURLMOPT_MAX_TOTAL_CONNECTIONS,
                    static_cast<long>(params.connections) + 1);
  const Request file = get(kBrickManifestFile, kLongestManifest);
  const BrickVerdict verdict = verdictOf(file);
  if (verdict.status == BrickStatus::kMissing) {
    throw VolumeError(address, "there is no volume in bricks",
                      "check the address; the last thing that is copied there is " +
                          std::string(kBrickManifestFile));
  }
  if (verdict.status != BrickStatus::kArrived) {
    throw VolumeError(url(kBrickManifestFile), verdict.why,
                      "check the address, the server and the way to it");
  }
  manifest = BrickManifest::parse(file.body, url(kBrickManifestFile));
  const auto known = std::min({file.body.size(), BrickFacts::headOf(file.body), kLongestHead});
  head.assign(file.body.begin(), file.body.begin() + static_cast<std::ptrdiff_t>(known));
  range = "0-" + std::to_string(known - 1);
  // The thread is to need no memory but libcurl's, which says so.
  for (int i = 0; i < params.connections; ++i) {
    free.push_back(std::make_unique<Fetch>());
    free.back()->easy = makeEasy(params);
  }
  away.reserve(free.size());
  here.reserve(free.size());
  asker.easy = makeEasy(params);
  asker.request.body.reserve(head.size());
  curl_easy_setopt(asker.easy.get(), CURLOPT_RANGE, range.c_str());
  thread = std::thread([this] { run(); });
}

/// An object, by a connection of the caller's; tried again where nothing comes of it.
Request HttpBricks::State::get(const std::string& object, std::size_t limit) {
  constexpr int kTries = 3;
  Easy easy;
  {
    const std::lock_guard lock(mutex);
    if (!idle.empty()) {
      easy = std::move(idle.back());
      idle.pop_back();
    }
  }
  if (!easy) {
    easy = makeEasy(params);
    // What is long may take long, while it goes on.
    curl_easy_setopt(easy.get(), CURLOPT_TIMEOUT_MS, 0L);
    const auto seconds = std::chrono::ceil<std::chrono::seconds>(params.stalled).count();
    curl_easy_setopt(easy.get(), CURLOPT_LOW_SPEED_LIMIT, 1'000L);
    curl_easy_setopt(easy.get(), CURLOPT_LOW_SPEED_TIME, std::max(1L, static_cast<long>(seconds)));
  }
  Request request;
  for (int i = 0; i < kTries && request.code == 0; ++i) {
    request.begin(limit);
    curl_easy_setopt(easy.get(), CURLOPT_MAXFILESIZE_LARGE, static_cast<curl_off_t>(limit));
    aim(easy.get(), url(object), request);
    conclude(easy.get(), curl_easy_perform(easy.get()), request);
  }
  const std::lock_guard lock(mutex);
  idle.push_back(std::move(easy));
  return request;
}

BrickCodec HttpBricks::State::takeCodec() {
  const std::lock_guard lock(mutex);
  if (codecs.empty()) return {manifest->format(), manifest->identity()};
  BrickCodec codec = std::move(codecs.back());
  codecs.pop_back();
  return codec;
}

BrickArrival HttpBricks::State::arrivalOf(const BrickId& id, BrickVerdict verdict) const {
  BrickArrival arrival{id, verdict.status, ""};
  if (verdict.status == BrickStatus::kArrived) return arrival;
  const char* remedy = "copy or write the volume again";
  if (verdict.status == BrickStatus::kUnknown) remedy = "ask for one that there is";
  if (verdict.status == BrickStatus::kUnreadable) remedy = "check the server and the way to it";
  arrival.why = url(brickObject(id, manifest->format())) + ": " + verdict.why + ": " + remedy;
  return arrival;
}

BrickArrival HttpBricks::State::decode(const Fetch& fetch, std::span<std::byte> slot) {
  if (fetch.entry.kind != BrickKind::kStored) {
    fillBrick(manifest->format(), fetch.entry, slot);
    return {fetch.id, BrickStatus::kArrived, ""};
  }
  BrickVerdict verdict = verdictOf(fetch.request);
  if (verdict.status == BrickStatus::kArrived) {
    BrickCodec codec = takeCodec();
    const std::vector<std::byte>& body = fetch.request.body;
    if (body.size() <= codec.object().size()) {
      std::copy(body.begin(), body.end(), codec.object().begin());
      verdict = codec.decode(fetch.id, body.size(), &fetch.entry, slot);
    } else {
      verdict = {BrickStatus::kCut, "it is longer than any brick"};
    }
    const std::lock_guard lock(mutex);
    codecs.push_back(std::move(codec));
  }
  return arrivalOf(fetch.id, std::move(verdict));
}

void HttpBricks::State::come(FetchPtr fetch) {
  const std::chrono::duration<double> took = Clock::now() - fetch->begun;
  {
    const std::lock_guard lock(mutex);
    if (fetch->entry.kind == BrickKind::kStored) {
      const bool whole = fetch->request.isWhole();
      counts.objects += whole ? 1 : 0;
      counts.failed += whole ? 0 : 1;
      counts.bytes += whole ? fetch->request.body.size() : 0;
      const double share = counts.objects == 1 ? 1.0 : 1.0 / kDelays;
      if (whole) counts.delay += share * (took.count() - counts.delay);
    }
    here.push_back(std::move(fetch));
  }
  arrived.notify_one();
}

/// Asks for an object; where that fails at once request.error says so.
void HttpBricks::State::send(Fetch& fetch, const std::string& object, std::size_t limit) {
  CURL* const easy = fetch.easy.get();
  fetch.request.begin(limit);
  aim(easy, url(object), fetch.request);
  curl_easy_setopt(easy, CURLOPT_PRIVATE, &fetch);
  const CURLMcode how = curl_multi_add_handle(multi.get(), easy);
  if (how != CURLM_OK) fetch.request.error = curl_multi_strerror(how);
}

/// As many as there are connections, and no more than are taken.
void HttpBricks::State::beginFetches() {
  while (true) {
    FetchPtr fetch;
    {
      const std::lock_guard lock(mutex);
      if (wishes.empty() || free.empty()) return;
      fetch = std::move(free.back());
      free.pop_back();
      fetch->id = wishes.begin();
    }
    const bool known = manifest->has(fetch->id);
    fetch->entry = known ? manifest->entry(fetch->id) : BrickEntry{};
    fetch->begun = Clock::now();
    if (fetch->entry.kind != BrickKind::kStored) {
      come(std::move(fetch));
      continue;
    }
    try {
      send(*fetch, brickObject(fetch->id, manifest->format()), longest(fetch->entry));
    } catch (const std::bad_alloc&) {
      fetch->request.error = kNoMemory;
    }
    if (fetch->request.error != nullptr) {
      come(std::move(fetch));
    } else {
      away.push_back(std::move(fetch));
    }
  }
}

void HttpBricks::State::endFetches() {
  int left = 0;
  while (const CURLMsg* message = curl_multi_info_read(multi.get(), &left)) {
    if (message->msg != CURLMSG_DONE) continue;
    CURL* const easy = message->easy_handle;
    const CURLcode how = message->data.result;
    Fetch* which = nullptr;
    curl_easy_getinfo(easy, CURLINFO_PRIVATE, &which);
    conclude(easy, how, which->request);
    curl_multi_remove_handle(multi.get(), easy);
    if (which == &asker) {
      answer();
      asked = 0;
      continue;
    }
    const auto found = std::find_if(away.begin(), away.end(),
                                    [&](const FetchPtr& one) { return one.get() == which; });
    FetchPtr fetch = std::move(*found);
    away.erase(found);
    come(std::move(fetch));
  }
}

/// What stands still makes room.
void HttpBricks::State::endStalled() {
  const Clock::time_point now = Clock::now();
  for (std::size_t i = away.size(); i-- > 0;) {
    Request& request = away[i]->request;
    if (now - request.last <= params.stalled) continue;
    curl_multi_remove_handle(multi.get(), away[i]->easy.get());
    request.error = "nothing more comes";
    FetchPtr fetch = std::move(away[i]);
    away.erase(away.begin() + static_cast<std::ptrdiff_t>(i));
    come(std::move(fetch));
  }
}

/// Whether what answers is this volume, as it was. A server that knows no ranges gives all of the
/// manifest, of which no more is taken.
void HttpBricks::State::answer() {
  const Request& of = asker.request;
  if (of.error == kNoMemory) return;  // nothing is known
  there = (of.code == 200 || of.code == 206) && of.body == head;
}

/// Asks once at a time whether the volume is there.
void HttpBricks::State::probe() {
  if (asked != 0) {
    if (Clock::now() - asker.request.last <= params.silent) return;
    curl_multi_remove_handle(multi.get(), asker.easy.get());
    there = false;
    asked = 0;
    return;
  }
  if (!ask.exchange(false)) return;
  try {
    send(asker, kBrickManifestFile, head.size());
    if (asker.request.error == nullptr) asked = asker.request.last.time_since_epoch().count();
  } catch (const std::bad_alloc&) {
    return;
  }
}

void HttpBricks::State::run() {
  while (!stop) {
    probe();
    beginFetches();
    int running = 0;
    curl_multi_perform(multi.get(), &running);
    endFetches();
    endStalled();
    curl_multi_poll(multi.get(), nullptr, 0, kTurnMs, nullptr);
  }
  for (const FetchPtr& fetch : away) curl_multi_remove_handle(multi.get(), fetch->easy.get());
  if (asked != 0) curl_multi_remove_handle(multi.get(), asker.easy.get());
}

HttpBricks::HttpBricks(const std::string& address, const HttpParams& params)
    : state_(std::make_unique<State>(address, params)) {}

HttpBricks::~HttpBricks() = default;

const BrickManifest& HttpBricks::manifest() const noexcept {
  return *state_->manifest;
}

void HttpBricks::want(std::vector<BrickWish> wishes) {
  {
    const std::lock_guard lock(state_->mutex);
    state_->wishes.set(std::move(wishes));
  }
  state_->wakeThread();
}

std::optional<BrickArrival> HttpBricks::next(std::span<std::byte> slot,
                                             std::chrono::milliseconds patience) {
  assert(slot.size() == manifest().format().bytes());
  State::FetchPtr fetch;
  {
    std::unique_lock lock(state_->mutex);
    if (!state_->arrived.wait_for(lock, patience, [&] { return !state_->here.empty(); })) {
      return std::nullopt;
    }
    fetch = std::move(state_->here.front());
    state_->here.erase(state_->here.begin());
  }
  // Whatever becomes of it, there is room for another one.
  const auto end = [&](State* state) {
    {
      const std::lock_guard lock(state->mutex);
      state->wishes.end(fetch->id);
      state->free.push_back(std::move(fetch));
    }
    state->wakeThread();
  };
  const std::unique_ptr<State, decltype(end)> ended(state_.get(), end);
  if (manifest().has(fetch->id)) return state_->decode(*fetch, slot);
  return state_->arrivalOf(fetch->id,
                           {BrickStatus::kUnknown, "there is no such place in its pyramid"});
}

bool HttpBricks::isThere() {
  state_->ask = true;
  state_->wakeThread();
  // Also where the thread itself waits, as for a name.
  const Clock::duration since(state_->asked);
  const bool silent =
      since.count() != 0 && Clock::now().time_since_epoch() - since > state_->params.silent;
  return state_->there && !silent;
}

BrickArrival HttpBricks::read(const BrickId& id, std::span<std::byte> slot) {
  assert(slot.size() == manifest().format().bytes());
  if (!manifest().has(id)) {
    return state_->arrivalOf(id, {BrickStatus::kUnknown, "there is no such place in its pyramid"});
  }
  State::Fetch fetch;
  fetch.id = id;
  fetch.entry = manifest().entry(id);
  if (fetch.entry.kind == BrickKind::kStored) {
    fetch.request = state_->get(brickObject(id, manifest().format()), state_->longest(fetch.entry));
  }
  return state_->decode(fetch, slot);
}

std::chrono::duration<double> HttpBricks::delay() const {
  const std::lock_guard lock(state_->mutex);
  return std::chrono::duration<double>(state_->counts.delay);
}

HttpState HttpBricks::state() const {
  const std::lock_guard lock(state_->mutex);
  return state_->counts;
}

bool isAddress(std::string_view name) noexcept {
  for (const std::string_view scheme : {"http://", "https://"}) {
    if (!name.starts_with(scheme)) continue;
    const std::string_view rest = name.substr(scheme.size());
    // Of objects in a folder: what a question or a name adds would stand before theirs.
    return !rest.empty() && rest.front() != '/' &&
           rest.find_first_of("?#@") == std::string_view::npos;
  }
  return false;
}

}  // namespace palpate
