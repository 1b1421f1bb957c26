/// Small .vdb files for tests.
#pragma once

#include <filesystem>
#include <string>

namespace palpate::test {

/// A temporary folder, removed by the destructor.
class TemporaryFolder {
 public:
  TemporaryFolder();
  ~TemporaryFolder();
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  [[nodiscard]] std::filesystem::path operator/(const std::string& name) const {
    return path_ / name;
  }
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

/// Writes these files into a folder:
/// - ball.vdb: "ball", level set of a sphere of radius 2, voxels of 0.1, half-width 3;
/// - labels.vdb: "labels", integers, not usable as a field; mixed.vdb: "ball" and "labels";
/// - linear.vdb: "density" = x + 2 y - z and "velocity" = (-y, x, 3 z), 9^3 voxels of 0.5 from 0;
/// - nan.vdb: "density" as in linear.vdb, with one NaN.
void writeTestVolumes(const std::filesystem::path& folder);

}  // namespace palpate::test
