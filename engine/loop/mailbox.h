/// Passes the newest value from one thread to another. Neither thread ever waits.
///
/// There are three slots: one belongs to the writer, one to the reader, and one is in the middle.
/// One atomic word contains the index of the middle slot, and a flag that the slot is fresh. The
/// writer fills its slot and exchanges it with the middle slot. If the middle slot is fresh, the
/// reader exchanges its own slot with the middle slot. No slot ever belongs to both threads.
/// Earlier values that the reader did not read are lost. The protocol is model checked:
/// tests/loop/mailbox.pml.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>

namespace palpate {

/// A mailbox for one writing thread and one reading thread. The three values of type T live as long
/// as the mailbox. Only the writer assigns to them, and so frees the resources of old values.
template <class T>
class Mailbox {
 public:
  Mailbox() = default;
  Mailbox(const Mailbox&) = delete;
  Mailbox& operator=(const Mailbox&) = delete;

  /// Returns the writer's slot, which contains an old value. RT: no allocation, wait-free.
  [[nodiscard]] T& draft() noexcept { return slots_[draft_].value; }
  /// Publishes the draft. The writer then has another slot. RT: one atomic exchange, wait-free.
  void publish() noexcept {
    draft_ = between_.exchange(draft_ | kFresh, std::memory_order_acq_rel) & kSlot;
  }

  /// Makes the slot with the newest published value the reader's slot. If no value was published
  /// since the last refresh, returns false and changes no slot. RT: at most one atomic exchange,
  /// wait-free.
  bool refresh() noexcept {
    if ((between_.load(std::memory_order_relaxed) & kFresh) == 0) return false;
    current_ = between_.exchange(current_, std::memory_order_acq_rel) & kSlot;
    return true;
  }
  /// Returns the reader's slot; refresh() changes it. RT: no allocation, wait-free.
  [[nodiscard]] const T& current() const noexcept { return slots_[current_].value; }

 private:
  static constexpr std::uint8_t kSlot = 3;
  static constexpr std::uint8_t kFresh = 4;
  static_assert(std::atomic<std::uint8_t>::is_always_lock_free);

  // Each slot has its own cache lines, so that no thread writes next to the other thread's data.
  static constexpr std::size_t kLine = 64;
  struct alignas(kLine) Slot {
    T value{};
  };
  std::array<Slot, 3> slots_;
  alignas(kLine) std::uint8_t draft_ = 0;
  alignas(kLine) std::uint8_t current_ = 1;
  alignas(kLine) std::atomic<std::uint8_t> between_{2};  ///< Index of the middle slot, and kFresh.
};

}  // namespace palpate
