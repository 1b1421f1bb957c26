#include "palpate/devices/recording/recorder.h"

#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <fcntl.h>
#include <readerwriterqueue.h>
#include <unistd.h>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"

namespace palpate {

struct Recorder::Ring {
  struct Slot {
    RecordedTick row;
    Slot() = default;
    explicit Slot(const Telemetry& tick) noexcept : row(recordedTick(tick)) {}
  };
  explicit Ring(std::size_t room) : slots(room) {}
  /// Ticks that are not yet written. The queue has a fixed size: try_emplace does not allocate.
  moodycamel::ReaderWriterQueue<Slot> slots;
};

Recorder::Recorder(std::filesystem::path file, const RecordedSetting& setting)
    : file_(std::move(file)), ring_(std::make_unique<Ring>(kRoom)) {
  beside_ = fmt::format("{}.{}.begun", file_.string(), ::getpid());
  descriptor_ = ::open(beside_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
  if (descriptor_ < 0) {
    // If the file exists, another run with the same process number has made it, and was probably
    // killed.
    const bool exists = errno == EEXIST;
    throw Error(file_.string(),
                exists ? fmt::format("its unfinished file {} exists already", beside_.string())
                       : fmt::format("it cannot be written ({})", std::strerror(errno)),
                exists ? "if no run writes to that file, remove it"
                       : "check the folder and its permissions");
  }
  rows_.reserve(kRoom);
  write(recordingHeader(setting));
  if (!trouble_.empty()) {
    ::close(descriptor_);
    ::unlink(beside_.c_str());
    throw Error(
        file_.string(), trouble_,
        "make room on the disk, raise the limit of file sizes (ulimit -f), or give another path");
  }
}

void Recorder::begin() {
  if (std::rename(beside_.c_str(), file_.c_str()) != 0) {
    throw Error(file_.string(), fmt::format("it cannot be written ({})", std::strerror(errno)),
                "check what is at this path and its permissions, or give another path");
  }
  beside_.clear();
  thread_ = std::thread([this] { run(); });
}

Recorder::~Recorder() {
  end();
}

void Recorder::take(const Telemetry& tick) noexcept {
  if (off_.load(std::memory_order_relaxed)) return;
  if (!ring_->slots.try_emplace(tick)) lost_.fetch_add(1, std::memory_order_relaxed);
}

void Recorder::expect(RecordedScene scene) {
  const std::lock_guard lock(mutex_);
  scenes_.push_back(std::move(scene));
}

void Recorder::wait() const {
  while (!off_ && ring_->slots.size_approx() > kRoom / 2) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
}

std::string Recorder::trouble() const {
  const std::lock_guard lock(mutex_);
  return trouble_;
}

void Recorder::fail(const std::string& why) {
  const std::lock_guard lock(mutex_);
  if (trouble_.empty()) trouble_ = fmt::format("writing stopped ({})", why);
  off_ = true;
}

void Recorder::end() {
  if (descriptor_ < 0) return;
  if (thread_.joinable()) {
    ends_ = true;
    thread_.join();
  }
  if (::close(descriptor_) != 0) fail(std::strerror(errno));
  descriptor_ = -1;
  if (!beside_.empty()) ::unlink(beside_.c_str());
}

void Recorder::run() {
  using Clock = std::chrono::steady_clock;
  constexpr std::chrono::duration<double> kLook(0.5 * kWritten);
  auto synced = Clock::now();
  for (bool last = false; !last;) {
    last = ends_;
    try {
      writeNew();
    } catch (const std::bad_alloc&) {
      fail("not enough memory");
    }
    const auto now = Clock::now();
    if (last || now - synced >= std::chrono::duration<double>(kSynced)) {
      if (::fdatasync(descriptor_) != 0 && errno != EINVAL) fail(std::strerror(errno));
      synced = now;
    }
    // Pauses only while the ring is less than a quarter full, because it fills fast in virtual
    // time.
    if (!last && ring_->slots.size_approx() < kRoom / 4) std::this_thread::sleep_for(kLook);
  }
}

void Recorder::writeNew() {
  rows_.clear();
  Ring::Slot slot;
  while (rows_.size() < rows_.capacity() && ring_->slots.try_dequeue(slot))
    rows_.push_back(slot.row);
  // The program calls expect() before it publishes a scene, so scenes_ has all scenes of these
  // ticks.
  std::vector<RecordedScene> scenes;
  {
    const std::lock_guard lock(mutex_);
    scenes.swap(scenes_);
  }
  for (const RecordedScene& scene : scenes) write(recordingChunk(scene));
  if (!rows_.empty()) write(recordingChunk(rows_));
}

void Recorder::write(const std::string& chunk) {
  if (off_) return;
  std::size_t at = 0;
  while (at < chunk.size()) {
    const ssize_t wrote = ::write(descriptor_, chunk.data() + at, chunk.size() - at);
    if (wrote < 0 && errno == EINTR) continue;
    if (wrote <= 0) {
      const std::string why = std::strerror(wrote < 0 ? errno : ENOSPC);
      // Removes the incomplete chunk at the file's end.
      if (::ftruncate(descriptor_, static_cast<off_t>(whole_)) != 0) errno = 0;
      fail(why);
      return;
    }
    at += static_cast<std::size_t>(wrote);
  }
  whole_ += chunk.size();
}

}  // namespace palpate
