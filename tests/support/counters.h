/// Counts what a tick may not do, on this thread: proof by counting, not by reading.
#pragma once

#include <cstddef>

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

/// While it lives the n-th allocation of kLarge or more from its beginning, of any thread, fails
/// once, as where there is no memory: a smaller one is had from what a program has already. One at
/// a time; not under a sanitizer, which owns the allocator.
class FailScope {
 public:
  static constexpr std::size_t kLarge = 512;  ///< [bytes]
  explicit FailScope(long n);
  ~FailScope();
  FailScope(const FailScope&) = delete;
  FailScope& operator=(const FailScope&) = delete;
  /// False under a sanitizer.
  [[nodiscard]] static bool works();
  /// Such allocations so far.
  [[nodiscard]] static long seen();
};

}  // namespace palpate::test
