#include "palpate/scenes/cli/asked.h"

#include <algorithm>
#include <cmath>

namespace palpate::cli {
Asked asked(const LiveWishes& before, const LiveWishes& now) {
  Asked asked;
  asked.cut = now.cuts != before.cuts;
  asked.clear = now.clears != before.clears && !asked.cut;
  asked.closed = now.closed != 0;
  if (now.dialled == before.dialled) return asked;
  asked.dialled = now.dialled;
  const auto count = std::min<std::size_t>(now.dial_count, now.dials.size());
  for (std::size_t i = 0; i < count; ++i) {
    const LiveDial& dial = now.dials[i];
    if (!std::isfinite(dial.factor)) continue;
    asked.dials.push_back({dial.mode, std::clamp(dial.factor, 0.0F, kMostDial)});
  }
  return asked;
}

}  // namespace palpate::cli
