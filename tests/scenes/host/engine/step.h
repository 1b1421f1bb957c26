/// A header of the host. palpate has one of the same name.
#pragma once

namespace host {
inline constexpr int kSteps = 640;
}  // namespace host
