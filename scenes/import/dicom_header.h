/// Private to the importer: headers of DICOM files, by vtk-dicom, without what identifies a
/// patient.
#pragma once

#include <array>
#include <cstddef>
#include <filesystem>
#include <limits>
#include <string>
#include <vector>

#include <vtkDICOMMetaData.h>

#include "palpate/engine/types.h"

namespace palpate::importer {

inline constexpr double kUnsaid = std::numeric_limits<double>::quiet_NaN();

/// What tells one time from another, the best first; `seconds` a unit, or 0: only an order.
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

/// What makes images of one place different in kind, hence no steps of time.
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

/// One image: a file, or a frame of one.
struct Slice {
  std::size_t file = 0;
  int frame = 0;
  /// Rows, columns, bits allocated and stored, signed.
  std::array<int, 5> format{};
  bool placed = false;  ///< The next five are known.
  Vec3 position = Vec3::Zero();
  Vec3 row = Vec3::Zero();  ///< Unit, along which the column number grows.
  Vec3 column = Vec3::Zero();
  double across = 0.0;  ///< Between columns [mm].
  double down = 0.0;    ///< Between rows [mm].
  double depth = 0.0;   ///< Along the normal [mm].
  bool has_rescale = false;
  double slope = 1.0;
  double intercept = 0.0;
  /// Stored values from the first to the second are no data; none if NaN.
  std::array<double, 2> padding{kUnsaid, kUnsaid};
  std::array<double, kTimeTags.size()> times{};
  std::array<std::string, kKindTags.size()> kinds;
};

using Slices = std::vector<Slice>;

/// A DICOM file's header.
struct File {
  std::filesystem::path path;
  std::string damage;  ///< Empty if none.
  bool is_image = false;
  bool is_colour = false;
  bool is_packed = false;  ///< And for GDCM to unpack.
  bool is_lossy = false;
  bool has_table = false;  ///< Values go through a table instead of slope and intercept.
  std::string series;
  int series_number = 0;
  std::string description;
  std::string study;
  std::string modality;
  std::string unit;
  double thickness = 0.0;
  double time_step = 0.0;  ///< [s], 0: not said.
  std::vector<Slice> slices;
};

/// True where it begins as DICOM files do.
[[nodiscard]] bool isDicom(const std::filesystem::path& path);

/// Reads a header and no pixels. What is wrong with the file is its `damage`.
[[nodiscard]] File headerOf(const std::filesystem::path& path);

}  // namespace palpate::importer
