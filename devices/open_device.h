/// Opens a device by its name, such as `simulated` or `hid:polhem`. Every program uses the same
/// names.
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
  double rate = 1000.0;   ///< Ticks a second [Hz], > 0.
  HandTarget target;      ///< Target of a simulated hand.
  HandTarget mouse;       ///< Target of a hand that a window's mouse leads; may be empty.
  HandTarget client;      ///< Target of a hand that a client of the program's server leads; may be
                          ///< empty.
  bool realtime = false;  ///< The loop runs in real time. An arm needs it; a simulated one is then
                          ///< treated as real.
  bool passive = false;   ///< The energy tank limits the force.
  double refill = 0.0;    ///< TankParams::refill [W].
  std::function<void(const std::string&)> say;  ///< Receives messages for the user; may be empty.
  std::function<bool()> stop;                   ///< Called while an arm is awaited; may be empty.
};

/// Opens one of these devices:
///
/// - `simulated`: a simulated arm and hand
/// - `simulated:TROUBLE`, `simulated:TROUBLE@SECONDS`: the same with a trouble (faulty_device.h),
///   which begins at that time
/// - `mouse`: a simulated hand that a window's mouse leads
/// - `igtl`: a simulated hand that 3D Slicer leads
/// - `path:FILE.csv`: a hand that follows a path exactly; - is standard input
/// - `replay:FILE`, `replay:FILE@SECONDS`: a recorded hand, from that time on
/// - `hid`, `hid:PROFILE`, `hid:PROFILE@SERIAL`, `hid:FILE.json`: an arm (openArm)
/// - `plugin:NAME`, `plugin:NAME@SERIAL`: an arm of a plug-in, which runs in its own process;
///   `plugin-inside:NAME` runs it in this one (openPluginArm)
///
/// Throws Error with the problem and the remedy. Slow: an arm may home itself.
[[nodiscard]] std::unique_ptr<Device> openDevice(const std::string& name,
                                                 const DeviceOptions& options);

/// Opens an arm by one of the last two kinds of name, for operations that need an arm. Throws as
/// openDevice.
[[nodiscard]] OpenedArm openAnyArm(const std::string& name, const ArmHost& host);

}  // namespace palpate
