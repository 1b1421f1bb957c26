/// Progress of work that several threads share.
#pragma once

#include <atomic>
#include <mutex>

#include "palpate/scenes/import/reader.h"

namespace palpate::importer {

/// Tells of it from one thread at a time; who comes while another tells goes on.
class SharedProgress {
 public:
  SharedProgress(const Progress& progress, int steps) : progress_(progress), steps_(steps) {}

  /// One of the steps is done.
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
