/// Reads keys from the terminal during a run.
#pragma once

#include <atomic>
#include <mutex>
#include <termios.h>
#include <thread>
#include <vector>

#include "palpate/engine/loop/haptic_thread.h"
#include "palpate/engine/loop/play_clock.h"
#include "palpate/samplers/time/frame_sequence.h"

namespace palpate::cli {

/// Esc cuts the force, Enter restores it; space 0 , . - + r control the playback. A separate thread
/// reads the keys, so that slow output cannot delay them. A background process does not use the
/// terminal.
class Keys {
 public:
  /// @param played  Times of the scene's sequences. If empty, the keys do not control `clock`.
  Keys(const std::vector<HapticThread*>& hands, PlayClock& clock, std::vector<FrameTimes> played);
  ~Keys();
  /// Sets the times of a new scene's sequences.
  void play(std::vector<FrameTimes> played);
  Keys(const Keys&) = delete;
  Keys& operator=(const Keys&) = delete;

 private:
  void run();
  void look();
  void steer(char key);
  void stepFrame(bool forward);

  std::vector<HapticThread*> hands_;
  PlayClock& clock_;
  std::mutex mutex_;  ///< Guards `played_`.
  std::vector<FrameTimes> played_;
  termios usual_{};
  bool shown_;
  bool raw_ = false;  ///< True while the terminal delivers each key at once instead of whole lines.
  std::atomic<bool> quit_{false};
  std::thread thread_;
};

}  // namespace palpate::cli
