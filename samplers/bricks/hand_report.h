/// Private to samplers: the last report of a hand to a window of bricks.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "palpate/engine/types.h"
#include "palpate/samplers/bricks/brick_window.h"

namespace palpate::detail {

/// The last report of a hand that required a new choice of requests, as a seqlock. The threads of
/// all hands that share the record write it. Any thread may read it.
struct HandReport {
  using Aim = BrickWindow::Aim;  ///< What a report states.

  std::atomic<std::uint32_t> count{0};  ///< Odd during a write; 0 before the first write.
  std::atomic<std::uint32_t> beats{0};  ///< Number of calls of BrickWindow::aim() for this record.
  std::array<std::atomic<double>, 9> numbers{};  ///< Proxy, probe and velocity of the report.

  /// Writes a report. Returns false, without a change, if another thread writes at the same time.
  /// RT: wait-free.
  [[nodiscard]] bool tryWrite(const Aim& at) noexcept {
    std::uint32_t before = count.load(std::memory_order_relaxed);
    // Acquires the numbers of the last writer, so that the stores below come after them.
    if ((before & 1U) != 0 ||
        !count.compare_exchange_strong(before, before + 1U, std::memory_order_acquire)) {
      return false;
    }
    for (std::size_t i = 0; i < 3; ++i) {
      const auto a = static_cast<Eigen::Index>(i);
      numbers[i].store(at.proxy[a], std::memory_order_release);
      numbers[3 + i].store(at.probe[a], std::memory_order_release);
      numbers[6 + i].store(at.velocity[a], std::memory_order_release);
    }
    count.store(before + 2U, std::memory_order_release);
    return true;
  }
  /// Returns the last report. Returns std::nullopt before the first report, and if another thread
  /// writes during the call. RT: wait-free.
  [[nodiscard]] std::optional<Aim> read() const noexcept {
    const std::uint32_t before = count.load(std::memory_order_acquire);
    if (before == 0 || (before & 1U) != 0) return std::nullopt;
    Aim out;
    for (std::size_t i = 0; i < 3; ++i) {
      const auto a = static_cast<Eigen::Index>(i);
      out.proxy[a] = numbers[i].load(std::memory_order_acquire);
      out.probe[a] = numbers[3 + i].load(std::memory_order_acquire);
      out.velocity[a] = numbers[6 + i].load(std::memory_order_acquire);
    }
    if (count.load(std::memory_order_relaxed) != before) return std::nullopt;
    return out;
  }
};

}  // namespace palpate::detail
