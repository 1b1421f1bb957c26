// Feels an array in memory. See docs/embed.md.
#include <cmath>
#include <cstdio>
#include <memory>
#include <vector>

#include "palpate/scenes/palpate.h"

using namespace palpate;

// Copies an array of n x n x n values into a volume with its centre at 0. Index i varies fastest.
std::shared_ptr<const Volume> volumeOf(const std::vector<float>& values, int n) {
  VoxelArray array;
  array.values = values.data();
  array.size = {n, n, n};
  array.stride = {4, 4 * n, 4 * n * n};            // [bytes]
  array.axes = 1e-3 * Mat3::Identity();            // voxels of 1 mm, in metres
  array.origin = Vec3::Constant(-5e-4 * (n - 1));  // [m]
  array.background = -100.0;                       // outside of the array
  return makeVolume(array);
}

int main() try {
  constexpr int kEdge = 61;
  std::vector<float> depth;  // in a ball of radius 20 voxels
  for (int k = -30; k <= 30; ++k) {
    for (int j = -30; j <= 30; ++j) {
      for (int i = -30; i <= 30; ++i) {
        depth.push_back(20.0F - std::sqrt(static_cast<float>(i * i + j * j + k * k)));
      }
    }
  }
  SceneSpec spec;
  spec.volumes["ball"].volume = volumeOf(depth, kEdge);
  spec.volumes["ball"].place.kind = PlaceSpec::Kind::kMap;  // the array is in metres
  ModeSpec skin;
  skin.kind = ModeKind::kIsosurface;
  skin.of = "ball";
  skin.strength = 2.0;
  spec.graph.modes.push_back(skin);
  const BuiltScene built = buildScene(spec);

  Reader reader;
  ProxyState state;
  StepReport report;
  for (int tick = 0; tick <= 70; ++tick) {
    const HandState hand{{0.0, 0.0, 0.025 - 1e-4 * tick}};
    report = hapticStep(*built.scene, reader, hand, state, 1e-3);
  }
  std::printf("array: 2 mm inside: %.1f N\n", report.force.z());
} catch (const Error& e) {
  std::fprintf(stderr, "array: %s\n", e.what());
  return 2;
}
