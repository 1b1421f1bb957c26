#include "palpate/devices/hid/hid_device.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <fcntl.h>
#include <unistd.h>
#include <utility>

#include <Eigen/Geometry>

#include "palpate/devices/arm/pace.h"
#include "palpate/devices/hid/profile_facts.h"
#include "palpate/engine/error.h"

namespace palpate {

namespace {

constexpr std::size_t kFullRing = 60;          // of the kernel's 63: later reports are lost
constexpr std::size_t kMostReads = 128;        // per call
constexpr std::int64_t kWriteTime = 20000000;  // [ns]: a longer write is blocked
constexpr auto kFirstReport = std::chrono::seconds(1);
constexpr auto kAsk = std::chrono::milliseconds(10);  // some firmware only answers
constexpr auto kMend = std::chrono::milliseconds(50);
constexpr std::int64_t kLongestSleep = 1000000;  // [ns] of the writer, so that it can end
constexpr double kLongestStep = 0.02;            // [s]: most time a read for a puck or a weight
using Clock = std::chrono::steady_clock;

[[noreturn]] void throwGone(const std::string& name) {
  throw DeviceError(name, "it was unplugged, or refuses a report", "plug it in again");
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

HidInput::HidInput(const HidProfile& profile) : profile_(profile) {
  std::size_t fields = 0;
  for (const HidReportSpec& report : profile.input) {
    first_.push_back(fields);
    fields += report.fields.size();
    if (report.id) head_ = 1;
  }
  values_.assign(fields, 0.0);
  forget();
  joints_in_.assign(profile.input.size(), false);
  for (const HidJoint& joint : profile.joints) joints_in_[joint.from.report] = true;
  fresh_.assign(profile.input.size(), false);
  came_ = known_ = fresh_;
}

HidInput::Taken HidInput::take(std::span<const std::byte> report) noexcept {
  for (std::size_t r = 0; r < profile_.input.size(); ++r) {
    const HidReportSpec& spec = profile_.input[r];
    if (spec.id && (report.empty() || static_cast<std::byte>(*spec.id) != report[0])) continue;
    const std::span<const std::byte> body = report.subspan(std::min(head_, report.size()));
    std::size_t needed = 0;
    for (const ReportField& field : spec.fields) needed = std::max(needed, field.end());
    if (body.size() < needed) return Taken::kStrange;
    if (spec.sequence && known_[r] &&
        values_[first_[r] + *spec.sequence] == rawOf(body, spec.fields[*spec.sequence])) {
      return Taken::kRepeated;
    }
    for (std::size_t f = 0; f < spec.fields.size(); ++f) {
      values_[first_[r] + f] = rawOf(body, spec.fields[f]);
    }
    fresh_[r] = came_[r] = known_[r] = true;
    return Taken::kUsed;
  }
  return Taken::kStrange;
}

void HidInput::forget() noexcept {
  // A puck that has not reported yet rests.
  for (std::size_t r = 0; r < profile_.input.size(); ++r) {
    for (std::size_t f = 0; f < profile_.input[r].fields.size(); ++f) {
      const ReportField& field = profile_.input[r].fields[f];
      values_[first_[r] + f] = profile_.rate_control > 0.0 ? -field.offset / field.scale : 0.0;
    }
  }
  std::fill(fresh_.begin(), fresh_.end(), false);
  came_ = known_ = fresh_;
}

void HidInput::adopt(const HidInput& other) noexcept {
  std::copy(other.values_.begin(), other.values_.end(), values_.begin());
  std::copy(other.known_.begin(), other.known_.end(), known_.begin());
  std::fill(fresh_.begin(), fresh_.end(), false);
}

ReadStatus HidInput::takeNewest(ReportPort& port) noexcept {
  std::size_t count = 0;
  std::int64_t good = 0;
  std::fill(came_.begin(), came_.end(), false);
  for (; count < kMostReads; ++count) {
    std::size_t size = 0;
    const ReadStatus got = port.read(buffer_, size);
    if (got == ReadStatus::kGone) return ReadStatus::kGone;
    if (got == ReadStatus::kNothing) break;
    const auto report = std::span<const std::byte>(buffer_).first(std::min(size, buffer_.size()));
    const Taken taken = take(report);
    good += static_cast<std::int64_t>(taken == Taken::kUsed);
    counts_.strange += static_cast<std::int64_t>(taken == Taken::kStrange);
    counts_.repeated += static_cast<std::int64_t>(taken == Taken::kRepeated);
  }
  if (count >= kFullRing) {
    std::fill(known_.begin(), known_.end(), false);
    counts_.dropped += static_cast<std::int64_t>(count);
    std::fill(fresh_.begin(), fresh_.end(), false);
    std::fill(came_.begin(), came_.end(), false);
    return ReadStatus::kNothing;
  }
  counts_.taken += good;
  // Reports without a joint's field do not give a position.
  for (std::size_t r = 0; r < fresh_.size(); ++r) {
    if (joints_in_[r] && !fresh_[r]) return ReadStatus::kNothing;
  }
  std::fill(fresh_.begin(), fresh_.end(), false);
  counts_.passed_by += good - 1;
  ++counts_.reports;
  return ReadStatus::kReport;
}

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
      host_.say("arm " + profile_.name + ": its home pose is now: " + profile_.home_words);
    }
    for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
      home_raw_[i] = about_[i] = input_.raw(profile_.joints[i].from);
    }
  }
  guard_ = fcntl(port_->guardDescriptor(), F_DUPFD_CLOEXEC, 3);
  if (guard_ < 0 && port_->guardDescriptor() >= 0) {
    throw DeviceError("arm " + profile_.name, "no descriptor is left for its guardian",
                      "close some files");
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
  // A report that was not sent may succeed the next time. The steps run one by one: the amplifiers
  // are switched off even if a wait for the arm fails.
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
    throw DeviceError(name, "it takes no report", "see whether another program has it");
  }
  runSequence(port, input, profile_.open, stop);
  const auto end = Clock::now() + kFirstReport;
  auto ask = Clock::now();
  for (ReadStatus got = ReadStatus::kNothing; !silent() && got != ReadStatus::kReport && !stop();) {
    got = input.takeNewest(port);
    if (got == ReadStatus::kGone) throw DeviceError(name, "it was unplugged", "plug it in again");
    if (Clock::now() > end) {
      throw DeviceError(name, "it sends no report that its profile knows",
                        "see to its power and firmware" +
                            (profile_.firmware.empty() ? "" : ": " + profile_.firmware));
    }
    if (profile_.output && Clock::now() > ask) {
      (void)port.write(zero_);
      ask += kAsk;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  if (stop()) throw DeviceError(name, "it was not made ready", "the program has ended");
  runSequence(port, input, profile_.home, stop);
} catch (...) {
  leave(port, input);
  throw;
}

void HidDevice::runSequence(ReportPort& port, HidInput& input, const std::vector<HidStep>& steps,
                            const std::function<bool()>& stop) {
  const std::string name = "arm " + profile_.name;
  const auto require = [&](bool good) {
    if (!good) throwGone(name);
  };
  for (const HidStep& step : steps) {
    const auto end = Clock::now() + std::chrono::duration<double>(step.seconds);
    if (stop && stop()) throw DeviceError(name, "it was not made ready", "the program has ended");
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
  (void)look();  // discards older reports
  if (host_.say && asked) host_.say(name + ": " + step.words);
  bool begun = !asked || (input.known(report) && !is());
  for (bool says = false; !begun || !says;) {
    if (Clock::now() > end || (stop && stop())) {
      const std::string value = field.name + " = " + std::to_string(std::lround(step.equals));
      if (!begun && says) {
        throw DeviceError(name, "it has said " + value + " all the time",
                          "let go first; then " + step.words);
      }
      throw DeviceError(name, "it does not say " + value,
                        asked ? step.words : "see to its power and firmware");
    }
    std::this_thread::sleep_for(kAsk);
    if (!look()) continue;
    says = is();
    begun = begun || !says;
  }
}

void HidDevice::follow(double dt) noexcept {
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    const HidJoint& joint = profile_.joints[i];
    const ReportField& field = profile_.input[joint.from.report].fields[joint.from.field];
    double raw = input_.raw(joint.from);
    if (field.wraps) raw = counters_[i].follow(raw, field.bits, about_[i]);
    joints_[i] = jointAt(profile_, i, raw, home_raw_[i]);
  }
  pose_ = profile_.kinematics->at(joints_);
  const Vec3 position_W = profile_.world_from_device * (pose_.position_D - profile_.origin_D);
  if (profile_.rate_control <= 0.0) {
    position_W_ = position_W;
    return;
  }
  position_W_ += profile_.rate_control * std::min(dt, kLongestStep) * position_W;
  const double reach = profile_.limits.workspace_radius;
  if (position_W_.norm() > reach) position_W_ *= reach / position_W_.norm();
}

void HidDevice::lookAtHandle() noexcept {
  Handle handle;
  std::copy(joints_.begin(), joints_.begin() + static_cast<std::ptrdiff_t>(profile_.joints.size()),
            handle.joints.begin());
  const HidHandle& of = profile_.handle;
  for (std::size_t i = 0; i < of.buttons.size(); ++i) {
    const bool pressed = input_.known(of.buttons[i].field.report) &&
                         input_.raw(of.buttons[i].field) == of.buttons[i].equals;
    handle.buttons |= static_cast<std::uint32_t>(pressed) << i;
  }
  const auto angle_of = [&](const HidTurn& turn) {
    if (turn.joint) return joints_[*turn.joint];
    const ReportField& field = profile_.input[turn.from.report].fields[turn.from.field];
    return (field.scale * input_.raw(turn.from) + field.offset) / turn.ratio + turn.home;
  };
  if (of.gripper) handle.gripper = angle_of(*of.gripper);
  Eigen::Quaterniond turned(profile_.world_from_device);
  for (const HidTurn& turn : of.orientation) {
    turned = turned * Eigen::AngleAxisd(angle_of(turn), turn.axis);
  }
  turned.normalize();
  if (!of.orientation.empty()) {
    handle.orientation = {turned.w(), turned.x(), turned.y(), turned.z()};
  }
  // Fields may be floats of any value. If one is not finite, the handle keeps its last state.
  bool finite = std::isfinite(handle.gripper) && turned.coeffs().allFinite();
  for (const double joint : handle.joints) finite = finite && std::isfinite(joint);
  if (!finite) {
    handle.joints = handle_.joints;
    handle.gripper = handle_.gripper;
    handle.orientation = handle_.orientation;
  }
  handle_ = handle;
}

HandState HidDevice::read() noexcept {
  HandState hand;
  const std::int64_t now = host_.now();
  const double dt = 1e-9 * static_cast<double>(now - read_at_);
  read_at_ = now;
  readReports(now, dt, hand);
  hand.position = position_W_;
  lookAtHandle();
  hand.handle = handle_;
  hand.drives = drivesHere();
  hand.age = silent() ? 0.0 : 1e-9 * static_cast<double>(now - heard_at_);
  hand.ready = pose_.reachable && (heard_ || silent());
  if (profile_.output && !numbered_) hand.still = 1e-9 * static_cast<double>(now - moved_at_);
  applyFlags(hand);
  lookAtFlags(now, hand);
  lookAtWrites(now, hand);
  // The carried weight grows like every force, and ends at once.
  upright_ = hand.ready && hand.fault == Fault::kNone && hand.age <= profile_.limits.stale;
  const double step = std::min(dt, kLongestStep) / kEngage;
  carried_share_ = carries_ && upright_ ? std::min(1.0, carried_share_ + step) : 0.0;
  return hand;
}

void HidDevice::readReports(std::int64_t now, double dt, HandState& hand) noexcept {
  const Using port(open_port_, reading_);
  const std::uint32_t plugging = plugging_;
  if (port && plugging != plugging_seen_) {
    plugging_seen_ = plugging;
    adoptMended(now);
  }
  // The arm may have moved since the opening. An arm that reports by itself that it is homed is
  // where it now reports. An arm homed at the opening must be followed from there on.
  if (!std::exchange(ticked_, true) && !profile_.home_at_open && profile_.home.empty()) {
    forgetCounters();
  }
  // After a pause the waiting reports are old; the next report gives the position.
  const bool paused = dt > profile_.limits.stale;
  if (paused) forgetReports(now);
  ReadStatus got = port ? input_.takeNewest(*port) : ReadStatus::kGone;
  if (paused && got == ReadStatus::kReport && !silent()) got = ReadStatus::kNothing;
  // The counters may have wrapped, so only homing can give the position.
  if (got == ReadStatus::kReport && !countedOn(1e-9 * static_cast<double>(now - counted_at_))) {
    miscounted_ = true;
    got = ReadStatus::kGone;
    hand.fault = Fault::kMiscounted;
  }
  if (got == ReadStatus::kGone) {
    if (port) lost();
    if (hand.fault == Fault::kNone) hand.fault = Fault::kGone;
  }
  if (got == ReadStatus::kReport) {
    counted_at_ = now;
    heard_ = true;
    heard_at_ = now;
    lookForMotion(now);
  }
  for (std::size_t r = 0; r < flags_at_.size(); ++r) {
    if (input_.came(r) && !paused) flags_at_[r] = now;
  }
  // A puck that is held off its rest sends reports again and again. If they stop, the last one is
  // valid until it is stale.
  const double since = 1e-9 * static_cast<double>(now - heard_at_);
  const double moves = std::clamp(profile_.limits.stale - (since - dt), 0.0, dt);
  if (got == ReadStatus::kReport || (got == ReadStatus::kNothing && silent())) follow(moves);
}

void HidDevice::adoptMended(std::int64_t now) noexcept {
  heard_ = false;
  heard_at_ = written_at_ = now;
  forgetCounters();
  input_.adopt(mended_);
  moved_at_ = now;
  knowFlags(now);
}

void HidDevice::forgetReports(std::int64_t now) noexcept {
  heard_ = false;
  if (!silent()) heard_at_ = now;
  moved_at_ = written_at_ = now;
  std::fill(flags_at_.begin(), flags_at_.end(), kNever);
}

void HidDevice::forgetCounters() noexcept {
  for (Unwrapped& counter : counters_) counter.forget();
}

void HidDevice::applyFlags(HandState& hand) noexcept {
  for (const HidFlag& flag : profile_.flags) {
    // Flags without a report are ignored here; lookAtFlags waits for them.
    if (!silent() && flags_at_[flag.field.report] == kNever) continue;
    const bool says = input_.raw(flag.field) == flag.equals;
    // Homing sets counters, so their earlier values are not a reference.
    if (flag.means == HidFlag::Means::kHomed && !says) forgetCounters();
    if (flag.means == HidFlag::Means::kHomed || flag.means == HidFlag::Means::kEnabled) {
      hand.ready = hand.ready && says;
    } else if (says && hand.fault == Fault::kNone) {
      hand.fault = flag.means == HidFlag::Means::kHot         ? Fault::kTemperature
                   : flag.means == HidFlag::Means::kUnpowered ? Fault::kPower
                                                              : Fault::kSwitch;
    }
  }
}

void HidDevice::lookAtFlags(std::int64_t now, HandState& hand) noexcept {
  for (std::size_t r = 0; r < flags_in_.size(); ++r) {
    if (!flags_in_[r]) continue;
    const double stale = profile_.input[r].stale;
    const double age = 1e-9 * static_cast<double>(now - flags_at_[r]);
    if (flags_at_[r] == kNever) {
      hand.ready = false;
    } else if (age > (stale > 0.0 ? stale : profile_.limits.stale) && hand.fault == Fault::kNone) {
      hand.fault = Fault::kStale;
    }
  }
}

void HidDevice::lookAtWrites(std::int64_t now, HandState& hand) noexcept {
  if (const std::uint32_t written = written_; written != written_seen_) {
    written_seen_ = written;
    written_at_ = now;
  }
  if (written_seen_ == sent_ || hand.fault != Fault::kNone) return;
  const auto period = static_cast<std::int64_t>(1e9 / profile_.output_rate);
  if (now - written_at_ > kWriteTime + period) hand.fault = Fault::kWrite;
}

void HidDevice::lookForMotion(std::int64_t now) noexcept {
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    const double raw = input_.raw(profile_.joints[i].from);
    // A joint that does not move the tip, such as a wrist's, is no evidence for the others.
    if (raw != counts_[i] && !pose_.jacobian[i].isZero(0.0)) moved_at_ = now;
    counts_[i] = raw;
  }
}

