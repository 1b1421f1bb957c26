/// Reduces combinations under sanitizers.
#pragma once

namespace palpate::test {

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
inline constexpr bool kSanitized = true;
#else
inline constexpr bool kSanitized = false;
#endif

/// Selects the combinations that a test runs: all, or with sanitizers the first and each `every`-th
/// after it. Sanitizers look for faults that no combination may have, and make each ten times as
/// slow.
class Thinned {
 public:
  explicit Thinned(int every) : every_(kSanitized ? every : 1) {}
  /// Call once for each combination.
  bool runs() { return number_++ % every_ == 0; }

 private:
  int every_;
  int number_ = 0;
};

}  // namespace palpate::test
