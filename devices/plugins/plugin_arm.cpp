#include "palpate/devices/plugins/plugin_arm.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

constexpr std::int64_t kWriteTime = 20000000;  // [ns]; a write that takes longer is blocked
// [s]: longest time for which one read raises the carried weight.
constexpr double kLongestStep = 0.02;
constexpr double kMostRate = 100000.0;   // [Hz]
constexpr double kMostWorkspace = 10.0;  // [m]
constexpr double kMostWeight = 100.0;    // [N]

std::int64_t timeOf(std::int64_t taken, std::int64_t now) noexcept {
  return std::clamp<std::int64_t>(taken, 0, now);
}

double secondsOf(std::int64_t ns) noexcept {
  return 1e-9 * static_cast<double>(ns);
}

Vec3 vectorOf(const double (&v)[3]) noexcept {  // NOLINT(modernize-avoid-c-arrays): the ABI's
  return {v[0], v[1], v[2]};
}

}  // namespace

DeviceInfo infoFor(const palpate_plugin_facts& facts, const std::string& name, bool tested) {
  const bool drives = (facts.has & PALPATE_PLUGIN_FORCE) != 0;
  // Returns `value` in its range, or `otherwise` for 0 if the fact may be left out. Else throws.
  const auto number = [&](const char* what, const char* unit, double value, double least,
                          double most, double otherwise) {
    if (value == 0.0 && otherwise >= 0.0) return otherwise;
    if (value >= least && value <= most) return value;
    throw DeviceError(name, fmt::format("its plug-in reports {} = {}, out of range", what, value),
                      fmt::format("correct the plug-in: report {} to {} {}", least, most, unit));
  };
  constexpr double kNone = -1.0;
  constexpr double kAny = 1e9;
  const auto needed = [&](double otherwise) { return drives ? kNone : otherwise; };
  DeviceInfo info;
  info.name = name;
  info.hand = drives;
  info.limits.peak = number("force", "N", facts.force, 1e-3, 1e3, needed(info.limits.peak));
  info.limits.slew = number("slew", "N/s", facts.slew, 1.0, 1e6, kPluginSlew);
  info.max_stiffness =
      number("stiffness", "N/m", facts.stiffness, 1e-3, 1e6, needed(info.max_stiffness));
  info.max_damping = number("damping", "N s/m", facts.damping, 0.0, kAny, 0.0);
  info.workspace_radius =
      number("workspace_radius", "m", facts.workspace_radius, 1e-3, kMostWorkspace, kNone);
  const double rate = number("rate", "Hz", facts.rate, 1.0, kMostRate, kNone);
  info.output_rate = number("output_rate", "Hz", facts.output_rate, 1.0, kMostRate, rate);
  info.watch.stale = number("stale", "s", facts.stale, 1e-3, 0.5, WatchLimits().stale);
  info.watch.max_speed = number("speed", "m/s", facts.speed, 0.05, 10.0, WatchLimits().max_speed);
  info.limits.continuous = number("continuous", "N", facts.continuous, 1e-3, 1e3, 0.0);
  info.limits.heating = number("heating", "s", facts.heating, 1e-3, 1e4, info.limits.heating);
  (void)number("resolution", "m", facts.resolution, 0.0, kMostWorkspace, 0.0);
  (void)number("watchdog", "s", facts.watchdog, 1e-4, 60.0, 0.0);
  if ((facts.continuous > 0.0) != (facts.heating > 0.0)) {
    throw DeviceError(name, "its plug-in reports only one of continuous and heating",
                      "correct the plug-in: report both or none");
  }
  if (facts.joints > kMostJoints || facts.buttons > HandleInfo::kMostButtons) {
    throw DeviceError(
        name,
        fmt::format("its plug-in reports {} joints and {} buttons", facts.joints, facts.buttons),
        "correct the plug-in: report at most 6 joints and 32 buttons");
  }
  if (!drives) info.output_rate = 0.0;
  info.source = facts.source[0] != '\0' ? facts.source : "its plug-in, which states no source";
  if (drives && !tested) holdUntested(info);
  info.limits.continuous = std::min(info.limits.continuous, info.limits.peak);
  info.handle.velocity = (facts.has & PALPATE_PLUGIN_VELOCITY) != 0;
  info.handle.orientation = (facts.has & PALPATE_PLUGIN_ORIENTATION) != 0;
  info.handle.gripper = (facts.has & PALPATE_PLUGIN_GRIPPER) != 0;
  info.handle.joints = facts.joints;
  for (std::uint32_t i = 0; i < facts.buttons; ++i) {
    const char* given = facts.button[i];
    info.handle.buttons.push_back(*given != '\0' ? given : fmt::format("button {}", i + 1));
  }
  return info;
}

