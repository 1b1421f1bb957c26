#include <string>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/slice_names.h"
#include "palpate/scenes/apps/import/slice_spacing.h"

namespace palpate::slices_test {
using Catch::Contains;
using importer::FolderFile;
using importer::PictureKind;

importer::SliceNames ordered(const std::vector<std::string>& names) {
  std::vector<FolderFile> files;
  for (const std::string& name : names) {
    const bool is_tiff = name.find(".tif") != std::string::npos;
    const bool is_png = name.find(".png") != std::string::npos;
    files.push_back({name, is_tiff  ? PictureKind::kTiff
                           : is_png ? PictureKind::kPng
                                    : PictureKind::kNone});
  }
  return importer::orderSlices("folder", files);
}

TEST_CASE("slices are in the order of the one number that differs between their names",
          "[slices]") {
  using Names = std::vector<std::string>;
  CHECK(ordered({"a10.tif", "a2.tif", "a6.tif"}).slices == Names{"a2.tif", "a6.tif", "a10.tif"});
  CHECK(ordered({"3_b_2020.png", "03_b_2019.png"}).slices ==
        Names{"03_b_2019.png", "3_b_2020.png"});
  CHECK(ordered({"000000000000000001.tif", "2.tif"}).slices.size() == 2);
  // A run of more than 18 digits is text.
  CHECK(ordered({"1234567890123456789_2.tif", "1234567890123456789_1.tif"}).slices.front() ==
        "1234567890123456789_1.tif");
  CHECK_THROWS_WITH(ordered({"1234567890123456789_2.tif", "1234567890123456788_1.tif"}),
                    Contains("differ only in a number"));
  // A "#" in a name is not a number.
  CHECK_THROWS_WITH(ordered({"a#.tif", "a1.tif"}), Contains("differ only in a number"));
  CHECK(ordered({"1.tif", "2.tif", "1.png", "x", "4.txt"}).notes.front() ==
        "ignored 3 of 5 files, which are not slices of this series, such as 1.png");
  CHECK_THROWS_WITH(ordered({}), Contains("differ only in a number"));
}

TEST_CASE("a series whose numbers increase by unequal steps is refused as incomplete", "[slices]") {
  CHECK(ordered({"1.tif", "2.tif", "3.tif"}).step == 1);
  CHECK(ordered({"1.tif", "3.tif", "5.tif"}).step == 2);
  CHECK_THROWS_WITH(ordered({"1.tif", "3.tif", "4.tif"}), Contains("after 1.tif comes 3.tif"));
  CHECK_THROWS_WITH(ordered({"0.tif", "999999999999999999.tif", "1.tif"}),
                    Contains("after 1.tif comes 999999999999999999.tif"));
}

TEST_CASE("option --spacing takes three positive lengths and converts nm to um", "[slices]") {
  const importer::Spacing plain = importer::spacingOf("0.5,1e-3,2");
  CHECK(plain.edges == Vec3(0.5, 1e-3, 2.0));
  CHECK(plain.unit.empty());
  const importer::Spacing nm = importer::spacingOf("8,8,40nm");
  CHECK((nm.edges - Vec3(0.008, 0.008, 0.04)).norm() < 1e-15);
  CHECK(nm.unit == "um");
  CHECK(importer::spacingOf("1,2,3\xc2\xb5m").unit == "um");
  for (const char* bad : {"", ",", ",,", "1,2", "1,2,", "1,2,3,", "1,2,3,4mm", "0,1,2", "-1,1,1",
                          "1,2,3 mm", "1,2,mm", "1e400,1,1", "1,2,3e", "inf,1,1"}) {
    CAPTURE(bad);
    CHECK_THROWS_WITH(importer::spacingOf(bad), Contains("--spacing"));
  }
}

TEST_CASE("descriptions of TIFF files that state no length give no spacing", "[slices]") {
  const auto edges = [](const std::string& description) {
    return importer::statedBy({description, 2.0, 4.0, 1}).spacing.edges;
  };
  CHECK(edges("ImageJ=1\nimages=2\nunit=mm\nspacing=3").isApprox(Vec3(0.5, 0.25, 3.0)));
  CHECK(edges("ImageJ=1\r\nimages=2\r\nunit=mm\r\n").isApprox(Vec3(0.5, 0.25, 1.0)));
  CHECK(edges("ImageJ=1\nunit=mm").isApprox(Vec3(0.5, 0.25, 0.0)));
  for (const char* text :
       {"", "\n", "ImageJ=1\nimages=2", "ImageJ=1\nimages=2\nunit=pixel",
        "ImageJ=1\nunit=", "ImageJ=1\nunit=mm\nzunit=um\nspacing=1", "unit=mm\nspacing=1", "<OME",
        "<OME <Pixels", "<OME><Pixels PhysicalSizeX=\"1", "<OME><Pixels PhysicalSizeX=\"1e999\">",
        "<OME><Pixels PhysicalSizeX=\"1\" PhysicalSizeXUnit=\"pixel\">"}) {
    CAPTURE(text);
    CHECK(edges(text).isZero(0.0));
  }
  // If lengths have different units, all are ignored.
  CHECK(edges("<OME><Pixels PhysicalSizeX='1' PhysicalSizeY='1' PhysicalSizeYUnit='mm'/>")
            .isZero(0.0));
}

}  // namespace palpate::slices_test