Mat3 HidDevice::drivesHere() const noexcept {
  Mat3 onto = drives_W_;
  // A joint that turns freely bears no force in the direction of its motion.
  for (const std::size_t i : undriven_) {
    const Vec3 free = onto * (profile_.world_from_device * pose_.jacobian[i]);
    constexpr double kNone = 1e-6;  // [m/rad]
    if (free.norm() > kNone) onto -= free * free.transpose() / free.squaredNorm();
  }
  return onto;
}

double HidDevice::heatMotors() noexcept {
  const std::int64_t now = host_.now();
  const double dt = told_at_ == 0 ? 0.0 : 1e-9 * static_cast<double>(now - told_at_);
  told_at_ = now;
  for (MotorHeat& motor : heat_) motor.pass(dt);
  return dt;
}

std::array<double, kMostJoints> HidDevice::carried() const noexcept {
  std::array<double, kMostJoints> raw{};
  const double share = carries_ && upright_ ? carried_share_ : 0.0;
  if (profile_.masses.empty() || share <= 0.0) return raw;
  const Joints torques = carryingTorques(profile_, joints_);
  double most = 1.0;
  if (!tested_) {
    const double weight = forceOf(profile_, pose_, torques).norm();
    if (!(weight <= host_.carries)) most = host_.carries / weight;
  }
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    const HidJoint& joint = profile_.joints[i];
    if (!joint.to) continue;
    const ReportField& field = profile_.output->fields[*joint.to];
    raw[i] = field.scale * torques[i] / (joint.ratio * joint.torque_constant);
    double room = raw[i] > 0.0 ? field.most - field.offset : field.offset - field.least;
    if (joint.continuous > 0.0) room = std::min(room, joint.continuous * std::abs(field.scale));
    if (std::abs(raw[i]) > room) most = std::min(most, std::max(room, 0.0) / std::abs(raw[i]));
  }
  for (double& r : raw) {
    r *= most * share;
    if (!std::isfinite(r)) return {};
  }
  return raw;
}

