#include <cstdlib>

#include "palpate/scenes/apps/import/mpi_group.h"

namespace palpate::importer {

std::optional<int> rankByEnvironment() {
  // Open MPI's mpirun, PMIx launchers such as Slurm's srun, and MPICH's mpiexec set these.
  for (const char* name : {"OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK"}) {
    if (const char* rank = std::getenv(name)) return std::atoi(rank);
  }
  return std::nullopt;
}

int ranksByEnvironment() {
  for (const char* name : {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE"}) {
    if (const char* size = std::getenv(name)) return std::atoi(size);
  }
  return 1;
}

}  // namespace palpate::importer
