/// Checks an arm through a real kernel's HID layer: vm_check uhid|usb|pid|ruler|chain VOLUME
/// PROFILE. Runs in a virtual machine whose clock counts instructions, so limits can be tight. Exit
/// status: 1 if a check failed; 2 if arguments are missing; 3 if the machine paused and the run
/// must be repeated.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fcntl.h>
#include <fstream>
#include <functional>
#include <iterator>
#include <memory>
#include <string>
#include <sys/wait.h>
#include <unistd.h>
#include <vector>

#include "palpate/devices/arm/guardian.h"
#include "palpate/devices/hid/open_arm.h"
#include "palpate/devices/hid/pid_device.h"
#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/error.h"
#include "palpate/engine/loop/haptic_thread.h"
#include "palpate/engine/loop/realtime.h"
#include "palpate/scenes/library/build_scene.h"
#include "tests/devices/vm/vm_arm.h"

using namespace palpate;
using namespace palpate::vm;

namespace {

constexpr double kFriction = 0.2;  // friction coefficient of the ball

int failures = 0;

void check(bool good, const std::string& claim) {
  std::printf("%s %s\n", good ? "ok  " : "FAIL", claim.c_str());
  std::fflush(stdout);
  failures += good ? 0 : 1;
}

std::string text(double value) {
  std::array<char, 32> out{};
  std::snprintf(out.data(), out.size(), "%.6g", value);
  return out.data();
}

double quantile(std::vector<double> values, double q) {
  std::sort(values.begin(), values.end());
  return values[std::min(values.size() - 1,
                         static_cast<std::size_t>(q * static_cast<double>(values.size())))];
}

/// A port without hidapi. It does not check which process owns the device.
class BarePort final : public ReportPort {
 public:
  explicit BarePort(const std::string& path) : file_(open(path.c_str(), O_RDWR | O_NONBLOCK)) {}
  ~BarePort() override { close(file_); }
  [[nodiscard]] ReadStatus read(std::span<std::byte> to, std::size_t& size) noexcept override {
    const ssize_t n = ::read(file_, to.data(), to.size());
    size = static_cast<std::size_t>(std::max<ssize_t>(n, 0));
    return n > 0                      ? ReadStatus::kReport
           : n < 0 && errno == EAGAIN ? ReadStatus::kNothing
                                      : ReadStatus::kGone;
  }
  [[nodiscard]] bool write(std::span<const std::byte> report) noexcept override {
    return ::write(file_, report.data(), report.size()) >= 0;
  }
  [[nodiscard]] bool sendFeature(std::span<const std::byte>) noexcept override { return false; }

 private:
  int file_;
};

/// A second connection to the arm. It reads the arm's internal counters and sends commands.
class Aside {
 public:
  Aside(const HidProfile& profile, const std::string& path)
      : profile_(profile), port_(std::make_unique<BarePort>(path)), input_(profile_) {}
  void command(Command what) {
    Out out;
    out.command = what;
    (void)port_->write(std::as_bytes(std::span(&out, 1)));
  }
  /// Returns the newest value of a field.
  double ask(std::size_t field) {
    // Reads again after an overflow, because queued reports may be old.
    while (input_.takeNewest(*port_) != ReadStatus::kReport || drops_ != input_.counts().dropped) {
      drops_ = input_.counts().dropped;
      usleep(200);
    }
    return input_.raw({0, field});
  }

