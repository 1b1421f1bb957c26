#include "palpate/devices/plugins/haply_messages.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <numbers>
#include <optional>
#include <string>

#include <nlohmann/json.hpp>

namespace palpate::haply {
namespace {

using Json = nlohmann::json;

/// Returns the largest depth of brackets outside of strings. The text need not be JSON.
int nesting(std::string_view bytes) {
  int depth = 0;
  int deepest = 0;
  bool in_string = false;
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    const char c = bytes[i];
    if (in_string) {
      if (c == '\\') ++i;
      if (c == '"') in_string = false;
    } else if (c == '"') {
      in_string = true;
    } else if (c == '{' || c == '[') {
      deepest = std::max(deepest, ++depth);
    } else if (c == '}' || c == ']') {
      --depth;
    }
  }
  return deepest;
}

/// Returns a member of an object; null if it is missing, or if `of` is not an object.
const Json* member(const Json* of, const char* name) {
  if (of == nullptr || !of->is_object()) return nullptr;
  const auto found = of->find(name);
  return found == of->end() ? nullptr : &*found;
}

std::optional<double> number(const Json* of, double limit) {
  if (of == nullptr || !of->is_number()) return std::nullopt;
  const double value = of->get<double>();
  if (!(std::abs(value) <= limit)) return std::nullopt;
  return value;
}

std::optional<Triple> triple(const Json* of, std::array<const char*, 3> names, double limit) {
  Triple out{};
  for (std::size_t i = 0; i < 3; ++i) {
    const auto value = number(member(of, names[i]), limit);
    if (!value) return std::nullopt;
    out[i] = *value;
  }
  return out;
}

constexpr std::array<const char*, 3> kAxes{"x", "y", "z"};
constexpr std::array<const char*, 3> kAngles{"a0", "a1", "a2"};

std::optional<std::array<double, 4>> quaternion(const Json* of) {
  const auto w = number(member(of, "w"), 2.0);
  const auto v = triple(of, kAxes, 2.0);
  if (!w || !v) return std::nullopt;
  const double length = std::hypot(std::hypot(*w, (*v)[0]), std::hypot((*v)[1], (*v)[2]));
  // The service rounds components to 14 bits. A sleeping handle sends zeros.
  if (!(std::abs(length - 1.0) < 0.1)) return std::nullopt;
  return std::array<double, 4>{*w / length, (*v)[0] / length, (*v)[1] / length, (*v)[2] / length};
}

std::int8_t truth(const Json* of) {
  if (of == nullptr || !of->is_boolean()) return -1;
  return of->get<bool>() ? 1 : 0;
}

std::string_view text(const Json* of) {
  if (of == nullptr || !of->is_string()) return {};
  return of->get_ref<const std::string&>();
}

bool differs(const Json* part, const char* name, double from) {
  const Json* value = member(part, name);
  return value != nullptr && !(value->is_number() && value->get<double>() == from);
}

/// Returns true if a transform is not the identity. Missing parts count as the identity.
bool transforms(const Json* transform) {
  if (transform == nullptr) return false;
  const Json* turned = member(transform, "rotation");
  bool found = differs(turned, "w", 1.0);
  for (const char* axis : kAxes) {
    found = found || differs(member(transform, "position"), axis, 0.0) ||
            differs(turned, axis, 0.0) || differs(member(transform, "scale"), axis, 1.0);
  }
  return found;
}

ArmConfig readConfig(const Json* config) {
  ArmConfig out;
  const std::string_view preset = text(member(config, "preset"));
  if (preset == "arm_front_centered") {
    out.origin = Origin::kCentre;
  } else if (!preset.empty() && preset != "defaults" && preset != "arm_front") {
    out.origin = Origin::kOther;
  }
  const std::string_view basis = text(member(member(config, "basis"), "permutation"));
  out.plain_axes = basis.empty() || basis == "XYZ" || basis == "+X+Y+Z";
  out.miniature = text(member(config, "type")) == "minverse";
  out.left = text(member(config, "handedness")) == "left";
  return out;
}

bool readArm(std::string_view id, const Json& of, ArmState& out) {
  out = {};
  if (!out.id.assign(id)) return false;
  const Json* state = member(&of, "state");
  if (const auto position = triple(member(state, "cursor_position"), kAxes, kFarthest)) {
    out.placed = true;
    out.position_D = *position;
  }
  out.velocity_D = triple(member(state, "cursor_velocity"), kAxes, kFastest).value_or(Triple{});
  if (const auto degrees = triple(member(state, "angular_position"), kAngles, kWidest)) {
    for (std::size_t i = 0; i < 3; ++i) out.joints[i] = (*degrees)[i] * std::numbers::pi / 180.0;
  }
  out.transformed = transforms(member(state, "transform"));
  const Json* status = member(&of, "status");
  out.powered = truth(member(status, "power_supply"));
  out.ready = truth(member(status, "ready"));
  out.calibrated = truth(member(status, "calibrated"));
  if (const Json* config = member(&of, "config"); config != nullptr && config->is_object()) {
    out.configured = true;
    out.config = readConfig(config);
  }
  return true;
}

bool readGrip(std::string_view id, const Json& of, GripState& out) {
  out = {};
  if (!out.id.assign(id)) return false;
  const Json* state = member(&of, "state");
  if (const auto orientation = quaternion(member(state, "orientation"))) {
    out.turned = true;
    out.orientation_D = *orientation;
  }
  // A handle with a cable has one button; one without has a, b, c, or numbered buttons.
  if (const std::int8_t pressed = truth(member(state, "button")); pressed >= 0) {
    out.button_count = 1;
    out.buttons = pressed == 1 ? 1U : 0U;
  }
  const Json* buttons = member(state, "buttons");
  for (const auto& names : {std::array<const char*, 4>{"a", "b", "c", nullptr},
                            {"button_0", "button_1", "button_2", "button_3"}}) {
    for (int bit = 0; bit < 4 && names[static_cast<std::size_t>(bit)] != nullptr; ++bit) {
      const std::int8_t pressed = truth(member(buttons, names[static_cast<std::size_t>(bit)]));
      if (pressed < 0) continue;
      out.button_count = std::max(out.button_count, bit + 1);
      if (pressed == 1) out.buttons |= 1U << static_cast<unsigned>(bit);
    }
  }
  return true;
}

/// Reads a list of devices. Skips those without a valid id, and those for which `out` has no room.
template <class Device, std::size_t N, class Read>
void readList(const Json* list, std::array<Device, N>& out, std::size_t& count, Read read) {
  if (list == nullptr) return;
  const bool by_id = list->is_object();
  if (!by_id && !list->is_array()) return;
  for (auto it = list->begin(); it != list->end() && count < N; ++it) {
    const std::string_view id =
        by_id ? std::string_view(it.key()) : text(member(&*it, "device_id"));
    if (read(id, *it, out[count])) ++count;
  }
}

class Writer {
 public:
  explicit Writer(std::span<char> out) : out_(out) {}
  Writer& operator<<(std::string_view words) noexcept {
    if (words.size() > out_.size() - size_) fits_ = false;
    if (fits_) std::memcpy(out_.data() + size_, words.data(), words.size());
    if (fits_) size_ += words.size();
    return *this;
  }
  Writer& operator<<(double value) noexcept {
    if (!fits_) return *this;
    const auto [end, error] = std::to_chars(out_.data() + size_, out_.data() + out_.size(), value);
    if (error != std::errc{}) fits_ = false;
    if (fits_) size_ = static_cast<std::size_t>(end - out_.data());
    return *this;
  }
  [[nodiscard]] std::size_t size() const noexcept { return fits_ ? size_ : 0; }

