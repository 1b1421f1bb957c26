// Tests the selection and the stacking of DICOM images, with headers that this test makes.
#include "palpate/scenes/apps/import/dicom_stack.h"

#include <cmath>
#include <functional>
#include <string>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "tests/import/axial_image.h"

using namespace palpate;
using namespace palpate::importer;
using Catch::Contains;

namespace {

constexpr int kImages = 5;

/// Returns an axial series with one image per file, not in the order of the slices. An image has 4
/// x 3 pixels of 0.5 x 0.8 mm. The slices are 2 mm apart along z.
std::vector<File> axial() {
  std::vector<File> files;
  for (int i = 0; i < kImages; ++i) {
    const int k = (3 * i) % kImages;
    File file = test::axialImage(k);
    file.path = "image" + std::to_string(k);
    file.series = "1.2.3";
    file.description = "axial";
    files.push_back(file);
  }
  return files;
}

Stack stacked(const std::vector<File>& files) {
  const std::vector<Series> all = seriesOf(files);
  REQUIRE(all.size() == 1);
  return stackOf(all.front(), "the series");
}

std::string trouble(const std::function<void(std::vector<File>&)>& change) {
  std::vector<File> files = axial();
  change(files);
  try {
    (void)stacked(files);
  } catch (const VolumeError& e) {
    return e.what();
  }
  return "none";
}

Slice& at(std::vector<File>& files, int k) {
  for (File& file : files) {
    if (file.path == "image" + std::to_string(k)) return file.slices.front();
  }
  throw std::out_of_range("image");
}

}  // namespace

TEST_CASE("DICOM images in any order are stacked along their normal", "[dicom]") {
  const Stack stack = stacked(axial());
  REQUIRE(stack.steps.size() == 1);
  CHECK(stack.times.empty());
  CHECK(stack.notes.empty());
  for (int k = 0; k < kImages; ++k) {
    CHECK(stack.steps[0][static_cast<std::size_t>(k)].position.z() == 2.0 * k);
  }
  // DICOM's axes, to the left and back, become axes to the right and front.
  CHECK(stack.map.origin == Vec3(-10.0, -20.0, 0.0));
  CHECK(stack.map.linear.col(0) == Vec3(-0.5, 0.0, 0.0));
  CHECK(stack.map.linear.col(1) == Vec3(0.0, -0.8, 0.0));
  CHECK(stack.map.linear.col(2) == Vec3(0.0, 0.0, 2.0));
}

TEST_CASE("a tilted CT gantry shears the imported volume by the reported angle", "[dicom]") {
  std::vector<File> files = axial();
  const double shift = 2.0 * std::tan(15.0 * M_PI / 180.0);
  for (int k = 0; k < kImages; ++k) at(files, k).position.y() += shift * k;
  const Stack stack = stacked(files);
  CHECK((stack.map.linear.col(2) - Vec3(0.0, -shift, 2.0)).norm() < 1e-12);
  REQUIRE(stack.notes.size() == 1);
  CHECK_THAT(stack.notes.front(), Contains("15.0 degrees"));
  // A shear of more than 80 degrees is refused.
  CHECK_THAT(trouble([](std::vector<File>& f) {
               for (int k = 0; k < kImages; ++k) at(f, k).position.y() += 12.0 * k;
             }),
             Contains("sheared by 81 degrees"));
}

TEST_CASE("DICOM images that do not form a volume are refused with the reason", "[dicom]") {
  using Files = std::vector<File>;
  CHECK_THAT(trouble([](Files& f) {
               at(f, 3).position.z() = 20.0;
               at(f, 4).position.z() = 22.0;
             }),
             Contains("slices are missing between z = 4 and 20 mm: 7 of 12 in all"));
  CHECK_THAT(trouble([](Files& f) { at(f, 2).position.x() += 1.0; }),
             Contains("the slices are not on a line: the slice at z = 4 mm is 1 mm away "
                      "from the line"));
  CHECK_THAT(trouble([](Files& f) { at(f, 2).format[0] = 5; }),
             Contains("1 of 5 images differ from the others") && Contains("such as image2"));
  CHECK_THAT(trouble([](Files& f) { at(f, 1).row = Vec3(0, 1, 0); }), Contains("localisers"));
  CHECK_THAT(trouble([](Files& f) { at(f, 1).placed = false; }),
             Contains("1 of 5 images do not state their position in the patient, such as image1"));
  CHECK_THAT(trouble([](Files& f) { at(f, 1).has_rescale = true; }),
             Contains("only 1 of 5 images state the scale of their values") &&
                 Contains("image0 does not"));
  CHECK_THAT(trouble([](Files& f) { f[0].is_colour = true; }),
             Contains("1 of 5 files have colour images"));
  CHECK_THAT(trouble([](Files& f) { at(f, 4).position = at(f, 3).position; }),
             Contains("2 images are at the same position, z = 6 mm"));
}

