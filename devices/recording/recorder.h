/// Writes a recording (recording.h) while the loop runs.
#pragma once

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "palpate/devices/recording/recording.h"

namespace palpate {

/// Passes ticks through a ring buffer to a thread that writes the file. While the disk keeps up, a
/// killed program loses at most the ticks of the last kWritten. If the power fails, the ticks since
/// the last sync are lost (kSynced).
class Recorder {
 public:
  static constexpr double kWritten = 0.05;  ///< Time until a tick is in the file [s].
  static constexpr double kSynced = 1.0;    ///< Time between two syncs of file and disk [s].

  /// Creates a temporary file in the folder of `file` and writes the header. Throws Error if this
  /// fails.
  Recorder(std::filesystem::path file, const RecordedSetting& setting);
  Recorder(const Recorder&) = delete;
  Recorder& operator=(const Recorder&) = delete;
  ~Recorder();

  /// Renames the temporary file to `file`, which replaces an existing file, and starts the thread
  /// that writes. Call it before the first tick. Without this call an existing file stays
  /// unchanged. Throws Error if the file cannot be renamed.
  void begin();

  // Called by the haptic thread.

  /// Records a tick. If the ring is full, the tick is lost and counted. After writing has failed,
  /// ticks are ignored. RT: no allocation, no lock, no system call; copies a RecordedTick.
  void take(const Telemetry& tick) noexcept PALPATE_NONBLOCKING;

  // Called by the scene thread.
  /// Adds a scene. Call it before the scene is published.
  void expect(RecordedScene scene);
  /// For virtual time: waits until about half of the ring is free, or until writing has failed.
  void wait() const;
  /// Returns the number of ticks that were lost because the ring was full.
  [[nodiscard]] std::int64_t lost() const noexcept { return lost_; }
  /// Returns the path of the recording.
  [[nodiscard]] const std::filesystem::path& file() const noexcept { return file_; }
  /// Returns why writing has stopped, such as a full disk; empty while writing continues. The file
  /// keeps the chunks that were written completely.
  [[nodiscard]] std::string trouble() const;
  /// Writes the remaining ticks and closes the file. Without begin(), removes the temporary file.
  void end();

 private:
  struct Ring;
  void run();
  void writeNew();
  void write(const std::string& chunk);
  void fail(const std::string& why);

  static constexpr std::size_t kRoom = 65536;  // [ticks]: 6 s at 10 kHz, in case the disk is busy

  std::filesystem::path file_;
  std::filesystem::path beside_;  ///< Path of the temporary file; empty after begin().
  int descriptor_ = -1;
  std::uint64_t whole_ = 0;  ///< Length of the file up to the last complete chunk [bytes].
  std::unique_ptr<Ring> ring_;
  std::atomic<std::int64_t> lost_{0};
  std::atomic<bool> off_{false};  ///< Writing has failed.
  std::atomic<bool> ends_{false};
  mutable std::mutex mutex_;  ///< Guards the next two members.
  std::vector<RecordedScene> scenes_;
  std::string trouble_;
  std::vector<RecordedTick> rows_;
  std::thread thread_;
};

}  // namespace palpate
