/// Floating-point mode of ticks. If a host application flushes denormals to zero, rounds upwards or
/// traps at a NaN, ticks still compute the same bits and do not trap.
#pragma once

#if defined(__x86_64__)
#include <xmmintrin.h>
#else
#include <cfenv>
#endif

namespace palpate {

/// Sets this thread's floating-point mode to the default of IEEE 754 while the object lives:
/// rounding to nearest, with denormals, without traps. RT: no allocation.
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
  // bits of MXCSR that record exceptions
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
