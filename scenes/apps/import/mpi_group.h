/// Private to the importer: the group of processes that mpirun has started, if built with MPI.
#pragma once

#include <memory>
#include <optional>

#include "palpate/samplers/process_group.h"

namespace palpate::importer {

/// Returns the rank of this process from its environment. No value if neither mpirun nor a similar
/// launcher has started it.
[[nodiscard]] std::optional<int> rankByEnvironment();

/// Returns the number of ranks from the environment; 1 if it is not stated.
[[nodiscard]] int ranksByEnvironment();

/// Returns true if this program was built with MPI.
[[nodiscard]] bool canJoinGroup();

/// Joins the process group. All ranks must call this function. The group ends when the result is
/// destroyed. Call it only once, in the process that does the work, and only if canJoinGroup() is
/// true.
[[nodiscard]] std::unique_ptr<ProcessGroup> joinGroup();

}  // namespace palpate::importer
