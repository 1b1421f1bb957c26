/// A hand for tests that reset the hand many times.
#pragma once

#include "palpate/engine/tick/step.h"

namespace palpate::test {

/// Holds a reader and a proxy, whose memory is allocated only once. Constructing both again would
/// take 7 ms, with AddressSanitizer 15 ms. restart() takes 0.1 ms, with AddressSanitizer 2 ms.
class FreshHand {
 public:
  explicit FreshHand(const ForceLimits& limits) : state(limits), made_state_(state) {}
  /// Resets both to their initial state.
  void restart() {
    reader = made_reader_;
    state = made_state_;
  }

  Reader reader;
  ProxyState state;

 private:
  const Reader made_reader_;
  const ProxyState made_state_;
};

}  // namespace palpate::test
