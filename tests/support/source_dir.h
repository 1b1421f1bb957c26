/// The location of the tests' sources, for files beside them.
#pragma once

#include <string>

namespace palpate::test {

/// Returns the project's root, absolute. Only one small source contains the path. So all other
/// sources compile to the same bytes in any clone, and the compiler cache finds them.
[[nodiscard]] std::string sourceDir();

}  // namespace palpate::test
