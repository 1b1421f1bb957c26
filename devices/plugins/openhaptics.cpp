// Plug-in for the Touch and the Phantoms (3D Systems, SensAble) through OpenHaptics' HD API, libHD.
// Build it as in docs/plugins.md. Not yet tried on an arm.
//
// Threads: the API reads and drives an arm within a frame, on its scheduler's thread. So the servo
// loop is a callback of the scheduler. `stop` sets a flag for the callback, and waits until a zero
// has been sent, usually 1 ms. `stop` calls no function of the API.
#include <HD/hd.h>
#include <atomic>
#include <ctime>
#include <new>

#include "answer.h"
#include "newest.h"

namespace {

using namespace palpate_plugins;

// TO CHANGE: the limits of each model, by the API's model name, and their source. A model that is
// not listed gets the API's nominal limits.
struct Model {
  const char* name;  // HD_DEVICE_MODEL_TYPE
  double force, stiffness, damping, radius;
  const char* source;
};
constexpr const char* kSource = "CHAI3D 3.3.0, CPhantomDevices.cpp";
constexpr Model kModels[] = {
    {"Touch", 3.3, 400.0, 4.0, 0.075, kSource},
    {"PHANTOM Omni", 3.3, 700.0, 5.0, 0.10, kSource},
    {"PHANTOM Desktop", 7.9, 1000.0, 5.0, 0.10, kSource},
};

// TO CHECK: the API's x points to the right, y up, z to the user, in millimetres.
constexpr Frame kFrame = {{{1, 0, 0}, {0, 0, -1}, {0, 1, 0}}};
constexpr double kMillimetre = 1e-3;

palpate_plugin_host host;

struct Arm {
  palpate_plugin_device device;
  HHD handle = HD_INVALID_HANDLE;
  char serial[64] = {};
  char model[64] = {};
  palpate_plugin_facts facts{};
  double middle[3] = {};  // middle of the workspace, in the API's axes [mm]
  HDint style = 0;        // the API's calibration style
  HDSchedulerHandle callback = 0;
  bool runs = false;
  Newest<palpate_plugin_reading> readings;
  Orders orders;
  std::atomic<bool> gone{false};
  std::atomic<bool> refused{false};  // a force was refused since the last write
  std::atomic<HDenum> calibration{HD_CALIBRATION_NEEDS_MANUAL_INPUT};
  std::atomic<HDenum> calibrate{0};  // requested calibration; 0: no request
};

Arm* open_arm = nullptr;  // [main]; the API has one scheduler for all arms

Arm& of(palpate_plugin_device* device) {
  return *static_cast<Arm*>(device->data);
}

// Errors on the API's stack. Reading them empties the stack.
struct Errors {
  HDerror newest = HD_SUCCESS;
  bool lost = false;
  bool warm = false;
  bool refused = false;
};

Errors errorsNow() {
  Errors errors;
  constexpr int kMost = 64;
  for (int i = 0; i < kMost; ++i) {
    const HDerror code = hdGetError().errorCode;
    if (code == HD_SUCCESS) break;
    if (errors.newest == HD_SUCCESS) errors.newest = code;
    switch (code) {
      case HD_WARM_MOTORS:
        errors.warm = true;
        break;
      case HD_EXCEEDED_MAX_FORCE:
      case HD_EXCEEDED_MAX_FORCE_IMPULSE:
      case HD_EXCEEDED_MAX_VELOCITY:
      case HD_FORCE_ERROR:
        errors.refused = true;  // the API has taken the force off
        break;
      default:
        errors.lost = true;  // the cable or the arm is lost, or a call was wrong
    }
  }
  return errors;
}

HDCallbackCode HDCALLBACK onServo(void* data) {
  Arm& arm = *static_cast<Arm*>(data);
  hdMakeCurrentDevice(arm.handle);
  const HDenum style = arm.calibrate.exchange(0, std::memory_order_acq_rel);
  if (style != 0) hdUpdateCalibration(style);
  const HDenum calibration = hdCheckCalibration();
  arm.calibration.store(calibration, std::memory_order_release);

  hdBeginFrame(arm.handle);  // every frame is a new reading
  palpate_plugin_reading r{};
  r.size = sizeof r;
  r.taken = host.now();
  HDdouble position[3] = {};
  HDdouble velocity[3] = {};
  HDdouble transform[16] = {};
  HDint buttons = 0;
  hdGetDoublev(HD_CURRENT_POSITION, position);
  hdGetDoublev(HD_CURRENT_VELOCITY, velocity);
  hdGetDoublev(HD_CURRENT_TRANSFORM, transform);
  hdGetIntegerv(HD_CURRENT_BUTTONS, &buttons);
  const Order order = arm.orders.now(host.now());
  HDdouble force[3];
  kFrame.toD(order.force, force);
  hdSetDoublev(HD_CURRENT_FORCE, force);
  hdEndFrame(arm.handle);

  const Errors errors = errorsNow();
  if (!errors.lost) arm.orders.sent(order);
  if (errors.lost) {
    arm.orders.serve(false);
    hdBeginFrame(arm.handle);
    const HDdouble none[3] = {0.0, 0.0, 0.0};
    hdSetDoublev(HD_CURRENT_FORCE, none);
    hdEndFrame(arm.handle);
    errorsNow();
    arm.gone.store(true, std::memory_order_release);
    return HD_CALLBACK_DONE;
  }
  if (errors.refused) arm.refused.store(true, std::memory_order_release);
  if (calibration == HD_CALIBRATION_OK) r.state |= PALPATE_PLUGIN_READY;
  if (errors.warm) r.state |= PALPATE_PLUGIN_HOT;
  const double from_middle[3] = {position[0] - arm.middle[0], position[1] - arm.middle[1],
                                 position[2] - arm.middle[2]};
  kFrame.toW(from_middle, kMillimetre, r.position);
  kFrame.toW(velocity, kMillimetre, r.velocity);
  // The API stores matrices column by column, as OpenGL does.
  double turned[3][3];
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) turned[i][j] = transform[4 * j + i];
  }
  kFrame.toW(turned, r.orientation);
  r.buttons = static_cast<std::uint32_t>(buttons);
  arm.readings.put(r);
  return HD_CALLBACK_CONTINUE;
}

