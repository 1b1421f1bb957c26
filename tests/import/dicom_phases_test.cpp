// Tests the choice and the order of DICOM series that are time steps of one volume.
#include "palpate/scenes/apps/import/dicom_phases.h"

#include <algorithm>
#include <functional>
#include <string>
#include <vector>

#include <catch2/catch.hpp>

#include "tests/import/axial_image.h"

namespace palpate::dicom_phases_test {
using namespace palpate::importer;
using Catch::Contains;

namespace {

constexpr int kImages = 3;
constexpr std::size_t kTrigger = 0;
constexpr std::size_t kIdentifier = 3;
constexpr std::size_t kAcquisition = 5;

/// Changes the file of image `k` of series `s`.
using Change = std::function<void(int s, int k, File& file)>;

/// Returns series of equal geometry with the UIDs "0", "1" and so on.
std::vector<File> phases(int count, const Change& change) {
  std::vector<File> files;
  for (int s = 0; s < count; ++s) {
    for (int k = 0; k < kImages; ++k) {
      File file = test::axialImage(k);
      file.path = "s" + std::to_string(s) + "k" + std::to_string(k);
      file.series = std::to_string(s);
      file.series_number = s;
      change(s, k, file);
      files.push_back(file);
    }
  }
  return files;
}

Phases joined(const std::vector<File>& files) {
  return phasesOf(seriesOf(files));
}

/// Returns the first image's file of each step, and the steps' times.
std::pair<std::vector<std::string>, std::vector<double>> orderOf(const Phases& found) {
  REQUIRE(found.problem.empty());
  const std::vector<Series> one = seriesOf(found.files);
  REQUIRE(one.size() == 1);
  const Stack stack = stackOf(one.front(), "the series");
  std::vector<std::string> names;
  for (const Slices& step : stack.steps) {
    names.push_back(one.front().files[step.front().file]->path.string());
  }
  return {names, stack.times};
}

using Names = std::vector<std::string>;
using Times = std::vector<double>;

}  // namespace

TEST_CASE("series with percentages are steps in the order of the percentages", "[dicom]") {
  const std::vector<std::string> names = {"Gated, 50%", "T=0 Gated, 0%", "10.0 % A", "100%"};
  const Phases found =
      joined(phases(4, [&](int s, int /*k*/, File& file) { file.description = names.at(s); }));
  const auto [order, times] = orderOf(found);
  CHECK(order == Names{"s1k0", "s2k0", "s0k0", "s3k0"});
  CHECK(times == Times{0.0, 1.0, 2.0, 3.0});
  CHECK(found.notes.empty());
}

TEST_CASE("a series without a percentage is left out beside series that have one", "[dicom]") {
  const std::vector<std::string> names = {"30%", "Average", "0%"};
  const Phases found = joined(phases(3, [&](int s, int k, File& file) {
    file.description = names.at(s);
    if (s == 1) file.slices.front().position.x() += 5.0 + k;
  }));
  CHECK(orderOf(found).first == Names{"s2k0", "s0k0"});
  REQUIRE(found.notes.size() == 1);
  CHECK_THAT(found.notes.front(), Contains("2: \"Average\"") && Contains("no phase or time"));
}

TEST_CASE("a time or a number that all images of a series share orders steps that have percentages",
          "[dicom]") {
  const auto found = joined(phases(3, [](int s, int k, File& file) {
    file.description = std::to_string(10 * s) + "%";
    file.slices.front().times[kTrigger] = 700.0 - 250.0 * s;
    file.slices.front().times[kAcquisition] = k;
  }));
  const auto [order, times] = orderOf(found);
  CHECK(order == Names{"s2k0", "s1k0", "s0k0"});
  CHECK(times == Times{0.0, 0.25, 0.5});
  // The trigger times vary within a series, so the numbers of the steps give the order.
  const auto numbered = joined(phases(2, [](int s, int k, File& file) {
    file.slices.front().times[kTrigger] = 10.0 * k;
    file.slices.front().times[kIdentifier] = 4.0 - s;
  }));
  CHECK(orderOf(numbered).first == Names{"s1k0", "s0k0"});
  CHECK(orderOf(numbered).second == Times{0.0, 1.0});
}

TEST_CASE("series without phases are steps in the order of their acquisition", "[dicom]") {
  const auto at = [](double first, double step) {
    return joined(phases(3, [&](int s, int k, File& file) {
      file.slices.front().times[kAcquisition] = first - step * s + 0.5 * k;
    }));
  };
  const auto [order, times] = orderOf(at(1000.0, 2.0));
  CHECK(order == Names{"s2k0", "s1k0", "s0k0"});
  CHECK(times == Times{0.0, 2.0, 4.0});
  // The acquisitions overlap, so their times are not those of the steps.
  CHECK(orderOf(at(1000.0, 0.25)).second == Times{0.0, 1.0, 2.0});
}

TEST_CASE("series of different geometry or without an order are not steps", "[dicom]") {
  const auto problem = [](const Change& change) {
    return joined(phases(2,
                         [&](int s, int k, File& file) {
                           file.description = std::to_string(10 * s) + "%";
                           change(s, k, file);
                         }))
        .problem;
  };
  CHECK(problem([](int, int, File&) {}).empty());
  const auto second = [&](const std::function<void(File&)>& change) {
    return problem([&](int s, int, File& file) {
      if (s == 1) change(file);
    });
  };
  CHECK_THAT(second([](File& f) { f.modality = "PT"; }), Contains("1 and 2 differ in modality"));
  CHECK_THAT(second([](File& f) { f.frame_of_reference = "1.2"; }), Contains("frame of reference"));
  CHECK_THAT(second([](File& f) { f.slices.front().position.z() += 0.1; }), Contains("positions"));
  CHECK_THAT(second([](File& f) { f.slices.front().across = 0.6; }), Contains("pixel spacing"));
  CHECK_THAT(second([](File& f) { f.slices.front().format[1] = 5; }), Contains("size"));
  CHECK_THAT(second([](File& f) { f.slices.push_back(f.slices.front()); }),
             Contains("number of images"));
  CHECK_THAT(second([](File& f) { f.damage = "the file is truncated"; }), Contains("truncated"));
  CHECK_THAT(second([](File& f) { f.description = "0%"; }), Contains("the same percentage"));
  CHECK_THAT(problem([](int, int, File& f) { f.description = "lung"; }),
             Contains("neither a phase nor a time"));
  CHECK_THAT(problem([](int, int, File& f) { f.is_localiser = true; }), Contains("fewer than two"));
}

}  // namespace palpate::dicom_phases_test
