/// Private to the importer: a process group that mpirun has started, if built with MPI.
#pragma once

#include <memory>
#include <optional>

#include "palpate/samplers/process_group.h"

namespace palpate::importer {

/// Returns this process's rank from its environment; unset if no mpirun or similar launcher started
/// it.
[[nodiscard]] std::optional<int> rankByEnvironment();

/// Returns the number of ranks from the environment; 1 if not stated.
[[nodiscard]] int ranksByEnvironment();

/// Returns true if built with MPI.
[[nodiscard]] bool canJoinGroup();

/// Joins the other ranks, which have to join too. The group ends when the result is destroyed. Call
/// this function once, in the process that does the work, and only if canJoinGroup().
[[nodiscard]] std::unique_ptr<ProcessGroup> joinGroup();

}  // namespace palpate::importer
