#include "palpate/devices/hid/hid_device.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fcntl.h>
#include <unistd.h>
#include <utility>

#include "palpate/devices/hid/profile_facts.h"
#include "palpate/engine/error.h"

namespace palpate {

namespace {

constexpr auto kFirstReport = std::chrono::seconds(1);
// Time between two reports of zero force while the driver waits: some firmware sends only replies.
constexpr auto kAsk = std::chrono::milliseconds(10);
constexpr auto kMend = std::chrono::milliseconds(50);
using Clock = std::chrono::steady_clock;

[[noreturn]] void throwGone(const std::string& name) {
  throw DeviceError(name, "it was unplugged, or it rejects a report", "plug it in again");
}

[[noreturn]] void throwStopped(const std::string& name) {
  throw DeviceError(name, "the program was stopped before the arm was ready",
                    "start the program again");
}

DeviceInfo infoFor(const HidProfile& profile, bool tested) {
  const HidLimits& limits = profile.limits;
  DeviceInfo info;
  info.name = "hid:" + profile.name;
  info.hand = profile.output.has_value();
  info.output_rate = profile.output_rate;
  info.limits.peak = limits.force;
  info.limits.slew = limits.slew;
  info.limits.continuous = limits.continuous;
  info.limits.heating = limits.heating;
  info.max_stiffness = limits.stiffness;
  info.max_damping = limits.damping;
  info.workspace_radius = limits.workspace_radius;
  info.watch.stale = limits.stale;
  info.watch.max_speed = limits.speed;
  for (const HidButton& button : profile.handle.buttons) {
    info.handle.buttons.push_back(button.name);
  }
  info.handle.orientation = !profile.handle.orientation.empty();
  info.handle.gripper = profile.handle.gripper.has_value();
  info.handle.joints = profile.joints.size();
  const auto source = profile.sources.find("/limits");
  info.source = source != profile.sources.end() ? source->second : profile.source;
  if (info.hand && !tested) holdUntested(info);
  return info;
}

ArmTraits traitsOf(const HidProfile& profile, const ProfileFacts& facts) {
  ArmTraits traits;
  traits.drives = profile.output.has_value();
  traits.moves = facts.moves;
  traits.down_W = profile.world_from_device * profile.down_D;
  traits.input_rate = profile.input_rate;
  traits.stiffness = profile.limits.stiffness;
  traits.workspace_radius = profile.limits.workspace_radius;
  traits.carries = !profile.masses.empty();
  return traits;
}

}  // namespace

HidDevice::HidDevice(HidProfile profile, std::unique_ptr<ReportPort> port, bool tested,
                     HidHost host)
    : profile_(std::move(profile)),
      info_(infoFor(profile_, tested)),
      host_(std::move(host)),
      port_(std::move(port)),
      mended_(profile_),
      input_(profile_),
      tested_(tested) {
  counters_.resize(profile_.joints.size());
  home_raw_.assign(profile_.joints.size(), 0.0);
  counts_ = home_raw_;
  for (const HidJoint& joint : profile_.joints) heat_.emplace_back(joint.continuous, joint.heating);
  flags_in_.assign(profile_.input.size(), false);
  for (const HidFlag& flag : profile_.flags) flags_in_[flag.field.report] = !silent();
  flags_at_.assign(profile_.input.size(), kNever);
  const ProfileFacts facts = factsOf(profile_);
  about_ = profile_.home.empty() ? rawInMiddle(profile_, facts) : rawAtHome(profile_);
  if (profile_.output) drives_W_ = facts.drives;
  traits_ = traitsOf(profile_, facts);
  for (std::size_t i = 0; i < std::min(kMotors, profile_.joints.size()); ++i) {
    if (profile_.output && !profile_.joints[i].to) undriven_.push_back(i);
  }
  numbered_ =
      std::all_of(profile_.joints.begin(), profile_.joints.end(), [&](const HidJoint& joint) {
        return profile_.input[joint.from.report].sequence.has_value();
      });
  if (profile_.output) {
    zero_.assign(profile_.output->size + 1, std::byte{0});
    zero_[0] = static_cast<std::byte>(profile_.output->id.value_or(0));
    const std::span<std::byte> body = std::span(zero_).subspan(1);
    for (const ReportField& field : profile_.output->fields) putRaw(body, field, field.rest);
    for (const HidJoint& joint : profile_.joints) {
      if (!joint.to) continue;
      const ReportField& field = profile_.output->fields[*joint.to];
      putRaw(body, field, field.offset);
    }
  }
  prepare(*port_, input_);
  try {
    begin();
  } catch (...) {
    endThreads();
    leave(*port_, input_);
    if (guard_ >= 0) close(guard_);
    throw;
  }
}

void HidDevice::begin() {
  if (profile_.home_at_open) {
    if (host_.say) {
      host_.say("arm " + profile_.name +
                ": palpate takes its present pose as its home pose: " + profile_.home_words);
    }
    for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
      home_raw_[i] = about_[i] = input_.raw(profile_.joints[i].from);
    }
  }
  guard_ = fcntl(port_->guardDescriptor(), F_DUPFD_CLOEXEC, 3);
  if (guard_ < 0 && port_->guardDescriptor() >= 0) {
    throw DeviceError("arm " + profile_.name,
                      "the program has too many open files, so its guardian cannot use the arm",
                      "close files, or raise the limit of open files (ulimit -n)");
  }
  heard_ = !silent();
  follow(0.0);
  info_.limits.friction = host_.measured.coulomb;
  if (profile_.output && host_.measured.viscous > 0.0) {
    info_.limits.tank.arm = dissipation();
    info_.limits.tank.use = info_.limits.tank.arm.viscous > 0.0 ? host_.tank : TankUse::kOff;
    info_.limits.tank.refill = host_.refill;
    info_.mass = host_.measured.mass;
  }
  read_at_ = heard_at_ = counted_at_ = moved_at_ = written_at_ = host_.now();
  knowFlags(read_at_);
  open_port_ = port_.get();
  if (profile_.output) writer_ = std::thread([this] { writeLoop(); });
  mender_ = std::thread([this] { mendLoop(); });
}

