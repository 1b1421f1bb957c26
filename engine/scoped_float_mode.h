/// Floating-point mode of ticks, independent of the mode that the host application has set. The
/// application may flush denormals to zero, round upwards or trap at a NaN. This changes no bit of
/// a tick's results, and the tick does not trap.
#pragma once

#if defined(__x86_64__)
#include <xmmintrin.h>
#else
#include <cfenv>
#endif

namespace palpate {

/// Sets the floating-point mode of this thread to the default of IEEE 754 while the object lives:
/// rounding to nearest, with denormals, without traps. The destructor restores the previous mode.
/// RT: no allocation. Cost: some 2 ns.
class ScopedFloatMode {
 public:
  ScopedFloatMode(const ScopedFloatMode&) = delete;
  ScopedFloatMode& operator=(const ScopedFloatMode&) = delete;

#if defined(__x86_64__)
  ScopedFloatMode() noexcept : before_(_mm_getcsr()) {
    if (differs()) _mm_setcsr(kPlain);
  }
  ~ScopedFloatMode() {
    if (differs()) _mm_setcsr(before_);
  }

 private:
  static constexpr unsigned kPlain = 0x1F80;  // value of MXCSR after a reset
  // its lowest bits, which record exceptions that have occurred
  static constexpr unsigned kSticky = 0x3F;
  [[nodiscard]] bool differs() const noexcept {
    return (before_ & ~kSticky) != kPlain;
  }
  unsigned before_;
#else
  ScopedFloatMode() noexcept {
    std::fegetenv(&before_);
    std::fesetenv(FE_DFL_ENV);
  }
  ~ScopedFloatMode() {
    std::fesetenv(&before_);
  }

 private:
  std::fenv_t before_{};
#endif
};

}  // namespace palpate