// Reads the arm's properties. Call it before the scheduler runs.
void describe(Arm& arm) {
  copy(arm.serial, hdGetString(HD_DEVICE_SERIAL_NUMBER));
  copy(arm.model, hdGetString(HD_DEVICE_MODEL_TYPE));
  // Six numbers: the smallest x, y, z, then the largest [mm].
  HDdouble room[6] = {};
  hdGetDoublev(HD_USABLE_WORKSPACE_DIMENSIONS, room);
  double smallest = room[3] - room[0];
  for (int i = 0; i < 3; ++i) {
    arm.middle[i] = (room[i] + room[3 + i]) / 2.0;
    smallest = std::min(smallest, room[3 + i] - room[i]);
  }
  hdGetIntegerv(HD_CALIBRATION_STYLE, &arm.style);
  HDdouble force = 0.0;
  HDdouble stiffness = 0.0;  // [N/mm]
  HDdouble damping = 0.0;    // [N s/mm]
  HDdouble rate = 1000.0;
  hdGetDoublev(HD_NOMINAL_MAX_FORCE, &force);
  hdGetDoublev(HD_NOMINAL_MAX_STIFFNESS, &stiffness);
  hdGetDoublev(HD_NOMINAL_MAX_DAMPING, &damping);
  hdGetDoublev(HD_UPDATE_RATE, &rate);
  palpate_plugin_facts& f = arm.facts;
  f.has = PALPATE_PLUGIN_FORCE | PALPATE_PLUGIN_VELOCITY | PALPATE_PLUGIN_ORIENTATION;
  f.force = force;
  f.stiffness = stiffness / kMillimetre;
  f.damping = damping / kMillimetre;
  f.workspace_radius = smallest / 2.0 * kMillimetre;
  f.rate = rate;
  f.buttons = 2;
  copy(f.source, "OpenHaptics, HD_NOMINAL_MAX_* and HD_USABLE_WORKSPACE_DIMENSIONS");
  for (const Model& m : kModels) {
    if (std::strcmp(m.name, arm.model) != 0) continue;
    f.force = force > 0.0 ? std::min(m.force, force) : m.force;
    f.stiffness = m.stiffness;
    f.damping = m.damping;
    f.workspace_radius = m.radius;
    copy(f.source, m.source);
  }
  // `continuous` stays zero, because the API has no time constant of the motors' heat. The API
  // reports HD_WARM_MOTORS instead.
}

