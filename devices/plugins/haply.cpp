/// haply.so: plug-in for Haply's Inverse3, through Haply's Inverse Service. See docs/haply.md.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <memory>
#include <string>
#include <string_view>

#include "palpate/devices/plugins/haply_messages.h"
#include "palpate/devices/plugins/haply_service.h"
#include "palpate/devices/plugins/plugin.h"

namespace {

using namespace palpate::haply;

// The maker's numbers for the Inverse3, except kContinuous and kHeating. Their sources are in
// docs/haply.md.
constexpr double kForce = 4.0;        ///< [N], possible in 80 % of the workspace; the peak is 10 N.
constexpr double kStiffness = 400.0;  ///< [N/m]
constexpr double kDamping = 3.0;      ///< [N s/m]
constexpr double kRadius = 0.1;       ///< [m]
constexpr double kResolution = 1e-5;  ///< [m]
constexpr double kContinuous = 2.0;   ///< [N]; not published, assumed to be half of kForce.
constexpr double kHeating = 10.0;     ///< [s]; not published, assumed.
constexpr double kRate = 1000.0;      ///< [Hz]; the arm itself can exchange data at 4000 Hz.
constexpr char kSource[] =
    "4 N in 80 % of the workspace (peak 10 N) and 0.01 mm: Inverse3's data sheet; 0.1 m: Haply's "
    "tutorial 06; 400 N/m, 3 N s/m: ranges of Haply's Unity samples; continuous 2 N and 10 s: "
    "assumed, not published";
/// Middle of the workspace, measured from the arm's base, as in Haply's own example of a state [m].
constexpr Triple kMiddle{0.0, -0.12, 0.15};

constexpr std::int64_t kAnswerTime = 3'000'000'000;     ///< Longest wait for the service [ns].
constexpr std::int64_t kPrepareTime = 120'000'000'000;  ///< Longest wait for the user [ns].
/// Time for which prepare() does not report a silent arm to the user [ns].
constexpr std::int64_t kFirstAnswer = 1'000'000'000;
constexpr std::int64_t kStopTime = 15'000'000;  ///< Longest wait for the service thread [ns].
constexpr std::int64_t kStopPoll = 100'000;     ///< Time between two checks in stop() [ns].
constexpr std::int64_t kPoll = 2'000'000;       ///< Time between two checks in other waits [ns].

struct Host {
  void (*say)(const char*) = nullptr;
  int (*ends)() = nullptr;
  std::int64_t (*now)() = nullptr;
};
Host host;
Address address;
std::unique_ptr<Service> service;
int users = 0;

std::int64_t machineNow() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * 1'000'000'000LL + now.tv_nsec;
}

void rest() {
  const timespec time{0, kPoll};
  nanosleep(&time, nullptr);
}

bool ended() {
  return host.ends != nullptr && host.ends() != 0;
}

void tell(char* error, std::size_t room, const std::string& words) {
  if (error == nullptr || room == 0) return;
  std::snprintf(error, room, "%s", words.c_str());
}

class Using {
 public:
  Using() {
    if (users++ == 0) service = std::make_unique<Service>(address, host.now);
  }
  ~Using() {
    if (--users == 0) service.reset();
  }
  Using(const Using&) = delete;
  Using& operator=(const Using&) = delete;
};

/// Waits for the first list of arms and returns it. Empty `why` means success.
Inventory ask(std::string& why) {
  const std::int64_t since = machineNow();
  Inventory inventory = service->inventory();
  const int refusals = inventory.refusals;
  while (!inventory.answered) {
    if (inventory.refusals > refusals) {
      why = "no service answers at " + address.words +
            ": start the Haply Hub, or on Linux: systemctl start haply-inverse-service; "
            "PALPATE_HAPLY_URL sets another address";
      return inventory;
    }
    if (ended()) {
      why = "the program was ended before the service answered: start it again";
      return inventory;
    }
    if (machineNow() - since > kAnswerTime) {
      why = "the service at " + address.words +
            " does not answer as Haply's service: restart the Haply Hub, or set "
            "PALPATE_HAPLY_URL to its address";
      return inventory;
    }
    rest();
    inventory = service->inventory();
  }
  if (inventory.generation == Generation::k30) {
    why = address.words +
          " uses the messages of version 3.0, for which no message with a force is known: install "
          "Haply's Inverse Service 3.1 or newer, and set PALPATE_HAPLY_URL to its address";
  }
  return inventory;
}

