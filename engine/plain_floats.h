/// The arithmetic that ticks are computed in, whatever a thread's host has set: an application that
/// flushes denormals to zero, rounds upwards or traps at a NaN changes no bit of a tick, and the
/// tick does not trap.
#pragma once

#if defined(__x86_64__)
#include <xmmintrin.h>
#else
#include <cfenv>
#endif

namespace palpate {

/// While it lives, floating-point arithmetic of this thread is IEEE 754's default: to the nearest,
/// with denormals, without traps. Afterwards it is as it was. RT: no allocation. Cost: some 2 ns.
class PlainFloats {
 public:
  PlainFloats(const PlainFloats&) = delete;
  PlainFloats& operator=(const PlainFloats&) = delete;

#if defined(__x86_64__)
  PlainFloats() noexcept : before_(_mm_getcsr()) {
    if (differs()) _mm_setcsr(kPlain);
  }
  ~PlainFloats() {
    if (differs()) _mm_setcsr(before_);
  }

 private:
  static constexpr unsigned kPlain = 0x1F80;  // MXCSR at reset,
  static constexpr unsigned kSticky = 0x3F;   // whose lowest bits tell what has happened
  [[nodiscard]] bool differs() const noexcept {
    return (before_ & ~kSticky) != kPlain;
  }
  unsigned before_;
#else
  PlainFloats() noexcept {
    std::fegetenv(&before_);
    std::fesetenv(FE_DFL_ENV);
  }
  ~PlainFloats() {
    std::fesetenv(&before_);
  }

 private:
  std::fenv_t before_{};
#endif
};

}  // namespace palpate