void HidDevice::encode(const Vec3& force_W, std::span<std::byte> report) noexcept {
  const double dt = heatMotors();
  for (MotorHeat& motor : heat_) motor.tell(0.0);
  std::copy(zero_.begin(), zero_.end(), report.begin());
  const Vec3 force_D = profile_.world_from_device.transpose() * (drivesHere() * force_W);
  // If a motor's limit is exceeded, reduce all motors by the same share to keep the direction.
  std::array<double, kMostJoints> raw{};
  std::array<double, kMostJoints> room{};
  const std::array<double, kMostJoints> weight = carried();
  double share = 1.0;
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    const HidJoint& joint = profile_.joints[i];
    if (!joint.to) continue;
    const ReportField& field = profile_.output->fields[*joint.to];
    const double none = field.offset + weight[i];
    raw[i] =
        field.scale * Kinematics::torque(pose_, i, force_D) / (joint.ratio * joint.torque_constant);
    if (!std::isfinite(raw[i])) {
      given_ = 0.0;
      return;
    }
    const double end = raw[i] > 0.0 ? field.most - none : none - field.least;
    room[i] = std::max(end, 0.0);
    if (std::abs(raw[i]) > room[i]) share = std::min(share, room[i] / std::abs(raw[i]));
  }
  // Reduce all motors likewise if one is too hot for the force that remains beside its carried
  // weight. The reduction comes at once; the force returns as slowly as after a start.
  cool_ = std::min(1.0, cool_ + dt / kEngage);
  const auto unit = [&](std::size_t i) {
    return std::abs(profile_.output->fields[*profile_.joints[i].to].scale);
  };
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    const double asked = share * std::abs(raw[i]);
    if (!(profile_.joints[i].continuous > 0.0) || !(asked > 0.0)) continue;
    const double along = raw[i] > 0.0 ? weight[i] : -weight[i];
    const double allowed = unit(i) * heat_[i].allows((room[i] + along) / unit(i)) - along;
    cool_ = std::min(cool_, std::max(allowed, 0.0) / asked);
  }
  share *= cool_;
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    if (profile_.joints[i].to) heat_[i].tell((share * raw[i] + weight[i]) / unit(i));
  }
  given_ = share;
  if (share < 1.0) ++weakened_;
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    if (!profile_.joints[i].to) continue;
    const ReportField& field = profile_.output->fields[*profile_.joints[i].to];
    // Rounds towards zero, so that rounding adds no force.
    const double wanted = share * raw[i] + weight[i];
    putRaw(report.subspan(1), field,
           field.type == ReportField::Type::kFloat ? wanted + field.offset
                                                   : std::round(field.offset) + std::trunc(wanted));
  }
}

