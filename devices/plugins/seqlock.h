/// Private to devices: passes the newest value from one writer to another process. One of the two
/// processes may be untrusted.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <type_traits>

namespace palpate {

/// A value in memory that two processes share. If the writer dies during a write, readers reject
/// the value. For any content of this memory, a reader takes bounded time and reads only this
/// object. Mailbox does not guarantee this, because it reads a slot's index from the shared memory.
template <class T>
class Seqlock {
  static_assert(std::is_trivially_copyable_v<T> && sizeof(T) % 8 == 0);

 public:
  /// Stores a value. Call it on one thread only. RT: wait-free.
  void store(const T& value) noexcept {
    Words words;
    std::memcpy(words.data(), &value, sizeof(T));
    const std::uint32_t begun = count_.load(std::memory_order_relaxed) | 1U;
    count_.store(begun, std::memory_order_relaxed);
    // Release: a reader that sees a new word also sees the odd count.
    for (std::size_t i = 0; i < kWords; ++i) {
      words_[i].store(words[i], std::memory_order_release);
    }
    count_.store(begun + 1U, std::memory_order_release);
  }
  /// Returns false, and leaves `to` unchanged, if a write was in progress at each of a few
  /// attempts. Callable from any thread. RT: bounded time.
  [[nodiscard]] bool load(T& to) const noexcept {
    constexpr int kTries = 8;
    for (int i = 0; i < kTries; ++i) {
      const std::uint32_t before = count_.load(std::memory_order_acquire);
      if ((before & 1U) != 0) continue;
      Words words;
      // Acquire: the count is read again after all words.
      for (std::size_t k = 0; k < kWords; ++k) {
        words[k] = words_[k].load(std::memory_order_acquire);
      }
      if (count_.load(std::memory_order_relaxed) != before) continue;
      std::memcpy(static_cast<void*>(&to), words.data(), sizeof(T));
      return true;
    }
    return false;
  }

 private:
  static constexpr std::size_t kWords = sizeof(T) / 8;
  using Words = std::array<std::uint64_t, kWords>;
  static_assert(std::atomic<std::uint64_t>::is_always_lock_free);

  std::atomic<std::uint32_t> count_{0};  ///< Odd during a write.
  std::array<std::atomic<std::uint64_t>, kWords> words_{};
};

}  // namespace palpate
