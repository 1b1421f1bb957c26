/// A stub of libnifalcon: the published names that the plug-in uses, and a simulated arm. We wrote
/// the declarations.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>

#include "../../../../gate.h"

namespace libnifalcon {

class FalconFirmware {
 public:
  enum { GREEN_LED = 2, BLUE_LED = 4, RED_LED = 8 };
  enum { ENCODER_1_HOMED = 1, ENCODER_2_HOMED = 2, ENCODER_3_HOMED = 4 };
  virtual ~FalconFirmware() = default;
  bool loadFirmware(bool skip_checksum, const unsigned int& size, std::uint8_t* buffer);
  void setForces(const std::array<int, 3>& force) { forces_ = force; }
  std::array<int, 3> getEncoderValues() { return {}; }
  void setLEDStatus(unsigned leds) { leds_ = leds; }
  void setHomingMode(bool value) { homing_ = value; }
  unsigned getHomingModeStatus() { return homed_; }
  bool isHomed() { return homed_ > 0; }
  std::uint64_t getLoopCount() { return loops_; }

 private:
  friend class FalconDevice;
  std::array<int, 3> forces_ = {};  // sent to the motors in the next exchange
  unsigned leds_ = 0;
  bool homing_ = false;
  unsigned homed_ = 0;
  std::uint64_t loops_ = 0;
};

class FalconKinematic {
 public:
  virtual ~FalconKinematic() = default;
  virtual void getWorkspaceOrigin(std::array<double, 3>& origin) { origin = {0.0, 0.0, 0.11}; }
};

class FalconGrip {
 public:
  virtual ~FalconGrip() = default;
  unsigned getDigitalInputs() const;
};

class FalconDevice {
 public:
  bool getDeviceCount(unsigned& count);
  bool open(unsigned index);
  void close();
  bool isFirmwareLoaded();
  bool runIOLoop(unsigned flags = 7);
  int getErrorCode() { return 1; }
  std::array<double, 3> getPosition() { return position_; }
  void setForce(std::array<double, 3> force) { force_ = force; }
  template <class T>
  void setFalconFirmware() {
    firmware_ = std::make_shared<T>();
  }
  template <class T>
  void setFalconKinematic() {
    kinematic_ = std::make_shared<T>();
  }
  template <class T>
  void setFalconGrip() {
    grip_ = std::make_shared<T>();
  }
  std::shared_ptr<FalconFirmware> getFalconFirmware() { return firmware_; }
  std::shared_ptr<FalconKinematic> getFalconKinematic() { return kinematic_; }
  std::shared_ptr<FalconGrip> getFalconGrip() { return grip_; }

 private:
  std::shared_ptr<FalconFirmware> firmware_;
  std::shared_ptr<FalconKinematic> kinematic_;
  std::shared_ptr<FalconGrip> grip_;
  std::array<double, 3> position_ = {};
  std::array<double, 3> force_ = {};
};

}  // namespace libnifalcon

/// The arm. The test may access it while the plug-in's loop waits at the gate; atomic members at
/// any time.
namespace stub_nifalcon {
struct Arm {
  Gate gate;
  unsigned count = 1;
  bool refuses = false;                               // the arm cannot be opened
  std::array<double, 3> position = {0.0, 0.0, 0.11};  // [m]
  bool beyond = false;  // the position is out of reach: the kinematics has no solution
  unsigned buttons = 0;
  std::atomic<bool> lost{false};
  std::atomic<bool> throws{false};
  std::atomic<bool> quiet{false};  // the arm sends no new data
  std::atomic<unsigned> homed{0};
  std::atomic<int> homes_after{5};  // number of exchanges until homed; -1: never
  bool firmware = false;
  int loads = 0;
  int bad_loads = 1;               // number of firmware uploads that fail before one succeeds
  std::array<int, 3> motors = {};  // in thousandths of a newton
  int open = 0;
};
Arm& arm();
void plugAnew();
}  // namespace stub_nifalcon
