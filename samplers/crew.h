/// Processes that share one work, perhaps on several machines.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <exception>
#include <span>
#include <type_traits>
#include <vector>

namespace palpate {

/// Another of the crew has given up, and tells why: who catches this has nothing to say.
class CrewEnded : public std::exception {
 public:
  /// For nobody.
  [[nodiscard]] const char* what() const noexcept override { return "another rank has given up"; }
};

/// All do the same steps and meet in gather(), as often as each other: it is the only thing that
/// they do together, so that one who fails is missed by nobody (workTogether).
class Crew {
 public:
  /// What one brings.
  using Bytes = std::vector<std::byte>;

  Crew() = default;
  Crew(const Crew&) = delete;
  Crew& operator=(const Crew&) = delete;
  virtual ~Crew() = default;

  [[nodiscard]] virtual int rank() const noexcept = 0;  ///< From 0 on.
  [[nodiscard]] virtual int size() const noexcept = 0;  ///< How many they are.

  /// Everybody's bytes, by their ranks. Waits for all. Throws CrewEnded where one gives up; Error
  /// where they have lost each other.
  [[nodiscard]] virtual std::vector<Bytes> gather(std::span<const std::byte> own) = 0;

  /// In place of the next gather(), by who has failed. Waits for all.
  /// @return  True for the first of those who do, by rank: the one who tells why.
  [[nodiscard]] virtual bool giveUp() noexcept = 0;
};

/// Who works alone.
class CrewOfOne final : public Crew {
 public:
  [[nodiscard]] int rank() const noexcept override { return 0; }
  [[nodiscard]] int size() const noexcept override { return 1; }
  [[nodiscard]] std::vector<Bytes> gather(std::span<const std::byte> own) override {
    return {Bytes(own.begin(), own.end())};
  }
  [[nodiscard]] bool giveUp() noexcept override { return true; }
};

/// One of a type that is its bytes from each, by rank. All machines have to be of one kind.
template <class T>
[[nodiscard]] std::vector<T> gatherOne(Crew& crew, const T& own) {
  static_assert(std::is_trivially_copyable_v<T>);
  std::vector<T> all;
  for (const Crew::Bytes& bytes : crew.gather(std::as_bytes(std::span(&own, 1)))) {
    std::memcpy(&all.emplace_back(), bytes.data(), sizeof(T));
  }
  return all;
}

/// Lists from each, one behind the other by rank.
template <class T>
[[nodiscard]] std::vector<T> gatherAll(Crew& crew, const std::vector<T>& own) {
  static_assert(std::is_trivially_copyable_v<T>);
  if (crew.size() == 1) return own;
  const std::vector<Crew::Bytes> lists = crew.gather(std::as_bytes(std::span(own)));
  std::size_t bytes = 0;
  for (const Crew::Bytes& list : lists) bytes += list.size();
  std::vector<T> all(bytes / sizeof(T));
  auto* to = reinterpret_cast<std::byte*>(all.data());
  for (const Crew::Bytes& list : lists) {
    if (!list.empty()) std::memcpy(to, list.data(), list.size());
    to += list.size();
  }
  return all;
}

/// Some of a row.
struct Share {
  std::int64_t first = 0;  ///< Where they begin,
  std::int64_t end = 0;    ///< and the one behind them.

  /// That one is among them.
  [[nodiscard]] bool has(std::int64_t n) const noexcept { return n >= first && n < end; }
};

/// A rank's part of `count`: those of all are the whole, in order, and differ by one at most.
[[nodiscard]] inline Share shareOf(const Crew& crew, std::int64_t count) noexcept {
  return {count * crew.rank() / crew.size(), count * (crew.rank() + 1) / crew.size()};
}

/// Does what all do. Whatever it throws here ends it for all: they meet once more at its end.
/// @return  What `work` does; T() where another has given up and tells why, or has told.
template <class Work>
[[nodiscard]] auto workTogether(Crew& crew, Work work) -> decltype(work()) {
  try {
    auto result = work();
    (void)crew.gather({});
    return result;
  } catch (const CrewEnded&) {
    return {};
  } catch (...) {
    if (crew.giveUp()) throw;
    return {};
  }
}

}  // namespace palpate
