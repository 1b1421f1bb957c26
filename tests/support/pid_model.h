/// Models a device of USB's PID class (physical interface devices): its descriptor and its answers
/// to reports. Shares no code with the driver: the model reads fields at the positions at which it
/// placed them in the descriptor.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace palpate::test {

/// Properties of a device. Its two layouts are those of real firmware: OpenFFBoard (commands as a
/// bitmap, +-32767) and VPforce (output reports 101 to 113, +-4096, command 1 disables, 2 enables).
struct PidShape {
  bool rhino = false;  ///< True: VPforce's layout; false: OpenFFBoard's.
  int axes = 2;        ///< 1 to 3.
  bool pool = true, gain = true, free = true, create = true, control = true, state = true;
  bool extras = true;    ///< Set Effect has a trigger, a delay, directions and similar fields.
  bool duration = true;  ///< Effects have a duration.
  int duration_bits = 16;
  // Faults of the device.
  int load_status = 1;     ///< 1: success, 2: full, 3: error, 0: none.
  bool load_zero = false;  ///< The device reports success with the index 0.
  int load_refused = 0;    ///< Number of load requests that the device refuses.
  /// Number of answers that repeat the previous effect's index.
  int load_stale = 0;
  /// Number of effects that can play at once, as the device reports it. The model plays more.
  int at_once = 16;
  double longest = 1e9;  ///< Longest time that an effect plays [s].
  int wakes_with = 0;    ///< Initial magnitude of a new effect.
  /// After a stop of all effects, the device must be enabled again.
  bool stops_deaf = false;
  bool deaf_to_starts = false;  ///< The device ignores the start of an effect that is playing.
};

class PidModel {
 public:
  explicit PidModel(PidShape shape = {}) : shape_(shape) {
    if (shape_.rhino) {
      ids_ = {{"effect", 101}, {"constant", 105}, {"operation", 110},
              {"free", 111},   {"control", 112},  {"gain", 113},
              {"create", 5},   {"load", 6},       {"pool", 7}};
    } else {
      ids_ = {{"effect", 1}, {"constant", 5}, {"operation", 10}, {"free", 11}, {"control", 12},
              {"gain", 13},  {"create", 17},  {"load", 18},      {"pool", 19}};
    }
    describe();
  }

  [[nodiscard]] const std::vector<std::byte>& descriptor() const { return descriptor_; }
  [[nodiscard]] int full() const { return shape_.rhino ? 4096 : 32767; }

  /// Processes an output report at the time `now` [s]. The report's first byte is its number.
  void output(std::span<const std::byte> report, double now) {
    if (report.empty()) return;
    ++outputs_;
    const int id = std::to_integer<int>(report[0]);
    const auto body = report.subspan(1);
    const auto of = [&](const char* name) { return ids_.at(name) == id; };
    if (of("create") && shape_.create) {
      create();
    } else if (of("effect")) {
      set(body);
    } else if (of("constant")) {
      if (Effect* e = effectIn("constant", body)) e->magnitude = get("constant.magnitude", body);
    } else if (of("operation")) {
      operate(body, now);
    } else if (of("free") && shape_.free) {
      if (Effect* e = effectIn("free", body)) *e = {};
    } else if (of("control") && shape_.control) {
      control(body);
    } else if (of("gain") && shape_.gain) {
      gain_ = get("gain.gain", body);
    } else {
      ++strange_;
    }
  }
  /// Returns a feature report; empty if the device refuses the request or has no such report.
  std::vector<std::byte> feature(int id) {
    if (id == ids_.at("load") && shape_.create) {
      if (refused_ < shape_.load_refused) {
        ++refused_;
        return {};
      }
      std::vector<std::byte> out(1 + sizes_["f" + std::to_string(id)]);
      out[0] = static_cast<std::byte>(id);
      const auto body = std::span(out).subspan(1);
      const bool stale = made_ > 1 && stale_ < shape_.load_stale;
      if (stale) ++stale_;
      put("load.index", body, shape_.load_zero ? 0 : made_ - static_cast<int>(stale));
      put("load.status", body, made_ == 0 && shape_.load_status == 1 ? 2 : shape_.load_status);
      return out;
    }
    if (id == ids_.at("pool") && shape_.pool) {
      std::vector<std::byte> out(1 + sizes_["f" + std::to_string(id)]);
      out[0] = static_cast<std::byte>(id);
      put("pool.at_once", std::span(out).subspan(1), shape_.at_once);
      return out;
    }
    return {};
  }
  /// Returns an input report with these raw positions.
  [[nodiscard]] std::vector<std::byte> input(const std::vector<int>& raw,
                                             std::uint32_t buttons = 0) {
    std::vector<std::byte> out(1 + sizes_["i1"]);
    out[0] = std::byte{1};
    const auto body = std::span(out).subspan(1);
    for (std::size_t i = 0; i < raw.size(); ++i) put("input." + std::to_string(i), body, raw[i]);
    put("input.buttons", body, static_cast<std::int64_t>(buttons));
    return out;
  }
  [[nodiscard]] std::vector<std::byte> state() {
    std::vector<std::byte> out(1 + sizes_["i2"]);
    out[0] = std::byte{2};
    const auto body = std::span(out).subspan(1);
    put("state.actuators", body, active_ ? 1 : 0);
    put("state.safety", body, safety_ ? 1 : 0);
    put("state.power", body, power_ ? 1 : 0);
    return out;
  }