void HidDevice::knowFlags(std::int64_t now) noexcept {
  for (std::size_t r = 0; r < flags_at_.size(); ++r) flags_at_[r] = input_.known(r) ? now : kNever;
}

void HidDevice::endThreads() noexcept {
  {
    const std::lock_guard lock(mend_mutex_);
    quit_ = true;
  }
  mend_.notify_all();
  if (mender_.joinable()) mender_.join();
  if (!writer_.joinable()) return;
  ++sent_;
  sent_.notify_all();
  writer_.join();
}

HidDevice::~HidDevice() {
  carry(false);
  write(Vec3::Zero());
  const auto end = Clock::now() + kMend;
  while (profile_.output && !gone_ && written_ != sent_ && Clock::now() < end) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  endThreads();
  if (port_ != nullptr) leave(*port_, input_);
  if (guard_ >= 0) close(guard_);
}

void HidDevice::leave(ReportPort& port, HidInput& input) noexcept {
  // Repeats a report that could not be sent. Continues after a failed step, because later steps may
  // switch the amplifiers off.
  constexpr int kTries = 3;
  const auto insist = [](auto&& goes_out) {
    for (int i = 0; i < kTries && !goes_out(); ++i) continue;
  };
  if (profile_.output) insist([&] { return port.write(zero_); });
  for (const HidStep& step : profile_.close) {
    insist([&] {
      try {
        runSequence(port, input, {step}, nullptr);
        return true;
      } catch (const std::exception&) {
        return step.kind == HidStep::Kind::kWait;
      }
    });
  }
}

