/// Exceptions about volumes, scenes and devices. A tick never throws.
#pragma once

#include <cstddef>
#include <stdexcept>
#include <string>
#include <vector>

namespace palpate {

/// An error with a message of one line: what() has the subject, the reason and the remedy.
class Error : public std::runtime_error {
 public:
  Error(const std::string& subject, const std::string& reason, const std::string& remedy)
      : std::runtime_error(subject + ": " + reason + ": " + remedy),
        subject_(subject.size()),
        reason_(reason.size()) {}  ///< Joins the three parts with ": ".

  /// Returns the first part of what(): the file, JSON path or object with the error.
  [[nodiscard]] std::string subject() const { return std::string(what(), subject_); }
  /// Returns the second part of what(): the reason.
  [[nodiscard]] std::string reason() const { return {what() + subject_ + 2, reason_}; }
  /// Returns the last part of what(): the action for the user.
  [[nodiscard]] std::string remedy() const { return what() + subject_ + 2 + reason_ + 2; }

 private:
  /// Lengths of the subject and the reason in what(); ": " follows each.
  std::size_t subject_;
  std::size_t reason_;
};

/// A file or grid that cannot be used.
class VolumeError : public Error {
 public:
  using Error::Error;  ///< The arguments are the subject, the reason and the remedy.
};

/// A wrong scene description. The subject is the JSON path of the error, such as /modes/0/of.
class SceneError : public Error {
 public:
  using Error::Error;  ///< The arguments are the subject, the reason and the remedy.
  /// Returns `error` with `place`, a file or JSON path, in front of its subject.
  [[nodiscard]] static SceneError within(const std::string& place, const Error& error) {
    return {place + ": " + error.subject(), error.reason(), error.remedy()};
  }
};

/// A device, or the description of a simulated device, that cannot be used.
class DeviceError : public Error {
 public:
  using Error::Error;  ///< The arguments are the subject, the reason and the remedy.
};

/// Returns the candidate that needs the fewest edits of a byte to become `name`; of equal ones, the
/// first. Returns an empty string if all candidates need more than 1 + name.size()/3 edits, or
/// `name` has more than 200 bytes.
[[nodiscard]] std::string nearestName(const std::string& name,
                                      const std::vector<std::string>& candidates);

}  // namespace palpate
