/// Errors of loading, building and opening. Nothing in the tick throws.
#pragma once

#include <stdexcept>
#include <string>
#include <vector>

namespace palpate {

/// One line for the user: what was being done, why it cannot be, what to do about it.
class Error : public std::runtime_error {
 public:
  Error(const std::string& what, const std::string& why, const std::string& remedy)
      : std::runtime_error(what + ": " + why + ": " + remedy) {}

 protected:
  explicit Error(const std::string& line) : std::runtime_error(line) {}
};

/// A file or grid that cannot be felt.
class VolumeError : public Error {
 public:
  using Error::Error;
};

/// A scene description that is wrong; `what` names the JSON path, such as /modes/0/of.
class SceneError : public Error {
 public:
  using Error::Error;
  /// The same error, prefixed by the file or path that it is in.
  [[nodiscard]] static SceneError within(const std::string& place, const Error& error) {
    return SceneError(place + ": " + error.what());
  }

 private:
  explicit SceneError(const std::string& line) : Error(line) {}
};

/// A device, or the description of a simulated one, that cannot be used.
class DeviceError : public Error {
 public:
  using Error::Error;
};

/// The candidate that is spelled most like `name`, for remedies; empty if none is near.
[[nodiscard]] std::string nearestName(const std::string& name,
                                      const std::vector<std::string>& candidates);

}  // namespace palpate
