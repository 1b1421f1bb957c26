/// Constants and structs that the simulated arm and its host share.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>

#include "palpate/devices/simulated/simulated_device.h"
#include "tests/support/pid_model.h"

namespace palpate::vm {

inline constexpr std::uint16_t kVendor = 0x1209;  // pid.codes
inline constexpr std::uint16_t kProduct = 0x0001;
/// One product number for each kind of device.
inline constexpr std::array<std::uint16_t, 2> kPidProducts{0x0002, 0x0003};
inline constexpr const char* kSerial = "ARM0001";
inline constexpr double kStep = 1e-5;     // encoder step [m]
inline constexpr double kForce = 1e-6;    // force per output count [N]
inline constexpr double kRulerWay = 0.1;  // path of a ruler measurement [m]
inline constexpr std::size_t kInBytes = 40;
inline constexpr std::size_t kOutBytes = 24;

// Vendor-defined page FF00, usage 1; input is report 1, output is report 2.
inline constexpr std::array<std::uint8_t, 42> kDescriptor{
    0x06, 0x00,      0xFF, 0x09, 0x01, 0xA1, 0x01,     0x15, 0x00, 0x26, 0xFF, 0x00, 0x75,
    0x08, 0x85,      0x01, 0x09, 0x02, 0x95, kInBytes, 0x81, 0x02, 0x85, 0x02, 0x09, 0x03,
    0x95, kOutBytes, 0x91, 0x02, 0x85, 0x03, 0x09,     0x04, 0x95, 0x08, 0xB1, 0x02, 0xC0};

enum Command : std::uint32_t {
  kNothing = 0,
  kUnplug = 1,  ///< Unplugs the arm and plugs it in again after 200 ms.
  kGo = 2,      ///< Starts the hand's path. The arm logs every step.
  kEnd = 3,     ///< Unplugs the arm for good.
  /// The hand moves the arm by kRulerWay: along +x after 6 s, along +y and +z 5 s later each. It
  /// moves back after 20 s and lets go after 24 s.
  kRuler = 4,
};

#pragma pack(push, 1)
struct In {
  std::uint8_t id = 1;
  std::uint32_t count = 0;     ///< Number of the report; one per millisecond.
  std::uint32_t received = 0;  ///< Number of received forces.
  std::array<std::int32_t, 3> position{};
  std::uint32_t step = 0;   ///< Step of the hand's path; 0 before the start.
  std::uint32_t phase = 0;  ///< Time from the last report to the newest received force [us].
  std::array<std::uint8_t, 12> rest{};
};
struct Out {
  std::uint8_t id = 2;
  std::uint32_t command = kNothing;
  std::array<std::int32_t, 3> force{};
  std::array<std::uint8_t, 8> rest{};
};
#pragma pack(pop)
static_assert(sizeof(In) == kInBytes + 1);
static_assert(sizeof(Out) == kOutBytes + 1);

/// Returns one of two kinds of PID devices: 0 has two axes, 1 has three.
inline test::PidShape pidShape(std::size_t kind) {
  test::PidShape shape;
  shape.rhino = kind == 1;
  shape.axes = kind == 1 ? 3 : 2;
  return shape;
}

inline ArmParams armParams() {
  ArmParams arm;
  arm.mass = 0.1;
  arm.viscous = 0.5;
  arm.coulomb = 0.05;
  arm.encoder = kStep;
  arm.delay = 1e-3;
  return arm;
}

/// Returns a path on a ball of radius 3 cm: from above to 6 mm deep, along the surface, and out
/// again.
inline HandTarget handPath() {
  constexpr double kSeconds = 4.0;
  return {[](double t) -> Vec3 {
            const double u = std::fmin(t / kSeconds, 1.0);
            const double in = std::sin(M_PI * u);
            return {0.012 * std::sin(2.0 * M_PI * u), 0.004 * u, 0.042 - 0.018 * in * in};
          },
          kSeconds};
}

}  // namespace palpate::vm
