/// libFuzzer target for the parser of Haply's messages; docs/haply.md describes how to run it.
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <string>

#include "tests/devices/haply/fuzz_messages.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  const std::string wrong =
      palpate::test::fuzzHaplyMessage({reinterpret_cast<const char*>(bytes), size});
  if (!wrong.empty()) {
    std::fprintf(stderr, "%s\n", wrong.c_str());
    std::abort();
  }
  return 0;
}
