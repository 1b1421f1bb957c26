/// Reads DICOM series. vtk-dicom decodes the pixels.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iostream>
#include <unistd.h>
#include <utility>

#include <fmt/format.h>
#include <vtkDICOMReader.h>
#include <vtkDICOMSliceSorter.h>
#include <vtkImageData.h>
#include <vtkIntArray.h>
#include <vtkNew.h>
#include <vtkPointData.h>
#include <vtkStringArray.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/dicom_bytes.h"
#include "palpate/scenes/apps/import/dicom_phases.h"
#include "palpate/scenes/apps/import/dicom_stack.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/vtk_pieces.h"
#include "palpate/scenes/apps/import/vtk_run.h"

namespace palpate::importer {
namespace {

namespace fs = std::filesystem;

/// Returns a folder's DICOM files, sorted by name. Adds its subfolders to `folders` unless that is
/// null.
std::vector<fs::path> dicomFilesOf(const fs::path& folder, std::vector<fs::path>* folders) {
  std::vector<fs::path> files;
  std::error_code error;
  fs::directory_iterator entry(folder, error);
  for (; !error && entry != fs::directory_iterator(); entry.increment(error)) {
    std::error_code ignored;
    if (entry->is_directory(ignored)) {
      if (folders != nullptr) folders->push_back(entry->path());
    } else if (entry->is_regular_file(ignored) && isDicom(entry->path())) {
      files.push_back(entry->path());
    }
  }
  if (error) {
    throw VolumeError(folder.string(),
                      fmt::format("the folder cannot be read ({})", error.message()),
                      "check the folder and its permissions");
  }
  std::sort(files.begin(), files.end());
  return files;
}

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

/// Returns an array that is not 0 where a stored value is padding; empty if there is no padding.
Values hiddenOf(const Values& stored, const std::vector<Slice>& slices) {
  const bool any = std::any_of(slices.begin(), slices.end(),
                               [](const Slice& s) { return !std::isnan(s.padding[0]); });
  if (!any) return {};
  Values hidden(Type::kUint8, 1, stored.tuples());
  const std::size_t plane = stored.tuples() / slices.size();
  const bool found = visit(stored, [&](const auto* values) {
    bool padded = false;
    auto* out = hidden.as<std::uint8_t>();
    for (const Slice& slice : slices) {
      const auto [low, high] = slice.padding;
      for (std::size_t i = 0; i < plane; ++i, ++values, ++out) {
        const auto value = static_cast<double>(*values);
        const bool here = value >= low && value <= high;
        *out = here ? 1 : 0;
        padded = padded || here;
      }
    }
    return padded;
  });
  return found ? hidden : Values();
}

/// Returns slope * stored + intercept, as 16-bit integers if these are exact, otherwise as floats.
/// If no slice has a scale, returns `stored`. May write into the memory of `stored`. vtkDICOMReader
/// would choose a type that clips values, or doubles the memory. `hidden` is not 0 where a value is
/// padding; may be null.
Values slicesRescaled(const Values& stored, const std::vector<Slice>& slices,
                      const std::uint8_t* hidden) {
  const bool plain = std::all_of(slices.begin(), slices.end(), [](const Slice& s) {
    return s.slope == 1.0 && s.intercept == 0.0;
  });
  if (plain) return stored;
  const bool whole = std::all_of(slices.begin(), slices.end(), [](const Slice& s) {
    return s.slope == std::floor(s.slope) && s.intercept == std::floor(s.intercept);
  });
  const bool is_whole = whole && stored.type() != Type::kFloat32 && stored.type() != Type::kFloat64;
  const std::size_t plane = stored.tuples() / slices.size();
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

  return visit(stored, [&](const auto* values) {
    if (is_whole && fits(values)) {
      Values shorts =
          stored.type() == Type::kInt16 ? stored : Values(Type::kInt16, 1, stored.tuples());
      fill(values, shorts.as<std::int16_t>());
      return shorts;
    }
    Values floats(Type::kFloat32, 1, stored.tuples());
    fill(values, floats.as<float>());
    // A small slope loses digits, and a large one may exceed the range of a float.
    const auto [least, most] = std::minmax_element(
        slices.begin(), slices.end(),
        [](const Slice& a, const Slice& b) { return std::abs(a.slope) < std::abs(b.slope); });
    floats.setLost(floatLoss(stored, least->slope, least->intercept));
    floats.setLost(floatLoss(stored, most->slope, most->intercept));
    return floats;
  });
}

/// Captures standard error, to find messages about damage. GDCM, which decodes pixels, returns no
/// error for a damaged image, but its JPEG library prints a message.
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
    std::cerr.rdbuf(chat_);  // also clears error flags that writes without a buffer have set
  }