int facts(palpate_plugin_device* device, palpate_plugin_facts* theirs) {
  give(theirs, of(device).facts);
  return PALPATE_PLUGIN_OK;
}

void pauseFor(long milliseconds) {
  const timespec time = {0, milliseconds * 1'000'000};
  nanosleep(&time, nullptr);
}

// Ends the servo loop and switches the motors off.
void endServo(Arm& arm) {
  hdStopScheduler();
  hdUnschedule(arm.callback);
  hdMakeCurrentDevice(arm.handle);
  hdDisable(HD_FORCE_OUTPUT);
}

int prepare(palpate_plugin_device* device, char* error, std::size_t room) {
  Arm& arm = of(device);
  if (!arm.runs) {
    hdMakeCurrentDevice(arm.handle);
    arm.callback = hdScheduleAsynchronous(onServo, &arm, HD_DEFAULT_SCHEDULER_PRIORITY);
    hdEnable(HD_FORCE_OUTPUT);  // the force is zero, because no order has come yet
    hdStartScheduler();
    const Errors errors = errorsNow();
    if (errors.newest != HD_SUCCESS) {
      tell(error, room, "openhaptics: the scheduler does not start (%s); end other programs",
           hdGetErrorString(errors.newest));
      endServo(arm);
      errorsNow();
      return PALPATE_PLUGIN_FAILED;
    }
    arm.runs = true;
    arm.orders.serve(true);
  }
  bool said = false;
  std::int64_t asked = host.now();
  for (;;) {
    const HDenum calibration = arm.calibration.load(std::memory_order_acquire);
    if (calibration == HD_CALIBRATION_OK) return PALPATE_PLUGIN_OK;
    if (arm.gone.load(std::memory_order_acquire)) {
      tell(error, room, "openhaptics: the arm does not answer; check its cable and its power");
      return PALPATE_PLUGIN_FAILED;
    }
    if (host.ends() != 0) {
      tell(error, room,
           "openhaptics: the program was ended before the arm was calibrated; start it again "
           "and calibrate the arm");
      return PALPATE_PLUGIN_FAILED;
    }
    const bool by_hand = (arm.style & HD_CALIBRATION_ENCODER_RESET) != 0;
    if (calibration == HD_CALIBRATION_NEEDS_UPDATE && !by_hand) {
      arm.calibrate.store(static_cast<HDenum>(arm.style), std::memory_order_release);
    } else if (!said && calibration == HD_CALIBRATION_NEEDS_MANUAL_INPUT && host.say != nullptr) {
      host.say(by_hand ? "openhaptics: the arm is not calibrated: hold it in its reset position "
                         "for five seconds"
                       : "openhaptics: the arm is not calibrated: put the stylus into its inkwell");
      said = true;
      asked = host.now();
    }
    constexpr std::int64_t kHeld = 5'000'000'000;
    if (by_hand && said && host.now() - asked > kHeld) {
      arm.calibrate.store(HD_CALIBRATION_ENCODER_RESET, std::memory_order_release);
      said = false;
    }
    pauseFor(5);
  }
}

int read(palpate_plugin_device* device, palpate_plugin_reading* theirs) {
  Arm& arm = of(device);
  if (arm.gone.load(std::memory_order_acquire)) return PALPATE_PLUGIN_GONE;
  palpate_plugin_reading r{};
  if (!arm.readings.take(r)) return PALPATE_PLUGIN_NOTHING;
  give(theirs, r);
  return PALPATE_PLUGIN_OK;
}