ArmIdentity identityOf(const palpate_plugin_facts& facts, double carries, const std::string& name,
                       const std::string& version, const std::string& serial) {
  std::string all = version + "\n" + facts.source;
  for (const double value :
       {static_cast<double>(facts.has), facts.force, facts.slew, facts.stiffness, facts.damping,
        facts.workspace_radius, facts.rate, facts.output_rate, facts.stale, facts.speed,
        facts.continuous, facts.heating, facts.watchdog, facts.resolution, carries}) {
    all += fmt::format("\n{}", value);
  }
  return {name, serial, fingerprintOf(all), true};
}

PluginArm::PluginArm(std::unique_ptr<PluginPort> port, const std::string& name, bool tested,
                     const ArmHost& host)
    : port_(std::move(port)),
      facts_(port_->facts()),
      info_(infoFor(facts_, name, tested)),
      now_(host.now) {
  traits_.drives = has(PALPATE_PLUGIN_FORCE);
  traits_.input_rate = facts_.rate;
  traits_.stiffness = facts_.stiffness;
  traits_.workspace_radius = facts_.workspace_radius;
  // An arm that has not passed its test carries at most the weight that its host allows.
  const double weight = port_->carries();
  if (weight > 0.0 && weight <= kMostWeight) {
    most_carried_ = tested ? 1.0 : std::min(1.0, host.carries / weight);
  }
  traits_.carries = most_carried_ > 0.0;
  info_.limits.friction = host.measured.coulomb;
  if (traits_.drives && host.measured.viscous > 0.0) {
    ArmDissipation& arm = info_.limits.tank.arm;
    // Assumes that in another pose a lever may be longer by this factor.
    constexpr double kElsewhere = 2.0;
    arm.viscous = host.measured.viscous / (kElsewhere * kElsewhere);
    arm.coulomb = host.measured.coulomb / kElsewhere;
    arm.delay = host.measured.delay;
    arm.doubt = host.measured.doubt;
    arm.jitter = std::min(arm.doubt, 0.5 / facts_.rate);
    arm.step = kElsewhere * facts_.resolution;
    info_.limits.tank.use = host.tank;
    info_.limits.tank.refill = host.refill;
    info_.mass = host.measured.mass;
  }
  hand_.ready = false;
  read_at_ = moved_at_ = written_at_ = now_();
}

PluginArm::~PluginArm() {
  carry(false);
  write(Vec3::Zero());
}

HandState PluginArm::read() noexcept {
  const std::int64_t now = now_();
  const double dt = secondsOf(now - read_at_);
  read_at_ = now;
  HandState& hand = hand_;
  hand.fault = Fault::kNone;
  if (const std::uint32_t opening = port_->openings(); opening != opening_) {
    opening_ = opening;
    taken_ = 0;
    heard_at_ = kNever;
    order_.number = written_seen_ = withheld_seen_ = 0;
    news_ = {};
  }
  // After a long pause between reads, the arm may have moved or taken orders, so both times
  // restart.
  if (dt > info_.watch.stale) moved_at_ = written_at_ = now;
  const bool there = port_->read(news_);
  if (!there || news_.read < 0) {
    hand.fault = Fault::kGone;
    heard_at_ = kNever;
  } else if (news_.reading.taken != taken_) {
    take(now, hand);
  }
  const std::uint32_t state = news_.reading.state;
  const auto says = [&](std::uint32_t flag) { return (state & flag) != 0; };
  hand.age = heard_at_ == kNever ? 0.0 : secondsOf(now - heard_at_);
  hand.still = traits_.drives ? secondsOf(now - moved_at_) : 0.0;
  hand.ready = heard_at_ != kNever && says(PALPATE_PLUGIN_READY) &&
               (!has(PALPATE_PLUGIN_DEADMAN) || says(PALPATE_PLUGIN_HELD));
  if (hand.fault == Fault::kNone) {
    if (news_.wrote < 0) hand.fault = Fault::kWrite;
    if (says(PALPATE_PLUGIN_HOT)) hand.fault = Fault::kTemperature;
    if (says(PALPATE_PLUGIN_UNPOWERED)) hand.fault = Fault::kPower;
    if (says(PALPATE_PLUGIN_OPEN)) hand.fault = Fault::kSwitch;
  }
  // The plug-in's process has taken the force off: orders came late, or a guardian stopped it.
  if (news_.withheld != withheld_seen_ && hand.fault == Fault::kNone) hand.fault = Fault::kLate;
  withheld_seen_ = news_.withheld;
  if (news_.written != written_seen_) {
    if (news_.written == order_.number) longest_ = std::max(longest_, now - written_at_);
    written_seen_ = news_.written;
    written_at_ = now;
  }
  const auto period = static_cast<std::int64_t>(1e9 / std::max(info_.output_rate, 1.0));
  if (traits_.drives && written_seen_ != order_.number && hand.fault == Fault::kNone &&
      now - written_at_ > kWriteTime + period) {
    hand.fault = Fault::kWrite;
  }
  given_ = news_.given >= 0.0 ? std::min(news_.given, 1.0) : 0.0;
  // The motors take up the weight as slowly as a force grows after a start, and release it at once.
  upright_ = hand.ready && hand.fault == Fault::kNone && hand.age <= info_.watch.stale;
  const double step = std::min(dt, kLongestStep) / kEngage;
  order_.carry = carries_ && upright_ ? std::min(most_carried_, order_.carry + step) : 0.0;
  return hand;
}

