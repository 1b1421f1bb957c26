/// The smallest program with palpate: the force on a hand that presses on a ball.
#include <cstdio>

#include "palpate/engine/error.h"
#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/analytic_field.h"
#include "palpate/scenes/library/build_scene.h"

int main() try {
  using namespace palpate;

  // A scene: one volume with a surface of 3 N. For a level set in a file write
  //   spec.volumes["ball"].file = "ball.vdb";  // its longest side becomes 0.1 m
  SceneSpec spec;
  spec.volumes["ball"].field = makeSphere(/*centre=*/Vec3::Zero(), /*radius=*/0.04);
  ModeSpec skin;
  skin.kind = ModeKind::kIsosurface;
  skin.of = "ball";
  skin.value = 0.0;
  skin.solid = Solid::kBelow;
  skin.strength = 3.0;
  spec.graph.modes.push_back(skin);
  const BuiltScene ball = buildScene(spec);

  // Ticks: the hand moves down onto the ball from 0.1 m, with 0.1 m/s at 1 kHz.
  Reader reader;
  ProxyState state;
  for (int tick = 0; tick <= 640; ++tick) {
    const HandState hand{{0.0, 0.0, 0.1 - 1e-4 * tick}};
    const StepReport report = hapticStep(*ball.scene, reader, hand, state, 1e-3);
    if (tick % 20 == 0) {
      std::printf("hand %5.1f mm, proxy %5.1f mm, force %.2f N\n", 1e3 * hand.position.z(),
                  1e3 * report.proxy.z(), report.force.z());
    }
  }
} catch (const palpate::Error& e) {
  std::fprintf(stderr, "first_tick: %s\n", e.what());
  return 2;
}
