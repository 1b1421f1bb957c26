/// libFuzzer target for pid_entry.h. The first two bytes of the input are the descriptor's length.
///   cmake -S . -B build/fuzz -G Ninja -DCMAKE_CXX_COMPILER=clang++ -DPALPATE_FUZZ=ON
///     -DPALPATE_ENGINE_ONLY=ON -DPALPATE_SANITIZE=address,undefined
///   ninja -C build/fuzz palpate_fuzz_pid && build/fuzz/tests/palpate_fuzz_pid -max_total_time=60
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>

#include "tests/fuzz/pid_entry.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 2) return 0;
  const auto all = std::as_bytes(std::span(data, size));
  const std::size_t length = data[0] | static_cast<std::size_t>(data[1]) << 8U;
  const auto rest = all.subspan(2);
  const auto descriptor = rest.first(std::min(length, rest.size()));
  (void)palpate::test::fuzzPid(descriptor, rest.subspan(descriptor.size()));
  return 0;
}