  /// Returns the force of a motor as a share of its largest force.
  [[nodiscard]] double share(int axis, double now) const {
    if (!active_ || !power_) return 0.0;
    double sum = 0.0;
    for (const Effect& e : effects_) {
      if (!e.used || !plays(e, now)) continue;
      double factor = 0.0;
      if (e.directed) {
        const double angle =
            2.0 * M_PI * static_cast<double>(e.direction) / (shape_.rhino ? 255.0 : 36000.0);
        factor = axis == 0 ? std::sin(angle) : axis == 1 ? std::cos(angle) : 0.0;
      } else {
        factor = e.axes >> axis & 1 ? 1.0 : 0.0;
      }
      sum += factor * static_cast<double>(e.magnitude) / full() * static_cast<double>(e.gain) /
             static_cast<double>(mostGain());
    }
    const double gain =
        shape_.gain ? static_cast<double>(gain_) / static_cast<double>(mostGain()) : 1.0;
    return std::clamp(sum * gain, -1.0, 1.0);
  }

  void setPower(bool on) { power_ = on; }
  void setSafety(bool on) { safety_ = on; }
  void setActive(bool on) { active_ = on; }
  [[nodiscard]] bool active() const { return active_; }
  /// Number of errors in reports: unknown report numbers, wrong effect indices, unexpected values.
  [[nodiscard]] long strange() const { return strange_; }
  [[nodiscard]] long outputs() const { return outputs_; }  ///< Number of output reports so far.
  [[nodiscard]] long starts() const { return starts_; }
  [[nodiscard]] double gainShare() const {
    return static_cast<double>(gain_) / static_cast<double>(mostGain());
  }
  /// Returns the number of existing effects.
  [[nodiscard]] int made() const {
    return static_cast<int>(
        std::count_if(effects_.begin(), effects_.end(), [](const Effect& e) { return e.used; }));
  }
  [[nodiscard]] int playing(double now) const {
    return static_cast<int>(std::count_if(effects_.begin(), effects_.end(), [&](const Effect& e) {
      return e.used && plays(e, now);
    }));
  }
  /// Returns the raw durations of all Set Effect reports so far.
  [[nodiscard]] const std::vector<std::int64_t>& durations() const { return durations_; }
  /// Returns the report number of a name such as "control".
  [[nodiscard]] int id(const char* name) const { return ids_.at(name); }

 private:
  static constexpr std::size_t kEffects = 16;
  struct Effect {
    bool used = false;
    std::int64_t magnitude = 0, gain = 0, direction = 0, axes = 0, duration = 0;
    bool directed = false, started = false;
    double at = 0.0;  ///< time of the last start [s]
  };
  struct Place {
    std::size_t bit = 0, bits = 0;
    bool with_sign = false;
  };

  [[nodiscard]] std::int64_t mostGain() const { return shape_.rhino ? 4096 : 255; }

