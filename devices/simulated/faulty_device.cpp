#include "palpate/devices/simulated/faulty_device.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <thread>
#include <utility>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

constexpr std::array<const char*, kTroubles> kWords{
    "late",    "early", "repeated", "frozen", "jumping",   "nan",    "runaway", "unwritten",
    "blocked", "hung",  "gone",     "hot",    "unpowered", "switch", "released"};

void hang() noexcept {
  std::this_thread::sleep_for(std::chrono::duration<double>(FaultyDevice::kHang));
}

}  // namespace

const char* wordFor(Trouble trouble) noexcept {
  return kWords[static_cast<std::size_t>(trouble)];
}

std::optional<Trouble> troubleOf(std::string_view word) noexcept {
  const auto* found = std::find(kWords.begin(), kWords.end(), word);
  if (found == kWords.end()) return std::nullopt;
  return static_cast<Trouble>(found - kWords.begin());
}

bool needsClock(Trouble trouble) noexcept {
  return trouble == Trouble::kBlocked || trouble == Trouble::kHung;
}

FaultyDevice::FaultyDevice(std::unique_ptr<Device> device, Trouble trouble, double rate,
                           double begin, double end)
    : device_(std::move(device)), trouble_(trouble), rate_(rate), begin_(begin), end_(end) {
  if (device_->zeroForce().descriptor >= 0) {
    throw DeviceError(device_->info().name, "a simulated failure cannot be applied to a real arm",
                      "use a simulated arm");
  }
}

bool FaultyDevice::troubled() const noexcept {
  const double now = static_cast<double>(tick_) / rate_;
  return now >= begin_ && now < end_;
}

void FaultyDevice::hold(HandState& hand, std::int64_t old) const noexcept {
  hand.position = whole_.position;
  hand.age = whole_.age + static_cast<double>(old) / rate_;
}

HandState FaultyDevice::read() noexcept {
  HandState hand = device_->read();
  if (!troubled()) {
    since_ = 0;
    whole_ = hand;
    return hand;
  }
  ++since_;
  const double since = static_cast<double>(since_) / rate_;
  switch (trouble_) {
    case Trouble::kLate:
      hold(hand, since_);
      break;
    case Trouble::kEarly:
      hand.age = -5.0 / rate_;
      break;
    case Trouble::kRepeated:
      if (since_ % 4 == 1) whole_ = hand;
      hold(hand, (since_ - 1) % 4);
      break;
    case Trouble::kFrozen:
      hold(hand, 0);
      hand.still = since;
      break;
    case Trouble::kJumping:
      hand.position.x() += kJump;
      break;
    case Trouble::kNotFinite:
      hand.position.y() = std::numeric_limits<double>::quiet_NaN();
      break;
    case Trouble::kRunaway:
      hand.position.z() += kRun * since;
      break;
    case Trouble::kUnwritten:
      if (since_ > 1) hand.fault = Fault::kWrite;  // a failed write is reported by the next read
      break;
    case Trouble::kHung:
      hang();
      break;
    case Trouble::kGone:
      hand.fault = Fault::kGone;
      break;
    case Trouble::kHot:
      hand.fault = Fault::kTemperature;
      break;
    case Trouble::kUnpowered:
      hand.fault = Fault::kPower;
      break;
    case Trouble::kSwitch:
      hand.fault = Fault::kSwitch;
      break;
    case Trouble::kReleased:
      hand.ready = false;
      break;
    case Trouble::kBlocked:
      break;
  }
  return hand;
}

void FaultyDevice::write(const Vec3& force) noexcept {
  if (troubled() && trouble_ == Trouble::kBlocked) hang();
  // A lost write has no effect: the motors keep their force.
  const bool lost = trouble_ == Trouble::kUnwritten || trouble_ == Trouble::kGone;
  if (!troubled() || !lost) force_ = force;
  device_->write(force_);
  ++tick_;
}

}  // namespace palpate
