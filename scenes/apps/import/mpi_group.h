/// Private to the importer: the group of processes that mpirun has started.
#pragma once

#include <memory>
#include <optional>

#include "palpate/samplers/process_group.h"

namespace palpate::importer {

/// Returns the rank of this process; no value without mpirun or a similar launcher.
[[nodiscard]] std::optional<int> rankByEnvironment();

/// Returns the number of ranks; 1 if the environment does not state it.
[[nodiscard]] int ranksByEnvironment();

[[nodiscard]] bool canJoinGroup();

/// Joins the process group; the result's destructor leaves it. All ranks must call this function
/// once, in the process that does the work, and only if canJoinGroup() is true.
[[nodiscard]] std::unique_ptr<ProcessGroup> joinGroup();

}  // namespace palpate::importer
