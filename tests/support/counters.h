/// Counts operations of this thread that a tick must not do.
#pragma once

#include <cstddef>

namespace palpate::test {

/// Counts since the CountScope was constructed.
struct Counts {
  long allocations = 0;  ///< Calls of malloc, calloc, realloc and aligned_alloc, including those
                         ///< by operator new.
  /// Calls that lock or try to lock a pthread mutex, or that lock a pthread read-write lock (not
  /// counted under a sanitizer).
  long locks = 0;
  long exceptions = 0;  ///< Exceptions thrown, without rethrows.
};

/// Counts operations of this thread while this object lives. Only one scope may exist at a time.
class CountScope {
 public:
  CountScope();
  ~CountScope();
  CountScope(const CountScope&) = delete;
  CountScope& operator=(const CountScope&) = delete;
  [[nodiscard]] static Counts counts();
};

/// While this object lives, the n-th allocation of kLarge bytes or more, counted over all threads,
/// fails once. Smaller allocations succeed, because a program usually has memory for them. Only one
/// scope may exist at a time. Does not work under a sanitizer, which provides malloc.
class FailScope {
 public:
  static constexpr std::size_t kLarge = 512;  ///< [bytes]
  explicit FailScope(long n);
  ~FailScope();
  FailScope(const FailScope&) = delete;
  FailScope& operator=(const FailScope&) = delete;
  /// Returns true if allocations can fail: not under a sanitizer.
  [[nodiscard]] static bool works();
  /// Returns the number of allocations of kLarge bytes or more since the scope was constructed.
  [[nodiscard]] static long seen();
};

}  // namespace palpate::test
