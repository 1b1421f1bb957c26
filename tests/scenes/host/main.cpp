/// A host program that runs a palpate scene and has headers with the same names as palpate's.
#include <cstdio>

#include "engine/step.h"
#include "scenes/build_scene.h"

int main() {
  const palpate::Guardian guardian;
  const palpate::BuiltScene ball = host::buildScene();
  palpate::Reader reader;
  palpate::ProxyState state;
  palpate::StepReport report;
  for (int step = 0; step <= host::kSteps; ++step) {
    const palpate::HandState hand{{0.0, 0.0, 0.1 - 1e-4 * step}};
    report = palpate::hapticStep(*ball.scene, reader, hand, state, 1e-3);
  }
  palpate::DeviceOptions options;
  options.target = palpate::explore(ball.bounds, 1.0);
  const auto device = palpate::openDevice("simulated", options);
  std::printf("%s: force %.2f N, proxy %.1f mm\n", device->info().name.c_str(), report.force.z(),
              1e3 * report.proxy.z());
}
