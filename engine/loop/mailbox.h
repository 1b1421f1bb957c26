/// Passes the newest value from one thread to another; neither thread ever waits.
///
/// One atomic word says which of three slots lies between the two threads, and whether it is fresh.
/// The writer fills its own slot and exchanges it for the slot between. The reader exchanges its
/// own slot for the slot between if that is fresh. No slot is ever with both threads. The reader
/// gets the value that was published last; missed values are gone. The protocol is model checked:
/// tests/loop/mailbox.pml.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>

namespace palpate {

/// A mailbox from one writing thread to one reading thread; more readers need one each. A T lives
/// as long as the mailbox, and only the writer assigns to it. So the writer frees the resources of
/// an old value, when it fills that slot again.
template <class T>
class Mailbox {
 public:
  Mailbox() = default;
  Mailbox(const Mailbox&) = delete;
  Mailbox& operator=(const Mailbox&) = delete;

  /// Returns the writer's own slot, which holds an old value. RT: no allocation, wait-free.
  [[nodiscard]] T& draft() noexcept { return slots_[draft_].value; }
  /// Publishes the draft; the writer then has another slot. RT: one atomic exchange, wait-free.
  void publish() noexcept {
    draft_ = between_.exchange(draft_ | kFresh, std::memory_order_acq_rel) & kSlot;
  }

  /// Takes the value that was published since the last refresh. Without one, returns false and
  /// changes no slot. RT: at most one atomic exchange, wait-free.
  bool refresh() noexcept {
    if ((between_.load(std::memory_order_relaxed) & kFresh) == 0) return false;
    current_ = between_.exchange(current_, std::memory_order_acq_rel) & kSlot;
    return true;
  }
  /// Returns the reader's own slot, which stays unchanged until the next refresh. RT: no
  /// allocation, wait-free.
  [[nodiscard]] const T& current() const noexcept { return slots_[current_].value; }

 private:
  static constexpr std::uint8_t kSlot = 3;
  static constexpr std::uint8_t kFresh = 4;
  static_assert(std::atomic<std::uint8_t>::is_always_lock_free);

  // Each slot has cache lines of its own: no thread writes beside data that the other uses.
  static constexpr std::size_t kLine = 64;
  struct alignas(kLine) Slot {
    T value{};
  };
  std::array<Slot, 3> slots_;
  alignas(kLine) std::uint8_t draft_ = 0;                ///< The writer's slot.
  alignas(kLine) std::uint8_t current_ = 1;              ///< The reader's slot.
  alignas(kLine) std::atomic<std::uint8_t> between_{2};  ///< The slot between; whether it is fresh.
};

}  // namespace palpate