void HidDevice::prepare(ReportPort& port, HidInput& input) try {
  const std::string name = "arm " + profile_.name;
  const auto stop = [this] { return quit_ || (host_.stop && host_.stop()); };
  if (profile_.output && !port.write(zero_)) {
    throw DeviceError(name, "it was unplugged, or it rejects the report of zero force",
                      "plug it in again; if that does not help, check its profile and firmware");
  }
  runSequence(port, input, profile_.open, stop);
  const auto end = Clock::now() + kFirstReport;
  auto ask = Clock::now();
  for (ReadStatus got = ReadStatus::kNothing; !silent() && got != ReadStatus::kReport && !stop();) {
    got = input.takeNewest(port);
    if (got == ReadStatus::kGone) throw DeviceError(name, "it was unplugged", "plug it in again");
    if (Clock::now() > end) {
      throw DeviceError(name, "it sends no report for one or more joints of its profile",
                        "check its power, its profile and its firmware" +
                            (profile_.firmware.empty() ? "" : ": " + profile_.firmware));
    }
    if (profile_.output && Clock::now() > ask) {
      (void)port.write(zero_);
      ask += kAsk;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  if (stop()) throwStopped(name);
  runSequence(port, input, profile_.home, stop);
} catch (...) {
  leave(port, input);
  throw;
}

void HidDevice::runSequence(ReportPort& port, HidInput& input, const std::vector<HidStep>& steps,
                            const std::function<bool()>& stop) {
  const std::string name = "arm " + profile_.name;
  const std::string list = &steps == &profile_.open   ? "/open/"
                           : &steps == &profile_.home ? "/home/"
                                                      : "/close/";
  for (const HidStep& step : steps) {
    const auto require = [&](bool good) {
      if (good) return;
      throw DeviceError(name,
                        "it was unplugged, or it rejects the report of the step " + list +
                            std::to_string(&step - steps.data()),
                        "plug it in again, or correct this step of its profile");
    };
    const auto end = Clock::now() + std::chrono::duration<double>(step.seconds);
    if (stop && stop()) throwStopped(name);
    switch (step.kind) {
      case HidStep::Kind::kSend: {
        std::vector<std::byte> report = zero_;
        for (const auto& [field, raw] : step.values) {
          putRaw(std::span(report).subspan(1), profile_.output->fields[field], raw);
        }
        require(port.write(report));
        break;
      }
      case HidStep::Kind::kFeature:
        require(port.sendFeature(step.bytes));
        break;
      case HidStep::Kind::kPause:
        while (Clock::now() < end && !(stop && stop())) std::this_thread::sleep_for(kAsk);
        break;
      case HidStep::Kind::kWait:
        waitFor(port, input, step, stop);
        break;
    }
  }
}

void HidDevice::waitFor(ReportPort& port, HidInput& input, const HidStep& step,
                        const std::function<bool()>& stop) {
  const std::string name = "arm " + profile_.name;
  const auto end = Clock::now() + std::chrono::duration<double>(step.seconds);
  const std::size_t report = step.field.report;
  const ReportField& field = profile_.input[report].fields[step.field.field];
  const auto is = [&] { return input.raw(step.field) == step.equals; };
  const auto look = [&] {
    if ((profile_.output && !port.write(zero_)) || input.takeNewest(port) == ReadStatus::kGone) {
      throwGone(name);
    }
    return input.came(report);
  };
  const bool asked = !step.words.empty();
  (void)look();  // discards the reports that came during the preparation
  if (host_.say && asked) host_.say(name + ": " + step.words);
  bool begun = !asked || (input.known(report) && !is());
  for (bool says = false; !begun || !says;) {
    if (stop && stop()) throwStopped(name);
    if (Clock::now() > end) {
      std::array<char, 32> number{};
      std::snprintf(number.data(), number.size(), "%.10g", step.equals);
      const std::string value = field.name + " = " + number.data();
      if (!begun && says) {
        throw DeviceError(name, "it reported " + value + " from the start",
                          "release its button or switch first; then " + step.words);
      }
      throw DeviceError(name, "it does not report " + value,
                        asked ? step.words : "check its power, its profile and its firmware");
    }
    std::this_thread::sleep_for(kAsk);
    if (!look()) continue;
    says = is();
    begun = begun || !says;
  }
}

ZeroForce HidDevice::zeroForce() const noexcept {
  if (!profile_.output || zero_.size() > ZeroForce::kMostBytes) return {};
  ZeroForce zero{guard_, zero_};
  zero.version = plugging_;
  return zero;
}

void HidDevice::closePort() noexcept {
  open_port_ = nullptr;
  while (reading_ || writing_) std::this_thread::sleep_for(std::chrono::microseconds(100));
  // After a miscount the device is still connected, and would keep the last force.
  leave(*port_, mended_);
  port_.reset();
}

void HidDevice::mendLoop() noexcept {
  std::unique_lock lock(mend_mutex_);
  while (!quit_) {
    mend_.wait_for(lock, kMend);
    if (!gone_ || quit_) continue;
    lock.unlock();
    if (port_ != nullptr) closePort();
    std::unique_ptr<ReportPort> port;
    try {
      if (miscounted_.exchange(false)) {
        homeless_ = profile_.home.empty() || profile_.home_at_open;
        if (host_.say) {
          host_.say("arm " + profile_.name +
                    ": palpate did not read its encoders for so long that their counters may have "
                    "wrapped around: " +
                    (!homeless_              ? "palpate homes it again"
                     : profile_.home_at_open ? "put the arm into its home pose and start the "
                                               "program again"
                                             : "home the arm and start the program again"));
        }
      }
      // An arm with home_at_open cannot be homed again: its home is its pose at the opening.
      if (host_.find && !profile_.home_at_open && !homeless_) port = host_.find();
      if (port != nullptr) {
        mended_.forget();
        prepare(*port, mended_);
      }
    } catch (const std::exception&) {
      port.reset();
    }
    if (port != nullptr) {
      // Redirects the guardian's descriptor to the new device. The descriptor's number stays the
      // same.
      if (guard_ >= 0) (void)dup3(port->guardDescriptor(), guard_, O_CLOEXEC);
      port_ = std::move(port);
      gone_ = false;
      ++plugging_;
      open_port_ = port_.get();
    }
    lock.lock();
  }
}

ArmDissipation HidDevice::dissipation() const noexcept {
  ArmDissipation arm;
  // The self-test measures friction by pushing, so the friction of a joint without a motor is
  // unknown.
  if (!undriven_.empty()) return arm;
  // Assumes that in another pose a lever may be longer by this factor. Then one count moves the tip
  // farther, and the joint's friction is smaller at the tip.
  constexpr double kElsewhere = 2.0;
  arm.viscous = host_.measured.viscous / (kElsewhere * kElsewhere);
  arm.coulomb = host_.measured.coulomb / kElsewhere;
  arm.delay = host_.measured.delay;
  arm.doubt = host_.measured.doubt;
  // A position may be one input period old.
  constexpr double kUsb = 1000.0;  // [Hz]
  const double rate = profile_.input_rate > 0.0 ? profile_.input_rate : kUsb;
  arm.jitter = std::min(arm.doubt, 0.5 / rate);
  const auto steps = resolution();
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    arm.step += kElsewhere * steps[i];
    // Rounding the motor's value changes the force by up to one step of the field.
    const HidJoint& joint = profile_.joints[i];
    if (!joint.to) continue;
    const ReportField& motor = profile_.output->fields[*joint.to];
    const double lever = std::max(pose_.jacobian[i].norm() / kElsewhere, 1e-6);
    if (motor.type != ReportField::Type::kFloat) {
      arm.coulomb -= std::abs(joint.ratio * joint.torque_constant / motor.scale) / lever;
    }
  }
  // If the steps can add more energy than friction dissipates, the tank must not rely on friction.
  if (arm.coulomb < 0.0) arm = {};
  return arm;
}

}  // namespace palpate