  [[nodiscard]] bool plays(const Effect& e, double now) const {
    if (!e.started) return false;
    if (now - e.at > shape_.longest) return false;
    if (!shape_.duration) return true;
    // Some firmware plays an effect of duration 0, or of the largest duration, without end. The
    // driver must not rely on this, so this model does not play such effects.
    if (e.duration == 0 || e.duration >= (1 << shape_.duration_bits) - 1) return false;
    return now - e.at <= 1e-3 * static_cast<double>(e.duration);
  }
  void create() {
    made_ = 0;
    for (std::size_t i = 0; i < effects_.size(); ++i) {
      if (effects_[i].used) continue;
      effects_[i] = {};
      effects_[i].used = true;
      effects_[i].magnitude = shape_.wakes_with;
      effects_[i].gain = mostGain();
      made_ = static_cast<int>(i) + 1;
      return;
    }
  }
  Effect* effectIn(const std::string& report, std::span<const std::byte> body) {
    const std::int64_t index = get(report + ".index", body);
    if (index < 1 || index > static_cast<std::int64_t>(kEffects)) {
      ++strange_;
      return nullptr;
    }
    Effect& e = effects_[static_cast<std::size_t>(index - 1)];
    // A driver that numbers effects itself creates an effect by its first use.
    if (!shape_.create && !e.used) {
      e.used = true;
      e.gain = mostGain();
    }
    if (!e.used) ++strange_;
    return e.used ? &e : nullptr;
  }
  void set(std::span<const std::byte> body) {
    Effect* e = effectIn("effect", body);
    if (e == nullptr) return;
    if (get("effect.type", body) != 1) ++strange_;
    if (shape_.duration) {
      e->duration = get("effect.duration", body);
      durations_.push_back(e->duration);
    }
    e->axes = get("effect.axes", body);
    if (shape_.extras) {
      e->gain = get("effect.gain", body);
      e->directed = get("effect.directed", body) != 0;
      e->direction = get("effect.direction", body);
      if (get("effect.trigger", body) != 255) ++strange_;
      if (get("effect.delay", body) != 0) ++strange_;
    }
  }
  void operate(std::span<const std::byte> body, double now) {
    Effect* e = effectIn("operation", body);
    if (e == nullptr) return;
    const std::int64_t operation = get("operation.operation", body);
    if (operation == 1) {
      ++starts_;
      if (shape_.deaf_to_starts && plays(*e, now)) return;
      e->started = true;
      e->at = now;
    } else if (operation == 3) {
      e->started = false;
    } else {
      ++strange_;
    }
  }
  void control(std::span<const std::byte> body) {
    const std::int64_t said = get("control.control", body);
    // Returns true if the report has a command: 0 enable, 1 disable, 2 stop, 3 reset. OpenFFBoard
    // sends a command as a bit, VPforce as a number.
    const auto is = [&](int bit) {
      if (!shape_.rhino) return (said >> bit & 1) != 0;
      constexpr int kNumbers[] = {2, 1, 3, 4};
      return said == kNumbers[bit];
    };
    if (is(0)) active_ = true;
    if (is(1)) active_ = false;
    if (is(2) || is(3)) {
      for (Effect& e : effects_) e.started = false;
      if (shape_.stops_deaf) active_ = false;
    }
    if (is(3)) {
      effects_.assign(kEffects, {});
      gain_ = mostGain();
      active_ = false;
    }
  }

