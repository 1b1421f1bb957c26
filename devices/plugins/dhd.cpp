// Plug-in for arms of Force Dimension (omega, delta; a Falcon with their driver), through their
// SDK, libdhd. Build it as in docs/plugins.md. Not yet tried on an arm.
//
// Threads: the SDK does not permit two threads to use one arm at the same time. So from `prepare`
// to `close`, one thread makes all calls for the arm: in each pass it reads, then it sends. `stop`
// sets a flag for this thread, and waits about 10 ms at most until the thread has sent a zero. If
// the SDK hangs, the arm's own watchdog takes the force off, if the arm has one.
#include <atomic>
#include <cstdlib>
#include <dhdc.h>
#include <new>
#include <thread>

#include "answer.h"
#include "newest.h"

namespace {

using namespace palpate_plugins;

// TO CHANGE: arms that are not listed here are refused. Give your arm's limits and their source.
struct Model {
  int type;  // as returned by dhdGetSystemType
  double force, stiffness, damping, radius;
  const char* source;
};
constexpr const char* kOmega = "omega.3 in CHAI3D 3.3.0, CDeltaDevices.cpp";
constexpr const char* kDelta = "delta.3 in CHAI3D 3.3.0, CDeltaDevices.cpp";
constexpr Model kModels[] = {
    {DHD_DEVICE_OMEGA3, 12.0, 5000.0, 30.0, 0.075, kOmega},
    {DHD_DEVICE_OMEGA33, 12.0, 5000.0, 30.0, 0.075, kOmega},
    {DHD_DEVICE_OMEGA33_LEFT, 12.0, 5000.0, 30.0, 0.075, kOmega},
    {DHD_DEVICE_OMEGA331, 12.0, 5000.0, 30.0, 0.075, kOmega},
    {DHD_DEVICE_OMEGA331_LEFT, 12.0, 5000.0, 30.0, 0.075, kOmega},
    {DHD_DEVICE_DELTA3, 20.0, 5000.0, 30.0, 0.15, kDelta},
    {DHD_DEVICE_FALCON, 8.0, 800.0, 20.0, 0.04, "HAPI; force, damping and radius as CHAI3D 3.3.0"},
};

// TO CHECK: the SDK's x points to the user, y to the right, z up, in metres. Its origin is the
// middle of the workspace.
constexpr Frame kFrame = {{{0, 1, 0}, {-1, 0, 0}, {0, 0, 1}}};

// Timeout of the arm's own watchdog, in units of 125 us: 30 ms.
constexpr unsigned char kWatchdog = 240;

palpate_plugin_host host;

struct Arm {
  palpate_plugin_device device;  // must be first: a pointer to it is also a pointer to the Arm
  char id = -1;
  palpate_plugin_found found = {};  // the result of `find` for this arm
  const Model* model = nullptr;
  bool wrist = false;
  bool gripper = false;
  bool watched = false;  // the arm's own watchdog is on
  bool weighs = false;   // the SDK can carry a share of the arm's weight
  // Share of the weight to carry from the next write on; used by the haptic thread.
  double share = 0.0;
  Newest<palpate_plugin_reading> readings;
  Orders orders;
  std::atomic<bool> gone{false};
  std::atomic<bool> ends{false};
  std::thread loop;
};

Arm* open_arm = nullptr;  // [main]; at most one arm is open at a time

Arm& of(palpate_plugin_device* device) {
  return *static_cast<Arm*>(device->data);
}

// The type of the serial number is ushort in some versions of the SDK, int in others.
template <class Number>
int serialBy(int (*ask)(Number*, char), char id) {
  Number number{};
  return ask(&number, id) < 0 ? -1 : static_cast<int>(number);
}

bool send(const Arm& arm, const double (&force_W)[3]) {
  double f[3];
  kFrame.toD(force_W, f);
  return dhdSetForceAndTorqueAndGripperForce(f[0], f[1], f[2], 0, 0, 0, 0, arm.id) >= 0;
}

// If the SDK is set to a share of this gravity, it carries the same share of the weight.
constexpr double kGravity = 9.81;  // [m/s^2]
bool carryNow(const Arm& arm, double share) {
  if (share <= 0.0) return dhdSetGravityCompensation(DHD_OFF, arm.id) >= 0;
  return dhdSetStandardGravity(kGravity * std::min(share, 1.0), arm.id) >= 0 &&
         dhdSetGravityCompensation(DHD_ON, arm.id) >= 0;
}

bool stateNow(const Arm& arm, std::uint32_t& state) {
  int status[DHD_MAX_STATUS] = {};
  if (dhdGetStatus(status, arm.id) < 0) return false;
  state = 0;
  if (status[DHD_STATUS_RESET] != 0) state |= PALPATE_PLUGIN_READY;
  if (status[DHD_STATUS_POWER] == 0) state |= PALPATE_PLUGIN_UNPOWERED;
  if (status[DHD_STATUS_FORCE] == 0) state |= PALPATE_PLUGIN_OPEN;
  return true;
}

bool readNow(Arm& arm, palpate_plugin_reading& r) {
  double p[3];
  double turned[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  const int got = dhdGetPositionAndOrientationFrame(&p[0], &p[1], &p[2], turned, arm.id);
  if (got < 0) return false;
  // If this call comes too soon, the SDK repeats its last answer, which does not count as a new
  // reading.
  if (got == DHD_TIMEGUARD && r.taken != 0) return true;
  r.taken = host.now();
  kFrame.toW(p, 1.0, r.position);
  if (arm.wrist) kFrame.toW(turned, r.orientation);
  // The SDK computes the velocity from several readings, so the first readings have no velocity.
  double v[3];
  if (dhdGetLinearVelocity(&v[0], &v[1], &v[2], arm.id) >= 0) kFrame.toW(v, 1.0, r.velocity);
  double angle = 0.0;
  if (arm.gripper && dhdGetGripperAngleRad(&angle, arm.id) >= 0) r.gripper = angle;
  r.buttons = static_cast<std::uint32_t>(dhdGetButtonMask(arm.id));
  arm.readings.put(r);
  return true;
}

void turns(Arm& arm) {
  palpate_plugin_reading r{};
  r.size = sizeof r;
  r.orientation[0] = 1.0;
  double carried = 0.0;
  constexpr int kStateEvery = 32;
  for (int turn = 0; !arm.ends.load(std::memory_order_acquire); ++turn) {
    bool well = turn % kStateEvery != 0 || stateNow(arm, r.state);
    well = well && readNow(arm, r);
    const Order order = arm.orders.now(host.now());
    if (well && order.share != carried) {
      well = carryNow(arm, order.share);
      carried = order.share;
    }
    if (!well || !send(arm, order.force)) {
      arm.gone.store(true, std::memory_order_release);
      break;
    }
    arm.orders.sent(order);
  }
  send(arm, {0.0, 0.0, 0.0});
  carryNow(arm, 0.0);
  arm.orders.serve(false);
}

int facts(palpate_plugin_device* device, palpate_plugin_facts* theirs) {
  const Arm& arm = of(device);
  palpate_plugin_facts f{};
  f.has = PALPATE_PLUGIN_FORCE | PALPATE_PLUGIN_VELOCITY;
  if (arm.wrist) f.has |= PALPATE_PLUGIN_ORIENTATION;
  if (arm.gripper) f.has |= PALPATE_PLUGIN_GRIPPER;
  if (dhdHasActiveWrist(arm.id)) f.has |= PALPATE_PLUGIN_TORQUE;
  f.force = arm.model->force;
  f.stiffness = arm.model->stiffness;
  f.damping = arm.model->damping;
  f.workspace_radius = arm.model->radius;
  f.rate = 1000.0;  // conservative: the SDK can exchange data 4,000 times a second
  f.watchdog = arm.watched ? kWatchdog * 125e-6 : 0.0;
  f.buttons = 1;
  copy(f.source, arm.model->source);
  give(theirs, f);
  return PALPATE_PLUGIN_OK;
}

int prepare(palpate_plugin_device* device, char* error, std::size_t room) {
  Arm& arm = of(device);
  if (arm.loop.joinable()) return PALPATE_PLUGIN_OK;
  std::uint32_t state = 0;
  if (dhdEnableForce(DHD_ON, arm.id) < 0 || !carryNow(arm, 0.0) || !send(arm, {0.0, 0.0, 0.0}) ||
      !stateNow(arm, state)) {
    tell(error, room, "dhd: the arm does not start with zero force (%s); switch it off and on",
         dhdErrorGetLastStr());
    return PALPATE_PLUGIN_FAILED;
  }
  // The arm calibrates itself while its user moves it, as its manual describes.
  if ((state & PALPATE_PLUGIN_READY) == 0) {
    if (host.say != nullptr) {
      host.say("dhd: the arm is not calibrated: calibrate it as its manual describes");
    }
    constexpr int kWait = 100;  // [ms] between two checks
    while (dhdWaitForReset(kWait, arm.id) < 0) {
      if (host.ends() != 0) {
        tell(error, room,
             "dhd: the program was ended before the arm was calibrated; start it again and "
             "calibrate the arm");
        return PALPATE_PLUGIN_FAILED;
      }
      if (dhdErrorGetLast() != DHD_ERROR_TIMEOUT) {
        tell(error, room, "dhd: the arm cannot be calibrated (%s); switch it off and on",
             dhdErrorGetLastStr());
        return PALPATE_PLUGIN_FAILED;
      }
    }
  }
  return safely("dhd", error, room, static_cast<int>(PALPATE_PLUGIN_FAILED), [&arm] {
    arm.orders.serve(true);
    arm.loop = std::thread([&arm] { turns(arm); });
    return static_cast<int>(PALPATE_PLUGIN_OK);
  });
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
  return arm.orders.write(known(theirs), arm.share, host.now());
}

void stop(palpate_plugin_device* device) {
  of(device).orders.stop();
}

void close(palpate_plugin_device* device) {
  Arm& arm = of(device);
  arm.ends.store(true, std::memory_order_release);
  if (arm.loop.joinable()) arm.loop.join();
  dhdStop(arm.id);
  dhdClose(arm.id);
  open_arm = nullptr;
  delete &arm;
}

void carry(palpate_plugin_device* device, double share) {
  of(device).share = share;
}

// Assumed bound on the weight at the tip for the models above; their makers publish no value.
constexpr double kMostWeight = 10.0;  // [N]
constexpr palpate_plugin_weight kWeight = {sizeof(palpate_plugin_weight), 0, carry, kMostWeight};

const void* extensionOf(palpate_plugin_device* device, const char* name) {
  if (of(device).weighs && std::strcmp(name, PALPATE_PLUGIN_WEIGHT) == 0) return &kWeight;
  return nullptr;
}

palpate_plugin_found factsOf(char id) {
  palpate_plugin_found found{};
  const int serial = serialBy(dhdGetSerialNumber, id);
  if (serial >= 0) std::snprintf(found.serial, sizeof found.serial, "%d", serial);
  copy(found.model, dhdGetSystemName(id));
  return found;
}

int find(palpate_plugin_found* found, int room) {
  const int count = dhdGetDeviceCount();
  for (int i = 0; i < count && i < room; ++i) {
    palpate_plugin_found f{};
    // The SDK gives the name of an arm only if it can open the arm.
    if (open_arm != nullptr && open_arm->id == i) {
      f = open_arm->found;
    } else if (const int id = dhdOpenID(static_cast<char>(i)); id >= 0) {
      f = factsOf(static_cast<char>(id));
      dhdClose(static_cast<char>(id));
    } else {
      std::snprintf(f.model, sizeof f.model, "an arm that cannot be opened (%s)",
                    dhdErrorGetLastStr());
    }
    give(at(found, i), f);
  }
  return count;
}

palpate_plugin_device* open(const char* serial, char* error, std::size_t room) {
  if (open_arm != nullptr) {
    tell(error, room, "dhd: an arm is open already; close that arm");
    return nullptr;
  }
  int id = -1;
  if (*serial == '\0') {
    id = dhdOpen();
  } else {
    char* end = nullptr;
    const long number = std::strtol(serial, &end, 10);
    if (*end != '\0' || number < 0 || number > 0x7fffffff) {
      tell(error, room, "dhd: \"%s\" is not a serial number; use the number on the arm's label",
           serial);
      return nullptr;
    }
    id = dhdOpenSerial(static_cast<int>(number));
  }
  if (id < 0) {
    tell(error, room,
         "dhd: no arm%s%s opens (%s); plug it in and switch it on, or end other programs",
         *serial == '\0' ? "" : " ", serial, dhdErrorGetLastStr());
    return nullptr;
  }
  const char own = static_cast<char>(id);
  const int type = dhdGetSystemType(own);
  const auto* model = std::find_if(std::begin(kModels), std::end(kModels),
                                   [type](const Model& m) { return m.type == type; });
  if (model == std::end(kModels)) {
    tell(error, room, "dhd: the limits of a %s are unknown; add them to kModels in dhd.cpp",
         dhdGetSystemName(own));
    dhdClose(own);
    return nullptr;
  }
  Arm* arm = new (std::nothrow) Arm;
  if (arm == nullptr) {
    tell(error, room, "dhd: no memory is left; end other programs to free memory");
    dhdClose(own);
    return nullptr;
  }
  arm->id = own;
  arm->found = factsOf(own);
  arm->model = model;
  arm->wrist = dhdHasWrist(own);
  arm->gripper = dhdHasGripper(own);
  // Only the SDK's expert functions can set the watchdog; older arms have no watchdog.
  if (dhdEnableExpertMode() >= 0) {
    arm->watched = dhdSetWatchdog(kWatchdog, own) >= 0;
    dhdDisableExpertMode();
  }
  arm->weighs = dhdSetStandardGravity(kGravity, own) >= 0;
  arm->device = {
      sizeof(palpate_plugin_device), 0, arm, facts, prepare, read, write, stop, close, extensionOf};
  open_arm = arm;
  return &arm->device;
}

int init(const palpate_plugin_host* theirs) {
  host = known(theirs);
  if (host.ends != nullptr && host.now != nullptr) return 0;
  if (host.say != nullptr) {
    host.say("dhd: this version of palpate is too old for this plug-in; install a newer palpate");
  }
  return -1;
}

void end() {}

const palpate_plugin_factory kArms = {sizeof kArms, 0, find, open};

const void* factory(const char* name) {
  return std::strcmp(name, PALPATE_PLUGIN_ARMS) == 0 ? &kArms : nullptr;
}

}  // namespace

const palpate_plugin_entry palpate_plugin = {
    sizeof palpate_plugin,
    PALPATE_PLUGIN_MAJOR,
    PALPATE_PLUGIN_MINOR,
    0,
    "Force Dimension's arms, by libdhd",
    "1",
    "Apache-2.0; needs Force Dimension's SDK, which is closed",
    init,
    end,
    factory};
