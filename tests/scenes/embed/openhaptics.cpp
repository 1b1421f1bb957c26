// Runs palpate in a callback of OpenHaptics' scheduler. See docs/embed.md.
#include <HD/hd.h>
#include <cstdio>

#include "ball.h"

// OpenHaptics uses millimetres, with x right, y up, z towards the user. palpate uses metres, with z
// up.
const palpate::Mat3 kFromArm = (palpate::Mat3() << 1, 0, 0, 0, 0, -1, 0, 1, 0).finished();

palpate::DeviceInfo infoOfArm() {
  HDdouble peak = 0.0;
  HDdouble stiffness = 0.0;  // [N/mm]
  hdGetDoublev(HD_NOMINAL_MAX_FORCE, &peak);
  hdGetDoublev(HD_NOMINAL_MAX_STIFFNESS, &stiffness);
  palpate::DeviceInfo info;
  info.name = "openhaptics";
  info.limits.peak = peak;
  info.max_stiffness = 1e3 * stiffness;
  return info;
}

HDCallbackCode HDCALLBACK onServo(void* data) {
  auto& servo = *static_cast<palpate::Servo*>(data);
  hdBeginFrame(hdGetCurrentDevice());
  HDdouble rate = 1000.0;
  hdGetDoublev(HD_INSTANTANEOUS_UPDATE_RATE, &rate);
  HDdouble millimetres[3];
  hdGetDoublev(HD_CURRENT_POSITION, millimetres);
  palpate::HandState hand;
  hand.position = kFromArm * palpate::Vec3(millimetres[0], millimetres[1], millimetres[2]) * 1e-3;
  const palpate::Vec3 force = kFromArm.transpose() * servo.tick(hand, 1.0 / rate);
  const HDdouble newtons[3] = {force.x(), force.y(), force.z()};
  hdSetDoublev(HD_CURRENT_FORCE, newtons);
  hdEndFrame(hdGetCurrentDevice());
  return HD_CALLBACK_CONTINUE;
}

int main(int argc, char**) try {
  // With an argument, as in the test, the loop runs in virtual time. With an arm, keep `real` true.
  const bool real = argc < 2;
  const palpate::DeviceInfo info = infoOfArm();
  palpate::Servo servo(info, 1000.0, real);
  servo.publish(ball(info));
  for (int i = 0; i <= 639; ++i) onServo(&servo);
  std::printf("openhaptics: force %.2f N, fault: %s\n", hd_shape::sent[1],
              palpate::wordFor(servo.latest().fault));
} catch (const palpate::Error& e) {
  std::fprintf(stderr, "openhaptics: %s\n", e.what());
  return 2;
}
