#include "palpate/samplers/module.h"

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>
#include <string>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/http_store.h"

namespace palpate::module_test {
namespace {

constexpr Module kOther{"palpate_other.so", "libother-dev"};

/// Sets the environment variable PALPATE_MODULES during the object's lifetime.
class ModulesIn {
 public:
  explicit ModulesIn(const std::filesystem::path& folder) {
    setenv("PALPATE_MODULES", folder.c_str(), 1);
  }
  ModulesIn(const ModulesIn&) = delete;
  ModulesIn& operator=(const ModulesIn&) = delete;
  ~ModulesIn() { unsetenv("PALPATE_MODULES"); }
};

/// Returns the error message for a module that cannot be loaded.
std::string refusalOf(const Module& module) {
  try {
    (void)loadModule(module, "--other");
  } catch (const Error& error) {
    return error.what();
  }
  return "it was loaded";
}

}  // namespace

TEST_CASE("a missing module is reported with the package that contains it", "[module]") {
  const ModulesIn folder("/nowhere");
  CHECK(refusalOf(kOther) ==
        "--other: palpate_other.so is missing in /nowhere: install the package palpate-network, or "
        "build palpate with libother-dev, or unset PALPATE_MODULES");
}

TEST_CASE(
    "without PALPATE_MODULES a module is searched only in ../lib/palpate if this folder exists",
    "[module]") {
  const auto own = std::filesystem::read_symlink("/proc/self/exe").parent_path().parent_path();
  CHECK(refusalOf(kOther).find("missing in " + (own / "lib/palpate").string() + ": install") !=
        std::string::npos);
}

TEST_CASE("a module of another release of palpate is refused", "[module]") {
  const ModulesIn folder(PALPATE_TEST_MODULES);
  const std::string file = std::string(PALPATE_TEST_MODULES) + "/palpate_other.so";
  CHECK(refusalOf(kOther) == "--other: " + file +
                                 " belongs to palpate 0.0.1, and this is palpate " + kVersion +
                                 ": install palpate and palpate-network of the same release");
}

TEST_CASE("a shared library that is not a palpate module is refused", "[module]") {
  const ModulesIn folder(PALPATE_TEST_MODULES);
  CHECK(refusalOf({"palpate_no_module.so", "libother-dev"}).find("belongs to another release") !=
        std::string::npos);
}

TEST_CASE("a module that cannot be loaded is refused with the loader's reason", "[module]") {
  const auto place = std::filesystem::temp_directory_path() /
                     ("palpate_module_" + std::to_string(std::random_device()()));
  std::filesystem::create_directory(place);
  std::ofstream(place / "palpate_other.so") << "not a library";
  const ModulesIn folder(place);
  const std::string refusal = refusalOf(kOther);
  CHECK(refusal.find((place / "palpate_other.so").string() + ": ") != std::string::npos);
  CHECK(refusal.find("palpate-network") != std::string::npos);
  std::filesystem::remove_all(place);
}

TEST_CASE("an error that a module throws arrives with its type and reason", "[module]") {
  std::string reason;
  try {
    (void)makeHttpStore("http://user@host/folder");
  } catch (const VolumeError& error) {
    reason = error.reason();
  }
  CHECK(reason.find("missing") == std::string::npos);
  CHECK(reason.find("address") != std::string::npos);
}

}  // namespace palpate::module_test
