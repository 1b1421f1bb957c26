#include "palpate/samplers/bricks/far_bricks.h"

#include <algorithm>
#include <atomic>
#include <cassert>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <mutex>
#include <new>
#include <thread>
#include <utility>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/brick_codec.h"
#include "palpate/samplers/bricks/brick_facts.h"
#include "palpate/samplers/bricks/request_queue.h"

namespace palpate {
namespace {

using Clock = std::chrono::steady_clock;

/// Longest manifest that is accepted [bytes], enough for 29 million bricks with 36 bytes each.
constexpr std::size_t kLongestManifest = std::size_t{1} << 30U;
/// Longest part of a manifest's head that is compared to identify the volume [bytes].
constexpr std::size_t kLongestHead = std::size_t{64} << 10U;
/// Upper bound for the number of bytes by which compression enlarges a brick.
constexpr std::size_t kMostAround = std::size_t{64} << 10U;
/// Each brick after the first one has the weight 1 / kDelaysAveraged in the mean delay.
constexpr double kDelaysAveraged = 8.0;
/// Longest time that the fetching thread waits for the end of a request.
constexpr std::chrono::milliseconds kTurn{100};

BrickVerdict verdictOf(const ObjectRequest& of) {
  switch (of.status) {
    case BrickStatus::kArrived:
      return {};
    case BrickStatus::kMissing:
      return {of.status, "it is missing"};
    case BrickStatus::kCut:
      if (of.announced && *of.announced < of.least) {
        return {of.status, "it has " + std::to_string(*of.announced) + " bytes instead of the " +
                               std::to_string(of.least) + " in the manifest"};
      }
      return {of.status, "it is longer than the manifest states"};
    default:
      break;
  }
  const std::string why = of.why == nullptr ? "no answer" : of.why;
  if (of.code != 0) return {BrickStatus::kUnreadable, why + " " + std::to_string(of.code)};
  return {BrickStatus::kUnreadable, "it was not received (" + why + ")"};
}

/// Returns the remedy for a manifest that did not arrive for the reason `why`.
const char* remedyForManifest(const ObjectRequest& request, const std::string& why) {
  const auto says = [&](const char* words) { return why.find(words) != std::string::npos; };
  if (says("rejects the key")) return "correct the server's key in that file (docs/servers.md)";
  if (says("PALPATE_HTTP_KEYS")) {
    return "write the server's key into a file, and set PALPATE_HTTP_KEYS to the file "
           "(docs/servers.md)";
  }
  if (says("certificate")) {
    return "correct the address, or let the machine trust the issuer of the server's certificate";
  }
  if (says("redirects")) return "give the address to which the server redirects";
  if (says(kNoMemory)) return "end other programs to free memory";
  return request.code != 0 ? "check the address and the server"
                           : "check the address, the server and the network";
}

}  // namespace

struct FarBricks::State {
  State(const std::string& to, std::unique_ptr<ObjectStore> from, const StoreParams& how);
  ~State() {
    stop = true;
    store->wake();
    if (thread.joinable()) thread.join();
  }

  struct Fetch {
    BrickId id;
    BrickEntry entry;
    std::unique_ptr<ObjectRequest> request;
    Clock::time_point begun;
  };
  using FetchPtr = std::unique_ptr<Fetch>;

  /// Returns the largest accepted size of a brick's object, even if the manifest states more.
  [[nodiscard]] std::size_t longest(const BrickEntry& entry) const {
    return std::min<std::size_t>(entry.bytes, manifest->format().bytes() + kMostAround);
  }
  [[nodiscard]] std::string url(const std::string& object) const { return address + "/" + object; }
  void get(Fetch& fetch, const std::string& object, std::size_t least, std::size_t limit);
  void run();
  void beginFetches();
  void end(const ObjectRequest* request);
  void endStalled();
  void probe();
  void answer();
  void come(FetchPtr fetch);
  [[nodiscard]] BrickCodec takeCodec();
  [[nodiscard]] BrickArrival arrivalOf(const BrickId& id, BrickVerdict verdict) const;
  [[nodiscard]] BrickArrival decode(const Fetch& fetch, std::span<std::byte> slot);

  std::string address;
  StoreParams params;
  std::unique_ptr<ObjectStore> store;
  std::optional<BrickManifest> manifest;
  std::vector<std::byte> head;  ///< Head of the manifest when the source was opened.

  /// Guards the members down to `delay`. Not held during a fetch or while a brick is decoded.
  mutable std::mutex mutex;
  std::condition_variable arrived;
  RequestQueue wishes;
  /// Unused fetches. There is one fetch for each connection.
  std::vector<FetchPtr> free;
  std::vector<FetchPtr> here;      ///< Complete fetches that next() has not yet taken.
  std::vector<BrickCodec> codecs;  ///< Codecs that no thread uses now.
  std::vector<std::unique_ptr<ObjectRequest>> idle;
  double delay = 0.0;  ///< BrickSource::delay [s].

  // Members for the fetching thread only.
  std::vector<FetchPtr> away;
  std::unique_ptr<ObjectRequest> asker;  ///< Request that checks whether the volume exists.

