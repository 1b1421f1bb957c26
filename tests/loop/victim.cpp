/// A program with a hand, for tests that kill it: victim SOCKET ACTION.
/// Its device sends each force to a datagram socket: three doubles [N]. The real loop presses the
/// hand with about 1.5 N. A line on standard input starts ACTION: exception, exit, return, hang (a
/// tick that does not return), slow (a slow write, then one that does not return), or nothing. Two
/// actions act from the start: fast (10 kHz) and blocked (a second device with a full queue).
/// kill_test.py sends the line and checks the forces.
#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <span>
#include <stdexcept>
#include <string>
#include <sys/socket.h>
#include <sys/un.h>
#include <thread>
#include <unistd.h>

#include "palpate/devices/arm/guardian.h"
#include "palpate/engine/loop/haptic_thread.h"
#include "tests/support/scenes.h"

namespace {

using namespace palpate;

std::atomic<bool> hang{false};
std::atomic<bool> slow{false};  // if true, one write takes 40 ms and the write after it blocks

int connectTo(const std::string& path) {
  const int descriptor = socket(AF_UNIX, SOCK_DGRAM | SOCK_NONBLOCK, 0);
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::strncpy(address.sun_path, path.c_str(), sizeof(address.sun_path) - 1);
  if (connect(descriptor, reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0) {
    throw std::runtime_error(path + ": " + std::strerror(errno));
  }
  return descriptor;
}

class SocketDevice final : public Device {
 public:
  explicit SocketDevice(int descriptor) : descriptor_(descriptor) {
    about.name = "socket";
    about.watch.late = 1.0;  // test machines are sometimes late
  }
  [[nodiscard]] const DeviceInfo& info() const noexcept override { return about; }
  [[nodiscard]] HandState read() noexcept override {
    // Simulates a tick that hangs.
    while (hang.load()) {
    }
    HandState hand;
    ++ticks_;
    // The hand stays outside for 1000 ticks, then moves inwards by 13 mm in 100 ticks.
    const double way = std::clamp(1e-3 * static_cast<double>(ticks_ - 1000) / 0.1, 0.0, 1.0);
    hand.position = {0, 0, 0.04 - 0.013 * way};
    return hand;
  }
  void write(const Vec3& force) noexcept override {
    if (slow) std::this_thread::sleep_for(std::chrono::milliseconds(stuck_ ? 100000000 : 40));
    stuck_ = slow;
    (void)!::write(descriptor_, force.data(), sizeof(double) * 3);
    pressed_ = pressed_ || force.norm() > 1.0;
  }

  /// Returns true once a force above 1 N was written.
  [[nodiscard]] bool pressed() const { return pressed_; }

 private:
  int descriptor_;
  bool stuck_ = false;
  std::atomic<bool> pressed_{false};
  DeviceInfo about;
  long ticks_ = 0;
};

int run(const std::string& path, const std::string& action) {
  Guardian guardian;
  const int descriptor = connectTo(path);
  const std::array<double, 3> none{};
  LoopParams params;
  if (action == "fast") params.rate = 10000.0;
  if (action == "blocked") {
    // Adds a second device with a full queue, so a write to that device would block.
    std::array<int, 2> ends{};
    if (socketpair(AF_UNIX, SOCK_DGRAM, 0, ends.data()) != 0) return 3;
    while (send(ends[0], none.data(), sizeof(none), MSG_DONTWAIT) > 0) {
    }
    (void)guardian.watch({ends[0], std::as_bytes(std::span(none))});
  }
  params.watch = guardian.watch({descriptor, std::as_bytes(std::span(none))});
  guardian.catchSignals();
  SocketDevice device(descriptor);
  HapticThread hand(device, params);
  hand.publish(test::ballScene(test::ballField()));
  std::printf("ready %d\n", guardian.child());
  std::fflush(stdout);
  // On a slow machine the loop can be late and cut the force before the hand presses.
  while (!device.pressed()) {
    if (const Fault fault = hand.latest().fault; fault != Fault::kNone) {
      std::fprintf(stderr, "%s\n", wordsFor(fault));
      hand.clear();
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  // Waits for the line that starts ACTION.
  char line[16];
  if (std::fgets(line, sizeof(line), stdin) == nullptr) return 3;
  if (action == "exception") throw std::runtime_error("a test exception of the application");
  if (action == "exit") std::exit(0);
  if (action == "return") return 0;
  if (action == "hang") hang = true;
  if (action == "slow") slow = true;
  for (;;) std::this_thread::sleep_for(std::chrono::seconds(1));
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  const std::string action = argv[2];
  // An uncaught exception ends the program by std::terminate.
  return run(argv[1], action);
}