 private:
  std::span<char> out_;
  std::size_t size_ = 0;
  bool fits_ = true;
};

}  // namespace

bool DeviceId::assign(std::string_view from) noexcept {
  text = {};
  const auto fit = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' ||
           c == '.' || c == ':' || c == '-';
  };
  if (from.empty() || from.size() >= text.size() || !std::all_of(from.begin(), from.end(), fit)) {
    return false;
  }
  std::copy(from.begin(), from.end(), text.begin());
  return true;
}

Verdict readMessage(std::string_view bytes, Message& out) {
  out.generation = Generation::kUnknown;
  out.arm_count = 0;
  out.grip_count = 0;
  if (bytes.size() > kMessageLimit) return Verdict::kTooLong;
  if (nesting(bytes) > kDepthLimit) return Verdict::kTooDeep;
  const Json json = Json::parse(bytes.begin(), bytes.end(), nullptr, false);
  if (json.is_discarded()) return Verdict::kNotJson;
  const Json* arms = member(&json, "inverse3");
  if (arms == nullptr || !(arms->is_array() || arms->is_object())) return Verdict::kOther;
  if (arms->is_object()) {
    out.generation = Generation::k30;
  } else {
    out.generation = member(&json, "session_id") != nullptr ? Generation::k35 : Generation::k31;
  }
  readList(arms, out.arms, out.arm_count, readArm);
  for (const char* kind : {"verse_grip", "wireless_verse_grip", "custom_verse_grip"}) {
    readList(member(&json, kind), out.grips, out.grip_count, readGrip);
  }
  return Verdict::kState;
}

std::size_t writeForces(Generation generation, std::span<const ForceTo> forces, bool introduce,
                        std::span<char> out) noexcept {
  if (generation != Generation::k31 && generation != Generation::k35) return 0;
  const bool newer = generation == Generation::k35;
  Writer to(out);
  to << "{";
  if (introduce && newer) to << R"("session":{"configure":{"profile":{"name":"palpate"}}},)";
  to << R"("inverse3":[)";
  bool first = true;
  for (const ForceTo& one : forces) {
    to << (first ? "" : ",") << R"({"device_id":")" << one.id
       << R"(","commands":{"set_cursor_force":{")" << (newer ? "vector" : "values") << R"(":{"x":)"
       << one.force_D[0] << R"(,"y":)" << one.force_D[1] << R"(,"z":)" << one.force_D[2] << "}}}}";
    first = false;
  }
  to << "]}";
  return to.size();
}

}  // namespace palpate::haply