void HidDevice::write(const Vec3& force) noexcept {
  if (!profile_.output) return;
  if (written_ == sent_) written_at_ = host_.now();
  const std::span<std::byte> report = std::span(out_.draft().bytes).first(zero_.size());
  encode(force, report);
  rests_.store(std::equal(report.begin(), report.end(), zero_.begin()), std::memory_order_relaxed);
  out_.publish();
  sent_.fetch_add(1, std::memory_order_release);
  sent_.notify_one();
}

ZeroForce HidDevice::zeroForce() const noexcept {
  if (!profile_.output || zero_.size() > ZeroForce::kMostBytes) return {};
  ZeroForce zero{guard_, zero_};
  zero.version = plugging_;
  return zero;
}

void HidDevice::lost() noexcept {
  gone_ = true;
  mend_.notify_all();
}

void HidDevice::writeLoop() noexcept {
  RealtimeRequest request;
  request.lock_memory = false;
  request.awake = false;
  (void)becomeRealtime(request, StayAwake(false));
  // Uses the machine's clock. A report that drives no motor goes at once.
  Pace pace(profile_.output_rate, nowNs());
  bool drives = false;
  for (std::uint32_t seen = 0;;) {
    sent_.wait(seen, std::memory_order_acquire);
    while (!quit_ && !(drives && rests_) && nowNs() < pace.from()) {
      sleepUntil(std::min(pace.from(), nowNs() + kLongestSleep));
    }
    pace.go(nowNs());
    seen = sent_.load(std::memory_order_acquire);
    if (quit_) return;
    out_.refresh();
    // A device that is only miscounted still accepts zero force.
    const Using port(open_port_, writing_);
    if (!port) continue;
    const std::int64_t began = host_.now();
    const auto report = std::span(out_.current().bytes).first(zero_.size());
    const bool good = port->write(report);
    drives = !std::equal(report.begin(), report.end(), zero_.begin());
    longest_ns_ = std::max<std::int64_t>(longest_ns_, host_.now() - began);
    ++count_;
    written_ = seen;
    if (!good) lost();
  }
}

