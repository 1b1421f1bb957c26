#include <algorithm>
#include <cmath>
#include <fcntl.h>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <streambuf>
#include <string>
#include <sys/stat.h>
#include <unistd.h>

#include <catch2/catch.hpp>

#include "palpate/devices/recording/csv.h"
#include "palpate/devices/simulated/path_device.h"
#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/error.h"
#include "palpate/engine/loop/haptic_loop.h"
#include "tests/support/counters.h"

namespace palpate::devices_test {
using Catch::Contains;

namespace {

std::vector<PathPoint> path(const std::string& text) {
  std::istringstream in(text);
  return readPath(in, "p.csv");
}

HandTarget hold(const Vec3& p, double seconds) {
  return alongPath({{0.0, p}, {seconds, p}});
}

}  // namespace

TEST_CASE("a late tick does not cut the force of a recorded path", "[devices]") {
  PathDevice device(path("t,x,y,z\n0,0,0,0\n1,0,0,0\n"), 1000.0);
  HapticLoop loop(device, 1000.0);
  TickTime time;
  time.now = time.dt = 0.021;
  time.late = 0.020;
  time.missed = true;
  loop.tick(time);
  CHECK(loop.latest().fault == Fault::kNone);
  CHECK(loop.latest().late_ticks == 1);
}

TEST_CASE("a recorded path is interpolated linearly between its rows and ends at its last row",
          "[path]") {
  PathDevice device(path("t,x,y,z\n0,0,0,0\n0.01,0.01,0,0\n0.02,0.01,0.02,0\n"), 1000.0);
  int ticks = 0;
  for (; !device.ended(); ++ticks) {
    const Vec3 p = device.read().position;
    const double t = ticks * 1e-3;
    CHECK((p - Vec3(std::min(t, 0.01), std::max(0.0, 2 * (t - 0.01)), 0)).norm() < 1e-15);
    device.write({5, 5, 5});
  }
  CHECK(ticks == 21);
}

TEST_CASE("a path file is refused if reading it fails before its end", "[path]") {
  // A stream that returns two rows and then throws, like a faulty disk.
  class Failing final : public std::streambuf {
   public:
    Failing() { setg(text_.data(), text_.data(), text_.data() + text_.size()); }

   private:
    int_type underflow() override { throw std::runtime_error("input/output error"); }
    std::string text_ = "t,x,y,z\n0,0,0,0\n1,0.01,0,0\n2,0.0";
  };
  Failing buffer;
  std::istream in(&buffer);
  CHECK_THROWS_WITH(readPath(in, "p.csv"), Contains("p.csv: reading failed after line 3"));
}

TEST_CASE("a path file that is a pipe or a device is refused before it is read", "[path][safety]") {
  const auto place =
      std::filesystem::temp_directory_path() / ("palpate_pipe_" + std::to_string(getpid()));
  REQUIRE(mkfifo(place.c_str(), 0600) == 0);
  // Keeps the pipe open for writing: without a writer, opening it for reading would block.
  const int writer = open(place.c_str(), O_RDWR | O_CLOEXEC);
  for (const std::string& file : {std::string("/dev/zero"), place.string()}) {
    std::ifstream holder;
    CHECK_THROWS_WITH(openInput(file, holder), Contains(file + ": it is a pipe or a device"));
    CHECK(!holder.is_open());
  }
  close(writer);
  std::filesystem::remove(place);
}

TEST_CASE("a path may have a single row and begin at 5 s", "[path]") {
  PathDevice device(path("t,x,y,z\n5,1,2,3\n"), 1000.0);
  CHECK(device.read().position == Vec3(1, 2, 3));
  device.write({});
  CHECK(device.ended());
}

TEST_CASE("a malformed path file is refused with its reason", "[path]") {
  CHECK_THROWS_WITH(path(""), Contains("p.csv: it is empty"));
  CHECK_THROWS_WITH(path("x,y,z\n1,2,3\n"), Contains("header t,x,y,z"));
  CHECK_THROWS_WITH(path("t,x,y,z\n"), Contains("no rows"));
  CHECK_THROWS_WITH(path("t,x,y,z\n0,1,2\n"), Contains("line 2: it has 3 fields"));
  CHECK_THROWS_WITH(path("t,x,y,z\n0,1,2,nan\n"), Contains("\"nan\" is not a finite number"));
  CHECK_THROWS_WITH(path("t,x,y,z\n0,1,2,3x\n"), Contains("\"3x\""));
  CHECK_THROWS_WITH(path("\n\nt,x,y,z\n0,1,2,3\n0,1,2,3\n"),
                    Contains("line 5: the time does not rise"));
  CHECK(path("t, x, y, z\r\n0, 1e-3, -2, +3\r\n\r\n").front().p == Vec3(1e-3, -2, 3));
}

TEST_CASE("a released simulated arm with viscous friction slows down as the closed form predicts",
          "[simulated]") {
  // An arm without a hand, Coulomb friction or encoder steps: after a push of one tick, v = v0
  // exp(-b t/m).
  ArmParams arm;
  arm.coulomb = 0.0;
  arm.encoder = 0.0;
  arm.delay = 0.0;
  SimulatedDevice device(arm, {0.0, 0.0}, hold(Vec3::Zero(), 1.0), 1000.0);
  device.write({1.0, 0, 0});
  const double v0 = device.velocity().x();
  const double decay = std::exp(-arm.viscous / arm.mass * 1e-3);
  CHECK(v0 == Approx((1.0 - decay) / arm.viscous).epsilon(1e-12));
  for (int i = 0; i < 100; ++i) device.write(Vec3::Zero());
  CHECK(device.velocity().x() == Approx(v0 * std::pow(decay, 100)).epsilon(1e-9));
}

TEST_CASE("a force displaces the simulated arm by the force over the hand's stiffness",
          "[simulated]") {
  ArmParams arm;
  arm.coulomb = 0.0;
  SimulatedDevice device(arm, {300.0, 5.0}, hold({0.01, 0, 0}, 5.0), 1000.0);
  for (int i = 0; i < 4000; ++i) device.write({0, 0.6, 0});
  CHECK((device.position() - Vec3(0.01, 0.6 / 300.0, 0)).norm() < 1e-9);
}

TEST_CASE("Coulomb friction holds the arm against a smaller force", "[simulated]") {
  ArmParams arm;
  arm.coulomb = 0.1;
  SimulatedDevice device(arm, {0.0, 0.0}, hold(Vec3::Zero(), 5.0), 1000.0);
  for (int i = 0; i < 1000; ++i) device.write({0.09, 0, 0});
  CHECK(device.position().norm() < 1e-5);
  for (int i = 0; i < 1000; ++i) device.write({0.2, 0, 0});
  CHECK(device.position().x() > 1e-2);
}

TEST_CASE("a force acts on the simulated arm after a delay of whole or fractional ticks",
          "[simulated]") {
  const double ticks = GENERATE(0.0, 1.0, 1.5, 3.25);
  ArmParams arm;
  arm.viscous = 0.0;
  arm.coulomb = 0.0;
  arm.encoder = 0.0;
  arm.delay = ticks * 1e-3;
  SimulatedDevice device(arm, {0.0, 0.0}, hold(Vec3::Zero(), 1.0), 1000.0);
  // Under a constant force of 1 N, v = (t - delay)/m.
  for (int i = 0; i < 10; ++i) device.write({1, 0, 0});
  CHECK(device.velocity().x() == Approx((10 - ticks) * 1e-3 / arm.mass));
}

TEST_CASE("the target of a simulated hand is evaluated once a tick at times that do not decrease",
          "[simulated]") {
  // The device evaluates a target at its construction and once per tick, so a target may have
  // state. Here each call moves the target by 1 mm, which is 1 m/s at 1 kHz.
  std::vector<double> asked;
  const auto at = [&asked](double t) -> Vec3 {
    asked.push_back(t);
    return {1e-3 * static_cast<double>(asked.size()), 0.0, 0.0};
  };
  ArmParams arm;
  arm.viscous = 0.0;
  arm.coulomb = 0.0;
  SimulatedDevice device(arm, {300.0, 5.0}, {at, 10.0}, 1000.0);
  for (int i = 0; i < 1000; ++i) device.write(Vec3::Zero());
  REQUIRE(asked.size() == 1001);
  CHECK(std::is_sorted(asked.begin(), asked.end()));
  CHECK(asked.back() == 0.999);
  // The hand's damper pulls the arm along. The arm has no friction, and is half a tick behind the
  // target.
  CHECK(device.velocity().x() == Approx(1.0).epsilon(2e-3));
  CHECK(device.position().x() == Approx(1.001 + 0.5e-3).margin(2e-5));
}

TEST_CASE("the simulated arm reports its position rounded to encoder steps", "[simulated]") {
  ArmParams arm;
  arm.encoder = 1e-3;
  SimulatedDevice device(arm, {300.0, 5.0}, hold({0.0126, -0.0004, 0}, 1.0), 1000.0);
  CHECK((device.read().position - Vec3(0.013, 0, 0)).norm() < 1e-15);
}

TEST_CASE("two equal simulated runs give bitwise equal positions", "[simulated]") {
  const Box box{Vec3::Constant(-0.05), Vec3::Constant(0.05)};
  SimulatedDevice a({}, {}, explore(box, 2.0), 1000.0);
  SimulatedDevice b({}, {}, explore(box, 2.0), 1000.0);
  while (!a.ended()) {
    REQUIRE(a.read().position == b.read().position);
    a.write({0.1, 0.2, 0.3});
    b.write({0.1, 0.2, 0.3});
  }
}

TEST_CASE("a released simulated arm never speeds up and comes to rest", "[simulated]") {
  SimulatedDevice device({}, {0.0, 0.0}, hold(Vec3::Zero(), 10.0), 1000.0);
  for (int i = 0; i < 50; ++i) device.write({1, -1, 0.5});
  double speed = device.velocity().norm();
  device.write(Vec3::Zero());
  device.write(Vec3::Zero());
  speed = device.velocity().norm();
  for (int i = 0; i < 2000; ++i) {
    device.write(Vec3::Zero());
    REQUIRE(device.velocity().norm() <= speed);
    speed = device.velocity().norm();
  }
  CHECK(speed == 0.0);
}

TEST_CASE("the position of a very light, strongly damped arm stays finite", "[simulated]") {
  ArmParams arm;
  arm.mass = 1e-6;
  SimulatedDevice device(arm, {}, hold({0.01, 0, 0}, 1.0), 1000.0);
  for (int i = 0; i < 100; ++i) device.write({0, 0.3, 0});
  CHECK((device.position() - Vec3(0.01, 0.001, 0)).norm() < 1e-4);
}

TEST_CASE("a simulated arm refuses parameters out of range", "[simulated]") {
  ArmParams arm;
  arm.mass = 0.0;
  CHECK_THROWS_AS(SimulatedDevice(arm, {}, hold(Vec3::Zero(), 1.0), 1000.0), DeviceError);
  CHECK_THROWS_AS(SimulatedDevice({}, {-1.0, 0.0}, hold(Vec3::Zero(), 1.0), 1000.0), DeviceError);
  CHECK_THROWS_AS(SimulatedDevice({}, {}, HandTarget{}, 1000.0), DeviceError);
}

TEST_CASE("the exploration path starts and ends outside the box and passes near its centre",
          "[simulated]") {
  const Box box{{-0.05, -0.03, -0.02}, {0.05, 0.03, 0.02}};
  for (const double seconds : {1.0, 5.0, 20.0}) {
    const HandTarget target = explore(box, seconds);
    CHECK(target.seconds == seconds);
    const auto depth = [&](const Vec3& p) {
      return (p - box.centre()).cwiseQuotient(0.5 * box.size()).norm();
    };
    double deepest = 9.0;
    for (int i = 0; i <= 1000; ++i) {
      const Vec3 p = target.at(seconds * i / 1000.0);
      REQUIRE(p.allFinite());
      // A path of 5 s or more has no jumps: its speed is below 1 m/s.
      if (seconds >= 5.0 && i > 0) {
        REQUIRE((p - target.at(seconds * (i - 1) / 1000.0)).norm() < seconds / 1000.0);
      }
      deepest = std::min(deepest, depth(p));
    }
    CHECK(depth(target.at(0.0)) > 1.1);
    CHECK(depth(target.at(seconds)) > 1.1);
    CHECK(deepest < 0.4);
  }
}

TEST_CASE("reading and writing a simulated arm or a recorded path neither allocates nor locks",
          "[simulated][realtime]") {
  const Box box{Vec3::Constant(-0.05), Vec3::Constant(0.05)};
  SimulatedDevice simulated({}, {}, explore(box, 2.0), 1000.0);
  PathDevice follower({{0.0, Vec3::Zero()}, {1.0, Vec3::Ones()}, {2.0, Vec3::Zero()}}, 1000.0);
  const test::CountScope scope;
  for (int i = 0; i < 1500; ++i) {
    (void)simulated.read();
    simulated.write({0.1, 0, 0});
    (void)follower.read();
    follower.write({0.1, 0, 0});
  }
  const test::Counts counts = test::CountScope::counts();
  CHECK(counts.allocations == 0);
  CHECK(counts.locks == 0);
}

}  // namespace palpate::devices_test
