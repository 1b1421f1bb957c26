/// The options of `palpate devices`.
#pragma once

#include <optional>
#include <string>

namespace palpate::cli {

struct DevicesOptions {
  std::string profile;
  std::string test;
  bool virtual_arm = false;  ///< Tests a simulated arm instead of `test`.
  std::string watch;
  double seconds = 0.0;
  double force = 0.5;
  std::optional<double> ruler;
  bool verbose = false;
  bool json = false;
};

}  // namespace palpate::cli
