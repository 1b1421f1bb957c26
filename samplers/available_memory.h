/// Private to samplers: the memory that a load may take.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace palpate {

/// Memory that a volume takes at least.
struct MemoryNeed {
  std::string volume;       ///< Name for messages.
  std::uint64_t bytes = 0;  ///< 0: unknown.
};

/// Returns the memory that this process can still take [bytes]. This is the sum of the system's
/// available memory and free swap space, or the rest of the address space (ulimit -v) if that is
/// less. Ignores other limits, such as those of a container. Infinity if unknown.
[[nodiscard]] double availableMemory();

/// Throws VolumeError, with the sum and the largest volume, if the volumes together need more than
/// availableMemory(). Counts an unknown need as 0.
void checkMemory(const std::vector<MemoryNeed>& volumes);

}  // namespace palpate
