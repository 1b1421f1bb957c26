/// Runs the installed Python programs that draw pictures (matplotlib).
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {

/// One program: JSON on its standard input, a picture on its standard output.
class Script {
 public:
  /// Throws Error, which names the option, if Python or matplotlib is missing.
  Script(const std::string& name, const std::string& option);
  /// Draws into a file that is not committed yet. Throws Error.
  void draw(const OrderedJson& json, const WholeFile& file, const std::string& path,
            const std::vector<std::string>& arguments = {}) const;

 private:
  std::filesystem::path script_;
};

}  // namespace palpate::cli
