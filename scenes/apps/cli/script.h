/// Runs the Python programs of palpate that draw pictures with matplotlib.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {

/// A Python program that reads JSON from standard input and writes a picture to standard output.
class Script {
 public:
  /// Throws Error if the program, Python or matplotlib is missing; the message names `option`.
  Script(const std::string& name, const std::string& option);
  /// Draws a picture into `file`, which the caller commits. Messages name the file `path`. Throws
  /// Error, and Interrupted after an interrupt.
  void draw(const OrderedJson& json, const WholeFile& file, const std::string& path,
            const std::vector<std::string>& arguments = {}) const;

 private:
  std::filesystem::path script_;
};

}  // namespace palpate::cli