std::string modelOf(const Named& arm) {
  if (arm.config.miniature) return "Haply Minverse";
  return arm.config.left ? "Haply Inverse3 (left)" : "Haply Inverse3";
}

std::string refusal(const Named& arm) {
  const std::string name = "the arm " + std::string(arm.id.view());
  if (arm.config.miniature) {
    return name + " is a Minverse, whose limits palpate does not know: use an Inverse3";
  }
  if (arm.config.origin == Origin::kOther) {
    return name +
           " has a custom mount, so palpate does not know its position: choose the "
           "preset arm_front or arm_front_centered in the Haply Hub";
  }
  if (!arm.config.plain_axes) {
    return name + " has other axes than XYZ: set its basis to XYZ in the Haply Hub";
  }
  return {};
}

struct Device {
  Line line;
  palpate_plugin_device face{};
  Triple middle_D{};
  // Used by the haptic thread.
  std::uint64_t seen_losses = 0;
  std::uint64_t acknowledged = 1;
  Using connection;  ///< Destroyed after `line` is released.
  bool turns = false;
  int buttons = 0;
};

Device& of(palpate_plugin_device* device) {
  return *static_cast<Device*>(device->data);
}

/// Copies the fields for which the caller's struct has room, and keeps the caller's `size`.
template <class T>
void give(const T& from, T* to) {
  const std::uint32_t size = to->size;
  std::memcpy(to, &from, std::min<std::size_t>(size, sizeof(T)));
  to->size = size;
}

int facts(palpate_plugin_device* face, palpate_plugin_facts* out) {
  const Device& device = of(face);
  palpate_plugin_facts all{};
  all.has = PALPATE_PLUGIN_FORCE;
  if (device.turns) all.has |= PALPATE_PLUGIN_ORIENTATION;
  all.force = kForce;
  all.stiffness = kStiffness;
  all.damping = kDamping;
  all.workspace_radius = kRadius;
  all.rate = kRate;
  all.continuous = kContinuous;
  all.heating = kHeating;
  all.resolution = kResolution;
  all.joints = 3;
  all.buttons = static_cast<std::uint32_t>(device.buttons);
  // A handle without a cable has three buttons, which are named by letters.
  if (device.buttons == 3) {
    for (std::size_t i = 0; i < 3; ++i) {
      all.button[i][0] = static_cast<char>('a' + static_cast<int>(i));
    }
  }
  static_assert(sizeof(kSource) <= sizeof(all.source));
  std::memcpy(all.source, kSource, sizeof(kSource));
  give(all, out);
  return PALPATE_PLUGIN_OK;
}

int prepare(palpate_plugin_device* face, char* error, std::size_t room) {
  Device& device = of(face);
  std::string name = "the arm ";
  name.append(device.line.id.view()).append(" ");
  const std::int64_t since = machineNow();
  std::string said;
  for (;;) {
    std::string wanted;
    if (device.line.away) {
      wanted = "is not found: plug it in, and check that the Haply Hub shows it";
    } else if (device.line.powered == 0) {
      wanted = "has no power: plug in its power supply";
    } else if (device.line.calibrated == 0) {
      wanted =
          "does not know its position: put its handle into the inkwell until its light is white";
    } else if (device.line.ready != 1) {
      wanted = "is not ready: check its light and the Haply Hub";
    } else {
      return PALPATE_PLUGIN_OK;
    }
    if (ended() || machineNow() - since > kPrepareTime) {
      tell(error, room, name + wanted);
      return device.line.away ? PALPATE_PLUGIN_GONE : PALPATE_PLUGIN_FAILED;
    }
    // The service's first answer may come late, so a silent arm is not reported before
    // kFirstAnswer.
    const bool early = device.line.away && machineNow() - since < kFirstAnswer;
    if (!early && wanted != said) {
      if (host.say != nullptr) host.say((name + wanted).c_str());
      said = wanted;
    }
    rest();
  }
}

