/// Private to the importer: imports an image as slabs, of which only one is in memory.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <exception>
#include <functional>
#include <span>
#include <type_traits>
#include <utility>
#include <vector>

#include "palpate/samplers/process_group.h"

namespace palpate::importer {

/// The processes of an import. A single process may divide an image into slabs. Each slab is then a
/// rank, and the process works on one rank after the other.
///
/// In a divided group, a rank cannot wait in gather() for the ranks after it. So gather() stores
/// the rank's bytes, and ends its work by an exception. When all ranks have done so, the work
/// begins again, and this call of gather() returns the bytes of all ranks. So the work runs once
/// more for each call of gather(). The work must be the same each time, and have no effect except
/// its result.
class SlabGroup final : public ProcessGroup {
 public:
  /// Default of `most_points`. As doubles, so many points need 256 MiB.
  static constexpr double kMostPoints = 1U << 25U;

  /// @param processes    Must outlive this object. Only a group of one process can be divided.
  /// @param most_points  Largest number of points in a slab that has several layers of bricks,
  ///                     unless slices are decoded together (divide()).
  explicit SlabGroup(ProcessGroup& processes, double most_points = kMostPoints)
      : processes_(processes), most_points_(most_points) {}

  [[nodiscard]] ProcessGroup& processes() const noexcept { return processes_; }
  [[nodiscard]] bool isDivided() const noexcept { return slabs_ > 1; }

  [[nodiscard]] int rank() const noexcept override {
    return isDivided() ? slab_ : processes_.rank();
  }
  [[nodiscard]] int size() const noexcept override {
    return isDivided() ? slabs_ : processes_.size();
  }
  [[nodiscard]] std::vector<Bytes> gather(std::span<const std::byte> own) override;
  [[nodiscard]] bool giveUp() noexcept override { return processes_.giveUp(); }

  /// Returns true if the next call of gather() ignores its argument, so that the caller need not
  /// compute it.
  [[nodiscard]] bool isKnown() const noexcept { return isDivided() && next_ < known_.size(); }

  /// Returns of(list), where `list` joins the lists of all ranks in order. A divided group computes
  /// it once, and stores only the result.
  template <class T, class Item>
  [[nodiscard]] T reduced(const std::vector<Item>& own, T (*of)(std::vector<Item> list)) {
    static_assert(std::is_trivially_copyable_v<T> && std::is_trivially_copyable_v<Item>);
    if (!isDivided()) return of(gatherAll(processes_, own));
    reduce_ = [of](const std::vector<Bytes>& lists) {
      std::vector<Item> all;
      for (const Bytes& list : lists) {
        const std::size_t before = all.size();
        all.resize(before + list.size() / sizeof(Item));
        if (!list.empty()) std::memcpy(&all[before], list.data(), list.size());
      }
      const T result = of(std::move(all));
      const auto bytes = std::as_bytes(std::span(&result, 1));
      return Bytes(bytes.begin(), bytes.end());
    };
    const std::vector<Bytes> result = gather(std::as_bytes(std::span(own)));
    reduce_ = nullptr;
    T out{};
    std::memcpy(&out, result.front().data(), sizeof(T));
    return out;
  }

  /// Divides the group into slabs of layers of bricks, if the image is larger than a slab. Does
  /// nothing in a group of several processes, and after the first call in a run.
  /// @param size     Number of the image's points along each axis.
  /// @param is_slow  True if a pass is slow. Then an image of up to four slabs is not divided.
  /// @param depth    Number of slices that the reader decodes together. Slabs are up to four times
  ///                 as large, so that a pass decodes a slice at most twice on average.
  void divide(const std::array<int, 3>& size, bool is_slow = false, int depth = 1) noexcept;

  /// Undivides the group and runs `work`, which may divide it. Returns the result of rank 0.
  /// @param turn  Called before each rank's turn while the group is divided, with the number of the
  ///              pass, from 0.
  template <class Work>
  [[nodiscard]] auto run(Work work, const std::function<void(int pass)>& turn) -> decltype(work()) {
    slabs_ = 0;
    known_.clear();
    for (int pass = 0;; ++pass) {
      pending_.clear();
      for (slab_ = 0; slab_ == 0 || slab_ < slabs_; ++slab_) {
        next_ = 0;
        if (isDivided()) turn(pass);
        try {
          return work();
        } catch (const Postponed&) {
          continue;
        }
      }
      if (reduce_) pending_ = {std::exchange(reduce_, nullptr)(pending_)};
      known_.push_back(std::move(pending_));
    }
  }

  /// Runs the same work again, in a group that it has divided. Returns the result of rank `slab`.
  template <class Work>
  [[nodiscard]] auto runAgain(int slab, Work work) -> decltype(work()) {
    slab_ = slab;
    next_ = 0;
    return work();
  }

  /// Returns the parts of `count` items that belong to the ranks which this process works on.
  [[nodiscard]] std::vector<Share> sharesOf(std::int64_t count);

 private:
  /// Ends the work of a rank that needs bytes of ranks after it.
  class Postponed : public std::exception {};

  ProcessGroup& processes_;
  double most_points_;
  int slabs_ = 0;  ///< Number of slabs; 0: divide() has not set it.
  int slab_ = 0;
  std::vector<std::vector<Bytes>> known_;  ///< Results of gather(), in order.
  std::vector<Bytes> pending_;  ///< Bytes of each rank for the result after the known ones.
  std::size_t next_ = 0;        ///< Index of the next result.
  /// Function that replaces the pending bytes by one result; empty: they stay.
  std::function<Bytes(const std::vector<Bytes>&)> reduce_;
};

}  // namespace palpate::importer
