/// The keyboard while a hand is on the arm.
#pragma once

#include <atomic>
#include <termios.h>
#include <thread>
#include <vector>

#include "palpate/engine/haptic_thread.h"
#include "palpate/engine/play_clock.h"

namespace palpate::cli {

/// Keys of a terminal while a hand is on the arm: Esc cuts the force, Enter lets it out again;
/// those of play, where there is any: space, 0 , . - + r. On a thread of their own, which waits for
/// nothing else: a program that cannot print is still obeyed. The terminal is left alone while it
/// is another program's.
class Keys {
 public:
  /// `clock`: steered by keys if `frame`, the length of a step [s], is above 0.
  Keys(const std::vector<HapticThread*>& hands, PlayClock& clock, double frame);
  ~Keys();
  /// Another length of a step, for another scene.
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
  bool raw_ = false;  ///< It gives every key at once.
  std::atomic<bool> quit_{false};
  std::thread thread_;
};

}  // namespace palpate::cli
