/// A simulated arm in a shared memory file. Through the file, the test sees the motors of a plug-in
/// that runs in another process.
#pragma once

#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <fcntl.h>
#include <new>
#include <sys/mman.h>
#include <unistd.h>

namespace palpate::test {

/// State of motors and sensors. A new file contains zeros, which are a valid state.
struct OddArm {
  /// Environment variable with the file's name.
  static constexpr const char* kFile = "PALPATE_ODD_ARM";
  std::atomic<double> position[3];     ///< Position [m]; the test sets it.
  std::atomic<double> force[3];        ///< Force of the motors [N].
  std::atomic<double> carried;         ///< Carried share of the weight.
  std::atomic<double> most;            ///< Largest sum of |x|, |y| and |z| of the force so far [N].
  std::atomic<std::int64_t> wrote_at;  ///< Time of the last write of a force [ns].
  std::atomic<std::int64_t> trouble_at;  ///< Time at which the trouble began [ns].
  std::atomic<std::int64_t> zero_at;     ///< Time of the first zero force after `trouble_at` [ns].
  std::atomic<std::uint32_t> reads, writes, stops, opens, closes;
  std::atomic<std::uint32_t> trouble;  ///< Set by the test to start the trouble.

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

  /// Maps the arm in a file. Returns null if the file cannot be opened, resized or mapped.
  static OddArm* at(const char* file) noexcept {
    const int descriptor = open(file, O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    if (descriptor < 0 || ftruncate(descriptor, sizeof(OddArm)) != 0) return nullptr;
    void* memory = mmap(nullptr, sizeof(OddArm), PROT_READ | PROT_WRITE, MAP_SHARED, descriptor, 0);
    close(descriptor);
    return memory == MAP_FAILED ? nullptr : static_cast<OddArm*>(memory);
  }
};

}  // namespace palpate::test
