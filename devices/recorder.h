/// Writes a recording (recording.h) while its hand feels.
#pragma once

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "palpate/devices/recording.h"

namespace palpate {

/// A ring, and a thread that writes what is in it. A program that is killed loses no more than
/// kWritten; a machine that loses its power kSynced.
///
/// Two threads use it beside its own: the haptic thread, and the scene thread.
class Recorder {
 public:
  static constexpr double kWritten = 0.05;  ///< [s]: a tick is in the file, as other programs see
                                            ///< it, so soon,
  static constexpr double kSynced = 1.0;    ///< and on the disk so soon.

  /// Makes the file beside its place, with its header. Throws Error where it cannot be written.
  Recorder(std::filesystem::path file, const RecordedSetting& setting);
  Recorder(const Recorder&) = delete;
  Recorder& operator=(const Recorder&) = delete;
  ~Recorder();

  /// Before the first tick: puts the file in its place, over what stands there. A recorder that
  /// never begins leaves that as it is. Throws Error where it cannot be put there.
  void begin();

  // For the haptic thread.
  /// Keeps a tick; where there is no room it is lost, and counted. RT: no allocation, no lock, no
  /// system call. Cost: some 0.1 us.
  void take(const Telemetry& tick) noexcept PALPATE_NONBLOCKING;

  // For the scene thread.
  /// To be called before a scene is published.
  void expect(RecordedScene scene);
  /// For time that is not real: waits until there is room for many more ticks.
  void wait() const;
  /// Ticks that there was no room for.
  [[nodiscard]] std::int64_t lost() const noexcept { return lost_; }
  /// Why nothing is written any more, as a disk that is full; empty: it is. What was written before
  /// is whole.
  [[nodiscard]] std::string trouble() const;
  /// Writes what is left and closes the file.
  void end();

 private:
  struct Ring;
  void run();
  void writeNew();
  void write(const std::string& chunk);
  void fail(const std::string& why);

  static constexpr std::size_t kRoom = 65536;  // 6 s at 10 kHz: as long as a disk may think

  std::filesystem::path file_;
  std::filesystem::path beside_;  ///< Where it is until begin(); then empty.
  int descriptor_ = -1;
  std::uint64_t whole_ = 0;  ///< Bytes up to the last whole chunk.
  std::unique_ptr<Ring> ring_;
  std::atomic<std::int64_t> lost_{0};
  std::atomic<bool> off_{false};  ///< There is trouble.
  std::atomic<bool> ends_{false};
  mutable std::mutex mutex_;  ///< Of the next two.
  std::vector<RecordedScene> scenes_;
  std::string trouble_;
  std::vector<RecordedTick> rows_;
  std::thread thread_;
};

}  // namespace palpate
