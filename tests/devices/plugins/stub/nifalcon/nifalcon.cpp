#include <falcon/core/FalconDevice.h>
#include <stdexcept>

namespace {
stub_nifalcon::Arm* the_arm = new stub_nifalcon::Arm;
}

namespace stub_nifalcon {
Arm& arm() {
  return *the_arm;
}
void plugAnew() {
  delete the_arm;
  the_arm = new Arm;
}
}  // namespace stub_nifalcon

namespace libnifalcon {

bool FalconFirmware::loadFirmware(bool, const unsigned int& size, std::uint8_t* buffer) {
  ++the_arm->loads;
  the_arm->firmware = the_arm->loads > the_arm->bad_loads && size == 4 && buffer[3] == 4;
  return the_arm->firmware;
}

unsigned FalconGrip::getDigitalInputs() const {
  return the_arm->buttons;
}

bool FalconDevice::getDeviceCount(unsigned& count) {
  count = the_arm->count;
  return true;
}

bool FalconDevice::open(unsigned index) {
  if (the_arm->throws) throw std::runtime_error("no USB");
  if (index >= the_arm->count || the_arm->refuses) return false;
  ++the_arm->open;
  return true;
}

void FalconDevice::close() {
  --the_arm->open;
}

bool FalconDevice::isFirmwareLoaded() {
  return the_arm->firmware;
}

// Like the library's function: sends the forces of the previous call to the motors. Then it updates
// position and forces, unless the arm is not homed or the kinematics has no solution.
bool FalconDevice::runIOLoop(unsigned) {
  the_arm->gate.arrive();
  if (the_arm->throws) throw std::runtime_error("no USB");
  if (!the_arm->firmware || the_arm->lost || the_arm->quiet) return false;
  the_arm->motors = firmware_->forces_;
  if (firmware_->homing_ && the_arm->homes_after >= 0 && the_arm->homes_after-- == 0) {
    the_arm->homed = 7;
  }
  firmware_->homed_ = the_arm->homed;
  ++firmware_->loops_;
  if (the_arm->beyond || !firmware_->isHomed()) return false;
  position_ = the_arm->position;
  for (std::size_t i = 0; i < 3; ++i) firmware_->forces_[i] = static_cast<int>(force_[i] * 1e3);
  return true;
}

}  // namespace libnifalcon
