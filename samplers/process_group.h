/// Processes that work on one task, possibly on several machines. Each has a number, its rank.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <exception>
#include <span>
#include <type_traits>
#include <vector>

namespace palpate {

/// Thrown when another rank has failed. Do not report it: the failed rank reports the error.
class GroupEnded : public std::exception {
 public:
  /// Returns a fixed text that is not meant for users.
  [[nodiscard]] const char* what() const noexcept override { return "another rank has failed"; }
};

/// A process group. All ranks must run the same steps and call gather() the same number of times.
/// They communicate only in gather(). workTogether() prevents a failed rank from blocking the
/// others.
class ProcessGroup {
 public:
  /// The data that one rank contributes.
  using Bytes = std::vector<std::byte>;

  ProcessGroup() = default;
  ProcessGroup(const ProcessGroup&) = delete;
  ProcessGroup& operator=(const ProcessGroup&) = delete;
  virtual ~ProcessGroup() = default;

  [[nodiscard]] virtual int rank() const noexcept = 0;  ///< Rank of this process, from 0.
  [[nodiscard]] virtual int size() const noexcept = 0;  ///< Number of ranks.

  /// Returns the bytes of all ranks, in order of rank. Waits for all ranks. Throws GroupEnded if
  /// another rank has failed, and Error if the connection between the ranks is lost.
  [[nodiscard]] virtual std::vector<Bytes> gather(std::span<const std::byte> own) = 0;

  /// Reports to all ranks that this rank has failed, in place of its next gather(). Waits for them.
  /// @return  True if this rank must report its error: on the lowest failed rank, and on each rank
  ///          that has lost the connection.
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

/// Gathers a value from each rank, in the order of ranks. All machines must have the
/// same byte order and data layout.
template <class T>
[[nodiscard]] std::vector<T> gatherOne(ProcessGroup& group, const T& own) {
  static_assert(std::is_trivially_copyable_v<T>);
  std::vector<T> all;
  for (const ProcessGroup::Bytes& bytes : group.gather(std::as_bytes(std::span(&own, 1)))) {
    std::memcpy(&all.emplace_back(), bytes.data(), sizeof(T));
  }
  return all;
}

/// Gathers a list from each rank and joins the lists in the order of ranks. All machines must have
/// the same byte order and data layout.
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

/// A contiguous part of a list, given by its indices.
struct Share {
  std::int64_t first = 0;  ///< First index.
  std::int64_t end = 0;    ///< The last index plus 1.

  /// Returns true if index n is in this part.
  [[nodiscard]] bool has(std::int64_t n) const noexcept { return n >= first && n < end; }
};

/// Returns the part of `count` items that belongs to this rank. The parts of all ranks, in the
/// order of ranks, form the whole list. Their sizes differ by at most one.
[[nodiscard]] inline Share shareOf(const ProcessGroup& group, std::int64_t count) noexcept {
  return {count * group.rank() / group.size(), count * (group.rank() + 1) / group.size()};
}

/// Runs `work`. Every rank must call this function. If `work` throws on one rank, the other ranks
/// leave `work` at their next gather(). At the end, each rank waits for all others.
/// Throws the exception of `work` on each rank that must report it (giveUp()).
/// @return  The result of `work`; a value-initialised result if another rank reports an error.
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
