/// Private to the importer: reads the headers of DICOM files with vtk-dicom. It leaves out all
/// fields that identify a patient.
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

/// A tag that gives the time of an image; kTimeTags lists the best tag first. `seconds` is the
/// tag's unit [s]; 0: the tag gives only an order.
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

/// A tag by which images at one place differ in kind, and are then not time steps.
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

/// One image: a file, or one frame of a file.
struct Slice {
  std::size_t file = 0;
  int frame = 0;
  /// Rows, columns, bits allocated and stored, signed.
  std::array<int, 5> format{};
  bool placed = false;  ///< The next five fields are known.
  Vec3 position = Vec3::Zero();
  Vec3 row = Vec3::Zero();  ///< Unit vector along which the column number grows.
  Vec3 column = Vec3::Zero();
  double across = 0.0;  ///< Distance between columns [mm].
  double down = 0.0;    ///< Distance between rows [mm].
  double depth = 0.0;   ///< Position along the normal [mm].
  bool has_rescale = false;
  double slope = 1.0;
  double intercept = 0.0;
  /// Stored values from the first to the second are padding, not data; NaN: no padding.
  std::array<double, 2> padding{kUnsaid, kUnsaid};
  std::array<double, kTimeTags.size()> times{};
  std::array<std::string, kKindTags.size()> kinds;
};

using Slices = std::vector<Slice>;

/// A DICOM file's header.
struct File {
  std::filesystem::path path;
  std::string damage;  ///< Empty if valid.
  bool is_image = false;
  bool is_colour = false;
  bool is_packed = false;  ///< Compressed, and GDCM has to unpack it.
  bool is_lossy = false;
  bool has_table = false;  ///< A table maps the values, not slope and intercept.
  std::string series;
  int series_number = 0;
  std::string description;
  std::string study;
  std::string modality;
  std::string unit;
  double thickness = 0.0;
  double time_step = 0.0;  ///< [s]; 0: not stated.
  std::vector<Slice> slices;
};

/// Returns true if the file begins as DICOM files do.
[[nodiscard]] bool isDicom(const std::filesystem::path& path);

/// Reads a header without pixels. Reports defects of the file in `damage`.
[[nodiscard]] File headerOf(const std::filesystem::path& path);

}  // namespace palpate::importer
