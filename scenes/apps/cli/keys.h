/// Keyboard control during a run.
#pragma once

#include <atomic>
#include <termios.h>
#include <thread>
#include <vector>

#include "palpate/engine/loop/haptic_thread.h"
#include "palpate/engine/loop/play_clock.h"

namespace palpate::cli {

/// Terminal keys during a run: Esc cuts the force, Enter restores it. If a sequence is played, its
/// keys are: space, 0 , . - + r. A separate thread reads the keys, so that they also work while the
/// program waits to print. The terminal is left alone while another program uses it.
class Keys {
 public:
  /// `clock`: controlled by keys if `frame`, the length of a step [s], is above 0.
  Keys(const std::vector<HapticThread*>& hands, PlayClock& clock, double frame);
  ~Keys();
  /// Sets the length of a step for another scene.
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
  bool raw_ = false;  ///< The terminal delivers each key at once.
  std::atomic<bool> quit_{false};
  std::thread thread_;
};

}  // namespace palpate::cli