  /// Returns the first line, or "" if there is none. Skips messages about extraneous bytes, which
  /// are not damage.
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
  DicomReader(Request request, const Series& series, const std::vector<std::string>& notes)
      : request_(std::move(request)),
        stack_(stackOf(series, request_.file.string())),
        head_(*series.files.front()) {
    stack_.notes.insert(stack_.notes.begin(), notes.begin(), notes.end());
    for (const File* file : series.files) {
      paths_.push_back(file->path);
      descriptions_.push_back(file->description);
      is_packed_.push_back(file->is_packed);
      bits_at_.push_back(file->bits_at);
    }
    const bool table = std::any_of(series.files.begin(), series.files.end(),
                                   [](const File* f) { return f->has_table; });
    if (table) stack_.notes.emplace_back("the table of values (Modality LUT) is not applied");
    if (std::any_of(series.files.begin(), series.files.end(),
                    [](const File* f) { return f->is_lossy; })) {
      stack_.notes.emplace_back("some or all images were compressed with loss");
    }
    if (head_.modality == "CT" && !table && !stack_.steps.front().front().has_rescale) {
      stack_.notes.emplace_back(
          "RescaleSlope or RescaleIntercept is missing: the stored values are used unchanged");
    }
    head_.slices.clear();
  }

  std::vector<double> times() const override { return stack_.times; }
  std::optional<double> timeUnit() const override { return 1.0; }

  Content read(std::size_t step) override {
    const std::vector<Slice>& slices = stack_.steps.at(step);
    const std::array<int, 3> size = {slices.front().format[1], slices.front().format[0],
                                     static_cast<int>(slices.size())};
    const Values stored = storedOf(slices);

    Content content;
    Piece image;
    image.size = size;
    image.file_from_index = stack_.map;
    image.depths = stack_.depths;
    image.hidden = hiddenOf(stored, slices);
    image.arrays.push_back({"density",
                            slicesRescaled(stored, slices, image.hidden.as<std::uint8_t>()), "", "",
                            false});
    content.pieces.push_back(std::move(image));
    content.length_unit = "mm";
    content.patient = true;
    content.notes = stack_.notes;
    describe(content, descriptions_[slices.front().file]);
    return content;
  }

 private:
  /// Reads one file at a time, so that errors name the file. Throws VolumeError if files differ in
  /// number or type of the pixels.
  Values storedOf(const std::vector<Slice>& slices) const {
    using Places = std::vector<std::size_t>;
    std::map<std::size_t, Places> of_file;
    for (std::size_t k = 0; k < slices.size(); ++k) of_file[slices[k].file].push_back(k);
    const std::size_t plane = static_cast<std::size_t>(slices.front().format[0]) *
                              static_cast<std::size_t>(slices.front().format[1]);
    Values out;
    std::size_t done = 0;
    for (const auto& [file, places] : of_file) {
      std::vector<int> frames;
      for (const std::size_t k : places) frames.push_back(slices[k].frame);
      Values values = bits_at_[file] > 0 ? bitsOf(file, frames, plane) : framesOf(file, frames);
      if (values.none() || values.components() != 1 || values.tuples() != plane * frames.size() ||
          (!out.none() && values.type() != out.type())) {
        throw VolumeError(paths_[file].string(),
                          "the pixels do not match the header or the other files in number or type",
                          kCopyDicomAgain);
      }
      if (of_file.size() == 1) return values;
      if (out.none()) out = Values(values.type(), 1, plane * slices.size());
      const std::size_t bytes = plane * values.bytesEach();
      for (std::size_t i = 0; i < places.size(); ++i) {
        std::memcpy(out.as<char>() + places[i] * bytes, values.as<char>() + i * bytes, bytes);
      }
      if (request_.progress) {
        request_.progress(static_cast<double>(++done) / static_cast<double>(of_file.size()));
      }
    }
    return out;
  }