 private:
  const HidProfile& profile_;
  std::unique_ptr<ReportPort> port_;
  HidInput input_;
  std::int64_t drops_ = -1;
};

// Fields of the profile in alphabetical order of their names, because the JSON parser sorts
// objects.
enum Field : std::size_t { kCount, kPhase, kReceived, kStepField, kX, kY, kZ };

std::string pathOfArm() {
  for (int tries = 0; tries < 300; ++tries) {
    for (const HidDeviceName& device : listHid()) {
      if (device.vendor == kVendor && device.product == kProduct) return device.path;
    }
    usleep(10000);
  }
  throw DeviceError("arm", "it did not appear within 3 s", "see the log");
}

template <class What>
std::string refusal(What what) {
  try {
    what();
  } catch (const DeviceError& e) {
    return e.what();
  }
  return "none";
}

bool contains(const std::string& all, const std::string& part) {
  return all.find(part) != std::string::npos;
}

void checkNames(const HidProfile& profile, const std::string& file) {
  (void)pathOfArm();
  const auto arms = findArms({profile});
  check(arms.size() == 1 && arms[0].device.serial == kSerial &&
            arms[0].device.usage_page == 0xFF00 && arms[0].device.usage == 1 && arms[0].may_open,
        "listHid() finds the arm by its numbers, usage and serial number");
  check(contains(refusal([] { (void)openHid("/dev/null"); }), "not a HID device"),
        "openHid() refuses the file of another kind of device");
  check(contains(refusal([] { (void)openHid("/dev/hidraw77"); }), "the device does not exist"),
        "openHid() refuses a device that does not exist");
  check(contains(refusal([] { (void)openHid("/init"); }), "not a HID device"),
        "openHid() refuses an ordinary file");
  check(contains(refusal([] { (void)openArm("hid:polhem", {}); }),
                 "no plugged-in arm fits this name"),
        "openArm() refuses a profile whose vendor and product numbers differ");
  check(contains(refusal([&] { (void)openArm("hid:" + file + "@OTHER", {}); }),
                 "use hid:" + file + "@ARM0001"),
        "a wrong serial number is refused, and the error names the arm that is plugged in");
  {
    std::ifstream in(file);
    std::string words((std::istreambuf_iterator<char>(in)), {});
    for (const char* id : {"\"id\": 1, ", "\"id\": 2, "}) words.erase(words.find(id), 9);
    std::ofstream("/tmp/forgetful.json") << words;
  }
  check(contains(refusal([] { (void)openArm("hid:/tmp/forgetful.json", {}); }),
                 "input report 1 of 40 bytes, and this report has no number: write \"id\": 1"),
        "a profile without a report's number is refused by the device's own descriptor");
  const std::string path = pathOfArm();
  const pid_t child = fork();
  if (child == 0) {
    if (setuid(12345) != 0) _exit(2);
    _exit(contains(refusal([&] { (void)openHid(path); }), "udev rules") ? 0 : 1);
  }
  int status = 0;
  waitpid(child, &status, 0);
  check(WIFEXITED(status) && WEXITSTATUS(status) == 0,
        "without permission the error names the udev rule to install");
  const int other = open(path.c_str(), O_RDWR);
  const pid_t holder = fork();
  if (holder == 0) {
    pause();
    _exit(0);
  }
  check(!whoHas(path).empty(), "whoHas() names a program that has the arm open: " +
                                   (whoHas(path).empty() ? "-" : whoHas(path)[0]));
  kill(holder, SIGKILL);
  waitpid(holder, nullptr, 0);
  close(other);
  {
    auto first = openHid(path);
    const int guardian = dup(first->guardDescriptor());
    first.reset();
    check(refusal([&] { (void)openHid(path); }) == "none",
          "a closed arm can be opened again while its guardian still has a descriptor");
    close(guardian);
  }
  const auto ours = openHid(path);
  const std::string pid = std::to_string(getpid());
  const pid_t second = fork();
  if (second == 0) {
    const std::string words = refusal([&] { (void)openHid(path); });
    _exit(contains(words, "uses this arm") && contains(words, "(" + pid + ")") ? 0 : 1);
  }
  waitpid(second, &status, 0);
  check(WIFEXITED(status) && WEXITSTATUS(status) == 0,
        "a second program is refused, and the error names the first program");
}

/// Opens the arm of a profile file. Stores messages to the user in `said`.
std::unique_ptr<HidDevice> openHidArm(const std::string& file, std::vector<std::string>& said) {
  ArmHost host;
  host.say = [&said](const std::string& words) { said.push_back(words); };
  std::unique_ptr<Arm> arm = openArm("hid:" + file, host).device;
  auto& device = dynamic_cast<HidDevice&>(*arm);
  (void)arm.release();
  return std::unique_ptr<HidDevice>(&device);
}

/// Reads and writes once a millisecond for `seconds`, and checks the traffic.
void checkLoop(HidDevice& arm, Aside& aside, double seconds, bool usb) {
  std::vector<double> periods;
  std::vector<double> reads;
  std::vector<double> writes;
  const auto ticks = static_cast<int>(1000.0 * seconds);
  periods.reserve(static_cast<std::size_t>(ticks));
  reads.reserve(periods.capacity());
  writes.reserve(periods.capacity());
  (void)arm.read();
  usleep(3000);
  (void)arm.read();
  const double count = aside.ask(kCount);
  const double received = aside.ask(kReceived);
  (void)arm.read();
  const HidInput::Counts before = arm.reads();
  const std::int64_t sent = arm.writes().count;
  const std::int64_t begin = nowNs();
  std::int64_t fresh = begin;
  std::int64_t used = before.reports;
  constexpr std::int64_t period = 1000000;
  int late = 0;
  int excused = 0;  // late ticks that the machine caused
  std::int64_t stood_to = begin;
  std::int64_t done = begin;
  for (int i = 0; i < ticks; ++i) {
    const std::int64_t due = begin + (i + 1) * period;
    const bool slept = done < due;
    sleepUntil(due);
    const std::int64_t start = nowNs();
    if (slept && start - due > period) stood_to = start;
    if (start - due > period) {
      ++late;
      if (due < stood_to) ++excused;
    }
    const HandState hand = arm.read();
    const std::int64_t middle = nowNs();
    if (hand.fault != Fault::kNone) {
      check(false, std::string("no fault in the loop: ") + wordFor(hand.fault));
      return;
    }
    arm.write({0.0, 0.0, 1e-3 * (i % 7)});
    const std::int64_t end = nowNs();
    done = end;
    reads.push_back(1e-3 * static_cast<double>(middle - start));
    writes.push_back(1e-3 * static_cast<double>(end - middle));
    if (arm.reads().reports != used) {
      used = arm.reads().reports;
      periods.push_back(1e-3 * static_cast<double>(middle - fresh));
      fresh = middle;
    }
  }
  usleep(20000);
  (void)arm.read();
  const HidInput::Counts after = arm.reads();
  const double passed = aside.ask(kCount) - count;
  const double arrived = aside.ask(kReceived) - received;
  const double taken =
      static_cast<double>(after.reports + after.passed_by - before.reports - before.passed_by);
  const double gone = static_cast<double>(arm.writes().count - sent);
  check(after.dropped == before.dropped && std::abs(taken - passed) <= 3.0,
        "no report is lost: " + text(taken) + " of " + text(passed) +
            " reports that the arm has counted");
  check(quantile(periods, 0.99) <= 1050.0, "a new position arrives in every period: median " +
                                               text(quantile(periods, 0.5)) + " us, p99 " +
                                               text(quantile(periods, 0.99)) + " us, longest " +
                                               text(quantile(periods, 1.0)) + " us");
  // On a busy host the virtual machine sometimes pauses for some milliseconds. Then all due ticks
  // come at once, and only the newest force is sent. A late tick is excused if the loop began to
  // wait for it in time. The next ticks are excused, too, if they were due before this tick began.
  // The machine can also pause while a tick computes, so one late tick of a thousand is allowed.
  check(late - excused <= ticks / 1000,
        "at most one tick of a thousand is late without a pause of the machine: " +
            text(late - excused) + " late, and with a pause " + text(excused));
  check(gone == arrived && gone <= ticks && gone >= ticks - 2 * late,
        "each tick writes once: " + text(gone) + " sent, " + text(arrived) + " arrived in " +
            text(ticks) + " ticks");
  check(quantile(writes, 1.0) < 200.0,
        "a write never delays the loop: at most " + text(quantile(writes, 1.0)) +
            " us, while sending a report takes up to " +
            text(1e-3 * static_cast<double>(arm.writes().longest_ns)) + " us; a read at most " +
            text(quantile(reads, 1.0)) + " us");
  if (usb) {
    check(arm.writes().longest_ns > 300000,
          "sending a report takes more than 0.3 ms, so the check above is meaningful");
  }
}

void checkStall(HidDevice& arm, Aside& aside) {
  aside.command(kGo);  // motion reveals old positions
  usleep(500000);
  (void)arm.read();
  const Vec3 before = arm.read().position;
  const std::int64_t dropped = arm.reads().dropped;
  usleep(300000);
  const HandState stalled = arm.read();
  check(arm.reads().dropped - dropped >= 60 && !stalled.ready && stalled.position == before,
        "after a pause of 300 ms no old report counts as new: " +
            text(static_cast<double>(arm.reads().dropped - dropped)) +
            " reports are discarded, and the arm is not ready");
  usleep(2000);
  const HandState fresh = arm.read();
  const double now = kStep * static_cast<std::int32_t>(static_cast<std::uint32_t>(
                                 static_cast<std::int64_t>(aside.ask(kZ))));
  check(fresh.ready && fresh.age < 0.0021 && std::abs(fresh.position.z() - now) < 5e-4,
        "the next position equals the arm's position: off by " +
            text(1e6 * (fresh.position.z() - now)) + " um");
}

/// Runs the real loop. When the arm is unplugged, the force is cut. After plugging in, the force
/// stays off until the program clears the fault.
void checkPlugging(HidDevice& arm, Aside& aside, Guardian& guardian) {
  LoopParams params;
  const ZeroForce zero = arm.zeroForce();
  params.watch = guardian.watch(zero);
  HapticThread hand(arm, params);
  usleep(100000);
  const std::int64_t ordered = nowNs();
  aside.command(kUnplug);
  std::int64_t known = 0;
  while (nowNs() - ordered < 1000000000) {
    if (hand.latest().fault == Fault::kGone) {
      known = nowNs();
      break;
    }
    usleep(50);
  }
  check(known != 0 && known - ordered < 4000000,
        "after unplugging, the loop cuts the force with the fault gone " +
            text(1e-6 * static_cast<double>(known - ordered)) +
            " ms after the command to unplug (at most one period plus the time of unplugging)");
  check(hand.latest().report.force == Vec3::Zero(), "the force is zero while the arm is unplugged");
  while (arm.pluggings() < 2 && nowNs() - ordered < 5000000000) usleep(1000);
  const double back = 1e-9 * static_cast<double>(nowNs() - ordered);
  check(arm.pluggings() == 2 && back < 3.0, "after plugging in, the arm is open again after " +
                                                text(back) +
                                                " s, including 0.2 s without a device");
  check(hand.latest().fault == Fault::kGone, "the fault stays until the program clears it");
  const ZeroForce renewed = arm.zeroForce();
  check(renewed.version != zero.version,
        "the version of the zero force changes, so the program can renew its guardian");
  guardian.renew(params.watch, renewed);
  usleep(100000);  // the new watcher process needs time on the only core
  hand.clear();
  usleep(50000);
  check(hand.latest().fault == Fault::kNone,
        std::string("after clear() the loop has no fault: ") + wordFor(hand.latest().fault));
  hand.stop();
  guardian.forget(params.watch);
}

struct Felt {
  std::array<std::int32_t, 3> position{};
  std::array<std::int32_t, 3> force{};
};

/// Tests the whole chain: a volume from a file, the engine, hidapi, the kernel, and an arm with its
/// own dynamics. Compares the result with a run in virtual time. Returns false if ticks were late,
/// because then the runs are not comparable.
[[nodiscard]] bool checkChain(const std::string& volume, const std::string& profile_file) {
  SceneSpec spec;
  spec.coupling.stiffness = 500.0;
  VolumeSpec ball;
  ball.file = volume;
  ball.place.kind = PlaceSpec::Kind::kMap;
  ball.place.scale = 0.015;  // the ball in the file has a radius of 2 units, which becomes 3 cm
  spec.volumes["ball"] = ball;
  ModeSpec mode;
  mode.kind = ModeKind::kIsosurface;
  mode.of = "ball";
  mode.solid = Solid::kBelow;
  mode.strength = 4.0;
  mode.friction = TransferSpec(TransferFunction(kFriction));
  spec.graph.modes.push_back(mode);
  const BuiltScene built = buildScene(spec);

  std::vector<std::string> said;
  std::unique_ptr<HidDevice> arm = openHidArm(profile_file, said);
  check(arm->info().limits.peak == 5.0, "the arm that has passed its test has its own limits");
  std::int64_t late = 0;
  {
    Aside aside(arm->profile(), pathOfArm());
    // The time between the arm's steps and the loop's ticks is random. A force that arrives close
    // to a step can act in that step or in the next. In virtual time it always arrives before the
    // step.
    std::unique_ptr<HapticThread> thread;
    double phase = 0.0;
    for (int tries = 0; tries < 20 && !(phase > 300.0 && phase < 800.0); ++tries) {
      thread.reset();
      // Waits longer at each attempt: on a machine that counts instructions, equal attempts have
      // equal results.
      usleep(1370 + 170 * static_cast<unsigned>(tries));
      thread = std::make_unique<HapticThread>(*arm);
      usleep(100000);
      phase = aside.ask(kPhase);
    }
    HapticThread& hand = *thread;
    hand.publish(built.scene);
    usleep(2000000);
    check(phase > 300.0 && phase < 800.0,
          "a force comes " + text(phase) +
              " us after the report of the position from which it was computed");
    check(hand.latest().fault == Fault::kNone, "the loop has no fault before the hand moves");
    aside.command(kGo);
    usleep(4300000);
    late = hand.latest().late_ticks;
    check(late > 0 || hand.latest().fault == Fault::kNone,
          std::string("no fault: ") + wordFor(hand.latest().fault));
    hand.stop();
    aside.command(kEnd);
  }
  arm.reset();
  usleep(300000);
  if (late > 0) {
    std::printf("the machine paused: %lld ticks were late, so the runs are not compared\n",
                static_cast<long long>(late));
    return false;
  }

  std::vector<Felt> real;
  std::ifstream log("/tmp/arm.log");
  for (std::size_t n = 0; log >> n;) {
    Felt felt;
    for (auto* triple : {&felt.position, &felt.force}) {
      for (auto& v : *triple) log >> v;
    }
    real.push_back(felt);
  }
  check(real.size() > 4000,
        "the arm has logged " + text(static_cast<double>(real.size())) + " steps");

  // The same scene in virtual time, on an arm with the same limits.
  HandTarget path = handPath();
  path.seconds = 1e9;
  SimulatedDevice simulated(armParams(), GripParams{}, path, 1000.0);
  struct Limited final : public Device {
    SimulatedDevice& inner;
    DeviceInfo about;
    Vec3 sent = Vec3::Zero();
    Limited(SimulatedDevice& d, const DeviceInfo& info) : inner(d), about(info) {
      about.hand = false;
    }
    [[nodiscard]] const DeviceInfo& info() const noexcept override { return about; }
    [[nodiscard]] HandState read() noexcept override { return inner.read(); }
    void write(const Vec3& force) noexcept override {
      sent = force;
      inner.write(force);
    }
  } limited(simulated, simulated.info());
  limited.about.limits = {5.0, 2000.0};
  HapticLoop loop(limited, 1000.0);
  loop.publish(built.scene);
  TickTime time;
  double worst = 0.0;
  double farthest = 0.0;
  double largest = 0.0;
  std::size_t worst_at = 0;
  const std::size_t steps = std::min<std::size_t>(real.size(), 4200);
  for (std::size_t n = 0; n < steps; ++n) {
    const Vec3 at = limited.read().position;
    time.now = 1e-3 * static_cast<double>(n);
    loop.tick(time);
    Vec3 felt;
    Vec3 stood;
    for (int a = 0; a < 3; ++a) {
      felt[a] = kForce * real[n].force[static_cast<std::size_t>(a)];
      stood[a] = kStep * real[n].position[static_cast<std::size_t>(a)];
    }
    const double off = (felt - limited.sent).norm();
    if (off > worst) {
      worst = off;
      worst_at = n;
    }
    farthest = std::max(farthest, (stood - at).norm());
    largest = std::max(largest, limited.sent.norm());
  }
  // One encoder step deeper increases the load of a slipping hand, and so also the friction.
  const double allowed = std::hypot(1.0, kFriction) * spec.coupling.stiffness * kStep;
  check(largest > 1.0, "the hand feels the ball: at most " + text(largest) + " N");
  check(worst <= allowed, "the forces equal those in virtual time within " + text(allowed) +
                              " N, the effect of one encoder step: at most " + text(worst) +
                              " N off, at step " + text(static_cast<double>(worst_at)) +
                              "; positions at most " + text(1e6 * farthest) + " um off");
  return true;
}

/// Returns the raw position that a PID arm reports at a position [m].
std::array<int, 3> standsAt(const Vec3& position, const std::vector<double>& steps) {
  std::array<int, 3> raw{};
  for (std::size_t a = 0; a < steps.size(); ++a) {
    raw[a] = static_cast<int>(std::lround(position[static_cast<Eigen::Index>(a)] / steps[a]));
  }
  return raw;
}

/// Checks a PID device whose reported position follows its motors' force. So its reports reveal the
/// forces that it received.
void checkPid(std::size_t kind) {
  const int axes = pidShape(kind).axes;
  std::string spec;
  for (int a = 0; a < axes; ++a) {
    spec += std::string(a == 0 ? "" : ",") + "{\"axis\": \"" +
            kAxisNames[static_cast<std::size_t>(a)] + "\", \"way\": 0.2, \"force\": 10}";
  }
  const HidProfile profile = parseHidProfile(
      R"({"palpate_arm": 1, "name": "pid", "firmware": "f", "match": [{"vendor": "1209", "product": "000)" +
          std::to_string(kPidProducts[kind]) + R"("}], "rate": {"input": 1000, "output": 9000},
      "pid": {"axes": [)" +
          spec + R"(]}, "limits": {"force": 10, "slew": 2000, "stiffness": 1000,
      "damping": 5, "workspace_radius": 0.1}})",
      "pid.json");
  const auto arms = findArms({profile});
  const std::string name = kind == 1 ? "as VPforce" : "as OpenFFBoard";
  check(arms.size() == 1 && !arms[0].against(profile) && effectNodes(arms[0].device.path).empty(),
        name + ": listHid() finds the device, and its descriptor has all required parts");
  if (arms.size() != 1) return;
  PidDevice arm(profile, arms[0].device.descriptor, openHid(arms[0].device.path), true);
  const auto steps = arm.steps();
  constexpr int kCycles = 2000;
  constexpr std::size_t kKept = 8;
  std::array<std::array<int, 3>, kKept> told{};
  int mismatches = 0;
  int different = 0;
  std::size_t latest = 0;
  const std::int64_t begin = nowNs();
  for (int i = 0; i < kCycles; ++i) {
    sleepUntil(begin + i * std::int64_t{1000000});
    const HandState hand = arm.read();
    if (hand.fault != Fault::kNone) {
      check(false, name + ": no fault: " + wordFor(hand.fault));
      return;
    }
    const auto stands = standsAt(hand.position, steps);
    for (std::size_t a = 0; a < static_cast<std::size_t>(axes); ++a) {
      std::size_t age = 0;
      while (age < kKept && told[age][a] != stands[a]) ++age;
      if (age == kKept && i > 10) ++mismatches;
      if (age < kKept) latest = std::max(latest, age);
      different += stands[a] != 0 ? 1 : 0;
    }
    const double t = 1e-3 * i;
    const Vec3 force(6.0 * std::sin(10.0 * t), 4.0 * std::cos(20.0 * t), 5.0 * std::sin(7.0 * t));
    arm.write(force);
    std::rotate(told.begin(), told.end() - 1, told.end());
    told[0] = {};
    for (int a = 0; a < axes; ++a) {
      told[0][static_cast<std::size_t>(a)] =
          static_cast<int>(std::trunc(force[a] / 10.0 * (kind == 1 ? 4096 : 32767)));
    }
  }
  check(mismatches == 0 && different > axes * kCycles / 2,
        name + ": " + text(kCycles) + " forces along " + text(axes) + " axes, " + text(mismatches) +
            " mismatches, the oldest written " + text(static_cast<double>(latest)) +
            " cycles before; " + text(static_cast<double>(arm.traffic().writes)) +
            " forces sent, the longest in " +
            text(1e-3 * static_cast<double>(arm.traffic().longest_ns)) + " us; at most " +
            text(arm.info().output_rate) + " a second");
  const ZeroForce zero = arm.zeroForce();
  const bool wrote = ::write(zero.descriptor, zero.bytes.data(), zero.bytes.size()) ==
                     static_cast<ssize_t>(zero.bytes.size());
  usleep(4000);
  (void)arm.read();
  check(wrote && standsAt(arm.read().position, steps) == std::array<int, 3>{},
        name + ": the guardian's report sets the force to zero");
}

