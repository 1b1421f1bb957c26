/// The hands elsewhere that one loop's hand feels: a spring to each (link.h), and what lies between
/// the loop and whoever carries the messages.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "palpate/engine/device.h"
#include "palpate/engine/link.h"
#include "palpate/engine/mailbox.h"
#include "palpate/engine/types.h"

namespace palpate {

inline constexpr std::size_t kMostLinks = 7;  ///< Hands elsewhere that are felt at once.

/// The newest word of each hand elsewhere.
struct LinksHeard {
  /// Any number for a hand; 0: nobody. With another number a link begins anew.
  std::array<std::uint64_t, kMostLinks> who{};
  std::array<LinkWord, kMostLinks> words{};  ///< What it said last.
};

/// What a tick has to tell.
struct LinksTold {
  Vec3 hand = Vec3::Zero();                     ///< [m]
  Vec3 proxy = Vec3::Zero();                    ///< [m]
  Vec3 force = Vec3::Zero();                    ///< On the hand, all of it [N].
  std::array<std::uint64_t, kMostLinks> who{};  ///< For whom each word is: LinksHeard::who.
  std::array<LinkWord, kMostLinks> words{};     ///< For each hand elsewhere.
  std::array<double, kMostLinks> presence{};    ///< Link::presence
  std::array<double, kMostLinks> paid{};        ///< Link::paid
  std::array<double, kMostLinks> energy{};      ///< Link::energy [J]
};

/// Two threads use it, each its own functions: the haptic thread and the one that carries.
class HandLinks {
 public:
  /// @param life  As Link: greater than at any start before, as the time of day is.
  explicit HandLinks(std::uint64_t life, const LinkParams& params = {});

  // For the thread that carries.
  /// Tells the loop what was heard: all of it, each time.
  void hear(const LinksHeard& heard) noexcept;
  /// What the newest tick tells; valid until the next call.
  [[nodiscard]] const LinksTold& told() noexcept {
    told_.refresh();
    return told_.current();
  }

  // For the haptic thread.
  /// A tick: the force of all springs on the hand [N], at most the peak, along hand.drives. Springs
  /// are each a part of one: of as many as are there.
  /// @param proxy  The last tick's [m].
  /// @param hand   As it was read.
  /// RT: no allocation.
  [[nodiscard]] Vec3 pull(const Vec3& proxy, const HandState& hand,
                          double dt) noexcept PALPATE_NONBLOCKING;
  /// In its place where no force goes to a hand, whatever comes out: others hear nothing of it.
  void rest(const HandState& hand) noexcept PALPATE_NONBLOCKING;
  /// The end of a tick with pull(): at least `share` of that has left, and `force` with it.
  /// RT: no allocation; one atomic exchange.
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
