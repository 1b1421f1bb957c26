/// The path of the project's sources.
#pragma once

#include <string>

namespace palpate::test {

/// Returns the project's root as an absolute path. Only one small source contains this path, so all
/// others compile to the same bytes in any clone, and the compiler cache finds them.
[[nodiscard]] std::string sourceDir();

}  // namespace palpate::test
