/// Runs fewer combinations under sanitizers.
#pragma once

namespace palpate::test {

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
inline constexpr bool kSanitized = true;
#else
inline constexpr bool kSanitized = false;
#endif

/// Selects the combinations that a test runs: all, or with sanitizers the first of every `every`,
/// because sanitizers slow each combination down.
class Thinned {
 public:
  explicit Thinned(int every) : every_(kSanitized ? every : 1) {}
  /// Returns true if this combination must run. Call it once per combination.
  bool runs() { return number_++ % every_ == 0; }

 private:
  int every_;
  int number_ = 0;
};

}  // namespace palpate::test
