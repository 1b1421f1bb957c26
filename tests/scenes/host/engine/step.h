/// The host's own, of a name that palpate has too.
#pragma once

namespace host {
inline constexpr int kSteps = 640;
}  // namespace host
