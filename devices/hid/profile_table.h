/// Private to devices: the format of an arm's profile as a table (json_table.h). check_profile.cpp
/// and check_consistency.cpp check whether the parts of a profile agree.
#pragma once

#include <array>
#include <cstddef>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "palpate/devices/hid/hid_profile.h"
#include "palpate/devices/json/json_table.h"

namespace palpate {

/// A field as given in the file; distinguishes a missing value from a given one.
struct FileField {
  std::optional<ReportField::Type> type;
  int bit = 0;
  int bits = 0;
  bool big_endian = false;
  double scale = 1.0;
  double offset = 0.0;
  bool wraps = false;
  std::optional<double> least, most, rest;
};

struct FileReport {
  std::optional<int> id;
  int size = 0;
  std::map<std::string, FileField> fields;
  std::string sequence;
  double stale = 0.0;
};

/// A flag with the name of its field; checkedProfile resolves the name.
struct FileFlag {
  HidFlag flag;
  std::string field;
};
struct FileJoint {
  HidJoint joint;
  std::string from, motor;
};
struct FileButton {
  HidButton button;
  std::string field;
};
struct FileTurn {
  HidTurn turn;
  std::string from;
};
struct FileStep {
  HidStep step;
  std::string field;
  std::map<std::string, double> send;
};

/// Lengths [m].
struct FileGeometry {
  double a = 0.0, b = 0.0, c = 0.0;
  double base = 0.0, plate = 0.0, upper = 0.0, fore = 0.0;
  std::array<double, 4> lengths{};
  std::vector<ChainLink> links;
  Vec3 tip = Vec3::Zero();
};

/// A profile as in its file, before names are resolved.
struct ProfileFile {
  HidProfile profile;  ///< The parts of the profile that refer to no other part of the file.
  std::vector<FileReport> input;
  std::optional<FileReport> output;
  std::vector<FileFlag> flags;
  std::vector<FileButton> buttons;
  std::vector<FileTurn> orientation;
  std::optional<FileTurn> gripper;
  FileGeometry geometry;
  std::function<std::shared_ptr<const Kinematics>(const FileGeometry&)> model;
  std::vector<FileJoint> joints;
  std::vector<FileStep> open, home, close;
  std::array<double, 4> rotation_wxyz{1, 0, 0, 0};
};

[[nodiscard]] const JsonObject<ProfileFile>& profileTable();

[[nodiscard]] JsonSchema profileTableSchema();

}  // namespace palpate
