// Plug-in for the Novint Falcon through libnifalcon (BSD). Build it as in docs/plugins.md. Not yet
// tried on an arm.
//
// Threads: the library has no locks, so from `prepare` to `close` one thread makes all calls for
// the arm. `stop` sets a flag for this thread, and waits until a zero has been sent, usually 1 ms.
// We found no description of a watchdog in the Falcon.
#include <atomic>
#include <cstdlib>
#include <ctime>
#include <falcon/core/FalconDevice.h>
#include <falcon/core/FalconFirmware.h>
#include <falcon/firmware/FalconFirmwareNovintSDK.h>
#include <falcon/grip/FalconGripFourButton.h>
#include <falcon/kinematic/FalconKinematicStamper.h>
#include <falcon/util/FalconFirmwareBinaryNvent.h>
#include <memory>
#include <thread>
#include <utility>

#include "answer.h"
#include "newest.h"

namespace {

using namespace palpate_plugins;
using namespace libnifalcon;  // in some versions the firmware is outside this namespace

// TO CHANGE: the limits and their source. For the stiffness CHAI3D 3.3.0 gives 3,000 N/m, HAPI
// gives 800 N/m; the smaller value is used.
constexpr double kForce = 8.0;        // [N]
constexpr double kStiffness = 800.0;  // [N/m]
constexpr double kDamping = 20.0;     // [N s/m]
constexpr double kRadius = 0.04;      // [m]
constexpr const char* kSource =
    "HAPI; force, damping and radius as CHAI3D 3.3.0, CFalconDevice.cpp";

// TO CHECK: the library's x points to the right, y up, z to the user [m].
constexpr Frame kFrame = {{{1, 0, 0}, {0, 0, -1}, {0, 1, 0}}};

// Time without an answer after which the arm counts as lost [ns].
constexpr std::int64_t kLost = 100'000'000;

palpate_plugin_host host;

struct Arm {
  palpate_plugin_device device;
  FalconDevice falcon;
  double middle[3] = {};
  Newest<palpate_plugin_reading> readings;
  Orders orders;
  std::atomic<bool> gone{false};
  std::atomic<bool> ends{false};
  std::thread loop;
};

Arm* open_arm = nullptr;  // [main]; at most one arm is open

Arm& of(palpate_plugin_device* device) {
  return *static_cast<Arm*>(device->data);
}

// These are boost::array in older versions of the library, std::array in newer ones.
using Vector = decltype(std::declval<FalconDevice&>().getPosition());
using Motors = decltype(std::declval<FalconFirmware&>().getEncoderValues());

void pauseFor(long microseconds) {
  const timespec time = {0, microseconds * 1000};
  nanosleep(&time, nullptr);
}

// The library's isHomed() is true as soon as one motor is homed; a position needs all three.
bool isHomed(FalconDevice& falcon) {
  constexpr unsigned kAll = FalconFirmware::ENCODER_1_HOMED | FalconFirmware::ENCODER_2_HOMED |
                            FalconFirmware::ENCODER_3_HOMED;
  return (falcon.getFalconFirmware()->getHomingModeStatus() & kAll) == kAll;
}

void setForce(FalconDevice& falcon, const double (&force_W)[3]) {
  double f[3];
  kFrame.toD(force_W, f);
  Vector force{};
  for (std::size_t i = 0; i < 3; ++i) force[i] = f[i];
  falcon.setForce(force);
  // If the kinematics fails, the motors would keep their last force, so zero is set directly.
  if (f[0] == 0.0 && f[1] == 0.0 && f[2] == 0.0) falcon.getFalconFirmware()->setForces(Motors{});
}

bool exchange(FalconDevice& falcon) {
  const auto before = falcon.getFalconFirmware()->getLoopCount();
  falcon.runIOLoop();
  return falcon.getFalconFirmware()->getLoopCount() != before;
}

void turnsOf(Arm& arm) {
  std::int64_t heard = host.now();
  while (!arm.ends.load(std::memory_order_acquire)) {
    const Order order = arm.orders.now(host.now());
    setForce(arm.falcon, order.force);
    const bool new_one = exchange(arm.falcon);
    const std::int64_t now = host.now();
    if (!new_one) {
      if (now - heard > kLost) {
        arm.gone.store(true, std::memory_order_release);
        break;
      }
      pauseFor(50);
      continue;
    }
    heard = now;
    arm.orders.sent(order);  // the exchange has begun with the force of setForce()
    palpate_plugin_reading r{};
    r.size = sizeof r;
    r.taken = now;
    r.state = isHomed(arm.falcon) ? PALPATE_PLUGIN_READY : 0;
    const Vector p = arm.falcon.getPosition();
    const double from_middle[3] = {p[0] - arm.middle[0], p[1] - arm.middle[1],
                                   p[2] - arm.middle[2]};
    kFrame.toW(from_middle, 1.0, r.position);
    r.buttons = arm.falcon.getFalconGrip()->getDigitalInputs() & 0xfU;
    arm.readings.put(r);
  }
  // The first exchange sends the zero of setForce(). The second exchange repeats the zero for
  // safety.
  constexpr int kTries = 20;
  int sent = 0;
  for (int i = 0; i < kTries && sent < 2; ++i) {
    setForce(arm.falcon, {0.0, 0.0, 0.0});
    if (exchange(arm.falcon)) {
      ++sent;
    } else {
      pauseFor(50);
    }
  }
}

void turns(Arm& arm) noexcept {
  char line[1];
  // An exception from the library counts as the loss of the arm.
  const bool ended = safely("nifalcon", line, sizeof line, false, [&arm] {
    turnsOf(arm);
    return true;
  });
  if (!ended) arm.gone.store(true, std::memory_order_release);
  arm.orders.serve(false);
}

int facts(palpate_plugin_device*, palpate_plugin_facts* theirs) {
  palpate_plugin_facts f{};
  f.has = PALPATE_PLUGIN_FORCE;
  f.force = kForce;
  f.stiffness = kStiffness;
  f.damping = kDamping;
  f.workspace_radius = kRadius;
  f.rate = 1000.0;
  f.buttons = 4;
  copy(f.source, kSource);
  give(theirs, f);
  return PALPATE_PLUGIN_OK;
}

int home(Arm& arm, char* error, std::size_t room) {
  FalconDevice& falcon = arm.falcon;
  auto firmware = falcon.getFalconFirmware();
  // An arm that was without power has lost its firmware, and may reject the first uploads.
  bool loaded = falcon.isFirmwareLoaded();
  constexpr int kTries = 10;
  for (int i = 0; i < kTries && !loaded; ++i) {
    loaded = firmware->loadFirmware(false, NOVINT_FALCON_NVENT_FIRMWARE_SIZE,
                                    const_cast<std::uint8_t*>(NOVINT_FALCON_NVENT_FIRMWARE)) &&
             falcon.isFirmwareLoaded();
  }
  if (!loaded) {
    tell(error, room,
         "nifalcon: the arm does not accept its firmware; switch it off, and plug it in again");
    return PALPATE_PLUGIN_FAILED;
  }
  setForce(falcon, {0.0, 0.0, 0.0});
  firmware->setHomingMode(true);
  firmware->setLEDStatus(FalconFirmware::RED_LED);
  bool said = false;
  std::int64_t heard = host.now();
  for (;;) {
    if (exchange(falcon)) {
      if (isHomed(falcon)) break;
      heard = host.now();
      if (!said && host.say != nullptr) {
        host.say(
            "nifalcon: the arm is not homed: pull the grip out as far as it goes, then push it in");
      }
      said = true;
    }
    if (host.ends() != 0) {
      tell(error, room,
           "nifalcon: the program was ended before the arm was homed; start it again and home "
           "the arm");
      return PALPATE_PLUGIN_FAILED;
    }
    if (host.now() - heard > 10 * kLost) {
      tell(error, room, "nifalcon: the arm does not answer; switch it off, and plug it in again");
      return PALPATE_PLUGIN_FAILED;
    }
    pauseFor(500);
  }
  firmware->setLEDStatus(FalconFirmware::GREEN_LED);
  arm.orders.serve(true);
  arm.loop = std::thread([&arm] { turns(arm); });
  return PALPATE_PLUGIN_OK;
}

int prepare(palpate_plugin_device* device, char* error, std::size_t room) {
  Arm& arm = of(device);
  if (arm.loop.joinable()) return PALPATE_PLUGIN_OK;
  return safely("nifalcon", error, room, static_cast<int>(PALPATE_PLUGIN_FAILED),
                [&] { return home(arm, error, room); });
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
  return arm.orders.write(known(theirs), 0.0, host.now());
}

void stop(palpate_plugin_device* device) {
  of(device).orders.stop();
}

void close(palpate_plugin_device* device) {
  Arm& arm = of(device);
  arm.ends.store(true, std::memory_order_release);
  if (arm.loop.joinable()) arm.loop.join();
  char line[1];
  safely("nifalcon", line, sizeof line, false, [&arm] {
    arm.falcon.close();
    return true;
  });
  open_arm = nullptr;
  delete &arm;
}

const void* extensionOf(palpate_plugin_device*, const char*) {
  return nullptr;
}

unsigned countNow() {
  char line[1];
  return safely("nifalcon", line, sizeof line, 0U, [] {
    FalconDevice falcon;
    unsigned count = 0;
    return falcon.getDeviceCount(count) ? count : 0U;
  });
}

// The library has no serial numbers: `serial` stays empty.
int find(palpate_plugin_found* found, int room) {
  const int count = static_cast<int>(countNow());
  for (int i = 0; i < count && i < room; ++i) {
    palpate_plugin_found f{};
    copy(f.model, "Novint Falcon");
    give(at(found, i), f);
  }
  return count;
}

// `serial` is 0 or empty for the first arm that the library finds, 1 for the second, ...
palpate_plugin_device* open(const char* serial, char* error, std::size_t room) {
  if (open_arm != nullptr) {
    tell(error, room, "nifalcon: an arm is open already; close that arm");
    return nullptr;
  }
  char* end = nullptr;
  const unsigned long index = std::strtoul(serial, &end, 10);
  const unsigned count = countNow();
  if (count == 0) {
    tell(error, room, "nifalcon: no arm is found; plug it in, and allow it by a udev rule");
    return nullptr;
  }
  if (*end != '\0' || index >= count) {
    tell(error, room, "nifalcon: there is no arm %s: %u are plugged in; count them from 0", serial,
         count);
    return nullptr;
  }
  open_arm = safely("nifalcon", error, room, static_cast<Arm*>(nullptr), [&]() -> Arm* {
    auto arm = std::make_unique<Arm>();
    arm->falcon.setFalconFirmware<FalconFirmwareNovintSDK>();
    arm->falcon.setFalconKinematic<FalconKinematicStamper>();
    arm->falcon.setFalconGrip<FalconGripFourButton>();
    Vector middle{};
    arm->falcon.getFalconKinematic()->getWorkspaceOrigin(middle);
    for (std::size_t i = 0; i < 3; ++i) arm->middle[i] = middle[i];
    if (!arm->falcon.open(static_cast<unsigned>(index))) {
      tell(error, room,
           "nifalcon: the arm cannot be opened (error %d); allow it by a udev rule, and end other "
           "programs that use it",
           static_cast<int>(arm->falcon.getErrorCode()));
      return nullptr;
    }
    arm->device = {sizeof(palpate_plugin_device),
                   0,
                   arm.get(),
                   facts,
                   prepare,
                   read,
                   write,
                   stop,
                   close,
                   extensionOf};
    return arm.release();
  });
  return open_arm != nullptr ? &open_arm->device : nullptr;
}

int init(const palpate_plugin_host* theirs) {
  host = known(theirs);
  if (host.ends != nullptr && host.now != nullptr) return 0;
  if (host.say != nullptr) {
    host.say(
        "nifalcon: this version of palpate is too old for this plug-in; install a newer palpate");
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
                                             "the Novint Falcon, by libnifalcon",
                                             "1",
                                             "Apache-2.0; needs libnifalcon (BSD)",
                                             init,
                                             end,
                                             factory};