bool run(const std::string& what, const std::string& volume, const std::string& profile_file) {
  if (what == "chain") return checkChain(volume, profile_file);
  if (what == "pid") {
    const StayAwake awake(false);
    (void)becomeRealtime({}, awake);
    for (std::size_t kind = 0; kind < kPidProducts.size(); ++kind) checkPid(kind);
    return true;
  }
  if (what == "ruler") {
    const HidProfile arm = readHidProfile(profile_file);
    Aside(arm, pathOfArm()).command(kRuler);
    return true;
  }
  Guardian guardian;
  const HidProfile profile = readHidProfile(profile_file);
  checkNames(profile, profile_file);
  std::vector<std::string> said;
  const std::unique_ptr<HidDevice> arm = openHidArm(profile_file, said);
  check(contains(refusal([&] { (void)openArm("hid:" + profile_file, {}); }), "other hands use"),
        "an arm that one hand uses is refused to another hand");
  check(arm->info().limits.peak == kUntestedForce && !said.empty() &&
            contains(said.back(), "palpate devices --test hid:" + profile_file + "@ARM0001"),
        "an untested arm is limited to 1 N, and the message names the test");
  const StayAwake awake(false);
  (void)becomeRealtime({}, awake);
  Aside aside(arm->profile(), pathOfArm());
  checkLoop(*arm, aside, what == "usb" ? 5.0 : 10.0, what == "usb");
  checkStall(*arm, aside);
  checkPlugging(*arm, aside, guardian);
  return true;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 4) return 2;
  try {
    const bool answered = run(argv[1], argv[2], argv[3]);
    if (!answered && failures == 0) return 3;
    std::printf("%s: %d failures\n", argv[1], failures);
    return failures == 0 ? 0 : 1;
  } catch (const std::exception& e) {
    std::printf("FAIL %s\n", e.what());
    return 1;
  }
}
