#include "tests/support/source_dir.h"

namespace palpate::test {

std::string sourceDir() {
  return PALPATE_SOURCE_DIR;
}

}  // namespace palpate::test
