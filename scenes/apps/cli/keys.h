/// Reads keys from the terminal during a run.
#pragma once

#include <atomic>
#include <termios.h>
#include <thread>
#include <vector>

#include "palpate/engine/loop/haptic_thread.h"
#include "palpate/engine/loop/play_clock.h"

namespace palpate::cli {

/// Reads keys from the terminal during a run: Esc cuts the force, Enter restores it. If a sequence
/// is played, these keys control it: space, 0 , . - + r. A separate thread reads the keys, so that
/// they also work while the main thread is blocked by output. While another program is in the
/// foreground, the terminal is left unchanged.
class Keys {
 public:
  /// @param frame  Length of a step of the playback [s]. If it is above 0, keys control `clock`.
  Keys(const std::vector<HapticThread*>& hands, PlayClock& clock, double frame);
  ~Keys();
  /// Sets the length of a playback step [s] for a new scene.
  void step(double frame) { frame_ = frame; }
  Keys(const Keys&) = delete;
  Keys& operator=(const Keys&) = delete;

 private:
  void run();
  void look();
  void steer(char key);

  std::vector<HapticThread*> hands_;
  PlayClock& clock_;
  std::atomic<double> frame_;
  termios usual_{};
  bool shown_;
  bool raw_ = false;  ///< The terminal delivers each key at once, not line by line.
  std::atomic<bool> quit_{false};
  std::thread thread_;
};

}  // namespace palpate::cli
