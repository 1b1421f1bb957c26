/// Tests that the outputs of an import appear all or none.
#include "palpate/scenes/apps/import/guard.h"

#include <atomic>
#include <chrono>
#include <dlfcn.h>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <thread>
#include <unistd.h>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/common/common.h"
#include "tests/support/vdb_files.h"

namespace palpate::guard_test {
using Catch::Contains;
using importer::Teller;
using palpate::test::TemporaryFolder;

namespace fs = std::filesystem;

namespace {

void put(const fs::path& file, const std::string& text) {
  std::ofstream(file) << text;
}

std::string textOf(const fs::path& file) {
  std::ifstream in(file);
  return {std::istreambuf_iterator<char>(in), {}};
}

/// Writes the partial file of an output, and announces it.
void writeOutput(Teller& teller, const fs::path& file) {
  const fs::path partial = file.string() + ".partial";
  put(partial, "new");
  teller.file(partial, file);
}

std::size_t filesIn(const fs::path& folder) {
  return static_cast<std::size_t>(
      std::distance(fs::directory_iterator(folder), fs::directory_iterator()));
}

}  // namespace

TEST_CASE("if one output of an import cannot appear, all outputs stay as before", "[import]") {
  const TemporaryFolder folder;
  const fs::path old = folder / "old.vdb";
  const fs::path fresh = folder / "fresh.vdb";
  const fs::path blocked = folder / "scene.json";
  put(old, "old");
  const auto work = [&](Teller& teller) {
    for (const fs::path& file : {old, fresh, blocked}) writeOutput(teller, file);
    fs::create_directory(blocked);  // after the check of its name
    put(blocked / "mine", "mine");
    return static_cast<int>(cli::kDone);
  };
  CHECK_THROWS_WITH(importer::runGuarded("in", "import less", work),
                    Contains("scene.json: it is a folder"));
  CHECK(textOf(old) == "old");
  CHECK(textOf(blocked / "mine") == "mine");
  CHECK(filesIn(folder.path()) == 2);
}

TEST_CASE("the outputs of an import replace older files, also behind a link", "[import]") {
  const TemporaryFolder folder;
  const fs::path old = folder / "old.vdb";
  const fs::path link = folder / "link.vdb";
  put(old, "old");
  put(folder / "behind.vdb", "old");
  fs::create_symlink("behind.vdb", link);
  const auto work = [&](Teller& teller) {
    for (const fs::path& file : {old, link, folder / "fresh.vdb"}) writeOutput(teller, file);
    return static_cast<int>(cli::kDone);
  };
  CHECK(importer::runGuarded("in", "import less", work) == cli::kDone);
  for (const char* name : {"old.vdb", "link.vdb", "behind.vdb", "fresh.vdb"}) {
    CAPTURE(name);
    CHECK(textOf(folder / name) == "new");
  }
  CHECK(fs::is_symlink(link));
  CHECK(filesIn(folder.path()) == 4);
}

TEST_CASE("an import can load libraries if a thread looked up symbols when the import began",
          "[import]") {
  const auto work = [](Teller&) {
    alarm(10);
    // The C library starts this thread on the stack that the searching thread had in the parent.
    std::thread([] { std::this_thread::sleep_for(std::chrono::hours(1)); }).detach();
    void* library = dlopen("libutil.so.1", RTLD_NOW | RTLD_GLOBAL);
    return static_cast<int>(library != nullptr && dlclose(library) == 0 ? cli::kDone
                                                                        : cli::kInternal);
  };
  for (int repeat = 0; repeat < 6; ++repeat) {
    std::atomic<bool> searching{false};
    std::atomic<bool> ends{false};
    std::thread thread([&] {
      using Clock = std::chrono::steady_clock;
      searching = true;
      const Clock::time_point end = Clock::now() + std::chrono::milliseconds(50);
      while (Clock::now() < end) (void)dlsym(RTLD_DEFAULT, "palpate_absent_symbol");
      while (!ends) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    });
    while (!searching) std::this_thread::yield();
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
    const int status = importer::runGuarded("in", "import less", work);
    ends = true;
    thread.join();
    REQUIRE(status == cli::kDone);
  }
}

}  // namespace palpate::guard_test
