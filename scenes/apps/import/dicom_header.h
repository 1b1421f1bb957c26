/// Private to the importer: reads DICOM headers, without the fields that identify a patient.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <string>
#include <vector>

#include <vtkDICOMMetaData.h>

#include "palpate/engine/types.h"

namespace palpate::importer {

inline constexpr double kUnsaid = std::numeric_limits<double>::quiet_NaN();

/// A tag that orders images by time. kTimeTags begins with the preferred tag. `seconds` is the unit
/// of the tag [s]; 0: the tag has only an order.
struct TimeTag {
  DC::EnumType tag;
  double seconds;
};
inline constexpr std::array kTimeTags = {
    TimeTag{DC::TriggerTime, 1e-3},
    TimeTag{DC::NominalCardiacTriggerDelayTime, 1e-3},
    TimeTag{DC::TemporalPositionTimeOffset, 1.0},
    TimeTag{DC::TemporalPositionIdentifier, 0.0},
    TimeTag{DC::TemporalPositionIndex, 0.0},
    TimeTag{DC::AcquisitionTime, 1.0},
};

/// A tag that differs between kinds of images. Its value must be the same in all images at one
/// position.
struct KindTag {
  DC::EnumType tag;
  const char* name;
};
inline constexpr std::array kKindTags = {
    KindTag{DC::EchoTime, "echo time"},
    KindTag{DC::EffectiveEchoTime, "echo time"},
    KindTag{DC::InversionTime, "inversion time"},
    KindTag{DC::FlipAngle, "flip angle"},
    KindTag{DC::DiffusionBValue, "diffusion weighting"},
    KindTag{DC::ImageType, "kind of image"},
    KindTag{DC::FrameType, "kind of image"},
};

/// An image: a whole file or one frame of a file.
struct Slice {
  std::size_t file = 0;
  int frame = 0;
  /// Number of rows, columns, allocated bits and stored bits; then 1 if values are signed, else 0.
  std::array<int, 5> format{};
  bool placed = false;  ///< True if the members from `position` to `down` are known.
  Vec3 position = Vec3::Zero();
  Vec3 row = Vec3::Zero();  ///< Direction in which the column number grows.
  Vec3 column = Vec3::Zero();
  double across = 0.0;      ///< Distance between columns [mm].
  double down = 0.0;        ///< Distance between rows [mm].
  double depth = 0.0;       ///< Position along the normal of the slices [mm].
  double number = kUnsaid;  ///< InstanceNumber; NaN: not stated, or several frames in a file.
  bool has_rescale = false;
  double slope = 1.0;
  double intercept = 0.0;
  /// Stored values from the first to the second number are padding. NaN: no padding.
  std::array<double, 2> padding{kUnsaid, kUnsaid};
  std::array<double, kTimeTags.size()> times{};
  std::array<std::string, kKindTags.size()> kinds;
};

using Slices = std::vector<Slice>;

inline constexpr const char* kCopyDicomAgain = "copy or export the file again";

/// The header of a DICOM file.
struct File {
  std::filesystem::path path;
  std::string damage;                    ///< Reason why the file cannot be read; empty if it can.
  std::string remedy = kCopyDicomAgain;  ///< Remedy for `damage`.
  bool is_image = false;
  bool is_colour = false;
  bool is_packed = false;  ///< True if GDCM must decode the pixels: compressed, but not by RLE.
  bool is_lossy = false;
  bool is_capture = false;      ///< True if its class is Secondary Capture.
  bool is_screen_save = false;  ///< True if its ImageType is SCREEN SAVE.
  bool is_localiser = false;
  /// Offset of the first item of RLE pixels with one bit [bytes]; 0: other pixels.
  std::int64_t bits_at = 0;
  /// True if a lookup table, not slope and intercept, maps the stored values.
  bool has_table = false;
  std::string series;
  int series_number = 0;
  std::string description;
  std::string study;
  std::string frame_of_reference;  ///< UID of the space of the positions; may be empty.
  std::string modality;
  std::string unit;
  double thickness = 0.0;  ///< Thickness of a slice [mm]; 0: not stated.
  double time_step = 0.0;  ///< Time between two steps [s]; 0: not stated.
  std::vector<Slice> slices;
};

[[nodiscard]] bool isDicom(const std::filesystem::path& path);

/// Reads a header without pixels. Writes damage of the file to File::damage.
[[nodiscard]] File headerOf(const std::filesystem::path& path);

}  // namespace palpate::importer
