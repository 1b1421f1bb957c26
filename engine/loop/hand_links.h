/// The links of one hand to remote hands, one spring (link.h) to each.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "palpate/engine/loop/link.h"
#include "palpate/engine/loop/mailbox.h"
#include "palpate/engine/safety/device.h"
#include "palpate/engine/types.h"

namespace palpate {

inline constexpr std::size_t kMostLinks = 7;  ///< Largest number of remote hands.

/// The newest message (LinkWord) of each remote hand.
struct LinksHeard {
  /// Number that identifies each hand; 0 if there is no hand. A changed number begins a new link.
  std::array<std::uint64_t, kMostLinks> who{};
  std::array<LinkWord, kMostLinks> words{};  ///< Newest message of each hand.
};

/// Data that a tick sends to remote hands.
struct LinksTold {
  Vec3 hand = Vec3::Zero();                     ///< Position of the hand [m].
  Vec3 proxy = Vec3::Zero();                    ///< Position of the proxy [m].
  Vec3 force = Vec3::Zero();                    ///< Whole force on the hand [N].
  std::array<std::uint64_t, kMostLinks> who{};  ///< Recipient of each message: LinksHeard::who.
  std::array<LinkWord, kMostLinks> words{};     ///< One message for each remote hand.
  std::array<double, kMostLinks> presence{};    ///< Link::presence of each link.
  std::array<double, kMostLinks> paid{};        ///< Link::paid of each link.
  std::array<double, kMostLinks> energy{};      ///< Link::energy of each link [J].
};

/// The links of one hand. Two threads use them; each function belongs to one thread.
class HandLinks {
 public:
  /// @param life  First life of each Link: greater than at earlier starts, such as ns since 1970.
  explicit HandLinks(std::uint64_t life, const LinkParams& params = {});

  // Functions for the thread that carries the messages.
  /// Passes the newest messages of all hands to the loop.
  void hear(const LinksHeard& heard) noexcept;
  /// Returns the data of the newest tick; valid until the next call.
  [[nodiscard]] const LinksTold& told() noexcept {
    told_.refresh();
    return told_.current();
  }

  // Functions for the haptic thread.
  /// Returns the force of all springs on the hand in a tick [N]: at most LinkParams::peak, in the
  /// directions of hand.drives. The springs of present hands have equal shares. `proxy` is the last
  /// tick's proxy [m], and `hand` the hand as read. RT: no allocation.
  [[nodiscard]] Vec3 pull(const Vec3& proxy, const HandState& hand,
                          double dt) noexcept PALPATE_NONBLOCKING;
  /// Ends the pull of all springs. Call this function instead of pull() if no force is sent. The
  /// remote hands get no message of this tick.
  void rest(const HandState& hand) noexcept PALPATE_NONBLOCKING;
  /// Publishes the messages of a tick. Call this function at the end of a tick with pull(). `share`
  /// is a lower bound of the share of the pull that the sent `force` contains. RT: no allocation;
  /// one atomic exchange.
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
