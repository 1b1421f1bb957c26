/// Processes that share one task, possibly on several machines.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <exception>
#include <span>
#include <type_traits>
#include <vector>

namespace palpate {

/// Thrown when another rank has failed. That rank reports the error, so the catcher must not.
class GroupEnded : public std::exception {
 public:
  /// Returns a fixed text, which is not meant for users.
  [[nodiscard]] const char* what() const noexcept override { return "another rank has failed"; }
};

/// A process group. All ranks run the same steps and call gather() equally often. They communicate
/// only in gather(). workTogether keeps a rank that fails from blocking the others.
class ProcessGroup {
 public:
  /// The data that one rank contributes.
  using Bytes = std::vector<std::byte>;

  ProcessGroup() = default;
  ProcessGroup(const ProcessGroup&) = delete;
  ProcessGroup& operator=(const ProcessGroup&) = delete;
  virtual ~ProcessGroup() = default;

  [[nodiscard]] virtual int rank() const noexcept = 0;  ///< Counts from 0.
  [[nodiscard]] virtual int size() const noexcept = 0;  ///< Number of ranks.

  /// Returns the bytes of all ranks, in order of rank. Waits for all ranks. Throws GroupEnded if a
  /// rank fails, and Error if the ranks have lost contact.
  [[nodiscard]] virtual std::vector<Bytes> gather(std::span<const std::byte> own) = 0;

  /// Reports that this rank has failed; a rank calls it in place of the next gather(). Waits for
  /// all ranks.
  /// @return  True for the lowest rank that gives up: that rank reports the error.
  [[nodiscard]] virtual bool giveUp() noexcept = 0;
};

/// A group of one process.
class SingleProcess final : public ProcessGroup {
 public:
  [[nodiscard]] int rank() const noexcept override { return 0; }
  [[nodiscard]] int size() const noexcept override { return 1; }
  [[nodiscard]] std::vector<Bytes> gather(std::span<const std::byte> own) override {
    return {Bytes(own.begin(), own.end())};
  }
  [[nodiscard]] bool giveUp() noexcept override { return true; }
};

/// Gathers one trivially copyable value from each rank, in order of rank. All machines must be of
/// one kind.
template <class T>
[[nodiscard]] std::vector<T> gatherOne(ProcessGroup& group, const T& own) {
  static_assert(std::is_trivially_copyable_v<T>);
  std::vector<T> all;
  for (const ProcessGroup::Bytes& bytes : group.gather(std::as_bytes(std::span(&own, 1)))) {
    std::memcpy(&all.emplace_back(), bytes.data(), sizeof(T));
  }
  return all;
}

/// Gathers a list from each rank and joins the lists in order of rank.
template <class T>
[[nodiscard]] std::vector<T> gatherAll(ProcessGroup& group, const std::vector<T>& own) {
  static_assert(std::is_trivially_copyable_v<T>);
  if (group.size() == 1) return own;
  const std::vector<ProcessGroup::Bytes> lists = group.gather(std::as_bytes(std::span(own)));
  std::size_t bytes = 0;
  for (const ProcessGroup::Bytes& list : lists) bytes += list.size();
  std::vector<T> all(bytes / sizeof(T));
  auto* to = reinterpret_cast<std::byte*>(all.data());
  for (const ProcessGroup::Bytes& list : lists) {
    if (!list.empty()) std::memcpy(to, list.data(), list.size());
    to += list.size();
  }
  return all;
}

/// A contiguous part of a list, by index.
struct Share {
  std::int64_t first = 0;  ///< First index.
  std::int64_t end = 0;    ///< Index after the last one.

  /// Returns whether index n is in this part.
  [[nodiscard]] bool has(std::int64_t n) const noexcept { return n >= first && n < end; }
};

/// Returns the part of `count` items for this rank. The parts of all ranks make up the whole, in
/// order, and differ in size by one at most.
[[nodiscard]] inline Share shareOf(const ProcessGroup& group, std::int64_t count) noexcept {
  return {count * group.rank() / group.size(), count * (group.rank() + 1) / group.size()};
}

/// Runs `work`; every rank must call this function. If `work` throws in one rank, it ends for all
/// ranks. At the end all ranks meet once more.
/// @return  The result of `work`; T() if another rank gives up, or has given up, and reports the
/// error.
template <class Work>
[[nodiscard]] auto workTogether(ProcessGroup& group, Work work) -> decltype(work()) {
  try {
    auto result = work();
    (void)group.gather({});
    return result;
  } catch (const GroupEnded&) {
    return {};
  } catch (...) {
    if (group.giveUp()) throw;
    return {};
  }
}

}  // namespace palpate
