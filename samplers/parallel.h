/// Private to samplers and scenes: parallel loops over volumes.
#pragma once

#include <atomic>
#include <cstddef>
#include <exception>

#include <tbb/parallel_for.h>

namespace palpate {

/// Calls body(0) to body(count - 1) in any order, from several threads. If a call throws, waits for
/// the calls in progress, skips all other calls, and throws the first exception again.
///
/// After an exception, tbb::parallel_for alone would also cancel the loops that run inside other
/// bodies, without an error. Then OpenVDB would leak trees, and a spline filter would stay
/// unfinished.
template <class Body>
void inParallel(std::size_t count, Body body) {
  std::atomic<bool> failed{false};
  std::exception_ptr error;
  tbb::task_group_context apart(tbb::task_group_context::isolated);
  const auto guarded = [&](std::size_t i) {
    if (failed) return;
    try {
      body(i);
    } catch (...) {
      if (!failed.exchange(true)) error = std::current_exception();
    }
  };
  tbb::parallel_for(std::size_t{0}, count, guarded, tbb::auto_partitioner(), apart);
  if (error) std::rethrow_exception(error);
}

}  // namespace palpate
