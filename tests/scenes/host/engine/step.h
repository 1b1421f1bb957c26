/// A header of a host program. palpate has a header with the same name.
#pragma once

namespace host {
inline constexpr int kSteps = 640;
}  // namespace host