int read(palpate_plugin_device* face, palpate_plugin_reading* out) {
  Device& device = of(face);
  // Reports a loss even if the arm has come back before this read.
  const std::uint64_t losses = device.line.losses.load();
  if (losses != device.seen_losses) {
    device.seen_losses = losses;
    return PALPATE_PLUGIN_GONE;
  }
  if (device.line.away) return PALPATE_PLUGIN_GONE;
  if (!device.line.readings.refresh()) return PALPATE_PLUGIN_NOTHING;
  const Reading& reading = device.line.readings.current();
  palpate_plugin_reading all{};
  all.taken = reading.taken;
  // In a moved, turned or scaled workspace, the positions are not those of the hand.
  const bool ready = device.line.ready == 1 && device.line.calibrated != 0 &&
                     device.line.powered != 0 && !reading.arm.transformed;
  if (ready) all.state |= PALPATE_PLUGIN_READY;
  if (device.line.powered == 0) all.state |= PALPATE_PLUGIN_UNPOWERED;
  for (std::size_t i = 0; i < 3; ++i) {
    all.position[i] = reading.arm.position_D[i] - device.middle_D[i];
    all.velocity[i] = reading.arm.velocity_D[i];
    all.joints[i] = reading.arm.joints[i];
  }
  for (std::size_t i = 0; i < 4; ++i) all.orientation[i] = reading.grip.orientation_D[i];
  all.buttons = reading.grip.buttons;
  give(all, out);
  return PALPATE_PLUGIN_OK;
}

int write(palpate_plugin_device* face, const palpate_plugin_force* force) {
  Device& device = of(face);
  palpate_plugin_force all{};
  std::memcpy(&all, force, std::min<std::size_t>(force->size, sizeof(all)));
  const Triple wanted{all.force[0], all.force[1], all.force[2]};
  // In libstdc++, std::hypot of three numbers may ignore a NaN.
  const double strength =
      std::sqrt(wanted[0] * wanted[0] + wanted[1] * wanted[1] + wanted[2] * wanted[2]);
  const bool good = std::isfinite(strength);
  Order& order = device.line.orders.draft();
  order = {};
  if (strength == 0.0) device.acknowledged = device.line.stops.load();
  if (good) {
    const double share = strength > kForce ? kForce / strength : 1.0;
    for (std::size_t i = 0; i < 3; ++i) order.force_D[i] = wanted[i] * share;
  }
  order.when = host.now();
  order.acknowledged = device.acknowledged;
  device.line.orders.publish();
  if (!good) return PALPATE_PLUGIN_FAILED;
  return device.line.away ? PALPATE_PLUGIN_GONE : PALPATE_PLUGIN_OK;
}

void stop(palpate_plugin_device* face) {
  Line& line = of(face).line;
  const std::uint64_t stops = line.stops.fetch_add(1) + 1;
  // The process may end next, so this waits until the zero force has been sent.
  const std::int64_t since = machineNow();
  while (!line.away && line.obeyed.load() < stops && machineNow() - since < kStopTime) {
    const timespec time{0, kStopPoll};
    nanosleep(&time, nullptr);
  }
}

void close(palpate_plugin_device* face) {
  const std::unique_ptr<Device> device(&of(face));
  service->release(device->line);
}

const void* extension(palpate_plugin_device*, const char*) {
  return nullptr;
}