  std::atomic<bool> there{true};
  std::atomic<bool> ask{false};
  /// Time at which the unanswered check began [ns]; 0 if no check is in progress.
  std::atomic<std::int64_t> asked{0};
  std::atomic<bool> stop{false};
  std::thread thread;
};

FarBricks::State::State(const std::string& to, std::unique_ptr<ObjectStore> from,
                        const StoreParams& how)
    : address(to), params(how), store(std::move(from)) {
  while (address.ends_with('/')) address.pop_back();
  params.connections = std::clamp(params.connections, 1, 32);
  Fetch file;
  get(file, kBrickManifestFile, 0, kLongestManifest);
  const BrickVerdict verdict = verdictOf(*file.request);
  if (verdict.status == BrickStatus::kMissing) {
    throw VolumeError(address, "it is not a volume in bricks",
                      "check the address, or finish the copy with its last file, " +
                          std::string(kBrickManifestFile));
  }
  if (verdict.status == BrickStatus::kCut) {
    throw VolumeError(url(kBrickManifestFile), "it is longer than 1 GiB",
                      "check the address; for so many bricks, give a folder instead of an address");
  }
  if (verdict.status != BrickStatus::kArrived) {
    throw VolumeError(url(kBrickManifestFile), verdict.why,
                      remedyForManifest(*file.request, verdict.why));
  }
  const std::vector<std::byte>& body = file.request->body;
  manifest = BrickManifest::parse(body, url(kBrickManifestFile));
  const auto known = std::min({body.size(), BrickFacts::headOf(body), kLongestHead});
  head.assign(body.begin(), body.begin() + static_cast<std::ptrdiff_t>(known));
  // Allocates the fetching thread's memory now. Later this thread allocates only objects' names and
  // the store's memory, and a lack of memory ends the fetch. Decoding allocates in the thread that
  // calls next().
  for (int i = 0; i < params.connections; ++i) {
    free.push_back(std::make_unique<Fetch>());
    free.back()->request = store->make();
  }
  away.reserve(free.size());
  here.reserve(free.size());
  asker = store->make();
  asker->body.reserve(head.size());
  thread = std::thread([this] { run(); });
}

/// Fetches an object for a caller that waits. If no answer comes, tries again, up to kTries times
/// and StoreParams::opened in all.
void FarBricks::State::get(Fetch& fetch, const std::string& object, std::size_t least,
                           std::size_t limit) {
  constexpr int kTries = 3;
  {
    const std::lock_guard lock(mutex);
    if (!idle.empty()) {
      fetch.request = std::move(idle.back());
      idle.pop_back();
    }
  }
  if (fetch.request == nullptr) fetch.request = store->make();
  ObjectRequest& request = *fetch.request;
  const Clock::time_point begun = Clock::now();
  for (int i = 0; i < kTries && Clock::now() - begun < params.opened; ++i) {
    request.ask(least, limit);
    request.last = begun;  // StoreParams::opened limits the time of all tries together
    store->get(object, request);
    if (request.status != BrickStatus::kUnreadable || request.code != 0) return;
  }
}

BrickCodec FarBricks::State::takeCodec() {
  const std::lock_guard lock(mutex);
  if (codecs.empty()) return {manifest->format(), manifest->identity()};
  BrickCodec codec = std::move(codecs.back());
  codecs.pop_back();
  return codec;
}

BrickArrival FarBricks::State::arrivalOf(const BrickId& id, BrickVerdict verdict) const {
  BrickArrival arrival{id, verdict.status, ""};
  if (verdict.status == BrickStatus::kArrived) return arrival;
  const char* remedy = "copy or write the volume again";
  if (verdict.status == BrickStatus::kUnknown) remedy = "request a brick that the volume has";
  if (verdict.status == BrickStatus::kUnreadable) remedy = "check the server and the network";
  const auto says = [&](const char* words) { return verdict.why.find(words) != std::string::npos; };
  if (says(kNoMemory)) remedy = "end other programs to free memory";
  if (says("PALPATE_HTTP_KEYS")) remedy = "give the server's key, and start the program again";
  arrival.why = url(brickObject(id, manifest->format())) + ": " + verdict.why + ": " + remedy;
  return arrival;
}

BrickArrival FarBricks::State::decode(const Fetch& fetch, std::span<std::byte> slot) {
  if (fetch.entry.kind != BrickKind::kStored) {
    fillBrick(manifest->format(), fetch.entry, slot);
    return {fetch.id, BrickStatus::kArrived, ""};
  }
  BrickVerdict verdict = verdictOf(*fetch.request);
  if (verdict.status == BrickStatus::kArrived) {
    BrickCodec codec = takeCodec();
    const std::vector<std::byte>& body = fetch.request->body;
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

void FarBricks::State::come(FetchPtr fetch) {
  const std::chrono::duration<double> took = Clock::now() - fetch->begun;
  {
    const std::lock_guard lock(mutex);
    if (fetch->entry.kind == BrickKind::kStored &&
        fetch->request->status == BrickStatus::kArrived) {
      delay += (delay == 0.0 ? 1.0 : 1.0 / kDelaysAveraged) * (took.count() - delay);
    }
    here.push_back(std::move(fetch));
  }
  arrived.notify_one();
}

/// Starts requested fetches while `free` has one. next() returns a complete fetch to `free`.
void FarBricks::State::beginFetches() {
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
    fetch->request->ask(fetch->entry.bytes, longest(fetch->entry));
    bool begun = false;
    try {
      begun = store->begin(brickObject(fetch->id, manifest->format()), *fetch->request);
    } catch (const std::bad_alloc&) {
      fetch->request->fail(kNoMemory);
    }
    if (begun) {
      away.push_back(std::move(fetch));
    } else {
      come(std::move(fetch));
    }
  }
}

void FarBricks::State::end(const ObjectRequest* request) {
  if (request == asker.get()) {
    answer();
    return;
  }
  const auto found = std::find_if(
      away.begin(), away.end(), [&](const FetchPtr& one) { return one->request.get() == request; });
  FetchPtr fetch = std::move(*found);
  away.erase(found);
  come(std::move(fetch));
}

void FarBricks::State::endStalled() {
  const Clock::time_point now = Clock::now();
  for (std::size_t i = away.size(); i-- > 0;) {
    ObjectRequest& request = *away[i]->request;
    if (now - request.last <= params.stalled && now - away[i]->begun <= params.longest) continue;
    store->drop(request);
    request.fail("the transfer stalled or took too long");
    end(&request);
  }
}

/// Processes the answer to a check: the volume exists if the manifest's head is unchanged.
void FarBricks::State::answer() {
  // If there was too little memory for the check, the check has no result.
  if (!asker->lacksMemory()) {
    there = asker->status == BrickStatus::kArrived && asker->body == head;
  }
  asked = 0;
}

/// Checks whether the volume exists. Only one check is in progress at a time.
void FarBricks::State::probe() {
  if (asked != 0) {
    if (Clock::now() - asker->last <= params.silent) return;
    store->drop(*asker);
    there = false;
    asked = 0;
    return;
  }
  if (!ask.exchange(false)) return;
  asker->ask(head.size(), head.size(), true);
  if (store->begin(kBrickManifestFile, *asker)) {
    asked = asker->last.time_since_epoch().count();
  } else {
    answer();
  }
}

void FarBricks::State::run() {
  while (!stop) {
    probe();
    beginFetches();
    auto patience = kTurn;
    while (const ObjectRequest* request = store->ended(patience)) {
      end(request);
      patience = {};
    }
    endStalled();
  }
  for (const FetchPtr& fetch : away) store->drop(*fetch->request);
  if (asked != 0) store->drop(*asker);
}

FarBricks::FarBricks(const std::string& address, std::unique_ptr<ObjectStore> store,
                     const StoreParams& params)
    : state_(std::make_unique<State>(address, std::move(store), params)) {}

FarBricks::~FarBricks() = default;

const BrickManifest& FarBricks::manifest() const noexcept {
  return *state_->manifest;
}

void FarBricks::want(std::vector<BrickWish> wishes) {
  {
    const std::lock_guard lock(state_->mutex);
    state_->wishes.set(std::move(wishes));
  }
  state_->store->wake();
}

std::optional<BrickArrival> FarBricks::next(std::span<std::byte> slot,
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
  // Frees the fetch for another brick, even if decoding throws.
  const auto end = [&](State* state) {
    {
      const std::lock_guard lock(state->mutex);
      state->wishes.end(fetch->id);
      state->free.push_back(std::move(fetch));
    }
    state->store->wake();
  };
  const std::unique_ptr<State, decltype(end)> ended(state_.get(), end);
  if (manifest().has(fetch->id)) return state_->decode(*fetch, slot);
  return state_->arrivalOf(fetch->id,
                           {BrickStatus::kUnknown, "the volume has no brick at this index"});
}

bool FarBricks::isThere() {
  state_->ask = true;
  state_->store->wake();
  // `silent` is also true if the fetching thread is blocked, for example by a name look-up.
  const Clock::duration since(state_->asked);
  const bool silent =
      since.count() != 0 && Clock::now().time_since_epoch() - since > state_->params.silent;
  return state_->there && !silent;
}

BrickArrival FarBricks::read(const BrickId& id, std::span<std::byte> slot) {
  assert(slot.size() == manifest().format().bytes());
  if (!manifest().has(id)) {
    return state_->arrivalOf(id, {BrickStatus::kUnknown, "the volume has no brick at this index"});
  }
  State::Fetch fetch;
  fetch.id = id;
  fetch.entry = manifest().entry(id);
  if (fetch.entry.kind == BrickKind::kStored) {
    state_->get(fetch, brickObject(id, manifest().format()), fetch.entry.bytes,
                state_->longest(fetch.entry));
  }
  BrickArrival arrival = state_->decode(fetch, slot);
  if (fetch.request != nullptr) {
    const std::lock_guard lock(state_->mutex);
    state_->idle.push_back(std::move(fetch.request));
  }
  return arrival;
}

std::chrono::duration<double> FarBricks::delay() const {
  const std::lock_guard lock(state_->mutex);
  return std::chrono::duration<double>(state_->delay);
}

}  // namespace palpate
