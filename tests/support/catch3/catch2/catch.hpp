#pragma once
// Tests include <catch2/catch.hpp> of Catch2 2. With Catch2 3, this file has that name and gives
// the names that changed.
#include <catch2/catch_all.hpp>

namespace Catch {

using TestEventListenerBase = EventListenerBase;
using Matchers::StartsWith;
inline auto Contains(const std::string& part) {
  return Matchers::ContainsSubstring(part);
}

}  // namespace Catch

using Catch::Approx;
