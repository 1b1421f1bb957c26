// A stub of CHAI3D's header with the names that docs/embed.md's program uses. Its arm moves down
// from 0.1 m at 0.1 m/s, in steps of 1 ms.
#pragma once

#include <cmath>

namespace chai3d {

struct cVector3d {
  double v[3] = {0.0, 0.0, 0.0};
  cVector3d() = default;
  cVector3d(double x, double y, double z) : v{x, y, z} {}
  double x() const { return v[0]; }
  double y() const { return v[1]; }
  double z() const { return v[2]; }
};

struct cHapticDeviceInfo {
  double m_maxLinearForce = 7.9;         // [N]
  double m_maxLinearStiffness = 1000.0;  // [N/m]
  double m_maxLinearDamping = 10.0;      // [N/(m/s)]
  double m_workspaceRadius = 0.1;        // [m]
};

class cGenericHapticDevice {
 public:
  cHapticDeviceInfo getSpecifications() const { return {}; }
  bool getPosition(cVector3d& position) {
    position = cVector3d(0.0, 0.0, 0.1 - 1e-4 * ticks_++);
    return true;
  }
  bool setForce(const cVector3d& force) {
    sent = force;
    return true;
  }
  cVector3d sent;

 private:
  int ticks_ = 0;
};

struct cPrecisionClock {
  double getCurrentTimeSeconds() { return 1e-3 * calls_++; }

 private:
  int calls_ = 0;
};

}  // namespace chai3d
