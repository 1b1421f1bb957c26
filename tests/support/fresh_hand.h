/// A hand for tests that restart it many times.
#pragma once

#include "palpate/engine/tick/step.h"

namespace palpate::test {

/// A reader and a proxy that are allocated once. restart() is faster than making new ones.
class FreshHand {
 public:
  explicit FreshHand(const ForceLimits& limits) : state(limits), made_state_(state) {}
  /// Resets reader and proxy to their initial state.
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
