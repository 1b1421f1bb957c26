#pragma once

#include <atomic>
#include <mutex>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Reports the total progress of several threads. If a thread is reporting, the reports of other
/// threads are dropped, so that they do not wait.
class SharedProgress {
 public:
  SharedProgress(const Progress& progress, int steps) : progress_(progress), steps_(steps) {}

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
