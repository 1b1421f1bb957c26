/// Where the tests' sources are: for the files that lie beside them.
#pragma once

#include <string>

namespace palpate::test {

/// The project's root, absolute. One small source knows it, so that all others are compiled to the
/// same bytes, and found in the compiler cache, wherever a clone lies.
[[nodiscard]] std::string sourceDir();

}  // namespace palpate::test