  Values framesOf(std::size_t file, const std::vector<int>& frames) const {
    const auto sorter = vtkSmartPointer<Order>::Take(new Order(frames));
    const PlainDicom plain(paths_[file]);
    vtkNew<vtkDICOMReader> reader;
    reader->SetFileName(plain.path().c_str());
    reader->SetSorter(sorter);
    reader->SetMemoryRowOrderToFileNative();
    reader->AutoRescaleOff();
    if (is_packed_[file]) {
      const Overheard overheard;
      run(reader, paths_[file].string(), nullptr, kCopyDicomAgain);
      const std::string damage = overheard.damage();
      if (!damage.empty()) {
        throw VolumeError(paths_[file].string(), fmt::format("the pixels are damaged ({})", damage),
                          kCopyDicomAgain);
      }
    } else {
      run(reader, paths_[file].string(), nullptr, kCopyDicomAgain);
    }
    // Takes only the values from vtkDICOMReader's output, which also has the patient's name.
    vtkDataArray* values = reader->GetOutput()->GetPointData()->GetScalars();
    return values == nullptr ? Values() : valuesOf(values);
  }

  /// Returns frames of one bit per pixel with RLE compression, which vtk-dicom would read as bytes.
  Values bitsOf(std::size_t file, const std::vector<int>& frames, std::size_t plane) const {
    std::ifstream in(paths_[file], std::ios::binary);
    in.seekg(bits_at_[file]);
    // The first item is a table of offsets; each other item has one frame.
    std::vector<std::string> items;
    std::array<unsigned char, 8> head{};
    while (in.read(reinterpret_cast<char*>(head.data()), head.size()) && head[0] == 0xfe &&
           head[1] == 0xff && head[2] == 0x00 && head[3] == 0xe0) {
      const std::size_t bytes = head[4] | static_cast<std::size_t>(head[5]) << 8U |
                                static_cast<std::size_t>(head[6]) << 16U |
                                static_cast<std::size_t>(head[7]) << 24U;
      items.emplace_back(bytes, '\0');  // headerOf has checked this size
      in.read(items.back().data(), static_cast<std::streamsize>(bytes));
    }
    Values values(Type::kUint8, 1, plane * frames.size());
    for (std::size_t i = 0; i < frames.size(); ++i) {
      const auto item = static_cast<std::size_t>(frames[i]) + 1;
      if (item >= items.size() ||
          !decodeBits(items[item], plane, values.as<unsigned char>() + i * plane)) {
        throw VolumeError(paths_[file].string(),
                          fmt::format("the pixels of frame {} are damaged (RLE)", frames[i] + 1),
                          kCopyDicomAgain);
      }
    }
    return values;
  }

  /// Sets the description, the modality and the unit. Omits names, numbers, dates, places and
  /// physicians, which could identify the patient.
  void describe(Content& content, const std::string& series) const {
    content.description = series;
    if (!head_.study.empty() && head_.study != series) {
      content.description += (content.description.empty() ? "" : ", ") + head_.study;
    }
    if (head_.modality == "CT") {
      content.modality = Modality::kCt;
      content.value_unit["density"] = "HU";
    } else if (head_.modality == "MR") {
      content.modality = Modality::kMr;
    }
    if (!head_.unit.empty() && head_.unit != "US") content.value_unit["density"] = head_.unit;
  }

