#include "palpate/scenes/apps/import/header_checks.h"

#include <filesystem>
#include <fstream>
#include <string>
#include <unistd.h>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"

namespace palpate::header_checks_test {
using Catch::Contains;
namespace fs = std::filesystem;

TEST_CASE("a header may name data files outside its folder only with option --follow", "[header]") {
  std::string name = (fs::temp_directory_path() / "palpate_header_XXXXXX").string();
  REQUIRE(mkdtemp(name.data()) != nullptr);
  const fs::path folder = name;
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
  fs::remove_all(folder);
}

}  // namespace palpate::header_checks_test
