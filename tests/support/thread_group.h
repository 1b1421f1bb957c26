/// Runs the ranks of a process group as threads.
#pragma once

#include <barrier>
#include <exception>
#include <functional>
#include <thread>
#include <vector>

#include "palpate/samplers/process_group.h"

namespace palpate::test {

/// State that the ranks share.
struct ThreadMeeting {
  explicit ThreadMeeting(int size)
      : brought(static_cast<std::size_t>(size)),
        gives_up(static_cast<std::size_t>(size)),
        barrier(size) {}

  std::vector<ProcessGroup::Bytes> brought;
  std::vector<char> gives_up;
  std::barrier<> barrier;
};

class ThreadGroup final : public ProcessGroup {
 public:
  ThreadGroup(ThreadMeeting& meeting, int rank) : meeting_(meeting), rank_(rank) {}

  [[nodiscard]] int rank() const noexcept override { return rank_; }
  [[nodiscard]] int size() const noexcept override {
    return static_cast<int>(meeting_.brought.size());
  }
  [[nodiscard]] std::vector<Bytes> gather(std::span<const std::byte> own) override {
    std::vector<Bytes> all;
    if (meet({own.begin(), own.end()}, false, &all) < size()) throw GroupEnded();
    return all;
  }
  [[nodiscard]] bool giveUp() noexcept override { return meet({}, true, nullptr) == rank_; }

 private:
  /// Waits for all ranks. Returns the lowest rank that gives up, or the number of ranks.
  int meet(Bytes own, bool gives_up, std::vector<Bytes>* all) {
    const auto mine = static_cast<std::size_t>(rank_);
    meeting_.brought[mine] = std::move(own);
    meeting_.gives_up[mine] = gives_up ? 1 : 0;
    meeting_.barrier.arrive_and_wait();
    int first = 0;
    while (first < size() && meeting_.gives_up[static_cast<std::size_t>(first)] == 0) ++first;
    if (all != nullptr) *all = meeting_.brought;
    meeting_.barrier.arrive_and_wait();
    return first;
  }

  ThreadMeeting& meeting_;
  int rank_;
};

/// Runs `work` on `size` ranks. If exactly one rank threw, rethrows its exception. Otherwise
/// returns the number of ranks that threw.
inline int byThreads(int size, const std::function<void(ProcessGroup&)>& work) {
  ThreadMeeting meeting(size);
  std::vector<std::exception_ptr> told(static_cast<std::size_t>(size));
  std::vector<std::thread> threads;
  for (int rank = 0; rank < size; ++rank) {
    threads.emplace_back([&, rank] {
      ThreadGroup group(meeting, rank);
      try {
        (void)workTogether(group, [&] {
          work(group);
          return 0;
        });
      } catch (...) {
        told[static_cast<std::size_t>(rank)] = std::current_exception();
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  int count = 0;
  for (const auto& one : told) count += one ? 1 : 0;
  for (const auto& one : told) {
    if (one && count == 1) std::rethrow_exception(one);
  }
  return count;
}

}  // namespace palpate::test
