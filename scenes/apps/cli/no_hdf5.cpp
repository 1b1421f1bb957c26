/// Replaces as_hdf5.cpp if the library is missing.
#include "palpate/engine/error.h"
#include "palpate/scenes/apps/cli/as_hdf5.h"

namespace palpate::cli {

void checkHdf5(const std::string& path) {
  throw Error(path, "this palpate was built without HDF5",
              "write a .csv, or install libhdf5-dev and build again");
}

void writeHdf5(const Recording& /*recording*/, const std::string& path) {
  checkHdf5(path);
}

}  // namespace palpate::cli
