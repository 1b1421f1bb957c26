/// A stub of OpenHaptics' HD API: the published names that the plug-in uses, and a simulated arm.
/// We wrote the declarations and chose the values of the constants.
#pragma once

#include <atomic>
#include <string>
#include <vector>

#include "../../../gate.h"

using HDdouble = double;
using HDint = int;
using HDenum = unsigned;
using HDerror = unsigned;
using HDushort = unsigned short;
using HDstring = const char*;
using HHD = unsigned;
using HDCallbackCode = unsigned;
using HDSchedulerHandle = unsigned long;
struct HDErrorInfo {
  HDerror errorCode;
  int internalErrorCode;
  HHD hHD;
};

#define HDCALLBACK
using HDSchedulerCallback = HDCallbackCode (*)(void*);
#define HD_DEFAULT_DEVICE nullptr
#define HD_INVALID_HANDLE 0xFFFFFFFFU
#define HD_CALLBACK_DONE 0U
#define HD_CALLBACK_CONTINUE 1U
#define HD_DEFAULT_SCHEDULER_PRIORITY 32767

enum : HDerror {
  HD_SUCCESS,
  HD_BAD_HANDLE,
  HD_WARM_MOTORS,
  HD_EXCEEDED_MAX_FORCE,
  HD_EXCEEDED_MAX_FORCE_IMPULSE,
  HD_EXCEEDED_MAX_VELOCITY,
  HD_FORCE_ERROR,
  HD_DEVICE_FAULT,
  HD_COMM_ERROR,
};
enum : HDenum {
  HD_CURRENT_BUTTONS = 1,
  HD_CURRENT_POSITION,
  HD_CURRENT_VELOCITY,
  HD_CURRENT_TRANSFORM,
  HD_CURRENT_FORCE,
  HD_DEVICE_MODEL_TYPE,
  HD_DEVICE_SERIAL_NUMBER,
  HD_USABLE_WORKSPACE_DIMENSIONS,
  HD_CALIBRATION_STYLE,
  HD_UPDATE_RATE,
  HD_NOMINAL_MAX_STIFFNESS,
  HD_NOMINAL_MAX_DAMPING,
  HD_NOMINAL_MAX_FORCE,
  HD_FORCE_OUTPUT,
  HD_CALIBRATION_OK,
  HD_CALIBRATION_NEEDS_UPDATE,
  HD_CALIBRATION_NEEDS_MANUAL_INPUT,
};
#define HD_CALIBRATION_ENCODER_RESET 1
#define HD_CALIBRATION_AUTO 2
#define HD_CALIBRATION_INKWELL 4

extern "C" {
HHD hdInitDevice(HDstring name);
void hdDisableDevice(HHD handle);
void hdMakeCurrentDevice(HHD handle);
void hdBeginFrame(HHD handle);
void hdEndFrame(HHD handle);
HDErrorInfo hdGetError();
HDstring hdGetErrorString(HDerror error);
void hdEnable(HDenum capability);
void hdDisable(HDenum capability);
void hdGetDoublev(HDenum name, HDdouble* values);
void hdGetIntegerv(HDenum name, HDint* values);
HDstring hdGetString(HDenum name);
void hdSetDoublev(HDenum name, const HDdouble* values);
HDenum hdCheckCalibration();
void hdUpdateCalibration(HDenum style);
void hdStartScheduler();
void hdStopScheduler();
HDSchedulerHandle hdScheduleAsynchronous(HDSchedulerCallback callback, void* data, HDushort);
void hdUnschedule(HDSchedulerHandle handle);
}

/// The arm. The test may access it while the plug-in's loop waits at the gate; atomic members at
/// any time.
namespace stub_hd {
struct Arm {
  Gate gate;
  bool plugged = true;
  std::string model = "Touch";
  double position[3] = {};  // [mm]
  double velocity[3] = {};
  double transform[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
  int buttons = 0;
  int style = HD_CALIBRATION_AUTO;
  HDenum calibration = HD_CALIBRATION_NEEDS_UPDATE;
  std::vector<HDerror> opening;   // errors that hdInitDevice pushes although it opens the arm
  std::vector<HDerror> starting;  // errors with which hdStartScheduler fails
  std::vector<HDerror> fails;     // errors that the next frame pushes on the error stack
  std::atomic<bool> lost{false};
  std::atomic<bool> inkwell{false};  // the stylus is in the inkwell
  double force[3] = {};              // in the API's frame [N]
  bool enabled = false;
  int open = 0;
  int outside = 0;  // number of calls outside of a frame that the API permits only within a frame
};
Arm& arm();
void plugAnew();
}  // namespace stub_hd
