/// Private to samplers and scenes: loops over volumes, in parallel.
#pragma once

#include <atomic>
#include <cstddef>
#include <exception>

#include <tbb/parallel_for.h>

namespace palpate {

/// body(0) to body(count - 1), in any order and by several threads. When one throws, those that
/// have begun end as if nothing had happened, the others are left out, and it is thrown on.
///
/// Not so tbb::parallel_for: there, loops within the other bodies stop half done as well, and say
/// nothing. OpenVDB frees its trees in such loops, which then leak, and a spline would be filtered
/// in parts.
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