int find(palpate_plugin_found* found, int room) {
  const Using connection;
  std::string why;
  const Inventory inventory = ask(why);
  if (!why.empty()) {
    if (host.say != nullptr) host.say(why.c_str());
    return PALPATE_PLUGIN_GONE;
  }
  for (std::size_t i = 0; i < inventory.arms.size() && static_cast<int>(i) < room; ++i) {
    palpate_plugin_found all{};
    const std::string_view serial = inventory.arms[i].id.view();
    const std::string model = modelOf(inventory.arms[i]);
    serial.copy(all.serial, sizeof(all.serial) - 1);
    model.copy(all.model, sizeof(all.model) - 1);
    // The entries have the size that the caller's version knows.
    auto* to =
        reinterpret_cast<palpate_plugin_found*>(reinterpret_cast<char*>(found) + i * found->size);
    give(all, to);
  }
  return static_cast<int>(inventory.arms.size());
}

palpate_plugin_device* openArm(const char* serial, char* error, std::size_t room) {
  auto device = std::make_unique<Device>();
  std::string why;
  const Inventory inventory = ask(why);
  if (!why.empty()) {
    tell(error, room, why);
    return nullptr;
  }
  const std::string_view asked = serial == nullptr ? "" : serial;
  const auto arm =
      std::find_if(inventory.arms.begin(), inventory.arms.end(),
                   [&](const Named& one) { return asked.empty() || one.id.view() == asked; });
  if (arm == inventory.arms.end()) {
    std::string there;
    for (const Named& one : inventory.arms) there += " " + std::string(one.id.view());
    tell(error, room,
         inventory.arms.empty()
             ? "the Haply Hub has no Inverse3: plug one in, with its power supply"
             : "the Haply Hub has no Inverse3 " + std::string(asked) + ": name one of" + there);
    return nullptr;
  }
  if (std::string words = refusal(*arm); !words.empty()) {
    tell(error, room, words);
    return nullptr;
  }
  device->line.id = arm->id;
  device->turns = inventory.grips;
  device->buttons = inventory.button_count;
  if (arm->config.origin == Origin::kBase) device->middle_D = kMiddle;
  if (!service->serve(device->line)) {
    tell(error, room,
         std::to_string(kMaxArms) + " arms are open already, which is the limit: close one");
    return nullptr;
  }
  device->face = {sizeof(palpate_plugin_device),
                  0,
                  device.get(),
                  facts,
                  prepare,
                  read,
                  write,
                  stop,
                  close,
                  extension};
  return &device.release()->face;
}

int init(const palpate_plugin_host* from) {
  palpate_plugin_host all{};
  std::memcpy(&all, from, std::min<std::size_t>(from->size, sizeof(all)));
  host = {all.say, all.ends, all.now};
  if (host.now == nullptr) host.now = machineNow;
  address = {};
  const char* url = std::getenv("PALPATE_HAPLY_URL");
  if (url == nullptr || *url == '\0') return 0;
  const char* anywhere = std::getenv("PALPATE_HAPLY_ANYWHERE");
  std::string why;
  if (readUrl(url, anywhere != nullptr && std::string_view(anywhere) == "1", address, why)) {
    return 0;
  }
  if (host.say != nullptr) host.say(why.c_str());
  return 1;
}

void end() {
  service.reset();
  users = 0;
}

const palpate_plugin_factory kArms{sizeof(palpate_plugin_factory), 0, find, openArm};

const void* factory(const char* name) {
  return std::strcmp(name, PALPATE_PLUGIN_ARMS) == 0 ? &kArms : nullptr;
}

}  // namespace

extern "C" const palpate_plugin_entry palpate_plugin{sizeof(palpate_plugin_entry),
                                                     PALPATE_PLUGIN_MAJOR,
                                                     PALPATE_PLUGIN_MINOR,
                                                     0,
                                                     "Haply's Inverse Service",
                                                     "1.0",
                                                     "as palpate; libwebsockets: MIT",
                                                     init,
                                                     end,
                                                     factory};
