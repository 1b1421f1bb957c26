/// A stub of Force Dimension's SDK: the published names that the plug-in uses, and a simulated arm.
/// We wrote the declarations and chose the values of the constants.
#pragma once

#include <atomic>

#include "../../gate.h"

using ushort = unsigned short;
using uint = unsigned int;
using uchar = unsigned char;

enum { DHD_NO_ERROR, DHD_ERROR, DHD_ERROR_COM, DHD_ERROR_NO_DEVICE_FOUND, DHD_ERROR_TIMEOUT };
enum {
  DHD_DEVICE_OMEGA3 = 1,
  DHD_DEVICE_OMEGA33,
  DHD_DEVICE_OMEGA33_LEFT,
  DHD_DEVICE_OMEGA331,
  DHD_DEVICE_OMEGA331_LEFT,
  DHD_DEVICE_DELTA3,
  DHD_DEVICE_FALCON,
  DHD_DEVICE_SIGMA331,
};
#define DHD_OFF 0
#define DHD_ON 1
#define DHD_TIMEGUARD 1
#define DHD_MAX_STATUS 16
#define DHD_STATUS_POWER 0
#define DHD_STATUS_RESET 3
#define DHD_STATUS_FORCE 5

extern "C" {
int dhdErrorGetLast();
const char* dhdErrorGetLastStr();
int dhdGetDeviceCount();
int dhdOpen();
int dhdOpenID(char ID);
int dhdOpenSerial(int serial);
int dhdClose(char ID = -1);
int dhdStop(char ID = -1);
int dhdGetSerialNumber(ushort* sn, char ID = -1);
int dhdGetSystemType(char ID = -1);
const char* dhdGetSystemName(char ID = -1);
int dhdGetStatus(int status[DHD_MAX_STATUS], char ID = -1);
int dhdSetStandardGravity(double g, char ID = -1);
int dhdSetGravityCompensation(int val = DHD_ON, char ID = -1);
int dhdEnableForce(uchar val, char ID = -1);
int dhdWaitForReset(int timeout = 0, char ID = -1);
bool dhdHasWrist(char ID = -1);
bool dhdHasActiveWrist(char ID = -1);
bool dhdHasGripper(char ID = -1);
int dhdGetPositionAndOrientationFrame(double* px, double* py, double* pz, double matrix[3][3],
                                      char ID = -1);
int dhdGetLinearVelocity(double* vx, double* vy, double* vz, char ID = -1);
int dhdGetGripperAngleRad(double* a, char ID = -1);
uint dhdGetButtonMask(char ID = -1);
int dhdSetForceAndTorqueAndGripperForce(double fx, double fy, double fz, double tx, double ty,
                                        double tz, double fg, char ID = -1);
int dhdEnableExpertMode();
int dhdDisableExpertMode();
int dhdSetWatchdog(unsigned char val, char ID = -1);
}

/// The arm. The test may access it while the plug-in's loop waits at the gate; atomic members at
/// any time.
namespace stub_dhd {
struct Arm {
  Gate gate;
  int count = 1;
  int type = DHD_DEVICE_OMEGA331;
  double position[3] = {};  // [m]
  double velocity[3] = {};
  double turned[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  double gripper = 0.0;
  bool old = false;       // a read came too soon: DHD_TIMEGUARD
  bool no_speed = false;  // the SDK has too few readings for a velocity
  uint buttons = 0;
  std::atomic<bool> reset{true};
  bool power = true;
  bool force_on = true;
  std::atomic<bool> lost{false};
  double force[3] = {};
  double force_at_stop = -1.0;  // largest force component when dhdStop was called; -1: never
  double rest = 0.0;            // largest torque or gripper force so far
  double gravity = 9.81;        // gravity from which the weight is computed [m/s^2]
  bool carries = true;          // gravity compensation is on, as on a new arm
  int fails = 0;                // number of further reads of the position that fail
  int watchdog = 0;
  bool expert = false;
  int open = 0;
};
Arm& arm();
void plugAnew();
}  // namespace stub_dhd
