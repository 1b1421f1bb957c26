#include "palpate/devices/hid/pid_port.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <thread>
#include <utility>

#include "palpate/engine/error.h"

namespace palpate {

namespace {

using Way = DescribedReport::Way;

// Number of requests for the index of a new effect, 1 ms apart: some firmware needs milliseconds.
constexpr int kAsks = 20;
constexpr int kRounds = 8;         // timed writes of each axis at the opening
constexpr double kRenewals = 4.0;  // restarts of an effect within its duration
// [ns]: shortest time between two attempts to enable the actuators.
constexpr std::int64_t kEnableAgain = 1000000000;

std::vector<std::byte> empty(const PidReport& report) {
  std::vector<std::byte> bytes(report.report.size + 1);
  bytes[0] = static_cast<std::byte>(report.report.id);
  return bytes;
}

std::span<std::byte> bodyOf(std::vector<std::byte>& bytes) {
  return std::span(bytes).subspan(1);
}

void put(const PidReport& report, std::vector<std::byte>& bytes, std::uint32_t usage, double raw) {
  if (const PidField* field = report.find(usage)) putRaw(bodyOf(bytes), field->at, raw);
}
void choose(const PidReport& report, std::vector<std::byte>& bytes, std::uint32_t usage) {
  if (const PidChoice* choice = report.choice(usage)) {
    putRaw(bodyOf(bytes), choice->at, choice->raw);
  }
}

/// Sets all bits of a field. In the field of the trigger button this value means "no button".
void putNone(const PidReport& report, std::vector<std::byte>& bytes, std::uint32_t usage) {
  const PidField* field = report.find(usage);
  if (field == nullptr) return;
  ReportField whole = field->at;
  whole.type = ReportField::Type::kUnsigned;
  whole.least = 0.0;
  whole.most = std::ldexp(1.0, static_cast<int>(whole.bits)) - 1.0;
  putRaw(bodyOf(bytes), whole, whole.most);
}

std::optional<double> told(std::span<const std::byte> body, const ReportField& field) {
  if (body.size() < field.end()) return std::nullopt;
  return rawOf(body, field);
}

/// Returns the seconds per count of a duration field. A field without a unit counts milliseconds.
double secondsACount(const PidField& field) {
  const double step = field.unit ? field.step : 1e-3;
  return step > 0.0 && std::isfinite(step) ? step : 1e-3;
}

/// Returns the shortest duration >= PidPort::kDuration [counts], or the longest one if all are
/// shorter. Avoids the largest count, which may mean forever.
double durationIn(const PidField& field) {
  const double wanted = std::ceil(PidPort::kDuration / secondsACount(field) - 1e-9);
  const double least = std::max(1.0, field.at.least);
  return std::clamp(wanted, least, std::max(least, field.at.most - 1.0));
}

}  // namespace

std::vector<std::byte> stoppingReport(const PidMap& map) {
  if (!map.control || map.control->report.way != Way::kOutput) return {};
  for (const std::uint32_t usage : {pid::kStopAll, pid::kDisable}) {
    if (map.control->choice(usage) == nullptr) continue;
    std::vector<std::byte> bytes = empty(*map.control);
    choose(*map.control, bytes, usage);
    return bytes;
  }
  return {};
}

PidPort::PidPort(const PidMap& map, PidParams params, std::unique_ptr<ReportPort> port,
                 PidState& state)
    : map_(map), params_(std::move(params)), port_(std::move(port)), state_(state) {
  state_.now = state_.ever = state_.buttons = 0;
  try {
    open();
  } catch (...) {
    undo();
    throw;
  }
}

PidPort::~PidPort() {
  undo();
}

void PidPort::require(bool good, const char* what) const {
  if (!good) {
    throw DeviceError(params_.name, std::string("it was unplugged, or it rejects ") + what,
                      "plug it in again, check its power and firmware, and end other programs that "
                      "use it");
  }
}

bool PidPort::send(const PidReport& report, const Bytes& bytes) noexcept {
  return report.report.way == Way::kFeature ? port_->sendFeature(bytes) : port_->write(bytes);
}

bool PidPort::control(std::uint32_t usage) noexcept {
  if (!map_.control || map_.control->choice(usage) == nullptr) return true;
  Bytes bytes = empty(*map_.control);
  choose(*map_.control, bytes, usage);
  return send(*map_.control, bytes);
}

bool PidPort::sendGain() noexcept {
  const PidField* gain = map_.gain ? map_.gain->find(pid::kDeviceGain) : nullptr;
  if (gain == nullptr) return true;
  Bytes bytes = empty(*map_.gain);
  const double least = std::max(0.0, gain->at.least);
  put(*map_.gain, bytes, pid::kDeviceGain,
      std::floor(least + params_.gain * (gain->at.most - least)));
  return send(*map_.gain, bytes);
}

void PidPort::open() {
  if (map_.pool) {
    Bytes bytes = empty(*map_.pool);
    std::size_t size = 0;
    const PidField* most = map_.pool->find(pid::kAtOnce);
    if (port_->getFeature(bytes, size) && most != nullptr && size > 0) {
      const auto effects = told(std::span(bytes).subspan(1, size - 1), most->at);
      const double needed = static_cast<double>(params_.axes.size());
      if (effects && *effects > 0.0 && *effects < needed) {
        throw DeviceError(params_.name,
                          "it plays at most " + std::to_string(std::lround(*effects)) +
                              " effects at the same time, and each axis needs one",
                          "remove axes from its profile");
      }
    }
  }
  require(control(pid::kReset), "a reset");
  std::this_thread::sleep_for(std::chrono::nanoseconds(params_.settle));
  require(control(pid::kEnable), "the command that enables its actuators");
  enabled_ = params_.now();
  require(sendGain(), "a gain");
  effects_.reserve(params_.axes.size());
  for (const int axis : params_.axes) {
    Effect& effect = effects_.emplace_back();
    const auto next = static_cast<int>(effects_.size());
    const bool makes = map_.create && map_.load;
    if (!makes && !goodIndex(next)) {
      throw DeviceError(params_.name,
                        "its reports cannot hold effect number " + std::to_string(next) +
                            ", for axis " + kAxisNames[static_cast<std::size_t>(axis)],
                        next == 1 ? "check its firmware" : "remove axes from its profile");
    }
    effect.index = makes ? makeEffect() : next;
    prepare(effect, axis);
    if (map_.effect) require(send(*map_.effect, effect.set), "an effect");
    require(sendMagnitude(effect, 0.0), "a magnitude");
    require(send(map_.operation, effect.start), "the start of an effect");
  }
  if (!(duration_ > 0.0) && stoppingReport(map_).empty()) {
    throw DeviceError(
        params_.name,
        "its effects have no duration, and no single report stops them if the program dies",
        "use a device whose effects have durations, or that has a report to stop all effects");
  }
  started_ = params_.now();
  measure();
}

int PidPort::makeEffect() {
  Bytes create = empty(*map_.create);
  choose(*map_.create, create, pid::kConstant);
  require(send(*map_.create, create), "a new effect");
  return loadedIndex();
}

bool PidPort::goodIndex(double index) const noexcept {
  for (const PidReport* report : {&map_.constant, &map_.operation}) {
    const PidField* field = report->find(pid::kIndex);
    if (field == nullptr) continue;
    if (!(index >= std::max(1.0, field->at.least) && index <= field->at.most)) return false;
  }
  return index >= 1.0 && index <= 255.0 &&
         std::none_of(effects_.begin(), effects_.end(),
                      [&](const Effect& effect) { return effect.index == index; });
}

int PidPort::loadedIndex() {
  Bytes bytes = empty(*map_.load);
  const PidField* index = map_.load->find(pid::kIndex);
  std::string why = "it does not report the index of the effect";
  for (int ask = 0; ask < kAsks; ++ask) {
    bytes[0] = static_cast<std::byte>(map_.load->report.id);
    std::size_t size = 0;
    if (!port_->getFeature(bytes, size)) {
      why = "it does not answer the request for the index of the effect";
    } else {
      const auto body =
          std::span<const std::byte>(bytes).subspan(1, std::max<std::size_t>(size, 1) - 1);
      const auto says = [&](std::uint32_t status) {
        const PidChoice* choice = map_.load->choice(status);
        return choice != nullptr && told(body, choice->at) == choice->raw;
      };
      if (says(pid::kLoadFull)) {
        throw DeviceError(params_.name, "it has no memory left for an effect",
                          "end other programs that play effects, or plug it in again");
      }
      if (says(pid::kLoadError)) {
        why = "it reports that the effect failed";
        break;
      }
      // If the report has no field that shows success, the index alone must show it.
      const bool loaded = map_.load->choice(pid::kLoaded) == nullptr || says(pid::kLoaded);
      const auto at = index != nullptr ? told(body, index->at) : std::nullopt;
      if (loaded && at && goodIndex(*at)) return static_cast<int>(*at);
      // An answer with the index of an earlier effect is outdated and does not count.
      if (loaded && at) {
        why = "it has given the effect the index " + std::to_string(std::llround(*at)) +
              (*at >= 1.0 ? ", which another effect has or its reports cannot hold"
                          : ", but indices begin at 1");
      }
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(params_.settle > 0 ? 1 : 0));
  }
  throw DeviceError(params_.name, "it cannot create a constant force: " + why,
                    "plug it in again; if that does not help, check its firmware");
}

void PidPort::prepare(Effect& effect, int axis) {
  const auto with_index = [&](const PidReport& report) {
    Bytes bytes = empty(report);
    put(report, bytes, pid::kIndex, effect.index);
    return bytes;
  };
  effect.magnitude = with_index(map_.constant);
  effect.start = with_index(map_.operation);
  choose(map_.operation, effect.start, pid::kStart);
  put(map_.operation, effect.start, pid::kLoopCount, 1.0);
  effect.stop = with_index(map_.operation);
  choose(map_.operation, effect.stop, pid::kStop);
  if (map_.free) effect.free = with_index(*map_.free);
  if (!map_.effect) return;

  const PidReport& report = *map_.effect;
  effect.set = with_index(report);
  choose(report, effect.set, pid::kConstant);
  if (const PidField* gain = report.find(pid::kGain)) {
    putRaw(bodyOf(effect.set), gain->at, gain->at.most);
  }
  if (const PidField* duration = report.find(pid::kDuration)) {
    const double raw = durationIn(*duration);
    putRaw(bodyOf(effect.set), duration->at, raw);
    duration_ = raw * secondsACount(*duration);
    if (duration_ > kMostDuration) {
      throw DeviceError(params_.name,
                        "its shortest effect lasts " + std::to_string(duration_) +
                            " s, more than " + std::to_string(std::lround(kMostDuration)) +
                            " s, so its force would stay on too long if the program dies",
                        "use a device with shorter effects");
    }
  }
  putNone(report, effect.set, pid::kTriggerButton);
  put(report, effect.set, pid::kX + static_cast<std::uint32_t>(axis), 1.0);
  // A device with two axes gets the direction as an angle, clockwise from "away from the user": x
  // is a quarter turn. A device with three axes gets a bit for each axis.
  const bool plane = report.find(pid::kX + 2) == nullptr && axis < 2;
  const auto direction = std::find_if(report.fields.begin(), report.fields.end(),
                                      [](const auto& f) { return f.inside == pid::kDirection; });
  if (plane && report.find(pid::kDirectionEnable) != nullptr && direction != report.fields.end()) {
    put(report, effect.set, pid::kDirectionEnable, 1.0);
    const double turn = direction->at.most - direction->at.least;
    putRaw(bodyOf(effect.set), direction->at,
           direction->at.least + (axis == 0 ? 0.25 * turn : 0.0));
  }
}

void PidPort::measure() {
  std::vector<std::int64_t> times;
  for (int i = 0; i < kRounds; ++i) {
    for (Effect& effect : effects_) {
      const std::int64_t began = params_.now();
      require(sendMagnitude(effect, 0.0), "a magnitude");
      times.push_back(params_.now() - began);
    }
  }
  std::sort(times.begin(), times.end());
  write_time_ = 1e-9 * static_cast<double>(times[times.size() / 2]);
}

void PidPort::undo() noexcept {
  // Continues after a failed report, because the device may be gone. Stops all effects first.
  (void)control(pid::kStopAll);
  for (Effect& effect : effects_) {
    if (effect.stop.empty()) continue;
    (void)sendMagnitude(effect, 0.0);
    (void)send(map_.operation, effect.stop);
    if (map_.free) (void)send(*map_.free, effect.free);
  }
  effects_.clear();
  (void)control(pid::kDisable);
}

bool PidPort::sendMagnitude(Effect& effect, double raw) noexcept {
  putRaw(bodyOf(effect.magnitude), map_.constant.find(pid::kMagnitude)->at, raw);
  const bool good = send(map_.constant, effect.magnitude);
  // After the device has refused a magnitude, its present magnitude is unknown.
  effect.sent = good ? raw : std::numeric_limits<double>::quiet_NaN();
  return good;
}

bool PidPort::renew(bool enable) noexcept {
  bool good = true;
  if (enable) {
    enabled_ = params_.now();
    // Some devices return to full gain when they are enabled.
    good = control(pid::kEnable) && sendGain();
    for (const Effect& effect : effects_) {
      good = good && (!map_.effect || send(*map_.effect, effect.set));
    }
  }
  started_ = params_.now();
  for (const Effect& effect : effects_) good = good && send(map_.operation, effect.start);
  return good;
}

bool PidPort::write(std::span<const std::byte> report) noexcept {
  if (report.size() < 1 + 4 * effects_.size()) return false;
  std::array<double, kAxes> raw{};
  bool rests = true;
  for (std::size_t i = 0; i < effects_.size(); ++i) {
    ReportField field;
    field.bit = static_cast<std::uint32_t>(32 * i);
    field.bits = 32;
    raw[i] = rawOf(report.subspan(1), field);
    rests = rests && raw[i] == 0.0;
  }
  const std::int64_t now = params_.now();
  // Some firmware switches its actuators off when all effects are stopped, for example by a
  // guardian. Enabling the actuators again gives no force, because the loop has latched a fault.
  const bool off =
      state_.fallen() == PidState::kActuators && rests && now - enabled_ > kEnableAgain;
  const bool due =
      duration_ > 0.0 && static_cast<double>(now - started_) >= 1e9 * duration_ / kRenewals;
  // Sends reductions of the force before increases.
  bool good = true;
  for (std::size_t i = 0; i < effects_.size(); ++i) {
    const bool less = !(std::abs(raw[i]) >= std::abs(effects_[i].sent));
    if (less) good = sendMagnitude(effects_[i], raw[i]) && good;
  }
  if (off || due) good = good && renew(off);
  for (std::size_t i = 0; i < effects_.size(); ++i) {
    if (due || raw[i] != effects_[i].sent) good = good && sendMagnitude(effects_[i], raw[i]);
  }
  return good;
}

ReadStatus PidPort::read(std::span<std::byte> to, std::size_t& size) noexcept {
  const ReadStatus got = port_->read(to, size);
  if (got == ReadStatus::kReport)
    keepState(std::span<const std::byte>(to).first(std::min(size, to.size())));
  return got;
}

void PidPort::keepState(std::span<const std::byte> report) noexcept {
  if (report.empty()) return;
  const std::uint8_t id = map_.numbered ? std::to_integer<std::uint8_t>(report[0]) : 0;
  const std::span<const std::byte> body = report.subspan(map_.numbered ? 1 : 0);
  const auto has = [&](const PidInput& input) {
    return input.report == id && body.size() >= input.at.end();
  };
  std::uint32_t now = state_.now;
  for (const auto& [input, bit] :
       {std::pair{&map_.actuators, PidState::kActuators}, std::pair{&map_.power, PidState::kPower},
        std::pair{&map_.safety, PidState::kSafety}}) {
    if (!*input || !has(**input)) continue;
    now = rawOf(body, (*input)->at) != 0.0 ? now | bit : now & ~bit;
  }
  // Writes `now` before `ever`, so that a newly set bit never counts as fallen.
  state_.now = now;
  state_.ever = state_.ever | now;
  std::uint32_t buttons = state_.buttons;
  for (std::size_t i = 0; i < map_.buttons.size(); ++i) {
    if (!has(map_.buttons[i])) continue;
    const std::uint32_t bit = 1U << i;
    buttons = rawOf(body, map_.buttons[i].at) != 0.0 ? buttons | bit : buttons & ~bit;
  }
  state_.buttons = buttons;
}

}  // namespace palpate