void PluginArm::take(std::int64_t now, HandState& hand) noexcept {
  const palpate_plugin_reading& reading = news_.reading;
  taken_ = reading.taken;
  heard_at_ = timeOf(reading.taken, now);
  const Vec3 position = vectorOf(reading.position);
  if (position != hand.position) moved_at_ = now;
  hand.position = position;
  Handle& handle = hand.handle;
  if (has(PALPATE_PLUGIN_VELOCITY) && vectorOf(reading.velocity).allFinite()) {
    std::copy_n(std::begin(reading.velocity), 3, handle.velocity.begin());
  }
  const std::uint32_t buttons = facts_.buttons;
  handle.buttons = buttons >= 32 ? reading.buttons : reading.buttons & ((1U << buttons) - 1U);
  if (has(PALPATE_PLUGIN_ORIENTATION)) {
    double squared = 0.0;
    for (const double q : reading.orientation) squared += q * q;
    const double length = std::sqrt(squared);
    // If the quaternion is invalid, the handle keeps its previous orientation.
    if (length > 0.5 && length < 2.0) {
      for (std::size_t i = 0; i < 4; ++i) handle.orientation[i] = reading.orientation[i] / length;
    }
  }
  if (has(PALPATE_PLUGIN_GRIPPER) && std::isfinite(reading.gripper)) {
    handle.gripper = reading.gripper;
  }
  for (std::size_t i = 0; i < facts_.joints; ++i) {
    if (std::isfinite(reading.joints[i])) handle.joints[i] = reading.joints[i];
  }
}

void PluginArm::write(const Vec3& force) noexcept {
  if (!traits_.drives) return;
  const bool good = force.allFinite();
  for (int i = 0; i < 3; ++i) order_.force.force[i] = good ? force[i] : 0.0;
  if (written_seen_ == order_.number) written_at_ = now_();
  ++order_.number;
  ++writes_;
  port_->write(order_);
}

void PluginArm::carry(bool may) noexcept {
  carries_ = may && traits_.carries;
  if (!may) order_.carry = 0.0;
}

std::string PluginArm::whyNotReady() const {
  if (heard_at_ == kNever) return "no position arrives: check the arm's cable and plug-in";
  if ((news_.reading.state & PALPATE_PLUGIN_READY) == 0) {
    return "the plug-in reports that the arm is not ready: home the arm, and check its power and "
           "its maker's program";
  }
  const bool held = (news_.reading.state & PALPATE_PLUGIN_HELD) != 0;
  if (has(PALPATE_PLUGIN_DEADMAN) && !held) return "the handle is free: hold it";
  return {};
}

std::vector<double> PluginArm::steps() const {
  if (!(facts_.resolution > 0.0)) return {};
  return {facts_.resolution};
}

ArmTraffic PluginArm::traffic() const {
  return {0, writes_, longest_};
}

}  // namespace palpate
