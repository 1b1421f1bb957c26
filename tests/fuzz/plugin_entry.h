/// Passes arbitrary data of a plug-in's process to the code that reads them. The random test and
/// libFuzzer share this code.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <span>
#include <string>
#include <utility>

#include "palpate/devices/plugins/plugin_arm.h"
#include "palpate/devices/plugins/plugin_link.h"
#include "palpate/engine/safety/safety.h"

namespace palpate::test {

inline std::int64_t& fuzzTime() noexcept {
  static std::int64_t now = 1'000'000'000;
  return now;
}
inline std::int64_t fuzzNow() noexcept {
  return fuzzTime();
}

/// An arm whose plug-in reports the test's data.
class PluginFuzz {
 public:
  explicit PluginFuzz(const palpate_plugin_facts& facts) {
    auto port = std::make_unique<Port>();
    port->told = facts;
    port_ = port.get();
    ArmHost host;
    host.now = fuzzNow;
    arm_ = std::make_unique<PluginArm>(std::move(port), "plugin:fuzz", true, host);
    watch_ = HandWatch(arm_->info().watch);
    buttons_ = facts.buttons;
  }

  [[nodiscard]] PluginNews& news() noexcept { return port_->next; }
  /// Returns the number of ticks without a fault.
  [[nodiscard]] long passed() const noexcept { return passed_; }

  /// Runs a tick. Returns "" if the handle is valid, and the loop gets a valid hand or a fault.
  /// Else returns a description of the error.
  [[nodiscard]] std::string tick() {
    fuzzTime() += 1'000'000;
    t_ += 1e-3;
    HandState hand = arm_->read();
    const Fault fault = watch_.look(hand, t_);
    if (fault != Fault::kNone) watch_.forget();
    arm_->write(Vec3(0.1, 0.0, 0.0));
    const Handle& handle = hand.handle;
    for (const double q : handle.orientation) {
      if (!(std::abs(q) <= 1.0 + 1e-9)) return "an orientation outside -1 to 1";
    }
    bool finite = std::isfinite(handle.gripper);
    for (const double q : handle.joints) finite = finite && std::isfinite(q);
    if (!finite) return "a handle that is not finite";
    if (buttons_ < 32 && (handle.buttons >> buttons_) != 0)
      return "buttons that the arm does not have";
    if (!(arm_->given() >= 0.0 && arm_->given() <= 1.0)) return "a share outside 0 to 1";
    if (fault != Fault::kNone) return {};
    ++passed_;
    if (!hand.position.allFinite() || !hand.velocity.allFinite())
      return "a hand that is not finite";
    if (!(hand.velocity.norm() < 5.1)) return "a velocity above 5.1 m/s";
    if (!(hand.age >= 0.0 && hand.age <= arm_->info().watch.stale))
      return "an age outside 0 to the limit";
    return {};
  }

 private:
  struct Port final : PluginPort {
    palpate_plugin_facts told{};
    PluginNews next;
    [[nodiscard]] const palpate_plugin_facts& facts() const noexcept override { return told; }
    [[nodiscard]] std::string version() const override { return "1"; }
    [[nodiscard]] std::string serial() const override { return "F"; }
    [[nodiscard]] double carries() const noexcept override { return 5.0; }
    [[nodiscard]] bool read(PluginNews& to) noexcept override {
      to = next;
      return true;
    }
    void write(const PluginOrder& /*order*/) noexcept override {}
  };

  Port* port_;
  std::unique_ptr<PluginArm> arm_;
  HandWatch watch_;
  std::uint32_t buttons_ = 0;
  double t_ = 0.0;
  long passed_ = 0;
};

/// Parses bytes as a message of the socket, and sets `taken` if the message is valid. Returns "" if
/// the message's text is valid or the bytes are refused, else a description of the error.
[[nodiscard]] inline std::string fuzzPluginMessage(std::span<const std::byte> bytes, bool& taken) {
  const auto message = pluginMessageOf(bytes);
  taken = message.has_value();
  if (!taken) return {};
  const std::string text = message->text();
  if (text.size() > PluginMessage::kMostBytes) return "a text that is too long";
  for (const char c : text) {
    if (std::iscntrl(static_cast<unsigned char>(c)) != 0 && c != '\n')
      return "a text with control characters";
  }
  return {};
}

}  // namespace palpate::test
