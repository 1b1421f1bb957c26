/// Counts operations of this thread that a tick must not do. If all counts are zero, the tick did
/// none of these operations.
#pragma once

#include <cstddef>

namespace palpate::test {

/// Events since the construction of the scope.
struct Counts {
  long allocations = 0;  ///< Calls of malloc and related functions, and so of operator new.
  /// Pthread mutexes and read-write locks that were taken (not counted under a sanitizer).
  long locks = 0;
  long exceptions = 0;  ///< throw expressions.
};

/// Starts to count on this thread. Only one object at a time.
class CountScope {
 public:
  CountScope();
  ~CountScope();
  CountScope(const CountScope&) = delete;
  CountScope& operator=(const CountScope&) = delete;
  [[nodiscard]] static Counts counts();
};

/// While this object lives, the n-th allocation of kLarge bytes or more fails once, as if memory
/// were exhausted. Counts all threads from the construction on. Smaller allocations succeed,
/// because a program usually gets them from memory that it already has. Only one object at a time.
/// Does not work under a sanitizer, which owns the allocator.
class FailScope {
 public:
  static constexpr std::size_t kLarge = 512;  ///< [bytes]
  explicit FailScope(long n);
  ~FailScope();
  FailScope(const FailScope&) = delete;
  FailScope& operator=(const FailScope&) = delete;
  /// Returns true if this build supports a FailScope; false under a sanitizer.
  [[nodiscard]] static bool works();
  /// Returns the number of allocations of kLarge bytes or more so far.
  [[nodiscard]] static long seen();
};

}  // namespace palpate::test
