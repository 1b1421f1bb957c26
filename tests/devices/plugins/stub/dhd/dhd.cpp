#include <algorithm>
#include <chrono>
#include <cmath>
#include <dhdc.h>
#include <thread>

namespace {

stub_dhd::Arm* the_arm = new stub_dhd::Arm;
std::atomic<int> last{DHD_NO_ERROR};

int fails(int error) {
  last = error;
  return -1;
}

int answer() {
  return the_arm->lost ? fails(DHD_ERROR_COM) : 0;
}

}  // namespace

namespace stub_dhd {
Arm& arm() {
  return *the_arm;
}
void plugAnew() {
  delete the_arm;
  the_arm = new Arm;
}
}  // namespace stub_dhd

extern "C" {

int dhdErrorGetLast() {
  return last;
}
const char* dhdErrorGetLastStr() {
  return last == DHD_ERROR_NO_DEVICE_FOUND ? "no device found" : "communication error";
}
int dhdGetDeviceCount() {
  return the_arm->count;
}
int dhdOpen() {
  return dhdOpenID(0);
}
int dhdOpenID(char id) {
  if (id >= the_arm->count) return fails(DHD_ERROR_NO_DEVICE_FOUND);
  ++the_arm->open;
  return id;
}
int dhdOpenSerial(int serial) {
  return serial == 4711 ? dhdOpenID(0) : fails(DHD_ERROR_NO_DEVICE_FOUND);
}
int dhdClose(char) {
  --the_arm->open;
  return 0;
}
int dhdStop(char) {
  for (const double f : the_arm->force) {
    the_arm->force_at_stop = std::max(the_arm->force_at_stop, std::abs(f));
  }
  std::fill(the_arm->force, the_arm->force + 3, 0.0);
  return 0;
}
int dhdGetSerialNumber(ushort* sn, char) {
  *sn = 4711;
  return 0;
}
int dhdGetSystemType(char) {
  return the_arm->type;
}
const char* dhdGetSystemName(char) {
  return the_arm->type == DHD_DEVICE_SIGMA331 ? "sigma.7" : "omega.7";
}
int dhdGetStatus(int status[DHD_MAX_STATUS], char) {
  std::fill(status, status + DHD_MAX_STATUS, 0);
  status[DHD_STATUS_RESET] = the_arm->reset ? 1 : 0;
  status[DHD_STATUS_POWER] = the_arm->power ? 1 : 0;
  status[DHD_STATUS_FORCE] = the_arm->force_on ? 1 : 0;
  return answer();
}
int dhdSetStandardGravity(double g, char) {
  the_arm->gravity = g;
  return answer();
}
int dhdSetGravityCompensation(int val, char) {
  the_arm->carries = val == DHD_ON;
  return answer();
}
int dhdEnableForce(uchar, char) {
  return answer();
}
int dhdWaitForReset(int, char) {
  if (the_arm->lost) return fails(DHD_ERROR_COM);
  std::this_thread::sleep_for(std::chrono::milliseconds(1));
  return the_arm->reset ? 0 : fails(DHD_ERROR_TIMEOUT);
}
bool dhdHasWrist(char) {
  return the_arm->type != DHD_DEVICE_OMEGA3;
}
bool dhdHasActiveWrist(char) {
  return the_arm->type == DHD_DEVICE_SIGMA331;
}
bool dhdHasGripper(char) {
  return the_arm->type == DHD_DEVICE_OMEGA331;
}
int dhdGetPositionAndOrientationFrame(double* px, double* py, double* pz, double matrix[3][3],
                                      char) {
  the_arm->gate.arrive();
  if (answer() < 0 || (the_arm->fails > 0 && the_arm->fails-- > 0)) return -1;
  *px = the_arm->position[0];
  *py = the_arm->position[1];
  *pz = the_arm->position[2];
  std::copy(&the_arm->turned[0][0], &the_arm->turned[0][0] + 9, &matrix[0][0]);
  return the_arm->old ? DHD_TIMEGUARD : 0;
}
int dhdGetLinearVelocity(double* vx, double* vy, double* vz, char) {
  *vx = *vy = *vz = 99.0;
  if (the_arm->no_speed) return fails(DHD_ERROR_TIMEOUT);
  *vx = the_arm->velocity[0];
  *vy = the_arm->velocity[1];
  *vz = the_arm->velocity[2];
  return answer();
}
int dhdGetGripperAngleRad(double* a, char) {
  *a = the_arm->gripper;
  return answer();
}
uint dhdGetButtonMask(char) {
  return the_arm->buttons;
}
int dhdSetForceAndTorqueAndGripperForce(double fx, double fy, double fz, double tx, double ty,
                                        double tz, double fg, char) {
  if (answer() < 0) return -1;
  const double force[3] = {fx, fy, fz};
  std::copy(force, force + 3, the_arm->force);
  the_arm->rest = std::max({the_arm->rest, std::abs(tx), std::abs(ty), std::abs(tz), std::abs(fg)});
  return 0;
}
int dhdEnableExpertMode() {
  the_arm->expert = true;
  return 0;
}
int dhdDisableExpertMode() {
  the_arm->expert = false;
  return 0;
}
int dhdSetWatchdog(unsigned char val, char) {
  if (!the_arm->expert) return fails(DHD_ERROR);
  the_arm->watchdog = val;
  return 0;
}
}
