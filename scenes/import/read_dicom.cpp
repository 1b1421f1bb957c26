/// DICOM series through vtk-dicom. It parses files and unpacks pixels; which images make a volume,
/// in which order and where they are is found here, since whatever does not fit must be told.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iostream>
#include <limits>
#include <string_view>
#include <tuple>
#include <unistd.h>
#include <utility>

#include <Eigen/Geometry>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <vtkDICOMImageCodec.h>
#include <vtkDICOMMetaData.h>
#include <vtkDICOMParser.h>
#include <vtkDICOMReader.h>
#include <vtkDICOMSliceSorter.h>
#include <vtkDICOMValue.h>
#include <vtkDataSetAttributes.h>
#include <vtkFloatArray.h>
#include <vtkImageData.h>
#include <vtkIntArray.h>
#include <vtkNew.h>
#include <vtkPointData.h>
#include <vtkShortArray.h>
#include <vtkStringArray.h>
#include <vtkUnsignedCharArray.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/import/reader.h"
#include "palpate/scenes/import/vtk_run.h"

namespace palpate::importer {
namespace {

namespace fs = std::filesystem;

/// A slice may be off its place among the others by this part of their distance.
constexpr double kUneven = 0.05;
/// Images are at the same place within this part of a pixel's edge.
constexpr double kSamePlace = 1e-3;
/// Directions are the same, and perpendicular, within this: files round them.
constexpr double kSameDirection = 1e-3;

constexpr unsigned kPacked = 0xffffffffU;  ///< The length of pixels that are packed.
constexpr const char* kAgain = "copy or export it again";

constexpr double kUnsaid = std::numeric_limits<double>::quiet_NaN();

/// What tells one time from another, the best first; `seconds` a unit, or 0: only an order.
struct TimeTag {
  DC::EnumType tag;
  double seconds;
};
constexpr std::array kTimeTags = {
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
constexpr std::array kKindTags = {
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

/// A DICOM file's header, without what identifies a patient.
struct File {
  fs::path path;
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

bool isDicom(const fs::path& path) {
  std::array<char, 132> begin{};
  std::ifstream in(path, std::ios::binary);
  in.read(begin.data(), begin.size());
  return in.gcount() == static_cast<std::streamsize>(begin.size()) &&
         std::string_view(begin.data() + 128, 4) == "DICM";
}

/// The DICOM files of a folder by name, `beneath` none; the folders in it.
std::vector<fs::path> dicomFilesOf(const fs::path& folder, std::vector<fs::path>* folders) {
  std::vector<fs::path> files;
  std::error_code error;
  fs::directory_iterator entry(folder, error);
  if (error) {
    throw VolumeError(folder.string(), "it cannot be read", "check its permissions");
  }
  for (; entry != fs::directory_iterator(); entry.increment(error)) {
    std::error_code ignored;
    if (entry->is_directory(ignored)) {
      if (folders != nullptr) folders->push_back(entry->path());
    } else if (entry->is_regular_file(ignored) && isDicom(entry->path())) {
      files.push_back(entry->path());
    }
    if (error) break;
  }
  std::sort(files.begin(), files.end());
  return files;
}

/// Text of a header, fit for a line.
std::string textOf(const vtkDICOMValue& value) {
  std::string text = value.AsUTF8String();
  std::erase_if(text, [](char c) { return static_cast<unsigned char>(c) < ' ' || c == '\x7f'; });
  return text;
}

/// NaN if the value is missing.
double numberOf(const vtkDICOMValue& value) {
  return value.GetNumberOfValues() == 0 ? kUnsaid : value.GetDouble(0);
}

/// HHMMSS.FFFFFF as seconds.
double secondsOf(const std::string& clock) {
  if (clock.size() < 6) return kUnsaid;
  try {
    return 3600.0 * std::stoi(clock.substr(0, 2)) + 60.0 * std::stoi(clock.substr(2, 2)) +
           std::stod(clock.substr(4));
  } catch (const std::exception&) {
    return kUnsaid;
  }
}

/// Fills in where a slice is; leaves `placed` false where the header does not say, or nonsense.
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
  // The first is from row to row, that is along a column.
  slice.down = spacing.GetDouble(0);
  slice.across = spacing.GetDouble(1);
  if (!slice.position.allFinite() || !(std::abs(slice.row.norm() - 1.0) < kSameDirection) ||
      !(std::abs(slice.column.norm() - 1.0) < kSameDirection) ||
      !(std::abs(slice.row.dot(slice.column)) < kSameDirection) || !std::isfinite(slice.down) ||
      !std::isfinite(slice.across) || !(slice.down > 0.0) || !(slice.across > 0.0)) {
    return;
  }
  slice.row.normalize();
  slice.column.normalize();
  slice.placed = true;
}

/// PixelPaddingValue, brought to the range of the stored values where it was written in the other.
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

/// A file of this kind is an image even where it ends before its size is told; one that ends before
/// its kind may be.
bool isImageClass(const std::string& uid) {
  if (uid.empty()) return true;
  static constexpr std::array kClasses = {"2", "2.1", "2.2", "4", "4.1", "4.4", "20", "128", "130"};
  const std::string_view begin = "1.2.840.10008.5.1.4.1.1.";
  return uid.rfind(begin, 0) == 0 &&
         std::find(kClasses.begin(), kClasses.end(), uid.substr(begin.size())) != kClasses.end();
}

/// Still images of any compression, but no films.
bool isReadable(const std::string& syntax) {
  constexpr std::array kPlain = {"",  // what old files leave out
                                 "1.2.840.10008.1.2", "1.2.840.10008.1.2.1", "1.2.840.10008.1.2.2"};
  if (std::find(kPlain.begin(), kPlain.end(), syntax) != kPlain.end()) return true;
  const vtkDICOMImageCodec codec(syntax);
  return codec.GetTransferSyntaxUID() == syntax && codec < vtkDICOMImageCodec::MPEG2ML;
}

constexpr const char* kTooFew = "it has fewer pixels than its header says";

/// The same of packed pixels, whose decoders fill up what is missing: all their parts must be
/// there.
std::string damageOfParts(const fs::path& path, vtkDICOMParser* parser, int frames) {
  std::ifstream in(path, std::ios::binary);
  auto at = static_cast<std::int64_t>(parser->GetFileOffset());
  int parts = -1;  // the first is a table of the others
  while (true) {
    std::array<unsigned char, 8> head{};
    in.seekg(at);
    in.read(reinterpret_cast<char*>(head.data()), head.size());
    // A part, or the end.
    if (!in || head[0] != 0xfe || head[1] != 0xff || head[2] != 0x00 || head[3] != 0xe0) break;
    std::int64_t bytes = 0;
    for (std::size_t i = 0; i < 4; ++i) bytes |= static_cast<std::int64_t>(head[4 + i]) << (8 * i);
    at += 8 + bytes;
    if (at > parser->GetFileSize()) {
      return fmt::format("it is cut short: {} bytes are missing", at - parser->GetFileSize());
    }
    ++parts;
  }
  return parts < frames ? kTooFew : "";
}

/// What is wrong with the file of an image, before any pixel is read; empty if nothing.
std::string damageOf(vtkDICOMParser* parser, vtkDICOMMetaData* meta, int frames) {
  if (!parser->GetPixelDataFound()) return "it ends before its pixels";
  const std::string syntax = textOf(meta->Get(0, DC::TransferSyntaxUID));
  if (!isReadable(syntax)) {
    return fmt::format("its pixels are packed in a way that is not read ({})", syntax);
  }
  const unsigned bytes = parser->GetPixelDataVL();
  if (bytes == kPacked) return damageOfParts(parser->GetFileName(), parser, frames);
  const auto end = parser->GetFileOffset() + static_cast<vtkTypeInt64>(bytes);
  if (end > parser->GetFileSize()) {
    return fmt::format("it is cut short: {} bytes are missing", end - parser->GetFileSize());
  }
  const double needed = 1.0 * meta->Get(0, DC::Rows).AsInt() * meta->Get(0, DC::Columns).AsInt() *
                        meta->Get(0, DC::BitsAllocated).AsInt() *
                        std::max(1, meta->Get(0, DC::SamplesPerPixel).AsInt()) * frames / 8.0;
  if (bytes < needed) {
    // 4:2:2 colours take less; they are refused anyhow.
    if (meta->Get(0, DC::SamplesPerPixel).AsInt() > 1) return "";
    return kTooFew;
  }
  return "";
}

File headerOf(const fs::path& path) {
  vtkNew<vtkDICOMMetaData> meta;
  vtkNew<vtkDICOMParser> parser;
  meta->SetNumberOfInstances(1);
  parser->SetMetaData(meta);
  parser->SetFileName(path.c_str());
  parser->SetIndex(0);
  parser->Update();

  File file;
  file.path = path;
  file.series = textOf(meta->Get(0, DC::SeriesInstanceUID));
  file.series_number = meta->Get(0, DC::SeriesNumber).AsInt();
  file.description = textOf(meta->Get(0, DC::SeriesDescription));
  file.study = textOf(meta->Get(0, DC::StudyDescription));
  file.modality = textOf(meta->Get(0, DC::Modality));
  file.is_image = meta->Get(0, DC::Rows).AsInt() > 0 && meta->Get(0, DC::Columns).AsInt() > 0;
  if (parser->GetErrorCode() != 0) {
    file.damage = "its header is cut short or damaged";
    return file;
  }
  if (!file.is_image) {
    if (isImageClass(meta->Get(0, DC::MediaStorageSOPClassUID).AsString())) {
      file.damage = "its header is cut short or damaged";
    }
    return file;
  }
  const int frames = std::max(1, meta->Get(0, DC::NumberOfFrames).AsInt());
  file.damage = damageOf(parser, meta, frames);
  if (!file.damage.empty()) return file;

  const std::string photometric = meta->Get(0, DC::PhotometricInterpretation).AsString();
  file.is_colour = meta->Get(0, DC::SamplesPerPixel).AsInt() > 1 ||
                   (!photometric.empty() && photometric.rfind("MONOCHROME", 0) != 0);
  file.is_packed = parser->GetPixelDataVL() == kPacked &&
                   meta->Get(0, DC::TransferSyntaxUID).AsString() != "1.2.840.10008.1.2.5";  // RLE
  file.is_lossy = meta->Get(0, DC::LossyImageCompression).AsString() == "01";
  file.has_table = meta->Get(0, DC::ModalityLUTSequence).GetNumberOfValues() > 0;
  file.unit = textOf(meta->Get(0, 0, DC::RescaleType));
  if (file.unit.empty()) file.unit = textOf(meta->Get(0, DC::Units));
  file.thickness = meta->Get(0, 0, DC::SliceThickness).AsDouble();
  file.time_step = 1e-3 * meta->Get(0, 0, DC::TemporalResolution).AsDouble();
  for (int frame = 0; frame < frames; ++frame) file.slices.push_back(sliceOf(meta, frame));
  return file;
}

/// Images that say that they belong together.
struct Series {
  std::string uid;
  std::vector<const File*> files;
  std::size_t images = 0;
};

std::string nameOf(std::size_t number, const Series& series) {
  const File& first = *series.files.front();
  return fmt::format("{}: \"{}\" {} {}", number, first.description, first.modality,
                     series.images == 1 ? "1 image" : fmt::format("{} images", series.images));
}

/// By series number, then identity.
std::vector<Series> seriesOf(const std::vector<File>& files) {
  std::vector<Series> all;
  for (const File& file : files) {
    if (!file.is_image) continue;
    auto at =
        std::find_if(all.begin(), all.end(), [&](const Series& s) { return s.uid == file.series; });
    if (at == all.end()) at = all.insert(all.end(), Series{file.series, {}, 0});
    at->files.push_back(&file);
    at->images += std::max<std::size_t>(1, file.slices.size());
  }
  std::sort(all.begin(), all.end(), [](const Series& a, const Series& b) {
    const int m = a.files.front()->series_number;
    const int n = b.files.front()->series_number;
    return std::tie(m, a.uid) < std::tie(n, b.uid);
  });
  return all;
}

/// The one that is asked for: by number, identity or description.
const Series& chosen(const std::vector<Series>& all, const Request& request) {
  std::vector<std::string> names;
  std::vector<const Series*> fits;
  for (const Series& series : all) {
    names.push_back(nameOf(names.size() + 1, series));
    if (request.series.empty() || series.uid == request.series ||
        series.files.front()->description == request.series) {
      fits.push_back(&series);
    }
  }
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (std::to_string(i + 1) == request.series) fits = {&all[i]};
  }
  if (fits.size() == 1) return *fits.front();
  const std::string list = fmt::format("{}", fmt::join(names, "; "));
  const char* remedy = "choose one with --series, by its number, description or identity";
  if (request.series.empty()) {
    throw VolumeError(request.file.string(), fmt::format("it has {} series ({})", all.size(), list),
                      remedy);
  }
  throw VolumeError(
      request.file.string(),
      fmt::format("{} series \"{}\" in it ({})",
                  fits.empty() ? "there is no" : "there is more than one", request.series, list),
      remedy);
}

/// DICOM's patient axes, left and back, turned to right and front.
Vec3 toRas(const Vec3& lps) {
  return {-lps.x(), -lps.y(), lps.z()};
}

/// The images of a series as a volume, or as one for each step.
struct Stack {
  std::vector<Slices> steps;  ///< In the order of their places.
  std::vector<double> times;  ///< [s], or numbers; empty for one step.
  Affine map;
  std::vector<std::string> notes;
};

/// Names a place along the axis that the slices run along most.
class Ruler {
 public:
  explicit Ruler(const Vec3& normal) { normal.cwiseAbs().maxCoeff(&axis_); }
  [[nodiscard]] std::string at(const Slice& slice) const {
    return fmt::format("{} = {:.6g}", "xyz"[axis_], toRas(slice.position)[axis_] + 0.0);
  }
  [[nodiscard]] std::string between(const Slice& a, const Slice& b) const {
    return fmt::format("between {} and {:.6g} mm", at(a), toRas(b.position)[axis_] + 0.0);
  }

 private:
  Eigen::Index axis_ = 2;
};

using Group = Slices;  ///< All at one place.

std::vector<Group> byPlace(std::vector<Slice> slices) {
  std::stable_sort(slices.begin(), slices.end(),
                   [](const Slice& a, const Slice& b) { return a.depth < b.depth; });
  std::vector<Group> groups;
  for (Slice& slice : slices) {
    const double same = kSamePlace * std::min(slice.across, slice.down);
    if (groups.empty() || slice.depth - groups.back().front().depth > same) groups.emplace_back();
    groups.back().push_back(std::move(slice));
  }
  return groups;
}

/// Sorts each group by time. Returns which of kTimeTags tells the times apart, if one does.
std::optional<std::size_t> sortByTime(std::vector<Group>& groups) {
  for (std::size_t tag = 0; tag < kTimeTags.size(); ++tag) {
    const auto earlier = [&](const Slice& a, const Slice& b) {
      return a.times[tag] < b.times[tag];
    };
    const bool all = std::all_of(groups.begin(), groups.end(), [&](Group& group) {
      if (std::any_of(group.begin(), group.end(),
                      [&](const Slice& s) { return std::isnan(s.times[tag]); })) {
        return false;
      }
      std::sort(group.begin(), group.end(), earlier);
      return std::adjacent_find(group.begin(), group.end(), [&](const Slice& a, const Slice& b) {
               return a.times[tag] == b.times[tag];
             }) == group.end();
    });
    if (all) return tag;
  }
  return std::nullopt;
}

class Stacker {
 public:
  Stacker(const Series& series, std::string what) : series_(series), what_(std::move(what)) {}

  Stack stack() {
    std::vector<Slice> slices = alike();
    const Slice& first = slices.front();
    const Vec3 normal = first.row.cross(first.column);
    for (Slice& slice : slices) slice.depth = normal.dot(slice.position);
    const Ruler ruler(normal);
    std::vector<Group> groups = byPlace(std::move(slices));

    Stack out;
    separate(groups, ruler, out);
    out.map = mapOf(groups, normal, ruler, out.notes);
    out.steps.resize(groups.front().size());
    for (Group& group : groups) {
      for (std::size_t i = 0; i < group.size(); ++i) out.steps[i].push_back(std::move(group[i]));
    }
    return out;
  }

 private:
  [[noreturn]] void refuse(const std::string& why, const std::string& remedy) const {
    throw VolumeError(what_, why, remedy);
  }

  /// All images, if they are of one size, orientation and number format.
  std::vector<Slice> alike() const {
    std::vector<Slice> slices;
    std::size_t colour = 0;
    std::size_t rescaled = 0;
    for (std::size_t f = 0; f < series_.files.size(); ++f) {
      if (series_.files[f]->is_colour) ++colour;
      for (Slice slice : series_.files[f]->slices) {
        slice.file = f;
        if (slice.has_rescale) ++rescaled;
        slices.push_back(std::move(slice));
      }
    }
    if (colour > 0) {
      refuse(fmt::format("its images are in colour: {} of {}", colour, series_.files.size()),
             "give the grey images they were made from");
    }
    const auto placed = static_cast<std::size_t>(
        std::count_if(slices.begin(), slices.end(), [](const Slice& s) { return s.placed; }));
    if (placed == 0) {
      refuse("its images do not say where they are in the patient, as copies of a screen do not",
             "give the original series");
    }
    if (placed < slices.size()) {
      refuse(fmt::format("{} of {} images do not say where they are in the patient",
                         slices.size() - placed, slices.size()),
             "remove them from the folder");
    }
    if (rescaled != 0 && rescaled != slices.size()) {
      refuse(fmt::format("only {} of {} images say what their values mean (RescaleSlope)", rescaled,
                         slices.size()),
             "export the series again");
    }
    // The most frequent kind against all others.
    const auto same = [](const Slice& a, const Slice& b) {
      return a.format == b.format && (a.row - b.row).norm() < kSameDirection &&
             (a.column - b.column).norm() < kSameDirection &&
             std::abs(a.across - b.across) < kSameDirection * a.across &&
             std::abs(a.down - b.down) < kSameDirection * a.down;
    };
    using Sort = std::pair<const Slice*, std::size_t>;
    std::vector<Sort> sorts;
    std::size_t most = 0;
    for (const Slice& slice : slices) {
      auto at = std::find_if(sorts.begin(), sorts.end(),
                             [&](const auto& sort) { return same(*sort.first, slice); });
      if (at == sorts.end()) at = sorts.insert(sorts.end(), {&slice, 0});
      most = std::max(most, ++at->second);
    }
    if (most != slices.size()) {
      refuse(fmt::format("{} of {} images differ from the others in size, orientation or kind of "
                         "number, as a localiser does",
                         slices.size() - most, slices.size()),
             "remove them from the folder");
    }
    return slices;
  }

  std::string fileOf(const Slice& slice) const {
    return series_.files[slice.file]->path.filename().string();
  }

  /// Takes several images at each place for steps of time, if they are.
  void separate(std::vector<Group>& groups, const Ruler& ruler, Stack& out) const {
    const auto fewer = [](const Group& a, const Group& b) { return a.size() < b.size(); };
    const auto [fewest, most] = std::minmax_element(groups.begin(), groups.end(), fewer);
    if (most->size() == 1) return;
    const Group& twice = *most;
    const std::size_t count = most->size();
    if (series_.files.size() == 1 && groups.size() == 1) {
      refuse(fmt::format("its {} images are all at one place", count), "give a volume");
    }
    for (const Group& group : groups) {
      for (const Slice& slice : group) {
        const double same = kSamePlace * std::min(slice.across, slice.down);
        if ((slice.position - group.front().position).norm() > 2.0 * same) {
          refuse(fmt::format("two images lie side by side at {} mm", ruler.at(slice)),
                 "remove one of them");
        }
        for (std::size_t i = 0; i < kKindTags.size(); ++i) {
          if (slice.kinds[i] == group.front().kinds[i]) continue;
          refuse(fmt::format("{} images are at each place, which differ in {}", count,
                             kKindTags[i].name),
                 "export each kind as a series of its own");
        }
      }
    }
    const std::optional<std::size_t> tag = sortByTime(groups);
    if (!tag.has_value() || fewest->size() == 1) {
      refuse(fmt::format("{} images are at the same place, {} mm: {} and {}", count,
                         ruler.at(twice.front()), fileOf(twice[0]), fileOf(twice[1])),
             "remove all but one");
    }
    if (fewest->size() != count) {
      refuse(fmt::format("steps of time are missing: {} images are at {} mm, {} at {} mm",
                         fewest->size(), ruler.at(fewest->front()), count, ruler.at(twice.front())),
             "copy or export all of its images");
    }
    // Acquisition times are of the day: only their differences are kept.
    const TimeTag& kind = kTimeTags[*tag];
    const double step = series_.files.front()->time_step;
    const double start = kind.tag == DC::AcquisitionTime || kind.seconds == 0.0
                             ? groups.front().front().times[*tag]
                             : 0.0;
    for (const Slice& slice : groups.front()) {
      const double time = slice.times[*tag] - start;
      out.times.push_back(time * (kind.seconds > 0.0 ? kind.seconds : step > 0.0 ? step : 1.0));
    }
    if (kind.seconds == 0.0 && !(step > 0.0)) {
      out.notes.emplace_back("its steps have numbers but no times: they are taken 1 s apart");
    }
  }

  /// Where the voxels are; refuses slices that are missing or uneven. The step from slice to slice
  /// is that of their positions, not the normal: a tilted gantry shears the volume.
  Affine mapOf(const std::vector<Group>& groups, const Vec3& normal, const Ruler& ruler,
               std::vector<std::string>& notes) const {
    const Slice& first = groups.front().front();
    const Slice& last = groups.back().front();
    const std::size_t count = groups.size();
    Vec3 step = normal;
    if (count > 1) {
      checkGaps(groups, ruler);
      step = (last.position - first.position) / static_cast<double>(count - 1);
      for (std::size_t i = 0; i < count; ++i) {
        const Slice& slice = groups[i].front();
        const Vec3 even = first.position + step * static_cast<double>(i);
        if ((slice.position - even).norm() > kUneven * step.norm()) {
          refuse(fmt::format("its slices are not evenly in line: that at {} mm is {:.3g} mm off",
                             ruler.at(slice), (slice.position - even).norm()),
                 "resample it to even slices");
        }
      }
      const double tilt = std::acos(std::min(1.0, normal.dot(step) / step.norm()));
      const double degrees = tilt * 180.0 / std::acos(-1.0);
      if (degrees > 80.0) {
        refuse(fmt::format("its slices are shifted by {:.0f} degrees along themselves", degrees),
               "export the series again");
      }
      if (degrees > 0.1) {
        notes.push_back(
            fmt::format("its slices are shifted along themselves by {:.1f} degrees, as "
                        "a tilted gantry does: so is the volume",
                        degrees));
      }
    } else if (series_.files.front()->thickness > 0.0) {
      step *= series_.files.front()->thickness;
    }
    Affine map;
    map.linear.col(0) = toRas(first.row * first.across);
    map.linear.col(1) = toRas(first.column * first.down);
    map.linear.col(2) = toRas(step);
    map.origin = toRas(first.position);
    return map;
  }

  void checkGaps(const std::vector<Group>& groups, const Ruler& ruler) const {
    std::vector<double> gaps;
    for (std::size_t i = 1; i < groups.size(); ++i) {
      gaps.push_back(groups[i].front().depth - groups[i - 1].front().depth);
    }
    // Of few slices the smaller gap: the others are due to missing slices.
    std::vector<double> sorted = gaps;
    const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>((sorted.size() - 1) / 2);
    std::nth_element(sorted.begin(), middle, sorted.end());
    const double common = *middle;
    std::size_t missing = 0;
    std::optional<std::size_t> where;
    for (std::size_t i = 0; i < gaps.size(); ++i) {
      const double times = std::round(gaps[i] / common);
      if (std::abs(gaps[i] / common - std::max(times, 1.0)) > kUneven) {
        refuse(
            fmt::format("its slices are uneven: {:.4g} mm apart {}, {:.4g} mm elsewhere", gaps[i],
                        ruler.between(groups[i].front(), groups[i + 1].front()), common),
            "resample it to even slices, or copy all of it");
      }
      if (times < 2.0) continue;
      if (!where.has_value()) where = i;
      missing += static_cast<std::size_t>(times) - 1;
    }
    if (!where.has_value()) return;
    refuse(fmt::format("slices are missing {}: {} of {}{}",
                       ruler.between(groups[*where].front(), groups[*where + 1].front()), missing,
                       groups.size() + missing, missing > 1 ? " in all" : ""),
           "copy or export all of its images");
  }

  const Series& series_;
  std::string what_;
};

/// Tells vtkDICOMReader which frames of a file to read, in which order.
class Order final : public vtkDICOMSliceSorter {
 public:
  explicit Order(std::vector<int> frames) : frames_(std::move(frames)) { InitializeObjectBase(); }

 protected:
  void SortFiles(vtkIntArray* files, vtkIntArray* frames) override {
    for (vtkIntArray* array : {files, frames}) {
      array->Initialize();
      array->SetNumberOfComponents(1);
    }
    for (const int frame : frames_) {
      files->InsertNextValue(0);
      frames->InsertNextValue(frame);
    }
  }

 private:
  std::vector<int> frames_;
};

/// Where stored values are padding; null if nowhere.
vtkSmartPointer<vtkUnsignedCharArray> hiddenOf(vtkDataArray* stored,
                                               const std::vector<Slice>& slices) {
  const bool any = std::any_of(slices.begin(), slices.end(),
                               [](const Slice& s) { return !std::isnan(s.padding[0]); });
  if (!any) return nullptr;
  auto hidden = vtkSmartPointer<vtkUnsignedCharArray>::New();
  hidden->SetName(vtkDataSetAttributes::GhostArrayName());
  hidden->SetNumberOfValues(stored->GetNumberOfTuples());
  const auto plane = static_cast<std::size_t>(stored->GetNumberOfTuples()) / slices.size();
  const auto mark = [&](const auto* values) {
    bool found = false;
    unsigned char* out = hidden->GetPointer(0);
    for (const Slice& slice : slices) {
      const auto [low, high] = slice.padding;
      for (std::size_t i = 0; i < plane; ++i, ++values, ++out) {
        const auto value = static_cast<double>(*values);
        const bool here = value >= low && value <= high;
        *out = here ? vtkDataSetAttributes::HIDDENPOINT : 0;
        found = found || here;
      }
    }
    return found;
  };
  bool found = false;
  switch (stored->GetDataType()) {
    vtkTemplateMacro(found = mark(static_cast<const VTK_TT*>(stored->GetVoidPointer(0))));
    default:
      break;
  }
  return found ? hidden : nullptr;
}

/// slope * stored + intercept, slice by slice: 16 bits where that is exact, else floats. Not
/// vtkDICOMReader's own: it reckons with all values that the bits could hold, and so clips or
/// doubles the memory of what most scanners write.
vtkSmartPointer<vtkDataArray> slicesRescaled(vtkDataArray* stored, const std::vector<Slice>& slices,
                                             const vtkUnsignedCharArray* padding) {
  const bool plain = std::all_of(slices.begin(), slices.end(), [](const Slice& s) {
    return s.slope == 1.0 && s.intercept == 0.0;
  });
  if (plain) return stored;
  const bool whole = std::all_of(slices.begin(), slices.end(), [](const Slice& s) {
    return s.slope == std::floor(s.slope) && s.intercept == std::floor(s.intercept);
  });
  const bool is_whole =
      whole && stored->GetDataType() != VTK_FLOAT && stored->GetDataType() != VTK_DOUBLE;
  const auto plane = static_cast<std::size_t>(stored->GetNumberOfTuples()) / slices.size();
  const unsigned char* hidden =
      padding == nullptr ? nullptr : const_cast<vtkUnsignedCharArray*>(padding)->GetPointer(0);
  constexpr double kLowest = std::numeric_limits<short>::min();
  constexpr double kHighest = std::numeric_limits<short>::max();

  const auto fits = [&](const auto* values) {
    std::size_t at = 0;
    for (const Slice& slice : slices) {
      for (std::size_t i = 0; i < plane; ++i, ++at) {
        const double value = slice.slope * static_cast<double>(values[at]) + slice.intercept;
        if (hidden != nullptr && hidden[at] != 0) continue;
        if (value < kLowest || value > kHighest) return false;
      }
    }
    return true;
  };
  const auto fill = [&](const auto* values, auto* out) {
    using Out = std::remove_pointer_t<decltype(out)>;
    std::size_t at = 0;
    for (const Slice& slice : slices) {
      for (std::size_t i = 0; i < plane; ++i, ++at) {
        const double value = slice.slope * static_cast<double>(values[at]) + slice.intercept;
        if constexpr (std::is_same_v<Out, short>) {
          out[at] = static_cast<short>(std::clamp(value, kLowest, kHighest));
        } else {
          out[at] = static_cast<Out>(value);
        }
      }
    }
  };

  vtkSmartPointer<vtkDataArray> out;
  const auto make = [&](const auto* values) {
    if (is_whole && fits(values)) {
      auto shorts = vtkSmartPointer<vtkShortArray>(vtkShortArray::SafeDownCast(stored));
      if (shorts == nullptr) {
        shorts = vtkSmartPointer<vtkShortArray>::New();
        shorts->SetNumberOfValues(stored->GetNumberOfTuples());
      }
      fill(values, shorts->GetPointer(0));
      out = shorts;
      return;
    }
    auto floats = vtkSmartPointer<vtkFloatArray>::New();
    floats->SetNumberOfValues(stored->GetNumberOfTuples());
    fill(values, floats->GetPointer(0));
    out = floats;
  };
  switch (stored->GetDataType()) {
    vtkTemplateMacro(make(static_cast<const VTK_TT*>(stored->GetVoidPointer(0))));
    default:
      break;
  }
  return out;
}

/// GDCM, which unpacks for vtk-dicom, throws away that a picture is damaged, but its JPEG library
/// prints so: what goes to standard error while this lives is kept, and its own chat dropped.
class Overheard {
 public:
  Overheard() : chat_(std::cerr.rdbuf(nullptr)), file_(std::tmpfile()) {
    std::fflush(stderr);
    if (file_ == nullptr) return;
    kept_ = ::dup(STDERR_FILENO);
    if (kept_ >= 0) ::dup2(::fileno(file_), STDERR_FILENO);
  }
  Overheard(const Overheard&) = delete;
  Overheard& operator=(const Overheard&) = delete;
  ~Overheard() {
    std::fflush(stderr);
    if (kept_ >= 0) {
      ::dup2(kept_, STDERR_FILENO);
      ::close(kept_);
    }
    if (file_ != nullptr) std::fclose(file_);
    std::cerr.rdbuf(chat_);  // clears the errors of having had none
  }

  /// Its first line that tells of damage. Bytes too many are harmless.
  [[nodiscard]] std::string damage() const {
    std::fflush(stderr);
    if (file_ == nullptr) return "";
    std::rewind(file_);
    std::array<char, 200> line{};
    while (std::fgets(line.data(), line.size(), file_) != nullptr) {
      std::string text = line.data();
      while (!text.empty() && (text.back() == '\n' || text.back() == '.')) text.pop_back();
      if (!text.empty() && text.find("extraneous bytes") == std::string::npos) return text;
    }
    return "";
  }

 private:
  std::streambuf* chat_;
  std::FILE* file_;
  int kept_ = -1;
};

class DicomReader final : public Reader {
 public:
  DicomReader(Request request, const Series& series)
      : request_(std::move(request)),
        stack_(Stacker(series, request_.file.string()).stack()),
        head_(*series.files.front()) {
    for (const File* file : series.files) {
      paths_.push_back(file->path);
      is_packed_.push_back(file->is_packed);
    }
    const bool table = std::any_of(series.files.begin(), series.files.end(),
                                   [](const File* f) { return f->has_table; });
    if (table) stack_.notes.emplace_back("its table of values (Modality LUT) is not applied");
    if (std::any_of(series.files.begin(), series.files.end(),
                    [](const File* f) { return f->is_lossy; })) {
      stack_.notes.emplace_back("its images were compressed with loss");
    }
    if (head_.modality == "CT" && !table && !stack_.steps.front().front().has_rescale) {
      stack_.notes.emplace_back("it has no RescaleSlope: its values are taken as they are");
    }
    head_.slices.clear();
  }

  std::vector<double> times() const override { return stack_.times; }

  Content read(std::size_t step) override {
    const std::vector<Slice>& slices = stack_.steps.at(step);
    const std::array<int, 3> size = {slices.front().format[1], slices.front().format[0],
                                     static_cast<int>(slices.size())};
    const vtkSmartPointer<vtkDataArray> stored = valuesOf(slices);

    // A new image: the reader's has the whole header with it, with the patient's name.
    Content content;
    const auto image = vtkSmartPointer<vtkImageData>::New();
    image->SetDimensions(size.data());
    const auto hidden = hiddenOf(stored, slices);
    if (hidden != nullptr) image->GetPointData()->AddArray(hidden);
    const auto values = slicesRescaled(stored, slices, hidden);
    values->SetName("density");
    image->GetPointData()->SetScalars(values);
    content.data = image;
    content.file_from_index = stack_.map;
    content.length_unit = "mm";
    content.notes = stack_.notes;
    describe(content);
    return content;
  }

 private:
  /// File by file: damage has its name, and one file's oddities do not meet another's.
  vtkSmartPointer<vtkDataArray> valuesOf(const std::vector<Slice>& slices) const {
    using Places = std::vector<std::size_t>;
    std::map<std::size_t, Places> of_file;
    for (std::size_t k = 0; k < slices.size(); ++k) of_file[slices[k].file].push_back(k);
    const auto plane = static_cast<vtkIdType>(slices.front().format[0]) * slices.front().format[1];
    vtkSmartPointer<vtkDataArray> out;
    std::size_t done = 0;
    for (const auto& [file, places] : of_file) {
      std::vector<int> frames;
      for (const std::size_t k : places) frames.push_back(slices[k].frame);
      vtkSmartPointer<vtkDataArray> values = framesOf(file, frames);
      const auto count = static_cast<vtkIdType>(frames.size());
      if (values == nullptr || values->GetNumberOfComponents() != 1 ||
          values->GetNumberOfTuples() != plane * count ||
          (out != nullptr && values->GetDataType() != out->GetDataType())) {
        throw VolumeError(paths_[file].string(), "its pixels do not fit the others'", kAgain);
      }
      if (of_file.size() == 1) return values;
      if (out == nullptr) {
        out.TakeReference(vtkDataArray::CreateDataArray(values->GetDataType()));
        out->SetNumberOfValues(plane * static_cast<vtkIdType>(slices.size()));
      }
      const auto bytes = static_cast<std::size_t>(plane * values->GetDataTypeSize());
      for (std::size_t i = 0; i < places.size(); ++i) {
        std::memcpy(out->GetVoidPointer(static_cast<vtkIdType>(places[i]) * plane),
                    values->GetVoidPointer(static_cast<vtkIdType>(i) * plane), bytes);
      }
      if (request_.progress) {
        request_.progress(static_cast<double>(++done) / static_cast<double>(of_file.size()));
      }
    }
    return out;
  }

  vtkSmartPointer<vtkDataArray> framesOf(std::size_t file, const std::vector<int>& frames) const {
    const auto sorter = vtkSmartPointer<Order>::Take(new Order(frames));
    vtkNew<vtkDICOMReader> reader;
    reader->SetFileName(paths_[file].c_str());
    reader->SetSorter(sorter);
    reader->SetMemoryRowOrderToFileNative();
    reader->AutoRescaleOff();
    if (is_packed_[file]) {
      const Overheard overheard;
      run(reader, paths_[file].string(), nullptr, kAgain);
      const std::string damage = overheard.damage();
      if (!damage.empty()) {
        throw VolumeError(paths_[file].string(), fmt::format("its pixels are damaged ({})", damage),
                          kAgain);
      }
    } else {
      run(reader, paths_[file].string(), nullptr, kAgain);
    }
    return reader->GetOutput()->GetPointData()->GetScalars();
  }

  /// What the scan is, and never who was scanned: no name, number, birth date, day, place or
  /// physician, nor an identity that leads to them, may get into what is written.
  void describe(Content& content) const {
    content.description = head_.description;
    if (!head_.study.empty() && head_.study != head_.description) {
      content.description += (content.description.empty() ? "" : ", ") + head_.study;
    }
    if (head_.modality == "CT") {
      content.modality = Modality::kCt;
      content.value_unit["density"] = "HU";
    } else if (head_.modality == "MR") {
      content.modality = Modality::kMr;
    }
    // US: unspecified.
    if (!head_.unit.empty() && head_.unit != "US") content.value_unit["density"] = head_.unit;
  }

  Request request_;
  Stack stack_;
  File head_;
  std::vector<fs::path> paths_;
  std::vector<bool> is_packed_;
};

/// For a folder without DICOM files: whether they are one level down.
[[noreturn]] void refuseFolder(const fs::path& folder, const std::vector<fs::path>& folders) {
  std::vector<fs::path> with;
  for (const fs::path& inner : folders) {
    std::error_code error;
    for (fs::directory_iterator entry(inner, error), end; !error && entry != end;
         entry.increment(error)) {
      std::error_code ignored;
      if (!entry->is_regular_file(ignored) || !isDicom(entry->path())) continue;
      with.push_back(inner);
      break;
    }
  }
  if (with.size() == 1) {
    throw VolumeError(folder.string(),
                      fmt::format("no DICOM file is in it, but in its folder \"{}\"",
                                  with.front().filename().string()),
                      "give that folder");
  }
  if (!with.empty()) {
    throw VolumeError(folder.string(),
                      fmt::format("no DICOM file is in it, but in {} of its folders", with.size()),
                      "give one of them");
  }
  throw VolumeError(folder.string(), "there is no DICOM file in it", "give a folder of slices");
}

}  // namespace

std::unique_ptr<Reader> openDicom(const Request& request) {
  std::error_code error;
  const bool is_folder = fs::is_directory(request.file, error);
  if (!is_folder && !isDicom(request.file)) {
    throw VolumeError(request.file.string(), "it is DICOM, but packed", "unpack it");
  }
  // A single file stands for its series, unless another is asked for.
  Request wanted = request;
  if (!is_folder && wanted.series.empty()) {
    const File file = headerOf(request.file);
    if (!file.damage.empty()) {
      throw VolumeError(request.file.string(), file.damage, kAgain);
    }
    if (!file.is_image) {
      throw VolumeError(request.file.string(), "there is no image in it", "give an image's file");
    }
    wanted.series = file.series;
  }

  const fs::path folder = is_folder                        ? request.file
                          : request.file.has_parent_path() ? request.file.parent_path()
                                                           : fs::path(".");
  std::vector<fs::path> folders;
  const std::vector<fs::path> paths = dicomFilesOf(folder, &folders);
  if (paths.empty()) refuseFolder(folder, folders);
  std::vector<File> files;
  files.reserve(paths.size());
  for (const fs::path& path : paths) files.push_back(headerOf(path));
  // A damaged file without identity may belong to any series.
  for (const File& file : files) {
    if (file.damage.empty() || (!file.series.empty() && file.is_image)) continue;
    throw VolumeError(file.path.string(), file.damage, kAgain);
  }
  const std::vector<Series> all = seriesOf(files);
  if (all.empty()) {
    throw VolumeError(request.file.string(), "its DICOM files have no images",
                      "give a folder of slices");
  }
  const Series& series = chosen(all, wanted);
  for (const File* file : series.files) {
    if (file->damage.empty()) continue;
    throw VolumeError(file->path.string(), file->damage, kAgain);
  }
  return std::make_unique<DicomReader>(request, series);
}

}  // namespace palpate::importer
