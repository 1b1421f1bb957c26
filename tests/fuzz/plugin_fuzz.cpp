/// libFuzzer target for plugin_entry.h. The whole input is parsed as a message, and then as facts
/// followed by news for each tick.
///   cmake -S . -B build/fuzz -G Ninja -DCMAKE_CXX_COMPILER=clang++ -DPALPATE_FUZZ=ON
///     -DPALPATE_SANITIZE=address,undefined
///   ninja -C build/fuzz palpate_fuzz_plugin && build/fuzz/tests/palpate_fuzz_plugin -max_len=30000
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <span>
#include <string>

#include "palpate/engine/error.h"
#include "tests/fuzz/plugin_entry.h"

namespace {

void demand(const std::string& wrong) {
  if (wrong.empty()) return;
  std::fprintf(stderr, "%s\n", wrong.c_str());
  std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  auto bytes = std::as_bytes(std::span(data, size));
  bool taken = false;
  demand(palpate::test::fuzzPluginMessage(bytes, taken));
  palpate_plugin_facts facts{};
  const std::size_t head = std::min(bytes.size(), sizeof(facts));
  std::memcpy(&facts, bytes.data(), head);
  facts.source[sizeof(facts.source) - 1] = '\0';
  for (auto& name : facts.button) name[sizeof(name) - 1] = '\0';
  bytes = bytes.subspan(head);
  try {
    palpate::test::PluginFuzz fuzz(facts);
    for (int i = 0; i < 100; ++i) {
      const std::size_t part = std::min(bytes.size(), sizeof(palpate::PluginNews));
      std::memcpy(static_cast<void*>(&fuzz.news()), bytes.data(), part);
      bytes = bytes.subspan(part);
      demand(fuzz.tick());
      if (part == 0) break;
    }
  } catch (const palpate::DeviceError&) {
    // Invalid facts are refused.
  }
  return 0;
}
