/// The keyboard while a hand is on the arm.
#pragma once

#include <atomic>
#include <termios.h>
#include <thread>
#include <vector>

#include "palpate/engine/haptic_thread.h"

namespace palpate::cli {

/// Keys of a terminal while a hand is on the arm: Esc cuts the force, Enter lets it out again. On a
/// thread of their own, which waits for nothing else: a program that cannot print is still obeyed.
/// The terminal is left alone while it is another program's.
class Keys {
 public:
  explicit Keys(const std::vector<HapticThread*>& hands);
  ~Keys();
  Keys(const Keys&) = delete;
  Keys& operator=(const Keys&) = delete;

 private:
  void run();
  void look();

  std::vector<HapticThread*> hands_;
  termios usual_{};
  bool shown_;
  bool raw_ = false;  ///< It gives every key at once.
  std::atomic<bool> quit_{false};
  std::thread thread_;
};

}  // namespace palpate::cli
