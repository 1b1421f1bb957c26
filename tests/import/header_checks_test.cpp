#include "palpate/scenes/apps/import/header_checks.h"

#include <filesystem>
#include <fstream>
#include <string>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "tests/support/vdb_files.h"

namespace palpate::header_checks_test {
using Catch::Contains;
namespace fs = std::filesystem;

TEST_CASE("a header may name data files outside its folder only with option --follow", "[header]") {
  const test::TemporaryFolder folder;
  fs::create_directories(folder / "headers" / "within");
  const fs::path header = folder / "headers" / "a.nhdr";
  for (const fs::path& file :
       {header, folder / "a.raw", folder / "headers" / "b.raw", folder / "headers/within/c.raw"}) {
    std::ofstream(file) << "12345678";
  }
  fs::create_symlink("../a.raw", folder / "headers" / "link.raw");
  const auto size = [&](const fs::path& data, bool follow) {
    return importer::sizeOfData(header, data, follow);
  };
  CHECK(size(folder / "headers" / "b.raw", false) == 8.0);
  CHECK(size(folder / "headers" / "within" / "c.raw", false) == 8.0);
  for (const fs::path& data :
       {folder / "a.raw", folder / "headers" / ".." / "a.raw", folder / "headers" / "link.raw"}) {
    CAPTURE(data);
    CHECK_THROWS_WITH(size(data, false),
                      Contains("the header names a data file in another folder"));
    CHECK(size(data, true) == 8.0);
  }
}

}  // namespace palpate::header_checks_test
