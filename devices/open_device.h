/// Opens a device by its name, such as `simulated` or `hid:polhem`.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "palpate/devices/hid/open_arm.h"
#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/safety/device.h"

namespace palpate {

/// Options for opening a device of any kind.
struct DeviceOptions {
  double rate = 1000.0;  ///< Ticks per second [Hz], > 0.
  HandTarget target;     ///< Target that a simulated hand follows.
  HandTarget mouse;      ///< Target that the mouse in a window sets; may be empty.
  HandTarget client;     ///< Target that a client of the program's server sets; may be empty.
  /// The loop runs in real time, which a real arm requires. The loop then treats the device
  /// `simulated` like a real arm (DeviceInfo::hand).
  bool realtime = false;
  bool passive = false;  ///< True: the energy tank reduces the force (TankUse::kAct).
  double refill = 0.0;   ///< TankParams::refill [W].
  std::function<void(const std::string&)> say;  ///< Receives messages for the user; may be empty.
  /// Returns true if the program should end; polled while an arm is awaited. May be empty.
  std::function<bool()> stop;
  std::function<void()> stuck;  ///< See ArmHost::stuck.
};

/// Opens a device by its name:
///
/// - `simulated`: a simulated arm and hand
/// - `simulated:TROUBLE`, `simulated:TROUBLE@SECONDS`: the same with a defect (faulty_device.h),
///   which begins after 1 s, or after SECONDS
/// - `mouse`: a simulated hand that follows the mouse in a window
/// - `igtl`: a simulated hand that follows 3D Slicer
/// - `path:FILE.csv`: a hand that follows a path exactly; `path:-` reads standard input
/// - `replay:FILE`, `replay:FILE@SECONDS`: a recorded hand, from the start or from SECONDS on
/// - `hid`, `hid:PROFILE`, `hid:PROFILE@SERIAL`, `hid:FILE.json`: an arm (openArm)
/// - `plugin:NAME`, `plugin:NAME@SERIAL`: an arm of a plug-in, which runs in its own process;
///   `plugin-inside:NAME`, `plugin-inside:NAME@SERIAL` run it in this process (openPluginArm)
///
/// Throws Error with the problem and the remedy. Slow: an arm may home itself, or wait for its
/// user.
[[nodiscard]] std::unique_ptr<Device> openDevice(const std::string& name,
                                                 const DeviceOptions& options);

/// Opens an arm by a name that begins with `hid` or `plugin`. Throws as openDevice.
[[nodiscard]] OpenedArm openAnyArm(const std::string& name, const ArmHost& host);

}  // namespace palpate
