#include "tests/support/vdb_files.h"

#include <cstdlib>
#include <limits>
#include <unistd.h>

#include <openvdb/tools/LevelSetSphere.h>

#include "tests/support/vdb_grids.h"

namespace palpate::test {

using openvdb::Vec3d;

TemporaryFolder::TemporaryFolder() {
  std::string pattern = (std::filesystem::temp_directory_path() / "palpate-XXXXXX").string();
  path_ = mkdtemp(pattern.data());
}

TemporaryFolder::~TemporaryFolder() {
  std::error_code error;
  std::filesystem::remove_all(path_, error);
}

void writeVdb(const std::filesystem::path& file, const openvdb::GridPtrVec& grids) {
  openvdb::initialize();
  openvdb::io::File out(file.string());
  out.write(grids);
  out.close();
}

openvdb::FloatGrid::Ptr makeBall(double radius, double voxel) {
  openvdb::initialize();
  auto ball = openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(
      static_cast<float>(radius), openvdb::Vec3f(0, 0, 0), static_cast<float>(voxel), 3.0F);
  ball->setName("ball");
  return ball;
}

void writeTestVolumes(const std::filesystem::path& folder) {
  openvdb::initialize();
  const auto half_unit = openvdb::math::Transform::createLinearTransform(0.5);
  const auto ball = makeBall(2.0, 0.1);
  writeVdb(folder / "ball.vdb", {ball});

  auto labels = openvdb::Int32Grid::create();
  labels->setName("labels");
  labels->tree().setValue(openvdb::Coord(0, 0, 0), 1);
  writeVdb(folder / "labels.vdb", {labels});
  writeVdb(folder / "mixed.vdb", {ball, labels});

  auto density = makeGrid<openvdb::FloatGrid>(
      9, half_unit, [](const Vec3d& p) { return static_cast<float>(p.x() + 2 * p.y() - p.z()); });
  auto velocity = makeGrid<openvdb::Vec3SGrid>(
      9, half_unit, [](const Vec3d& p) { return openvdb::Vec3s(Vec3d(-p.y(), p.x(), 3 * p.z())); },
      "velocity");
  writeVdb(folder / "linear.vdb", {density, velocity});

  density->tree().setValue(openvdb::Coord(1, 1, 1), std::numeric_limits<float>::quiet_NaN());
  writeVdb(folder / "nan.vdb", {density});
}

}  // namespace palpate::test