void HidDevice::closePort() noexcept {
  open_port_ = nullptr;
  while (reading_ || writing_) std::this_thread::sleep_for(std::chrono::microseconds(100));
  // A device that is only miscounted would keep the last force.
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
                    ": nobody has read it for so long that its encoders may have gone round: " +
                    (homeless_ ? "start the program again with the arm in its home pose"
                               : "it is homed again"));
        }
      }
      // An arm whose home was its pose at the opening has lost its position.
      if (host_.find && !profile_.home_at_open && !homeless_) port = host_.find();
      if (port != nullptr) {
        mended_.forget();
        prepare(*port, mended_);
      }
    } catch (const std::exception&) {
      port.reset();
    }
    if (port != nullptr) {
      // The guardian's descriptor leads to the new device, with the same number.
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
  // The friction of a joint is unknown if no motor has pushed it.
  if (!undriven_.empty()) return arm;
  // In another pose a lever may be longer by this factor. Then a count moves the tip farther, and
  // there is less friction at the tip.
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
    // Rounding changes the force by up to a step of each motor.
    const HidJoint& joint = profile_.joints[i];
    if (!joint.to) continue;
    const ReportField& motor = profile_.output->fields[*joint.to];
    const double lever = std::max(pose_.jacobian[i].norm() / kElsewhere, 1e-6);
    if (motor.type != ReportField::Type::kFloat) {
      arm.coulomb -= std::abs(joint.ratio * joint.torque_constant / motor.scale) / lever;
    }
  }
  // If the steps add more energy than friction takes, the tank cannot rely on the arm.
  if (arm.coulomb < 0.0) arm = {};
  return arm;
}

