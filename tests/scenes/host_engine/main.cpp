/// A host program with its own field, which links only palpate's engine.
#include <cstdio>
#include <palpate/engine/error.h>
#include <palpate/engine/tick/step.h>
#include <palpate/samplers/grid/analytic_field.h>

int main() try {
  palpate::GraphSpec graph;
  palpate::ModeSpec skin;
  skin.kind = palpate::ModeKind::kIsosurface;
  skin.of = "ball";
  skin.value = 0.0;
  skin.solid = palpate::Solid::kBelow;
  skin.strength = 3.0;
  graph.modes.push_back(skin);
  const auto scene =
      palpate::makeScene(graph, {{"ball", palpate::makeSphere(palpate::Vec3::Zero(), 0.04)}});
  palpate::Reader reader;
  palpate::ProxyState state;
  palpate::StepReport report;
  for (int i = 0; i <= 640; ++i) {
    const palpate::HandState hand{{0.0, 0.0, 0.1 - 1e-4 * i}};
    report = palpate::hapticStep(*scene, reader, hand, state, 1e-3);
  }
  std::printf("force %.2f N, proxy %.1f mm\n", report.force.z(), 1e3 * report.proxy.z());
} catch (const palpate::Error& e) {
  std::fprintf(stderr, "%s\n", e.what());
  return 1;
}