  // The functions from here to describe() write the descriptor.
  void item(int tag, std::int64_t value) {
    int length = 4;
    if (value >= -128 && value <= 127) {
      length = 1;
    } else if (value >= -32768 && value <= 32767) {
      length = 2;
    }
    descriptor_.push_back(static_cast<std::byte>(tag | (length == 4 ? 3 : length)));
    for (int k = 0; k < length; ++k) {
      descriptor_.push_back(static_cast<std::byte>(value >> (8 * k) & 255));
    }
  }
  void page(int p) { item(0x04, p); }
  void usage(int u) { item(0x08, u); }
  void begin(int u, int kind = 2) {
    usage(u);
    item(0xA0, kind);
  }
  void end() { descriptor_.push_back(std::byte{0xC0}); }
  void report(char way, int id) {
    way_ = way;
    id_ = id;
    item(0x84, id);
  }
  void range(std::int64_t least, std::int64_t most) {
    item(0x14, least);
    item(0x24, most);
  }
  /// Writes fields. `flags` is 2 for variables, 0 for arrays, 3 for padding.
  void fields(int bits, int count, int flags) {
    item(0x74, bits);
    item(0x94, count);
    item(way_ == 'i' ? 0x80 : way_ == 'o' ? 0x90 : 0xB0, flags);
    bits_[key()] += static_cast<std::size_t>(bits) * static_cast<std::size_t>(count);
    sizes_[key()] = (bits_[key()] + 7) / 8;
  }
  void named(const std::string& name, int bits, bool with_sign = false) {
    places_[name] = {bits_[key()], static_cast<std::size_t>(bits), with_sign};
  }
  [[nodiscard]] std::string key() const { return std::string(1, way_) + std::to_string(id_); }
  void index(const std::string& name) {
    usage(0x22);
    range(1, static_cast<int>(kEffects));
    named(name + ".index", 8);
    fields(8, 1, 2);
  }
  void effectType() {
    begin(0x25);
    for (const int u : {0x26, 0x27, 0x30, 0x31, 0x40, 0x41}) usage(u);
    range(1, 6);
    if (way_ == 'o') named("effect.type", 8);
    fields(8, 1, 0);
    end();
  }
  void describeInput() {
    begin(0x01, 0);
    report('i', 1);
    page(9);
    item(0x18, 1);
    item(0x28, 32);
    range(0, 1);
    named("input.buttons", 32);
    fields(1, 32, 2);
    page(1);
    usage(0x33);  // an axis that input() leaves at zero
    range(shape_.rhino ? -4096 : -32767, full());
    fields(16, 1, 2);
    for (int a = 0; a < shape_.axes; ++a) {
      usage(0x30 + a);
      named("input." + std::to_string(a), 16, true);
      fields(16, 1, 2);
    }
    end();
    page(0x0F);
    if (!shape_.state) return;
    begin(0x92);
    report('i', 2);
    range(0, 1);
    for (const auto& [u, name] : {std::pair{0x9F, "state.paused"},
                                  {0xA0, "state.actuators"},
                                  {0xA4, "state.safety"},
                                  {0xA6, "state.power"}}) {
      usage(u);
      named(name, 1);
      fields(1, 1, 2);
    }
    fields(4, 1, 3);
    end();
  }
  void describeEffect() {
    begin(0x21);
    report('o', ids_["effect"]);
    index("effect");
    effectType();
    if (shape_.duration) {
      usage(0x50);
      range(0, (1 << shape_.duration_bits) - 1);
      item(0x64, 0x1003);
      item(0x54, shape_.rhino ? 0x0D : -3);
      named("effect.duration", shape_.duration_bits);
      fields(shape_.duration_bits, 1, 2);
      item(0x54, 0);
      item(0x64, 0);
    }
    if (shape_.extras) {
      usage(0xA7);
      range(0, 32767);
      named("effect.delay", 16);
      fields(16, 1, 2);
      usage(0x52);
      range(0, mostGain());
      named("effect.gain", 16);
      fields(16, 1, 2);
      usage(0x53);
      range(1, 8);
      named("effect.trigger", 8);
      fields(8, 1, 2);
    }
    begin(0x55);
    page(1);
    for (int a = 0; a < shape_.axes; ++a) usage(0x30 + a);
    range(0, 1);
    named("effect.axes", shape_.axes);
    fields(1, shape_.axes, 2);
    end();
    page(0x0F);
    int used = shape_.axes;
    if (shape_.extras) {
      usage(0x56);
      named("effect.directed", 1);
      fields(1, 1, 2);
      ++used;
    }
    fields(8 - used, 1, 3);
    if (shape_.extras) {
      const int bits = shape_.rhino ? 8 : 16;
      begin(0x57);
      item(0x08, 0x0A0001 + 0LL);
      item(0x08, 0x0A0002 + 0LL);
      range(0, shape_.rhino ? 255 : 36000);
      named("effect.direction", bits);
      fields(bits, 2, 2);
      end();
      begin(0x58);
      item(0x08, 0x0A0001 + 0LL);
      item(0x08, 0x0A0002 + 0LL);
      range(0, 32765);
      fields(16, 2, 2);
      end();
    }
    end();
  }
  void describeOutputs() {
    begin(0x73);
    report('o', ids_["constant"]);
    index("constant");
    usage(0x70);
    range(-full(), full());
    named("constant.magnitude", 16, true);
    fields(16, 1, 2);
    end();
    begin(0x77);
    report('o', ids_["operation"]);
    index("operation");
    begin(0x78);
    for (const int u : {0x79, 0x7A, 0x7B}) usage(u);
    range(1, 3);
    named("operation.operation", 8);
    fields(8, 1, 0);
    end();
    usage(0x7C);
    range(0, 255);
    fields(8, 1, 2);
    end();
    if (shape_.free) {
      begin(0x90);
      report('o', ids_["free"]);
      index("free");
      end();
    }
    if (shape_.control) {
      begin(0x95);
      report('o', ids_["control"]);
      begin(0x96);
      named("control.control", 8);
      if (shape_.rhino) {
        for (const int u : {0x98, 0x97, 0x99, 0x9A, 0x9B, 0x9C}) usage(u);
        range(1, 6);
        fields(8, 1, 0);
      } else {
        for (const int u : {0x97, 0x98, 0x99, 0x9A, 0x9B, 0x9C}) usage(u);
        range(1, 6);  // as in OpenFFBoard's firmware, although each field has one bit
        fields(1, 8, 2);
      }
      end();
      end();
    }
    if (shape_.gain) {
      begin(0x7D);
      report('o', ids_["gain"]);
      usage(0x7E);
      range(0, mostGain());
      named("gain.gain", 16);
      fields(16, 1, 2);
      end();
    }
  }
  void describeFeatures() {
    if (shape_.create) {
      begin(0xAB);
      report('f', ids_["create"]);
      effectType();
      page(1);
      usage(0x3B);
      range(0, 511);
      fields(10, 1, 2);
      fields(6, 1, 3);
      end();
      page(0x0F);
      begin(0x89);
      report('f', ids_["load"]);
      index("load");
      begin(0x8B);
      for (const int u : {0x8C, 0x8D, 0x8E}) usage(u);
      range(1, 3);
      named("load.status", 8);
      fields(8, 1, 0);
      end();
      end();
    }
    if (shape_.pool) {
      begin(0x7F);
      report('f', ids_["pool"]);
      usage(0x80);
      range(0, 65535);
      fields(16, 1, 2);
      usage(0x83);
      range(0, 255);
      named("pool.at_once", 8);
      fields(8, 1, 2);
      end();
    }
  }
  void describe() {
    page(1);
    begin(0x04, 1);
    describeInput();
    describeEffect();
    describeOutputs();
    describeFeatures();
    end();
  }

