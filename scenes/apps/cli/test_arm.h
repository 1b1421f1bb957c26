/// The self-test of an arm by `palpate devices --test`.
#pragma once

#include <optional>
#include <string>

#include "palpate/devices/arm/self_test.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {

/// Options of `palpate devices`.
struct DevicesOptions {
  std::string profile;
  std::string test;
  std::string watch;
  double seconds = 0.0;
  double force = 0.5;
  std::optional<double> ruler;
  bool verbose = false;
  bool json = false;
};

inline constexpr const char* kNoMotor = "it has no motor there, and gives no force";

/// Returns the names of an arm's axes.
[[nodiscard]] OrderedJson axisNames(const ArmAxes& axes);

/// Tests the arm `options.test`: measures it, prints the result, and remembers an arm that passed.
/// Returns the exit status. Throws Error.
[[nodiscard]] int testArm(const DevicesOptions& options);

}  // namespace palpate::cli
