/// Makes a stub's loop wait for the test before each cycle, so that tests do not depend on the
/// machine's speed.
#pragma once

#include <condition_variable>
#include <mutex>

class Gate {
 public:
  /// Called by the loop at the start of each cycle.
  void arrive() {
    std::unique_lock lock(mutex_);
    ++waiting_;
    changed_.notify_all();
    changed_.wait(lock, [this] { return !held_ || turns_ > 0; });
    if (held_) --turns_;
    --waiting_;
  }

  /// Makes the loop wait at its next cycle. Returns when the loop waits.
  void hold() {
    std::unique_lock lock(mutex_);
    held_ = true;
    turns_ = 0;
    changed_.wait(lock, [this] { return waiting_ > 0; });
  }

  /// Runs `count` whole cycles of the loop.
  void turn(int count = 1) {
    std::unique_lock lock(mutex_);
    for (int i = 0; i < count; ++i) {
      ++turns_;
      changed_.notify_all();
      changed_.wait(lock, [this] { return turns_ == 0 && waiting_ > 0; });
    }
  }

  /// Lets the loop run freely.
  void release() {
    const std::lock_guard lock(mutex_);
    held_ = false;
    changed_.notify_all();
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  bool held_ = false;
  int waiting_ = 0;
  int turns_ = 0;
};
