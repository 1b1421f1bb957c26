/// Replaces mpi_group.cpp in a build without MPI.
#include "palpate/scenes/apps/import/mpi_group.h"

namespace palpate::importer {

bool canJoinGroup() {
  return false;
}

std::unique_ptr<ProcessGroup> joinGroup() {
  return std::make_unique<SingleProcess>();
}

}  // namespace palpate::importer