namespace {

/// Returns images at these heights [mm] with these image numbers; empty: without numbers.
std::vector<File> placed(const std::vector<double>& heights, const std::vector<double>& numbers) {
  const File model = axial().front();
  std::vector<File> files;
  for (std::size_t k = 0; k < heights.size(); ++k) {
    files.push_back(model);
    files.back().slices.front().position.z() = heights[k];
    if (!numbers.empty()) files.back().slices.front().number = numbers[k];
  }
  return files;
}

}  // namespace

TEST_CASE("DICOM slices at changing distances get an even spacing near the finer distance",
          "[dicom]") {
  // The slices are first 2.5 mm, then 5 mm apart, without and with image numbers.
  const std::vector<double> head{0, 2.5, 5, 7.5, 10, 15, 20, 25};
  for (const std::vector<double>& numbers :
       {std::vector<double>{}, std::vector<double>{8, 7, 6, 5, 4, 3, 2, 1}}) {
    const Stack stack = stacked(placed(head, numbers));
    CHECK((stack.map.linear.col(2) - Vec3(0, 0, 2.5)).norm() < 1e-12);
    CHECK(stack.depths == std::vector<double>{0, 1, 2, 3, 4, 6, 8, 10});
    REQUIRE(stack.notes.size() == 1);
    CHECK_THAT(stack.notes.front(), Contains("2.5 to 5 mm apart") && Contains("every 2.5 mm"));
  }
  // The length, 47.5 mm, is not a multiple of the finer distance, 7.5 mm. The number of steps is
  // rounded, so the first and last slices keep their positions.
  const Stack abdomen = stacked(placed({0, 7.5, 15, 22.5, 35, 47.5}, {}));
  CHECK(abdomen.depths.back() == 6.0);
  CHECK(abdomen.map.linear(2, 2) == Approx(47.5 / 6));
  // One displaced slice must not reduce the spacing.
  const Stack displaced = stacked(placed({0, 2, 4.3, 6, 8}, {}));
  CHECK(displaced.map.linear(2, 2) == Approx(2.0));
  CHECK(displaced.depths[2] == Approx(2.15));
  // In a tilted stack, distances are along the line through the slices.
  std::vector<File> tilted = placed(head, {});
  for (File& file : tilted) {
    Slice& slice = file.slices.front();
    slice.position.y() += 0.5 * slice.position.z();
  }
  CHECK((stacked(tilted).map.linear.col(2) - Vec3(0, -1.25, 2.5)).norm() < 1e-12);
}

TEST_CASE("a gap between DICOM slices is refused unless the image numbers continue across it",
          "[dicom]") {
  const auto says = [](const std::vector<double>& heights, const std::vector<double>& numbers) {
    try {
      (void)stacked(placed(heights, numbers));
    } catch (const VolumeError& e) {
      return std::string(e.what());
    }
    return std::string("none");
  };
  // A slice is missing between even slices, or where the distance changes. In the last case, the
  // images have no numbers.
  CHECK_THAT(says({0, 2, 4, 8, 10}, {1, 2, 3, 5, 6}), Contains("between z = 4 and 8 mm: 1 of 6"));
  CHECK_THAT(says({0, 2, 4, 10, 14, 18}, {1, 2, 3, 5, 6, 7}), Contains("1 of 7"));
  CHECK_THAT(says({0, 2, 6, 8, 12, 14}, {}), Contains("2 of 8 in all"));
  // The numbers continue across a gap, or jump without a gap.
  CHECK(says({0, 2, 4, 8, 10}, {1, 2, 3, 4, 5}) == "none");
  CHECK(says({0, 2, 4, 6, 8}, {1, 2, 3, 7, 8}) == "none");
}

