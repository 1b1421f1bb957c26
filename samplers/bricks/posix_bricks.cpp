#include <cassert>
#include <cerrno>
#include <condition_variable>
#include <cstring>
#include <memory>
#include <mutex>
#include <utility>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/brick_codec.h"
#include "palpate/samplers/bricks/brick_facts.h"
#include "palpate/samplers/bricks/brick_folder.h"
#include "palpate/samplers/bricks/bricks.h"
#include "palpate/samplers/bricks/request_queue.h"

namespace palpate {

struct PosixBricks::State {
  State(const std::filesystem::path& path, BrickManifest known)
      : manifest(std::move(known)),
        folder(std::make_shared<const BrickFolder>(path)),
        finished(folder->has(kBrickManifestFile)),
        manifest_stamp(folder->stampOf(kBrickManifestFile)) {}

  BrickManifest manifest;

  std::mutex mutex;
  /// The open folder. isThere() opens the folder again if it was removed and restored.
  std::shared_ptr<const BrickFolder> folder;
  const bool finished;                ///< True if the folder had a manifest at the start.
  BrickFolder::Stamp manifest_stamp;  ///< Stamp of the manifest when it was last found valid.
  std::condition_variable wake;
  RequestQueue wishes;
  std::vector<BrickCodec> free;  ///< Codecs that no thread uses now.

  BrickCodec takeCodec() {
    const std::lock_guard lock(mutex);
    if (free.empty()) return {manifest.format(), manifest.identity()};
    BrickCodec codec = std::move(free.back());
    free.pop_back();
    return codec;
  }
  void giveBack(BrickCodec codec) {
    const std::lock_guard lock(mutex);
    free.push_back(std::move(codec));
  }

  std::shared_ptr<const BrickFolder> held() {
    const std::lock_guard lock(mutex);
    return folder;
  }
  /// Returns true if the folder has not been removed, and still has its manifest if it had one at
  /// the start.
  bool isIn(const BrickFolder& some) const {
    return !some.isGone() && (!finished || some.has(kBrickManifestFile));
  }
  static BrickVerdict verdictOf(int error) {
    if (error == ENOENT || error == ENOTDIR) return {BrickStatus::kMissing, "it is missing"};
    if (error == EISDIR) return {BrickStatus::kDamaged, "it is not a file"};
    return {BrickStatus::kUnreadable,
            std::string("it cannot be read (") + std::strerror(error) + ")"};
  }

  BrickVerdict fetch(const BrickId& id, std::span<std::byte> slot) {
    if (!manifest.has(id)) return {BrickStatus::kUnknown, "the volume has no brick at this index"};
    const BrickEntry entry = manifest.entry(id);
    if (entry.kind != BrickKind::kStored) {
      fillBrick(manifest.format(), entry, slot);
      return {};
    }
    BrickCodec codec = takeCodec();
    std::size_t got = 0;
    const std::shared_ptr<const BrickFolder> from = held();
    const int error = from->read(brickObject(id, manifest.format()), codec.object(), got);
    BrickVerdict verdict =
        error == 0    ? codec.decode(id, got, &entry, slot)
        : isIn(*from) ? verdictOf(error)
                      : BrickVerdict{BrickStatus::kGone, "the volume does not exist any more"};
    giveBack(std::move(codec));
    return verdict;
  }
};

PosixBricks::PosixBricks(const std::filesystem::path& folder)
    : PosixBricks(folder, BrickManifest::read(folder)) {}

PosixBricks::PosixBricks(const std::filesystem::path& folder, BrickManifest manifest)
    : state_(std::make_unique<State>(folder, std::move(manifest))) {}

PosixBricks::~PosixBricks() = default;

const BrickManifest& PosixBricks::manifest() const noexcept {
  return state_->manifest;
}

void PosixBricks::want(std::vector<BrickWish> wishes) {
  {
    const std::lock_guard lock(state_->mutex);
    state_->wishes.set(std::move(wishes));
  }
  state_->wake.notify_all();
}

std::optional<BrickArrival> PosixBricks::next(std::span<std::byte> slot,
                                              std::chrono::milliseconds patience) {
  BrickId id;
  {
    std::unique_lock lock(state_->mutex);
    if (!state_->wake.wait_for(lock, patience, [&] { return !state_->wishes.empty(); })) {
      return std::nullopt;
    }
    id = state_->wishes.begin();
  }
  // Ends the fetch even if read() throws for lack of memory.
  const auto end = [&](State* state) {
    const std::lock_guard lock(state->mutex);
    state->wishes.end(id);
  };
  const std::unique_ptr<State, decltype(end)> ended(state_.get(), end);
  return read(id, slot);
}

bool PosixBricks::isThere() {
  State& state = *state_;
  const std::shared_ptr<const BrickFolder> held = state.held();
  if (!state.finished) return !held->isGone();
  try {
    auto found = std::make_shared<const BrickFolder>(held->path());
    const BrickFolder::Stamp stamp = found->stampOf(kBrickManifestFile);
    if (stamp.isNone()) return false;
    if (found->stamp() == held->stamp() && stamp == state.manifest_stamp) return true;
    if (BrickManifest::read(held->path()).identity() != state.manifest.identity()) return false;
    const std::lock_guard lock(state.mutex);
    state.folder = std::move(found);
    state.manifest_stamp = stamp;
    return true;
  } catch (const VolumeError&) {
    return false;
  }
}

BrickArrival PosixBricks::read(const BrickId& id, std::span<std::byte> slot) {
  assert(slot.size() == state_->manifest.format().bytes());
  BrickVerdict verdict = state_->fetch(id, slot);
  BrickArrival arrival{id, verdict.status, ""};
  if (verdict.status == BrickStatus::kArrived) return arrival;
  const char* remedy = "copy or write the volume again";
  if (verdict.status == BrickStatus::kUnknown) remedy = "request a brick that the volume has";
  if (verdict.status == BrickStatus::kUnreadable) remedy = "check the disk and file permissions";
  arrival.why = (state_->held()->path() / brickObject(id, state_->manifest.format())).string() +
                ": " + verdict.why + ": " + remedy;
  return arrival;
}

}  // namespace palpate