bool HidDevice::countedOn(double pause) const noexcept {
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    const HidJoint& joint = profile_.joints[i];
    const ReportField& field = profile_.input[joint.from.report].fields[joint.from.field];
    if (!field.wraps || !counters_[i].known()) continue;
    // Travel of the tip per joint unit; near a singular pose at least the workspace radius.
    const double lever = std::max(pose_.jacobian[i].norm(), profile_.limits.workspace_radius);
    const double half =
        std::ldexp(std::abs(field.scale / joint.ratio), static_cast<int>(field.bits) - 1);
    // No counter can wrap beyond the arm's reach.
    constexpr double kReach = 3.0;  // workspace radii, from one end of an arm's reach to the other
    const double farthest =
        std::min(profile_.limits.speed * pause, kReach * profile_.limits.workspace_radius);
    if (lever * half < farthest) return false;
  }
  return true;
}

std::string HidDevice::whyNotReady() const {
  for (const HidFlag& flag : profile_.flags) {
    if (input_.raw(flag.field) == flag.equals) continue;
    if (flag.means == HidFlag::Means::kHomed) return "it is not homed: home it";
    if (flag.means == HidFlag::Means::kEnabled) {
      return "its dead-man switch is open: hold it closed";
    }
  }
  if (!heard_ && !silent()) {
    return "its positions do not come: see to its cable, or to the program that shares it";
  }
  for (std::size_t r = 0; r < flags_in_.size(); ++r) {
    if (!flags_in_[r] || flags_at_[r] != kNever) continue;
    return "the report with " + profile_.input[r].fields.front().name +
           " does not come: see to its firmware, which has to send it again and again";
  }
  if (!pose_.reachable) {
    return "it is where its geometry cannot be: home it, or mend the profile's kinematics";
  }
  return {};
}

std::vector<double> HidDevice::steps() const {
  const auto all = resolution();
  return {all.begin(), all.begin() + static_cast<std::ptrdiff_t>(profile_.joints.size())};
}

std::array<double, kMostJoints> HidDevice::resolution() const noexcept {
  std::array<double, kMostJoints> steps{};
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    const HidJoint& joint = profile_.joints[i];
    const ReportField& field = profile_.input[joint.from.report].fields[joint.from.field];
    steps[i] = pose_.jacobian[i].norm() * std::abs(field.scale / joint.ratio);
  }
  return steps;
}

}  // namespace palpate
