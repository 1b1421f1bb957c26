/// A host program's header, with the same name as one of palpate's.
#pragma once

namespace host {
inline constexpr int kSteps = 640;
}  // namespace host
