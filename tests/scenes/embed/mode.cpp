// A user's own mode: resistance where a value is in a band. See docs/embed.md.
#include <cstdio>

#include "palpate/scenes/palpate.h"

using namespace palpate;

struct Band {
  double low = 0.0;
  double high = 0.0;
  double strength = 0.0;  // [N]
};

// Each tick calls this function once per balance. A point at the proxy is a drag: it holds the
// proxy while the spring's force is at most the point's strength.
bool placeHoney(void* state, const ModeInput& input, PrimitiveSet& set) noexcept {
  const Band& band = *static_cast<const Band*>(state);
  const auto index = static_cast<std::size_t>(input.reads[0]);
  const Properties::Scalar& value = input.properties.scalars[index];
  const bool within = value.inside && value.value > band.low && value.value < band.high;
  return set.tryAdd(
      {PrimitiveKind::kPoint, input.proxy, Vec3::UnitX(), within ? band.strength : 0.0});
}

int main() try {
  SceneSpec spec;
  spec.volumes["distance"].field = makeSphere(Vec3::Zero(), 0.04);  // distance to the ball's
                                                                    // surface [m]
  ModeSpec honey;
  honey.name = "honey";
  honey.kind = ModeKind::kUser;
  honey.user = {&placeHoney, std::make_shared<Band>(Band{0.005, 0.015, 0.5}), {"distance"}};
  spec.graph.modes.push_back(honey);
  const BuiltScene built = buildScene(spec);

  Reader reader;
  ProxyState state;
  for (int tick = 0; tick <= 250; ++tick) {
    const HandState hand{{0.0, 0.0, 0.06 - 1e-4 * tick}};
    const StepReport report = hapticStep(*built.scene, reader, hand, state, 1e-3);
    if (tick % 100 != 0) continue;
    std::printf("%s%.0f mm: %.2f N", tick == 0 ? "honey: " : ", ", 1e3 * hand.position.z(),
                report.force.z());
  }
  std::printf("\n");
} catch (const Error& e) {
  std::fprintf(stderr, "honey: %s\n", e.what());
  return 2;
}
