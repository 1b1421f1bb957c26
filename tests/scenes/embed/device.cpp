// A user's own device. See docs/embed.md.
#include <algorithm>
#include <array>
#include <chrono>
#include <csignal>
#include <cstddef>
#include <cstdio>
#include <fcntl.h>
#include <thread>
#include <unistd.h>

#include "ball.h"

// Stands for a driver: an arm that moves down at 10 mm/s to 38 mm above the ball's centre.
struct Driver {
  Driver() = default;
  Driver(const Driver&) = delete;
  Driver& operator=(const Driver&) = delete;
  ~Driver() { close(port); }

  bool counts(int out[3], double& age) {
    age = 0.0;
    out[0] = out[1] = 0;
    out[2] = std::max(4200 - ticks_++, 3800);
    return true;
  }
  bool currents(const double amperes[3]) {
    return write(port, amperes, 3 * sizeof *amperes) == 3 * sizeof *amperes;
  }
  const int port = open("/dev/null", O_WRONLY | O_CLOEXEC);

 private:
  int ticks_ = 0;
};

class MyArm final : public palpate::Device {
 public:
  explicit MyArm(Driver& driver) : driver_(driver) {
    info_.name = "my arm";
    info_.limits.peak = 5.0;      // [N]
    info_.limits.slew = 2000.0;   // [N/s]
    info_.max_stiffness = 800.0;  // [N/m]
    info_.watch.stale = 0.01;     // [s]; an older position is a fault
    info_.source = "its data sheet";
  }

  const palpate::DeviceInfo& info() const noexcept override { return info_; }

  // Returns the newest position, its age, and the last fault of read() or write(), which stays.
  // Must neither allocate nor wait.
  palpate::HandState read() noexcept override {
    palpate::HandState hand;
    int counts[3] = {0, 0, 0};
    if (!driver_.counts(counts, hand.age)) fault_ = palpate::Fault::kGone;
    hand.fault = fault_;
    hand.position = palpate::Vec3(counts[0], counts[1], counts[2]) * 1e-5;  // 10 um per count
    return hand;
  }

  void write(const palpate::Vec3& force) noexcept override {
    const double amperes[3] = {0.4 * force.x(), 0.4 * force.y(), 0.4 * force.z()};
    if (!driver_.currents(amperes)) fault_ = palpate::Fault::kWrite;
  }

  // Returns the message with which a guardian switches the force off.
  palpate::ZeroForce zeroForce() const noexcept override {
    palpate::ZeroForce zero;
    zero.descriptor = driver_.port;
    zero.bytes = kNoCurrent;
    return zero;
  }

 private:
  static constexpr std::array<std::byte, 3 * sizeof(double)> kNoCurrent{};  // three times 0.0

  Driver& driver_;
  palpate::DeviceInfo info_;
  palpate::Fault fault_ = palpate::Fault::kNone;
};

volatile std::sig_atomic_t interrupted = 0;

int main() try {
  palpate::Guardian guardian;  // before any thread starts
  guardian.catchSignals(&interrupted);
  Driver driver;
  MyArm arm(driver);
  palpate::LoopParams params;
  params.watch = guardian.watch(arm.zeroForce());
  palpate::HapticThread hand(arm, params);  // 1 kHz, until it is destroyed
  hand.publish(ball(arm.info()));
  while (hand.latest().tick < 500 && interrupted == 0) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  const palpate::Telemetry& last = hand.latest();
  std::printf("%s: proxy at %.0f mm, fault: %s\n", arm.info().name.c_str(),
              1e3 * last.report.proxy.z(), palpate::wordFor(last.fault));
  return last.fault == palpate::Fault::kNone ? 0 : 1;
} catch (const palpate::Error& e) {
  std::fprintf(stderr, "device: %s\n", e.what());
  return 2;
}
