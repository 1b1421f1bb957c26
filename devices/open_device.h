/// From words, as `simulated` or `hid:polhem`, to a device: the same in every program.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "palpate/devices/open_arm.h"
#include "palpate/devices/simulated_device.h"
#include "palpate/engine/device.h"

namespace palpate {

/// What is asked of a device, whatever it is.
struct DeviceOptions {
  double rate = 1000.0;  ///< Ticks a second [Hz], > 0.
  HandTarget target;     ///< Of a simulated hand.
  HandTarget mouse;      ///< Where a window's mouse means the hand to be; may be empty.
  HandTarget client;     ///< Where a client of the program's server does; may be empty.
  bool realtime =
      false;  ///< The loop keeps time: an arm wants it; a simulated one is as a real one.
  bool passive = false;                         ///< The energy tank acts.
  double refill = 0.0;                          ///< TankParams::refill [W].
  std::function<void(const std::string&)> say;  ///< What its user should know; may be empty.
  std::function<bool()> stop;                   ///< Asked while an arm is waited for; may be empty.
};

/// One of
///
/// - `simulated`: an arm and a hand made of numbers
/// - `simulated:TROUBLE`, `simulated:TROUBLE@SECONDS`: with a trouble (faulty_device.h) from then
/// on
/// - `mouse`: such a hand that a window's mouse leads
/// - `igtl`: such a hand that 3D Slicer leads
/// - `path:FILE.csv`: a hand that follows a path exactly; - is standard input
/// - `replay:FILE`, `replay:FILE@SECONDS`: a hand that was recorded, from there on
/// - `hid`, `hid:PROFILE`, `hid:PROFILE@SERIAL`, `hid:FILE.json`: an arm (openArm)
/// - `plugin:NAME`, `plugin:NAME@SERIAL`: an arm of a plug-in, which runs in a process of its own;
/// `plugin-inside:NAME` in this one (openPluginArm)
///
/// Throws Error: what is wrong with it, and what to write. Slow: an arm may home itself.
[[nodiscard]] std::unique_ptr<Device> openDevice(const std::string& name,
                                                 const DeviceOptions& options);

/// The last two, for what is asked of arms alone. Throws as openDevice.
[[nodiscard]] OpenedArm openAnyArm(const std::string& name, const ArmHost& host);

}  // namespace palpate
