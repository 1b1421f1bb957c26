// Runs palpate in CHAI3D's haptics thread. See docs/embed.md.
#include "chai3d.h"

#include <cstdio>

#include "ball.h"

// CHAI3D uses metres and newtons, with x towards the user, y right, z up. palpate has x right, y
// away from the user, z up.
const palpate::Mat3 kFromArm = (palpate::Mat3() << 0, 1, 0, -1, 0, 0, 0, 0, 1).finished();

// The arm's limits, from CHAI3D.
palpate::DeviceInfo infoOf(chai3d::cGenericHapticDevice& device) {
  const chai3d::cHapticDeviceInfo known = device.getSpecifications();
  palpate::DeviceInfo info;
  info.name = "chai3d";
  info.limits.peak = known.m_maxLinearForce;
  info.max_stiffness = known.m_maxLinearStiffness;
  info.max_damping = known.m_maxLinearDamping;
  info.workspace_radius = known.m_workspaceRadius;
  return info;
}

// One cycle of CHAI3D's updateHaptics() loop.
void updateHaptics(chai3d::cGenericHapticDevice& device, palpate::Servo& servo, double dt) {
  chai3d::cVector3d position;
  palpate::HandState hand;
  if (device.getPosition(position)) {
    hand.position = kFromArm * palpate::Vec3(position.x(), position.y(), position.z());
  } else {
    hand.fault = palpate::Fault::kStale;
  }
  const palpate::Vec3 force = kFromArm.transpose() * servo.tick(hand, dt);
  device.setForce(chai3d::cVector3d(force.x(), force.y(), force.z()));
}

int main(int argc, char**) try {
  // With an argument, as in the test, the loop runs in virtual time. With an arm, keep `real` true.
  const bool real = argc < 2;
  chai3d::cGenericHapticDevice device;
  const palpate::DeviceInfo info = infoOf(device);
  palpate::Servo servo(info, 1000.0, real);
  servo.publish(ball(info));
  chai3d::cPrecisionClock clock;
  double last = clock.getCurrentTimeSeconds();
  for (int i = 0; i <= 639; ++i) {
    const double now = clock.getCurrentTimeSeconds();
    updateHaptics(device, servo, now - last);
    last = now;
  }
  std::printf("chai3d: force %.2f N, fault: %s\n", device.sent.z(),
              palpate::wordFor(servo.latest().fault));
} catch (const palpate::Error& e) {
  std::fprintf(stderr, "chai3d: %s\n", e.what());
  return 2;
}
