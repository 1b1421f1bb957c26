#include "palpate/engine/loop/hand_links.h"

#include <algorithm>
#include <utility>

namespace palpate {
namespace {

template <std::size_t... I>
std::array<Link, sizeof...(I)> linksOf(std::uint64_t life, const LinkParams& params,
                                       std::index_sequence<I...> /*each*/) {
  return {((void)I, Link(life, params))...};
}

}  // namespace

HandLinks::HandLinks(std::uint64_t life, const LinkParams& params)
    : links_(linksOf(life, params, std::make_index_sequence<kMostLinks>())) {}

void HandLinks::hear(const LinksHeard& heard) noexcept {
  heard_.draft() = heard;
  heard_.publish();
}

void HandLinks::listen() noexcept {
  if (!heard_.refresh()) return;
  const LinksHeard& heard = heard_.current();
  for (std::size_t i = 0; i < kMostLinks; ++i) {
    if (who_[i] != heard.who[i]) links_[i].forgetOther();
    who_[i] = heard.who[i];
    if (who_[i] != 0) links_[i].hear(heard.words[i]);
  }
}

Vec3 HandLinks::pull(const Vec3& proxy, const HandState& hand, double dt) noexcept {
  listen();
  double there = 0.0;
  for (std::size_t i = 0; i < kMostLinks; ++i) {
    const double comes = who_[i] != 0 ? dt / kLinkRamp : 0.0;
    there += std::min(1.0, links_[i].presence() + comes);
  }
  const double part = 1.0 / std::max(1.0, there);
  Vec3 all = Vec3::Zero();
  for (Link& link : links_) all += link.pull(proxy, hand, part, dt);
  return all;
}

void HandLinks::rest(const HandState& hand) noexcept {
  listen();
  for (Link& link : links_) link.rest(hand.position);
}

void HandLinks::pulled(double share, const HandState& hand, const Vec3& proxy,
                       const Vec3& force) noexcept {
  LinksTold& told = told_.draft();
  told.who = who_;
  told.hand = hand.position;
  told.proxy = proxy;
  told.force = force;
  // If `share` is 0 although a force was sent, the share is unknown, which Link expects as -1.
  const double left = share > 0.0 || force.isZero(0.0) ? share : -1.0;
  for (std::size_t i = 0; i < kMostLinks; ++i) {
    links_[i].pulled(left);
    told.words[i] = links_[i].word(proxy);
    told.presence[i] = links_[i].presence();
    told.paid[i] = links_[i].paid();
    told.energy[i] = links_[i].energy();
  }
  told_.publish();
}

}  // namespace palpate
