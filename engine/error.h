/// Errors of loading, building and opening. The tick never throws.
#pragma once

#include <cstddef>
#include <stdexcept>
#include <string>
#include <vector>

namespace palpate {

/// An error with one line for the user, `what()`: the subject, the reason and the remedy.
class Error : public std::runtime_error {
 public:
  Error(const std::string& subject, const std::string& reason, const std::string& remedy)
      : std::runtime_error(subject + ": " + reason + ": " + remedy),
        subject_(subject.size()),
        reason_(reason.size()) {}  ///< what() is the three, with ": " between them.

  /// Returns the first part of what(): the file, JSON path or object with the error.
  [[nodiscard]] std::string subject() const { return std::string(what(), subject_); }
  /// Returns the second part of what(): the reason, with the value that is wrong.
  [[nodiscard]] std::string reason() const { return {what() + subject_ + 2, reason_}; }
  /// Returns the last part of what(): the action for the user.
  [[nodiscard]] std::string remedy() const { return what() + subject_ + 2 + reason_ + 2; }

 private:
  std::size_t subject_;  ///< Length of that part; the next begins two characters later.
  std::size_t reason_;
};

/// A file or grid that cannot be used.
class VolumeError : public Error {
 public:
  using Error::Error;  ///< Subject, reason and remedy.
};

/// A scene description that is wrong; `what` names the JSON path, such as /modes/0/of.
class SceneError : public Error {
 public:
  using Error::Error;  ///< Subject, reason and remedy.
  /// Returns the same error, prefixed by the file or path that it is in.
  [[nodiscard]] static SceneError within(const std::string& place, const Error& error) {
    return {place + ": " + error.subject(), error.reason(), error.remedy()};
  }
};

/// A device, or the description of a simulated one, that cannot be used.
class DeviceError : public Error {
 public:
  using Error::Error;  ///< Subject, reason and remedy.
};

/// Returns the candidate with the spelling nearest to `name`, for remedies; empty if no candidate
/// is near.
[[nodiscard]] std::string nearestName(const std::string& name,
                                      const std::vector<std::string>& candidates);

}  // namespace palpate
