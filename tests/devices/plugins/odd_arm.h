/// An arm that is a file: what a plug-in in another process does to its motors, a test sees.
#pragma once

#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <fcntl.h>
#include <new>
#include <sys/mman.h>
#include <unistd.h>

namespace palpate::test {

/// What its motors and sensors have. All zeros at first, as a new file is.
struct OddArm {
  static constexpr const char* kFile = "PALPATE_ODD_ARM";  ///< Variable with the file's name.
  std::atomic<double> position[3];                         ///< Set by the test [m].
  std::atomic<double> force[3];                            ///< What the motors give [N].
  std::atomic<double> carried;                             ///< The share of its weight.
  std::atomic<double> most;              ///< The largest force that there has been [N].
  std::atomic<std::int64_t> wrote_at;    ///< [ns]
  std::atomic<std::int64_t> trouble_at;  ///< When the trouble began [ns].
  std::atomic<std::int64_t> zero_at;     ///< When the force was off first after that [ns].
  std::atomic<std::uint32_t> reads, writes, stops, opens, closes;
  std::atomic<std::uint32_t> trouble;  ///< Set by the test: now.

  void give(double x, double y, double z, std::int64_t now) noexcept {
    force[0] = x;
    force[1] = y;
    force[2] = z;
    const double norm = std::abs(x) + std::abs(y) + std::abs(z);
    if (norm > most) most = norm;
    wrote_at = now;
    std::int64_t none = 0;
    if (trouble_at != 0 && norm == 0.0) zero_at.compare_exchange_strong(none, now);
  }
  [[nodiscard]] double norm() const noexcept {
    return std::abs(force[0]) + std::abs(force[1]) + std::abs(force[2]);
  }

  /// The file's; null where it cannot be.
  static OddArm* at(const char* file) noexcept {
    const int descriptor = open(file, O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    if (descriptor < 0 || ftruncate(descriptor, sizeof(OddArm)) != 0) return nullptr;
    void* memory = mmap(nullptr, sizeof(OddArm), PROT_READ | PROT_WRITE, MAP_SHARED, descriptor, 0);
    close(descriptor);
    return memory == MAP_FAILED ? nullptr : static_cast<OddArm*>(memory);
  }
};

}  // namespace palpate::test