TEST_CASE("DICOM localisers and screen saves are skipped with a note that names a file",
          "[dicom]") {
  std::vector<File> files = axial();
  files.push_back(files.front());
  files.back().path = "scout";
  files.back().is_localiser = true;
  files.back().slices.front().row = Vec3::UnitY();
  files.push_back(files.front());
  files.back().path = "screen";
  files.back().is_capture = true;
  files.back().is_colour = true;
  std::vector<std::string> notes;
  const std::vector<Series> one = seriesOf(files);
  const Series rest = withoutStrays(one.front(), notes);
  CHECK(rest.files.size() == kImages);
  REQUIRE(notes.size() == 1);
  CHECK_THAT(notes.front(), Contains("2 of 7 files, such as scout: a localiser"));
  CHECK(stackOf(rest, "the series").steps.front().size() == kImages);

  // Now the localiser and the screen save belong to other series.
  files[kImages].series = "1.2.4";
  files[kImages + 1].series = "1.2.5";
  notes.clear();
  const std::vector<Series> all = seriesOf(files);
  CHECK(chosen(all, Request(), notes).uid == "1.2.3");
  REQUIRE(notes.size() == 2);
  CHECK_THAT(notes[0], Contains("1 image in scout: a localiser"));
  CHECK_THAT(notes[1], Contains("1 image in screen: a screen save"));
  for (File& file : files) {
    file.is_localiser = true;
    file.series = "1.2.3";
  }
  const std::vector<Series> localisers = seriesOf(files);
  CHECK(withoutStrays(localisers.front(), notes).files.size() == files.size());
}

TEST_CASE("a DICOM screen save with a position among the slices is skipped", "[dicom]") {
  // If the slices are captures too, only ImageType distinguishes the screen save from them.
  for (const bool captures : {false, true}) {
    for (const double beyond : {1.0, 0.5}) {
      std::vector<File> files = axial();
      for (File& file : files) file.is_capture = captures;
      files.push_back(files.back());
      files.back().path = "screen";
      files.back().is_capture = true;
      files.back().is_screen_save = true;
      files.back().slices.front().position.z() += beyond;
      std::vector<std::string> notes;
      const std::vector<Series> all = seriesOf(files);
      const Series rest = withoutStrays(all.front(), notes);
      CHECK(rest.files.size() == kImages);
      REQUIRE(notes.size() == 1);
      CHECK_THAT(notes.front(), Contains("1 of 6 files, such as screen: a screen save"));
    }
  }
}

TEST_CASE("DICOM images at the same position are time steps if they state different times",
          "[dicom]") {
  const auto twice = [](std::size_t tag, double later) {
    std::vector<File> files = axial();
    const std::vector<File> again = files;
    files.insert(files.end(), again.begin(), again.end());
    for (std::size_t i = 0; i < files.size(); ++i) {
      files[i].slices.front().times[tag] = i < again.size() ? 0.0 : later;
    }
    return files;
  };
  // Trigger times are in milliseconds, temporal offsets in seconds.
  CHECK(stacked(twice(0, 250.0)).times == std::vector<double>{0.0, 0.25});
  const Stack stack = stacked(twice(2, 1.5));
  CHECK(stack.times == std::vector<double>{0.0, 1.5});
  REQUIRE(stack.steps.size() == 2);
  CHECK(stack.steps[1].size() == kImages);
  // A number of a step becomes a time by TemporalResolution. Without it, a time step of 1 s is
  // assumed.
  std::vector<File> numbered = twice(3, 1.0);
  CHECK_THAT(stacked(numbered).notes.front(), Contains("a time step of 1 s is assumed"));
  for (File& file : numbered) file.time_step = 0.04;
  CHECK(stacked(numbered).times == std::vector<double>{0.0, 0.04});
  numbered.back().time_step = 0.05;
  CHECK_THROWS_WITH(stacked(numbered), Contains("0.04 s in image0, 0.05 s in image2"));
  numbered.back().time_step = 0.0;
  CHECK_THROWS_WITH(stacked(numbered), Contains("(TemporalResolution): 0.04 s in image0, none in"));
  // Images of different kinds are not time steps.
  std::vector<File> kinds = twice(0, 250.0);
  for (std::size_t i = 0; i < kinds.size(); ++i) {
    kinds[i].slices.front().kinds[0] = i < kImages ? "10" : "80";
  }
  CHECK_THROWS_WITH(stacked(kinds), Contains("differ in echo time"));
  // A step lacks one image.
  std::vector<File> fewer = twice(0, 250.0);
  const std::vector<File> third(fewer.begin(), fewer.begin() + kImages);
  fewer.insert(fewer.end(), third.begin(), third.end());
  for (std::size_t i = 2 * kImages; i < fewer.size(); ++i) {
    fewer[i].slices.front().times[0] = 500.0;
  }
  fewer.pop_back();
  CHECK_THROWS_WITH(stacked(fewer), Contains("time steps are missing: 2 images are at"));
}
