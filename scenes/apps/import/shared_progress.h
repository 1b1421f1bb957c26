/// Progress of a task that several threads work on.
#pragma once

#include <atomic>
#include <mutex>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Reports the progress from one thread at a time. If another thread is reporting, a thread
/// continues without waiting.
class SharedProgress {
 public:
  SharedProgress(const Progress& progress, int steps) : progress_(progress), steps_(steps) {}

  /// Counts one step as done, and reports the progress.
  void step() { tell(static_cast<double>(++done_) / steps_); }
  void tell(double done) {
    if (!progress_ || !telling_.try_lock()) return;
    progress_(done);
    telling_.unlock();
  }

 private:
  const Progress& progress_;
  int steps_;
  std::atomic<int> done_{0};
  std::mutex telling_;
};

}  // namespace palpate::importer
