/// The remote hands that one loop's hand is linked to: a spring to each (link.h), and the exchange
/// between the loop and the thread that carries the messages.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "palpate/engine/loop/link.h"
#include "palpate/engine/loop/mailbox.h"
#include "palpate/engine/safety/device.h"
#include "palpate/engine/types.h"

namespace palpate {

inline constexpr std::size_t kMostLinks = 7;  ///< Most remote hands at once.

/// The newest word of each remote hand.
struct LinksHeard {
  /// Any number for a hand; 0: no hand. With another number a new link begins.
  std::array<std::uint64_t, kMostLinks> who{};
  std::array<LinkWord, kMostLinks> words{};  ///< Last word of each hand.
};

/// Data that a tick sends out.
struct LinksTold {
  Vec3 hand = Vec3::Zero();                     ///< [m]
  Vec3 proxy = Vec3::Zero();                    ///< [m]
  Vec3 force = Vec3::Zero();                    ///< Whole force on the hand [N].
  std::array<std::uint64_t, kMostLinks> who{};  ///< Recipient of each word: LinksHeard::who.
  std::array<LinkWord, kMostLinks> words{};     ///< One word for each remote hand.
  std::array<double, kMostLinks> presence{};    ///< Link::presence
  std::array<double, kMostLinks> paid{};        ///< Link::paid
  std::array<double, kMostLinks> energy{};      ///< Link::energy [J]
};

/// The links of one hand. Two threads use it, each with its own functions: the haptic thread and
/// the thread that carries the messages.
class HandLinks {
 public:
  /// @param life  See Link: greater than at any earlier start, such as nanoseconds since 1970.
  explicit HandLinks(std::uint64_t life, const LinkParams& params = {});

  // For the thread that carries the messages.
  /// Passes the heard words to the loop: all of them, each time.
  void hear(const LinksHeard& heard) noexcept;
  /// Returns the data of the newest tick; valid until the next call.
  [[nodiscard]] const LinksTold& told() noexcept {
    told_.refresh();
    return told_.current();
  }

  // For the haptic thread.
  /// Returns the force of all springs on the hand in a tick [N], at most the peak, along
  /// hand.drives. If several springs are present, each has an equal part.
  /// @param proxy  The last tick's proxy [m].
  /// @param hand   The hand as it was read.
  /// RT: no allocation.
  [[nodiscard]] Vec3 pull(const Vec3& proxy, const HandState& hand,
                          double dt) noexcept PALPATE_NONBLOCKING;
  /// Call it instead of pull() if no force goes to a hand, whatever the tick computes. The remote
  /// hands get no word of this tick.
  void rest(const HandState& hand) noexcept PALPATE_NONBLOCKING;
  /// Ends a tick that has pulled: `share` of that force or more has left, in `force`. RT: no
  /// allocation; one atomic exchange.
  void pulled(double share, const HandState& hand, const Vec3& proxy,
              const Vec3& force) noexcept PALPATE_NONBLOCKING;

 private:
  void listen() noexcept;

  std::array<Link, kMostLinks> links_;
  std::array<std::uint64_t, kMostLinks> who_{};
  Mailbox<LinksHeard> heard_;
  Mailbox<LinksTold> told_;
};

}  // namespace palpate
