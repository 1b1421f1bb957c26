/// Counts what a tick may not do, on this thread: proof by counting, not by reading.
#pragma once

namespace palpate::test {

/// What happened since it was made.
struct Counts {
  long allocations = 0;  ///< malloc and its kin, and so operator new.
  long locks = 0;        ///< pthread mutexes and read-write locks taken (not under a sanitizer).
  long exceptions = 0;   ///< throw expressions.
};

/// Starts counting on this thread; `counts()` reads. One at a time.
class CountScope {
 public:
  CountScope();
  ~CountScope();
  CountScope(const CountScope&) = delete;
  CountScope& operator=(const CountScope&) = delete;
  [[nodiscard]] static Counts counts();
};

}  // namespace palpate::test
