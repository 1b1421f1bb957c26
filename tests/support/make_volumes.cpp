/// Writes the volumes of cli_test.py into a folder.
#include <filesystem>
#include <limits>

#include <openvdb/openvdb.h>
#include <openvdb/tools/LevelSetSphere.h>

#include "tests/support/vdb_files.h"

int main(int argc, char** argv) {
  using namespace palpate::test;
  using openvdb::Vec3d;
  if (argc != 2) return 2;
  const std::filesystem::path folder = argv[1];
  openvdb::initialize();
  const auto unit = openvdb::math::Transform::createLinearTransform(0.5);

  auto ball = openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(
      2.0F, openvdb::Vec3f(0, 0, 0), 0.1F, 3.0F);
  ball->setName("ball");
  writeVdb(folder / "ball.vdb", {ball});

  auto labels = openvdb::Int32Grid::create();
  labels->setName("labels");
  labels->tree().setValue(openvdb::Coord(0, 0, 0), 1);
  writeVdb(folder / "mixed.vdb", {ball, labels});

  auto density = makeGrid<openvdb::FloatGrid>(
      9, unit, [](const Vec3d& p) { return static_cast<float>(p.x() + 2 * p.y() - p.z()); });
  auto velocity = makeGrid<openvdb::Vec3SGrid>(
      9, unit, [](const Vec3d& p) { return openvdb::Vec3s(Vec3d(-p.y(), p.x(), 3 * p.z())); },
      "velocity");
  writeVdb(folder / "linear.vdb", {density, velocity});

  auto nan = density->deepCopy();
  nan->tree().setValue(openvdb::Coord(1, 1, 1), std::numeric_limits<float>::quiet_NaN());
  writeVdb(folder / "nan.vdb", {nan});
}
