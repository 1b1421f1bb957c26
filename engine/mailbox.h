/// The newest value from one thread to another; neither ever waits.
///
/// Three slots and one atomic word that says which lies between the two threads and whether it is
/// fresh. The writer fills the slot that is its own and exchanges it for the one between; the
/// reader exchanges its own for the one between where that is fresh. So no slot is ever with both,
/// what was published last is what is read next, and what was missed is gone. The protocol is model
/// checked: tests/loop/mailbox.pml.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>

namespace palpate {

/// One writing thread and one reading thread; with more readers, a mailbox each. A T lives as long
/// as the mailbox and is assigned to by the writer only: whatever a value owned is freed by the
/// writer, when it fills that slot again.
template <class T>
class Mailbox {
 public:
  Mailbox() = default;
  Mailbox(const Mailbox&) = delete;
  Mailbox& operator=(const Mailbox&) = delete;

  /// The writer's own slot: holds a value of long ago. RT: no allocation, wait-free.
  [[nodiscard]] T& draft() noexcept { return slots_[draft_].value; }
  /// Hands the draft over; the writer has another one then. RT: one atomic exchange, wait-free.
  void publish() noexcept {
    draft_ = between_.exchange(draft_ | kFresh, std::memory_order_acq_rel) & kSlot;
  }

  /// Takes what was published since; false, and nothing changes, where nothing was.
  /// RT: at most one atomic exchange, wait-free.
  bool refresh() noexcept {
    if ((between_.load(std::memory_order_relaxed) & kFresh) == 0) return false;
    current_ = between_.exchange(current_, std::memory_order_acq_rel) & kSlot;
    return true;
  }
  /// The reader's own slot: stays as it is until the next refresh. RT: no allocation, wait-free.
  [[nodiscard]] const T& current() const noexcept { return slots_[current_].value; }

 private:
  static constexpr std::uint8_t kSlot = 3;
  static constexpr std::uint8_t kFresh = 4;
  static_assert(std::atomic<std::uint8_t>::is_always_lock_free);

  // Apart by cache lines: what one thread writes is not beside what the other does.
  static constexpr std::size_t kLine = 64;
  struct alignas(kLine) Slot {
    T value{};
  };
  std::array<Slot, 3> slots_;
  alignas(kLine) std::uint8_t draft_ = 0;                ///< The writer's.
  alignas(kLine) std::uint8_t current_ = 1;              ///< The reader's.
  alignas(kLine) std::atomic<std::uint8_t> between_{2};  ///< Slot, and whether it is fresh.
};

}  // namespace palpate
