/// Reduces combinations under sanitizers.
#pragma once

namespace palpate::test {

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
inline constexpr bool kSanitized = true;
#else
inline constexpr bool kSanitized = false;
#endif

/// Selects the combinations that a test runs: all of them, or with sanitizers the first and then
/// each `every`-th. Sanitizers make each combination ten times as slow, and the faults that they
/// detect do not depend on the combination.
class Thinned {
 public:
  explicit Thinned(int every) : every_(kSanitized ? every : 1) {}
  /// Returns true if the present combination is to be run. Call it once for each combination.
  bool runs() { return number_++ % every_ == 0; }

 private:
  int every_;
  int number_ = 0;
};

}  // namespace palpate::test