  Request request_;
  Stack stack_;
  File head_;
  std::vector<fs::path> paths_;
  std::vector<std::string> descriptions_;  ///< SeriesDescription of each file.
  std::vector<bool> is_packed_;
  std::vector<std::int64_t> bits_at_;
};

/// Returns the DICOM files in the given folders and in two levels of folders below them. Skips
/// links to folders.
std::vector<fs::path> filesBelow(std::vector<fs::path> folders) {
  constexpr int kDeepest = 3;  // patient, study, series
  std::vector<fs::path> files;
  for (int depth = 0; depth < kDeepest && !folders.empty(); ++depth) {
    std::vector<fs::path> inner;
    for (const fs::path& folder : folders) {
      std::error_code error;
      if (fs::is_symlink(folder, error)) continue;  // a link may lead to a parent folder
      const std::vector<fs::path> more = dicomFilesOf(folder, &inner);
      files.insert(files.end(), more.begin(), more.end());
    }
    folders = std::move(inner);
  }
  return files;
}

}  // namespace

std::unique_ptr<Reader> openDicom(const Request& request) {
  std::error_code error;
  const bool is_folder = fs::is_directory(request.file, error);
  if (!is_folder && !isDicom(request.file)) {
    throw VolumeError(request.file.string(), "the DICOM file is compressed as a whole",
                      "unpack it, for example with gunzip");
  }
  // If the input is a file, imports the file's series, unless --series names another series.
  Request wanted = request;
  if (!is_folder && wanted.series.empty()) {
    const File file = headerOf(request.file);
    if (!file.damage.empty()) {
      throw VolumeError(request.file.string(), file.damage, file.remedy);
    }
    if (!file.is_image) {
      throw VolumeError(request.file.string(), "the file has no image",
                        "give a file with an image");
    }
    wanted.series = file.series;
  }

  const fs::path folder = is_folder                        ? request.file
                          : request.file.has_parent_path() ? request.file.parent_path()
                                                           : fs::path(".");
  std::vector<fs::path> folders;
  std::vector<fs::path> paths = dicomFilesOf(folder, &folders);
  if (paths.empty()) paths = filesBelow(folders);
  if (paths.empty()) {
    throw VolumeError(folder.string(),
                      "the folder has no DICOM file, nor have the three levels of folders below it",
                      "give one file, a folder of DICOM, TIFF or PNG slices, a Zarr folder or an "
                      "OpenFOAM case");
  }
  std::vector<File> files;
  files.reserve(paths.size());
  for (const fs::path& path : paths) files.push_back(headerOf(path));
  // A damaged file without a series UID or without an image size may belong to the requested
  // series, so its error is thrown.
  for (const File& file : files) {
    if (file.damage.empty() || (!file.series.empty() && file.is_image)) continue;
    throw VolumeError(file.path.string(), file.damage, file.remedy);
  }
  std::vector<Series> all = seriesOf(files);
  if (all.empty()) {
    throw VolumeError(request.file.string(), "the DICOM files have no images",
                      "give a folder of DICOM slices");
  }
  std::vector<std::string> notes;
  Phases phases;
  if (request.timed && wanted.series.empty() && all.size() > 1) phases = phasesOf(all);
  if (!phases.files.empty()) {
    all = seriesOf(phases.files);
    notes = phases.notes;
  }
  const Series series = withoutStrays(chosen(all, wanted, notes), notes);
  for (const File* file : series.files) {
    if (file->damage.empty()) continue;
    throw VolumeError(file->path.string(), file->damage, file->remedy);
  }
  return std::make_unique<DicomReader>(request, series, notes);
}

}  // namespace palpate::importer
