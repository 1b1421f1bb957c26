/// Private to the importer: a crew that mpirun has started, if it was built with MPI.
#pragma once

#include <memory>
#include <optional>

#include "palpate/samplers/crew.h"

namespace palpate::importer {

/// The rank that this process has by its environment, where mpirun or its like has started it.
[[nodiscard]] std::optional<int> rankByEnvironment();

/// How many there are by it; 1 where it does not say.
[[nodiscard]] int ranksByEnvironment();

/// It was built with MPI.
[[nodiscard]] bool canJoinCrew();

/// Joins the others, who do so as well; they part when it is destroyed. Once, in the process that
/// does the work. Only where it can.
[[nodiscard]] std::unique_ptr<Crew> joinCrew();

}  // namespace palpate::importer