int write(palpate_plugin_device* device, const palpate_plugin_force* theirs) {
  Arm& arm = of(device);
  if (arm.gone.load(std::memory_order_acquire)) return PALPATE_PLUGIN_GONE;
  const int sent = arm.orders.write(known(theirs), 0.0, host.now());
  const bool refused = arm.refused.exchange(false, std::memory_order_acq_rel);
  return refused ? static_cast<int>(PALPATE_PLUGIN_FAILED) : sent;
}

void stop(palpate_plugin_device* device) {
  of(device).orders.stop();
}

void close(palpate_plugin_device* device) {
  Arm& arm = of(device);
  arm.orders.stop();
  if (arm.runs) endServo(arm);
  hdDisableDevice(arm.handle);
  errorsNow();
  open_arm = nullptr;
  delete &arm;
}

const void* extensionOf(palpate_plugin_device*, const char*) {
  return nullptr;
}

// Opens an arm by its name in the maker's set-up program. On failure returns false and sets `why`.
bool begin(Arm& arm, const char* name, HDerror& why) {
  errorsNow();
  arm.handle = hdInitDevice(name);
  why = errorsNow().newest;
  if (arm.handle == HD_INVALID_HANDLE) return false;
  if (why != HD_SUCCESS) {
    hdDisableDevice(arm.handle);
    errorsNow();
    return false;
  }
  describe(arm);
  errorsNow();
  return true;
}

// The API cannot list arms, so this function opens only the default arm.
int find(palpate_plugin_found* found, int room) {
  palpate_plugin_found f{};
  if (open_arm != nullptr) {
    copy(f.serial, open_arm->serial);
    copy(f.model, open_arm->model);
  } else {
    Arm arm;
    HDerror why = HD_SUCCESS;
    if (!begin(arm, HD_DEFAULT_DEVICE, why)) return 0;
    copy(f.serial, arm.serial);
    copy(f.model, arm.model);
    hdDisableDevice(arm.handle);
  }
  if (room > 0) give(found, f);
  return 1;
}

// `serial` is the default arm's serial number, or a name from the maker's set-up program.
palpate_plugin_device* open(const char* serial, char* error, std::size_t room) {
  if (open_arm != nullptr) {
    tell(error, room, "openhaptics: an arm is open already; close that arm");
    return nullptr;
  }
  Arm* arm = new (std::nothrow) Arm;
  if (arm == nullptr) {
    tell(error, room, "openhaptics: no memory is left; end other programs to free memory");
    return nullptr;
  }
  HDerror why = HD_SUCCESS;
  bool opened = begin(*arm, HD_DEFAULT_DEVICE, why);
  if (*serial != '\0' && !(opened && std::strcmp(serial, arm->serial) == 0)) {
    if (opened) hdDisableDevice(arm->handle);
    opened = begin(*arm, serial, why);
  }
  if (!opened) {
    tell(error, room, "openhaptics: no arm%s%s opens (%s); set it up with its maker's own program",
         *serial == '\0' ? "" : " ", serial, hdGetErrorString(why));
    delete arm;
    return nullptr;
  }
  arm->device = {
      sizeof(palpate_plugin_device), 0, arm, facts, prepare, read, write, stop, close, extensionOf};
  open_arm = arm;
  return &arm->device;
}

int init(const palpate_plugin_host* theirs) {
  host = known(theirs);
  if (host.ends != nullptr && host.now != nullptr) return 0;
  if (host.say != nullptr) {
    host.say(
        "openhaptics: this version of palpate is too old for this plug-in; install a newer "
        "palpate");
  }
  return -1;
}

void end() {}

const palpate_plugin_factory kArms = {sizeof kArms, 0, find, open};

const void* factory(const char* name) {
  return std::strcmp(name, PALPATE_PLUGIN_ARMS) == 0 ? &kArms : nullptr;
}

}  // namespace

const palpate_plugin_entry palpate_plugin = {sizeof palpate_plugin,
                                             PALPATE_PLUGIN_MAJOR,
                                             PALPATE_PLUGIN_MINOR,
                                             0,
                                             "the Touch and the Phantoms, by OpenHaptics",
                                             "1",
                                             "Apache-2.0; needs OpenHaptics, which is closed",
                                             init,
                                             end,
                                             factory};
