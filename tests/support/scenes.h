/// Scenes and devices for tests of the loop.
#pragma once

#include <atomic>
#include <chrono>
#include <memory>
#include <thread>
#include <utility>
#include <vector>

#include "palpate/engine/safety/device.h"
#include "palpate/engine/scene/scene.h"
#include "palpate/samplers/grid/analytic_field.h"

namespace palpate::test {

inline constexpr double kBallRadius = 0.03;  ///< [m]

inline FieldPtr ballField() {
  return makeSphere(Vec3::Zero(), kBallRadius);
}
/// Returns a scene with an isosurface of volume "ball", solid inside, of this strength [N].
inline GraphSpec ballSpec(double strength = 3.0) {
  GraphSpec spec;
  spec.modes.resize(1);
  spec.modes[0].kind = ModeKind::kIsosurface;
  spec.modes[0].of = "ball";
  spec.modes[0].solid = Solid::kBelow;
  spec.modes[0].strength = strength;
  return spec;
}
inline std::shared_ptr<const Scene> ballScene(const FieldPtr& ball, double strength = 3.0,
                                              const CouplingParams& coupling = {}) {
  return makeScene(ballSpec(strength), {{"ball", ball}}, coupling);
}

/// A device whose position a test sets. Stores the force that it receives.
class TestDevice final : public Device {
 public:
  TestDevice() {
    about.name = "test";
    about.limits = {8.0, 2000.0};
  }
  [[nodiscard]] const DeviceInfo& info() const noexcept override { return about; }
  [[nodiscard]] HandState read() noexcept override { return hand; }
  void write(const Vec3& force) noexcept override {
    sent = force;
    ++writes;
    if (write_ms > 0) std::this_thread::sleep_for(std::chrono::milliseconds(write_ms));
  }

  [[nodiscard]] double given() const noexcept override { return share; }

  HandState hand;
  double share = 1.0;  ///< Share of a force that the motors give.
  Vec3 sent = Vec3::Zero();
  long writes = 0;
  int write_ms = 0;  ///< Duration of a write [ms].
  DeviceInfo about;
};

}  // namespace palpate::test