  [[nodiscard]] std::int64_t get(const std::string& name, std::span<const std::byte> body) const {
    const auto at = places_.find(name);
    if (at == places_.end()) return 0;
    const Place& p = at->second;
    std::int64_t value = 0;
    for (std::size_t k = 0; k < p.bits; ++k) {
      const std::size_t bit = p.bit + k;
      if (bit / 8 >= body.size()) return 0;
      if ((std::to_integer<int>(body[bit / 8]) >> (bit % 8) & 1) != 0) value |= 1LL << k;
    }
    if (p.with_sign && (value >> (p.bits - 1) & 1) != 0) value -= 1LL << p.bits;
    return value;
  }
  void put(const std::string& name, std::span<std::byte> body, std::int64_t value) const {
    const Place& p = places_.at(name);
    for (std::size_t k = 0; k < p.bits; ++k) {
      const std::size_t bit = p.bit + k;
      if ((value >> k & 1) != 0) body[bit / 8] |= std::byte{1} << (bit % 8);
    }
  }

  PidShape shape_;
  std::map<std::string, int> ids_;
  std::vector<std::byte> descriptor_;
  char way_ = 'i';
  int id_ = 0;
  std::map<std::string, std::size_t> bits_, sizes_;
  std::map<std::string, Place> places_;

  std::vector<Effect> effects_ = std::vector<Effect>(kEffects);
  std::vector<std::int64_t> durations_;
  int made_ = 0;
  int refused_ = 0;
  int stale_ = 0;
  std::int64_t gain_ = mostGain();
  bool active_ = false, power_ = true, safety_ = true;
  long strange_ = 0, outputs_ = 0, starts_ = 0;
};

}  // namespace palpate::test
