/// Progress of work that several threads share.
#pragma once

#include <atomic>
#include <mutex>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Reports progress from one thread at a time. A thread does not wait while another reports.
class SharedProgress {
 public:
  SharedProgress(const Progress& progress, int steps) : progress_(progress), steps_(steps) {}

  /// Counts one more step as done.
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
