/// In place of mpi_crew.cpp where there is no MPI.
#include "palpate/scenes/import/mpi_crew.h"

namespace palpate::importer {

bool canJoinCrew() {
  return false;
}

std::unique_ptr<Crew> joinCrew() {
  return std::make_unique<CrewOfOne>();
}

}  // namespace palpate::importer
