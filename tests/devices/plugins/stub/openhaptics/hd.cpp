#include <HD/hd.h>
#include <algorithm>
#include <chrono>
#include <cstring>
#include <thread>

namespace {

stub_hd::Arm* the_arm = new stub_hd::Arm;
std::vector<HDerror> stack;
bool in_frame = false;
double wanted[3] = {};
HDSchedulerCallback callback = nullptr;
void* callback_data = nullptr;
std::atomic<bool> runs{false};
std::thread scheduler;

void run() {
  while (runs) {
    the_arm->gate.arrive();
    if (callback != nullptr && callback(callback_data) == HD_CALLBACK_DONE) callback = nullptr;
    std::this_thread::sleep_for(std::chrono::microseconds(20));
  }
}

void inFrame() {
  if (!in_frame) ++the_arm->outside;
}

}  // namespace

namespace stub_hd {
Arm& arm() {
  return *the_arm;
}
void plugAnew() {
  delete the_arm;
  the_arm = new Arm;
  stack.clear();
}
}  // namespace stub_hd

extern "C" {

HHD hdInitDevice(HDstring name) {
  const bool known = name == nullptr || std::strcmp(name, "Left") == 0;
  if (!known || !the_arm->plugged) {
    stack.push_back(HD_COMM_ERROR);
    return HD_INVALID_HANDLE;
  }
  ++the_arm->open;
  stack.insert(stack.end(), the_arm->opening.begin(), the_arm->opening.end());
  return 7;
}
void hdDisableDevice(HHD) {
  --the_arm->open;
}
void hdMakeCurrentDevice(HHD) {}
void hdBeginFrame(HHD handle) {
  in_frame = true;
  if (handle != 7) stack.push_back(HD_BAD_HANDLE);
}
void hdEndFrame(HHD) {
  in_frame = false;
  if (the_arm->lost) stack.push_back(HD_COMM_ERROR);
  stack.insert(stack.end(), the_arm->fails.begin(), the_arm->fails.end());
  the_arm->fails.clear();
  if (the_arm->enabled && !the_arm->lost) std::copy(wanted, wanted + 3, the_arm->force);
}
HDErrorInfo hdGetError() {
  HDErrorInfo info = {HD_SUCCESS, 0, 7};
  if (stack.empty()) return info;
  info.errorCode = stack.back();
  stack.pop_back();
  return info;
}
HDstring hdGetErrorString(HDerror error) {
  return error == HD_COMM_ERROR ? "communication error" : "error";
}
void hdEnable(HDenum capability) {
  if (capability == HD_FORCE_OUTPUT) the_arm->enabled = true;
}
void hdDisable(HDenum capability) {
  if (capability != HD_FORCE_OUTPUT) return;
  the_arm->enabled = false;
  std::fill(the_arm->force, the_arm->force + 3, 0.0);
}
void hdGetDoublev(HDenum name, HDdouble* values) {
  const double room[6] = {-80, -50, -35, 80, 70, 35};
  switch (name) {
    case HD_CURRENT_POSITION:
      inFrame();
      std::copy(the_arm->position, the_arm->position + 3, values);
      break;
    case HD_CURRENT_VELOCITY:
      inFrame();
      std::copy(the_arm->velocity, the_arm->velocity + 3, values);
      break;
    case HD_CURRENT_TRANSFORM:
      inFrame();
      std::copy(the_arm->transform, the_arm->transform + 16, values);
      break;
    case HD_USABLE_WORKSPACE_DIMENSIONS:
      std::copy(room, room + 6, values);
      break;
    case HD_UPDATE_RATE:
      *values = 1000.0;
      break;
    case HD_NOMINAL_MAX_FORCE:
      *values = 3.0;
      break;
    case HD_NOMINAL_MAX_STIFFNESS:
      *values = 0.5;
      break;
    case HD_NOMINAL_MAX_DAMPING:
      *values = 0.002;
      break;
    default:
      stack.push_back(HD_BAD_HANDLE);
  }
}
void hdGetIntegerv(HDenum name, HDint* values) {
  if (name == HD_CURRENT_BUTTONS) {
    inFrame();
    *values = the_arm->buttons;
  } else {
    *values = the_arm->style;
  }
}
HDstring hdGetString(HDenum name) {
  return name == HD_DEVICE_SERIAL_NUMBER ? "T-77" : the_arm->model.c_str();
}
void hdSetDoublev(HDenum name, const HDdouble* values) {
  inFrame();
  if (name == HD_CURRENT_FORCE) std::copy(values, values + 3, wanted);
}
HDenum hdCheckCalibration() {
  if (the_arm->calibration == HD_CALIBRATION_NEEDS_MANUAL_INPUT && the_arm->inkwell) {
    the_arm->calibration = HD_CALIBRATION_NEEDS_UPDATE;
  }
  return the_arm->calibration;
}
void hdUpdateCalibration(HDenum) {
  the_arm->calibration = HD_CALIBRATION_OK;
}
void hdStartScheduler() {
  stack.insert(stack.end(), the_arm->starting.begin(), the_arm->starting.end());
  if (!the_arm->starting.empty()) return;
  runs = true;
  scheduler = std::thread(run);
}
void hdStopScheduler() {
  runs = false;
  the_arm->gate.release();
  if (scheduler.joinable()) scheduler.join();
}
HDSchedulerHandle hdScheduleAsynchronous(HDSchedulerCallback function, void* data, HDushort) {
  callback = function;
  callback_data = data;
  return 1;
}
void hdUnschedule(HDSchedulerHandle) {
  callback = nullptr;
}
}
