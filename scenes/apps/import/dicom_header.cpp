#include "palpate/scenes/apps/import/dicom_header.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <optional>
#include <string_view>

#include <Eigen/Geometry>
#include <fmt/format.h>
#include <vtkDICOMImageCodec.h>
#include <vtkDICOMParser.h>
#include <vtkDICOMValue.h>
#include <vtkNew.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/dicom_bytes.h"
#include "palpate/scenes/apps/import/header_checks.h"
#include "palpate/scenes/apps/import/vtk_run.h"

namespace palpate::importer {
namespace {

namespace fs = std::filesystem;

/// Tolerance for perpendicular unit vectors, which files round.
constexpr double kPerpendicular = 1e-3;
constexpr unsigned kPacked = 0xffffffffU;

std::string textOf(const vtkDICOMValue& value) {
  std::string text = value.AsUTF8String();
  std::erase_if(text, [](char c) { return static_cast<unsigned char>(c) < ' ' || c == '\x7f'; });
  return text;
}

double numberOf(const vtkDICOMValue& value) {
  return value.GetNumberOfValues() == 0 ? kUnsaid : value.GetDouble(0);
}

/// Converts a time HHMMSS.FFFFFF to seconds since midnight; kUnsaid if it is invalid.
double secondsOf(const std::string& clock) {
  if (clock.size() < 6) return kUnsaid;
  try {
    return 3600.0 * std::stoi(clock.substr(0, 2)) + 60.0 * std::stoi(clock.substr(2, 2)) +
           std::stod(clock.substr(4));
  } catch (const std::exception&) {
    return kUnsaid;
  }
}

/// Reads position and directions. Sets `placed` only if both are valid.
void place(Slice& slice, vtkDICOMMetaData* meta) {
  const vtkDICOMValue& position = meta->Get(0, slice.frame, DC::ImagePositionPatient);
  const vtkDICOMValue& directions = meta->Get(0, slice.frame, DC::ImageOrientationPatient);
  const vtkDICOMValue& spacing = meta->Get(0, slice.frame, DC::PixelSpacing);
  if (position.GetNumberOfValues() != 3 || directions.GetNumberOfValues() != 6 ||
      spacing.GetNumberOfValues() != 2) {
    return;
  }
  std::array<double, 6> both{};
  directions.GetValues(both.data(), 6);
  position.GetValues(slice.position.data(), 3);
  slice.row = Vec3(both[0], both[1], both[2]);
  slice.column = Vec3(both[3], both[4], both[5]);
  // PixelSpacing: first the distance between rows, then that between columns.
  slice.down = spacing.GetDouble(0);
  slice.across = spacing.GetDouble(1);
  if (!slice.position.allFinite() || !(std::abs(slice.row.norm() - 1.0) < kPerpendicular) ||
      !(std::abs(slice.column.norm() - 1.0) < kPerpendicular) ||
      !(std::abs(slice.row.dot(slice.column)) < kPerpendicular) || !std::isfinite(slice.down) ||
      !std::isfinite(slice.across) || !(slice.down > 0.0) || !(slice.across > 0.0)) {
    return;
  }
  slice.row.normalize();
  slice.column.normalize();
  slice.placed = true;
}

/// Returns a padding value with the sign that the pixels' type requires: some files write a wrong
/// sign.
double paddingOf(const vtkDICOMValue& value, const Slice& slice) {
  double stored = numberOf(value);
  const int bits = slice.format[2];
  const bool is_signed = slice.format[4] != 0;
  if (is_signed && stored >= std::exp2(bits - 1)) stored -= std::exp2(bits);
  if (!is_signed && stored < 0.0) stored += std::exp2(bits);
  return stored;
}

Slice sliceOf(vtkDICOMMetaData* meta, int frame) {
  Slice slice;
  slice.frame = frame;
  slice.format = {meta->Get(0, DC::Rows).AsInt(), meta->Get(0, DC::Columns).AsInt(),
                  meta->Get(0, DC::BitsAllocated).AsInt(), meta->Get(0, DC::BitsStored).AsInt(),
                  meta->Get(0, DC::PixelRepresentation).AsInt()};
  place(slice, meta);

  const vtkDICOMValue& slope = meta->Get(0, frame, DC::RescaleSlope);
  const vtkDICOMValue& intercept = meta->Get(0, frame, DC::RescaleIntercept);
  slice.has_rescale = slope.GetNumberOfValues() > 0 && intercept.GetNumberOfValues() > 0;
  if (slice.has_rescale) {
    slice.slope = slope.AsDouble();
    slice.intercept = intercept.AsDouble();
    if (slice.slope == 0.0) slice.slope = 1.0;
  }
  slice.padding[0] = paddingOf(meta->Get(0, frame, DC::PixelPaddingValue), slice);
  slice.padding[1] = paddingOf(meta->Get(0, frame, DC::PixelPaddingRangeLimit), slice);
  if (std::isnan(slice.padding[1])) slice.padding[1] = slice.padding[0];
  if (slice.padding[0] > slice.padding[1]) std::swap(slice.padding[0], slice.padding[1]);

  for (std::size_t i = 0; i < kTimeTags.size(); ++i) {
    const vtkDICOMValue& value = meta->Get(0, frame, kTimeTags[i].tag);
    slice.times[i] =
        kTimeTags[i].tag == DC::AcquisitionTime ? secondsOf(value.AsString()) : numberOf(value);
  }
  for (std::size_t i = 0; i < kKindTags.size(); ++i) {
    slice.kinds[i] = meta->Get(0, frame, kKindTags[i].tag).AsString();
  }
  return slice;
}

/// Returns true for the classes of CT, MR, PET and nuclear medicine images. Also returns true for
/// "", because a truncated file may lack its class.
bool isImageClass(const std::string& uid) {
  if (uid.empty()) return true;
  static constexpr std::array kClasses = {"2", "2.1", "2.2", "4", "4.1", "4.4", "20", "128", "130"};
  const std::string_view begin = "1.2.840.10008.5.1.4.1.1.";
  return uid.rfind(begin, 0) == 0 &&
         std::find(kClasses.begin(), kClasses.end(), uid.substr(begin.size())) != kClasses.end();
}

/// Returns true for structured reports. Some have rows and columns, but no report has pixels.
bool isReport(const std::string& uid) {
  return uid.rfind("1.2.840.10008.5.1.4.1.1.88.", 0) == 0;
}

/// Returns the SOP class, which a file may state only in group 0002, or only in the data set.
std::string classOf(vtkDICOMMetaData* meta) {
  const std::string uid = meta->Get(0, DC::MediaStorageSOPClassUID).AsString();
  return uid.empty() ? meta->Get(0, DC::SOPClassUID).AsString() : uid;
}

void takePurpose(File& file, vtkDICOMMetaData* meta) {
  // Secondary Capture Image Storage. The classes for several frames begin with this UID.
  constexpr std::string_view kCapture = "1.2.840.10008.5.1.4.1.1.7";
  const std::string uid = classOf(meta);
  const std::string kind = meta->Get(0, DC::ImageType).AsString();
  file.is_capture = uid == kCapture || uid.rfind(std::string(kCapture) + ".", 0) == 0;
  file.is_screen_save = kind.find("SCREEN SAVE") != std::string::npos;
  file.is_localiser = kind.find("LOCALIZER") != std::string::npos;
}

/// Returns true if the decoder supports this transfer syntax: no compression, or a compression of
/// still images that vtk-dicom knows.
bool isReadable(const std::string& syntax) {
  constexpr std::array kPlain = {"",  // not stated in old files
                                 "1.2.840.10008.1.2", "1.2.840.10008.1.2.1", "1.2.840.10008.1.2.2"};
  if (std::find(kPlain.begin(), kPlain.end(), syntax) != kPlain.end()) return true;
  const vtkDICOMImageCodec codec(syntax);
  return codec.GetTransferSyntaxUID() == syntax && codec < vtkDICOMImageCodec::MPEG2ML;
}

constexpr const char* kExportPlain = "export it without compression";
constexpr const char* kTooFew = "the file has fewer pixels than its header states";

/// Returns the damage of a file that lacks compressed frames; "" if all are present. The decoders
/// would replace missing frames by invented pixels.
std::string damageOfParts(const fs::path& path, vtkDICOMParser* parser, int frames) {
  std::ifstream in(path, std::ios::binary);
  auto at = static_cast<std::int64_t>(parser->GetFileOffset());
  int parts = -1;  // the first part is a table of offsets, not a frame
  while (true) {
    std::array<unsigned char, 8> head{};
    in.seekg(at);
    in.read(reinterpret_cast<char*>(head.data()), head.size());
    if (!in || head[0] != 0xfe || head[1] != 0xff || head[2] != 0x00 || head[3] != 0xe0) break;
    std::int64_t bytes = 0;
    for (std::size_t i = 0; i < 4; ++i) bytes |= static_cast<std::int64_t>(head[4 + i]) << (8 * i);
    at += 8 + bytes;
    if (at > parser->GetFileSize()) {
      return fmt::format("the file is truncated: at least {} bytes are missing",
                         at - parser->GetFileSize());
    }
    ++parts;
  }
  return parts < frames ? kTooFew : "";
}

/// Returns the damage of an image file, without decoding its pixels; "" if valid.
std::string damageOf(vtkDICOMParser* parser, vtkDICOMMetaData* meta, int frames) {
  if (!parser->GetPixelDataFound()) return "the file has no pixels, or ends before them";
  const std::string syntax = textOf(meta->Get(0, DC::TransferSyntaxUID));
  if (!isReadable(syntax)) {
    return fmt::format("the pixels have an unsupported compression ({})", syntax);
  }
  const unsigned bytes = parser->GetPixelDataVL();
  if (bytes == kPacked) return damageOfParts(parser->GetFileName(), parser, frames);
  const auto end = parser->GetFileOffset() + static_cast<vtkTypeInt64>(bytes);
  if (end > parser->GetFileSize()) {
    return fmt::format("the file is truncated: {} bytes are missing", end - parser->GetFileSize());
  }
  const double needed = 1.0 * meta->Get(0, DC::Rows).AsInt() * meta->Get(0, DC::Columns).AsInt() *
                        meta->Get(0, DC::BitsAllocated).AsInt() *
                        std::max(1, meta->Get(0, DC::SamplesPerPixel).AsInt()) * frames / 8.0;
  if (bytes < needed) {
    // Colour images are rejected later. In 4:2:2 format these images need fewer bytes than computed
    // here.
    if (meta->Get(0, DC::SamplesPerPixel).AsInt() > 1) return "";
    return kTooFew;
  }
  return "";
}

}  // namespace

bool isDicom(const fs::path& path) {
  return beginsAsDicom(firstBytesOf(path));
}

File headerOf(const fs::path& path) {
  std::optional<PlainDicom> plain;
  try {
    plain.emplace(path);
  } catch (const VolumeError& e) {
    File file;
    file.path = path;
    file.damage = e.reason();
    file.remedy = e.remedy();
    return file;
  }
  vtkNew<vtkDICOMMetaData> meta;
  vtkNew<vtkDICOMParser> parser;
  meta->SetNumberOfInstances(1);
  parser->SetMetaData(meta);
  parser->SetFileName(plain->path().c_str());
  parser->SetIndex(0);
  parser->Update();

  File file;
  file.path = path;
  file.series = textOf(meta->Get(0, DC::SeriesInstanceUID));
  file.series_number = meta->Get(0, DC::SeriesNumber).AsInt();
  file.description = textOf(meta->Get(0, DC::SeriesDescription));
  file.study = textOf(meta->Get(0, DC::StudyDescription));
  file.modality = textOf(meta->Get(0, DC::Modality));
  file.frame_of_reference = textOf(meta->Get(0, DC::FrameOfReferenceUID));
  file.is_image = meta->Get(0, DC::Rows).AsInt() > 0 && meta->Get(0, DC::Columns).AsInt() > 0 &&
                  !isReport(classOf(meta));
  if (parser->GetErrorCode() != 0) {
    file.damage = "the header is truncated or damaged";
    return file;
  }
  if (!file.is_image) {
    if (isImageClass(classOf(meta))) {
      file.damage = "the header states no rows or no columns of the image";
    }
    return file;
  }
  const int frames = std::max(1, meta->Get(0, DC::NumberOfFrames).AsInt());
  file.damage = damageOf(parser, meta, frames);
  if (parser->GetPixelDataFound() && !isReadable(textOf(meta->Get(0, DC::TransferSyntaxUID)))) {
    file.remedy = kExportPlain;
  }
  if (!file.damage.empty()) return file;

  const std::string photometric = meta->Get(0, DC::PhotometricInterpretation).AsString();
  file.is_colour = meta->Get(0, DC::SamplesPerPixel).AsInt() > 1 ||
                   (!photometric.empty() && photometric.rfind("MONOCHROME", 0) != 0);
  const bool is_rle = meta->Get(0, DC::TransferSyntaxUID).AsString() == "1.2.840.10008.1.2.5";
  file.is_packed = parser->GetPixelDataVL() == kPacked && !is_rle;
  if (parser->GetPixelDataVL() == kPacked && meta->Get(0, DC::BitsAllocated).AsInt() == 1) {
    if (!is_rle) {
      file.damage =
          "the pixels have 1 bit each and a compression other than RLE, which is unsupported";
      file.remedy = kExportPlain;
      return file;
    }
    file.bits_at = static_cast<std::int64_t>(parser->GetFileOffset());
  }
  takePurpose(file, meta);
  file.is_lossy = meta->Get(0, DC::LossyImageCompression).AsString() == "01";
  file.has_table = meta->Get(0, DC::ModalityLUTSequence).GetNumberOfValues() > 0;
  file.unit = textOf(meta->Get(0, 0, DC::RescaleType));
  if (file.unit.empty()) file.unit = textOf(meta->Get(0, DC::Units));
  file.thickness = meta->Get(0, 0, DC::SliceThickness).AsDouble();
  file.time_step = 1e-3 * meta->Get(0, 0, DC::TemporalResolution).AsDouble();
  for (int frame = 0; frame < frames; ++frame) file.slices.push_back(sliceOf(meta, frame));
  if (frames == 1) file.slices.front().number = numberOf(meta->Get(0, DC::InstanceNumber));
  return file;
}

}  // namespace palpate::importer
