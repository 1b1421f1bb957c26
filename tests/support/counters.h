/// Counts operations that a tick must not do, on this thread. Tests prove their absence by
/// counting.
#pragma once

#include <cstddef>

namespace palpate::test {

/// Events since the construction of the scope.
struct Counts {
  long allocations = 0;  ///< malloc and related functions, and so operator new.
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

/// While this object lives, the n-th allocation of kLarge bytes or more, counted over all threads
/// from its construction, fails once, as if memory were exhausted. Smaller allocations succeed: a
/// program gets them from memory that it already has. One at a time. Does not work under a
/// sanitizer, which owns the allocator.
class FailScope {
 public:
  static constexpr std::size_t kLarge = 512;  ///< [bytes]
  explicit FailScope(long n);
  ~FailScope();
  FailScope(const FailScope&) = delete;
  FailScope& operator=(const FailScope&) = delete;
  /// Returns false under a sanitizer.
  [[nodiscard]] static bool works();
  /// Returns the number of allocations of kLarge bytes or more so far.
  [[nodiscard]] static long seen();
};

}  // namespace palpate::test
