/// Errors of loading, building and opening. Nothing in the tick throws.
#pragma once

#include <cstddef>
#include <stdexcept>
#include <string>
#include <vector>

namespace palpate {

/// One line for the user, `what()`: what was being done, why it cannot be, what to do about it.
class Error : public std::runtime_error {
 public:
  Error(const std::string& subject, const std::string& reason, const std::string& remedy)
      : std::runtime_error(subject + ": " + reason + ": " + remedy),
        subject_(subject.size()),
        reason_(reason.size()) {}  ///< what() is the three, with ": " between them.

  /// First part of what(): the file, JSON path or thing in which the error is.
  [[nodiscard]] std::string subject() const { return std::string(what(), subject_); }
  /// Second part of what(): why it cannot be, with the value that is wrong.
  [[nodiscard]] std::string reason() const { return {what() + subject_ + 2, reason_}; }
  /// Last part of what(): what the user can do about it.
  [[nodiscard]] std::string remedy() const { return what() + subject_ + 2 + reason_ + 2; }

 private:
  std::size_t subject_;  ///< Length of that part; the next begins two characters later.
  std::size_t reason_;
};

/// A file or grid that cannot be felt.
class VolumeError : public Error {
 public:
  using Error::Error;  ///< Subject, reason and remedy.
};

/// A scene description that is wrong; `what` names the JSON path, such as /modes/0/of.
class SceneError : public Error {
 public:
  using Error::Error;  ///< Subject, reason and remedy.
  /// The same error, prefixed by the file or path that it is in.
  [[nodiscard]] static SceneError within(const std::string& place, const Error& error) {
    return {place + ": " + error.subject(), error.reason(), error.remedy()};
  }
};

/// A device, or the description of a simulated one, that cannot be used.
class DeviceError : public Error {
 public:
  using Error::Error;  ///< Subject, reason and remedy.
};

/// The candidate that is spelled most like `name`, for remedies; empty if none is near.
[[nodiscard]] std::string nearestName(const std::string& name,
                                      const std::vector<std::string>& candidates);

}  // namespace palpate
