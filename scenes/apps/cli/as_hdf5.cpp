#include "palpate/scenes/apps/cli/as_hdf5.h"

#include "palpate/samplers/module.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/library/new_file.h"

namespace palpate::cli {
namespace {

Hdf5Writer* hdf5Writer(const std::string& path) {
  static auto* const writer = functionOf<Hdf5Writer>({"palpate_hdf5.so", "libhdf5-dev"}, path);
  return writer;
}

}  // namespace

void checkHdf5(const std::string& path) {
  (void)hdf5Writer(path);
}

void writeHdf5(const Recording& recording, const std::string& path) {
  auto* const write = hdf5Writer(path);
  checkReplaceable(path);
  WholeFile out(path);
  const auto progress = showProgress("converting");
  write(recording, nameOfOpen(out.descriptor(), out.place()).string(), path, [&](double done) {
    endIfInterrupted();
    if (progress) progress(done);
  });
  out.commit();
}

}  // namespace palpate::cli
