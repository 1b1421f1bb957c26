/// Reads MetaImage (.mha, .mhd) without VTK: VTK 9.1 ignores the image's position, reads missing
/// files as zeros, and crashes on damaged headers.
#include <algorithm>
#include <bit>
#include <cctype>
#include <charconv>
#include <cmath>
#include <fstream>
#include <limits>
#include <map>
#include <new>
#include <sstream>
#include <system_error>
#include <type_traits>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/header_checks.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/unpacked.h"

namespace palpate::importer {
namespace {

namespace fs = std::filesystem;

constexpr const char* kCorrectHeader = "correct the header";
/// Largest number of time steps, and of data files that a pattern names.
constexpr double kMostParts = 100000.0;

std::string trimmed(const std::string& text) {
  const auto first = text.find_first_not_of(" \t\r");
  if (first == std::string::npos) return "";
  return text.substr(first, text.find_last_not_of(" \t\r") - first + 1);
}

struct Part {
  fs::path file;
  std::uintmax_t offset = 0;
};

class Header {
 public:
  explicit Header(const Request& request) : file_(request.file), follow_(request.follow) {
    constexpr std::size_t kLongest = 1U << 20U;
    std::ifstream in(file_, std::ios::binary);
    std::string line;
    std::size_t length = 0;
    for (int number = 1; std::getline(in, line); ++number) {
      length += line.size();
      if (length > kLongest) refuse("the header is longer than 1 MiB", kCorrectHeader);
      const auto equals = line.find('=');
      if (equals == std::string::npos && !trimmed(line).empty()) {
        refuse(fmt::format("line {} of the header has no \"=\"", number), kCorrectHeader);
      }
      if (equals == std::string::npos) continue;
      const std::string key = trimmed(line.substr(0, equals));
      fields_[key] = trimmed(line.substr(equals + 1));
      if (key != "ElementDataFile") continue;
      offset_ = static_cast<std::uintmax_t>(in.tellg());
      while (fields_[key].rfind("LIST", 0) == 0 && std::getline(in, line)) {
        if (!trimmed(line).empty()) list_.push_back(trimmed(line));
      }
      break;
    }
    check();
  }

  [[noreturn]] void refuse(const std::string& why, const std::string& remedy) const {
    throw VolumeError(file_.string(), why, remedy);
  }

  [[nodiscard]] std::string text(std::initializer_list<const char*> keys) const {
    for (const char* key : keys) {
      const auto at = fields_.find(key);
      if (at != fields_.end()) return at->second;
    }
    return "";
  }

  /// Returns a field's numbers; empty if the field is absent. Throws VolumeError unless it has
  /// `count` finite numbers.
  [[nodiscard]] std::vector<double> numbers(std::initializer_list<const char*> keys,
                                            std::size_t count) const {
    std::istringstream words(text(keys));
    std::vector<double> out;
    bool all = true;
    for (std::string word; words >> word;) {
      const char* end = word.data() + word.size();
      const char* begin = word.data() + (word[0] == '+' ? 1 : 0);
      const auto parsed = std::from_chars(begin, end, out.emplace_back());
      all = all && parsed.ec == std::errc() && parsed.ptr == end && std::isfinite(out.back());
    }
    if (!all || (!out.empty() && out.size() != count)) {
      refuse(count == 1 ? fmt::format("the field {} is not a number", *keys.begin())
                        : fmt::format("the field {} is not {} numbers", *keys.begin(), count),
             kCorrectHeader);
    }
    return out;
  }

  [[nodiscard]] bool isTrue(std::initializer_list<const char*> keys) const {
    const std::string value = text(keys);
    return !value.empty() && (value[0] == 'T' || value[0] == 't' || value[0] == '1');
  }

  struct Stored {
    double bytes;
    Type type;
  };

  [[nodiscard]] Stored type() const {
    static const std::map<std::string, Stored> types = {
        {"MET_CHAR", {1, Type::kInt8}},       {"MET_UCHAR", {1, Type::kUint8}},
        {"MET_SHORT", {2, Type::kInt16}},     {"MET_USHORT", {2, Type::kUint16}},
        {"MET_INT", {4, Type::kInt32}},       {"MET_UINT", {4, Type::kUint32}},
        {"MET_LONG", {4, Type::kInt32}},      {"MET_ULONG", {4, Type::kUint32}},
        {"MET_LONG_LONG", {8, Type::kInt64}}, {"MET_ULONG_LONG", {8, Type::kUint64}},
        {"MET_FLOAT", {4, Type::kFloat32}},   {"MET_DOUBLE", {8, Type::kFloat64}}};
    const std::string name = text({"ElementType"});
    const auto at = types.find(name);
    if (at == types.end()) {
      refuse(name.empty() ? "the header has no ElementType"
                          : fmt::format("the ElementType \"{}\" is unknown", name),
             "export the image as MET_SHORT or MET_FLOAT");
    }
    return at->second;
  }

  /// Returns the number of axes: 3, or 4 if the last axis is time.
  [[nodiscard]] std::size_t dimensions() const { return dimensions_; }
  [[nodiscard]] std::vector<double> sizes() const { return numbers({"DimSize"}, dimensions_); }
  [[nodiscard]] std::vector<double> spacing() const {
    return numbers({"ElementSpacing", "ElementSize"}, dimensions_);
  }
  [[nodiscard]] std::vector<double> origin() const {
    return numbers({"Offset", "Position", "Origin"}, dimensions_);
  }
  /// Returns the directions of the axes: a row for each axis.
  [[nodiscard]] std::vector<double> matrix() const {
    return numbers({"TransformMatrix", "Rotation", "Orientation"}, dimensions_ * dimensions_);
  }
  [[nodiscard]] std::size_t steps() const {
    return dimensions_ == 4 ? static_cast<std::size_t>(sizes()[3]) : 1;
  }

  [[nodiscard]] int channels() const {
    const auto count = numbers({"ElementNumberOfChannels"}, 1);
    return count.empty() ? 1 : static_cast<int>(count[0]);
  }

  /// Returns true if single slices can be read: the data are neither text nor compressed.
  [[nodiscard]] bool isSeekable() const { return !isText() && !isTrue({"CompressedData"}); }

  /// Reads slices of a step. Unless isSeekable() is true, these must be all slices. Throws
  /// VolumeError.
  [[nodiscard]] Values values(std::size_t step, const Slab& slices, const Request& request) {
    const Progress& progress = request.progress;
    Values values;
    const std::vector<double> n = sizes();
    const std::size_t slice = static_cast<std::size_t>(n[0]) * static_cast<std::size_t>(n[1]);
    try {
      values = Values(type().type, channels(), slice * static_cast<std::size_t>(slices.count));
    } catch (const std::bad_alloc&) {
      refuse("the values need more memory than is free",
             remedyForMemory(request, static_cast<int>(n[2]),
                             isSeekable() ? "" : "export it as binary without compression"));
    }
    if (isSeekable()) {
      readSlices(step, slices, values, progress);
    } else if (isText()) {
      parseAll(step, values, progress);
    } else {
      Unpacked in(file_, parts_.front().file, Packing::kExpected, parts_.front().offset);
      const std::size_t size = values.size() * values.bytesEach();
      in.skip(static_cast<std::uint64_t>(step) * size);
      in.read(values.as<char>(), size, progress);
      // Verifies the checksum of the whole file once.
      if (!sound_) in.finish();
      sound_ = true;
    }
    const bool swap = !isText() && std::endian::native == std::endian::little &&
                      isTrue({"BinaryDataByteOrderMSB", "ElementByteOrderMSB"});
    if (swap) swapBytes(values.data(), values.size(), values.bytesEach());
    return values;
  }

 private:
  void readSlices(std::size_t step, const Slab& slices, const Values& values,
                  const Progress& progress) const {
    const auto slices_each = static_cast<std::size_t>(sizes()[2]);
    const std::size_t each = slices_each * steps() / parts_.size();
    auto* to = values.as<char>();
    const std::size_t first = step * slices_each + static_cast<std::size_t>(slices.first);
    const std::size_t end = first + static_cast<std::size_t>(slices.count);
    const std::size_t bytes = first == end ? 0 : values.size() * values.bytesEach() / (end - first);
    for (std::size_t k = first; k < end;) {
      const Part& part = parts_[k / each];
      const std::size_t here = std::min(end, (k / each + 1) * each) - k;
      std::ifstream in = opened(part);
      in.seekg(static_cast<std::streamoff>(part.offset + k % each * bytes));
      in.read(to, static_cast<std::streamsize>(here * bytes));
      if (!in) {
        refuse(fmt::format("{} cannot be read to the end", calledBy(file_, part.file)),
               "copy or export the file again");
      }
      to += here * bytes;
      k += here;
      if (progress) progress(static_cast<double>(k - first) / static_cast<double>(end - first));
    }
  }

  /// Reads all values of a step, which are text.
  void parseAll(std::size_t step, const Values& values, const Progress& progress) const {
    const std::size_t count = values.size();
    const std::size_t each = count * steps() / parts_.size();
    for (std::size_t done = 0; done < count;) {
      const std::size_t at = step * count + done;
      const Part& part = parts_[at / each];
      const std::size_t here = std::min(count - done, (at / each + 1) * each - at);
      std::ifstream in = opened(part);
      in.seekg(static_cast<std::streamoff>(part.offset));
      const std::string where =
          parts_.size() == 1 ? "" : fmt::format("in {} ", calledBy(file_, part.file));
      parse(in, where, at % each, values, done, here);
      done += here;
      if (progress) progress(static_cast<double>(done) / static_cast<double>(count));
    }
  }

  [[nodiscard]] std::ifstream opened(const Part& part) const {
    std::ifstream in(part.file, std::ios::binary);
    if (!in) {
      refuse(fmt::format("the data file {} cannot be read", part.file.filename().string()),
             "check its permissions");
    }
    return in;
  }

  [[nodiscard]] bool isText() const {
    return !text({"BinaryData"}).empty() && !isTrue({"BinaryData"});
  }

  /// Reads values as text, after `skipped` other values. The reason of an error begins with
  /// `where`.
  void parse(std::istream& in, const std::string& where, std::size_t skipped, const Values& values,
             std::size_t first, std::size_t count) const {
    const auto next = [&](std::size_t number) {
      double value = 0.0;
      if (in >> value) return value;
      if (in.eof()) refuse(where + "the values end too early", "copy or export the file again");
      refuse(fmt::format("{}value {} is not a number", where, number + 1),
             "correct the value, or export the file again");
    };
    for (std::size_t i = 0; i < skipped; ++i) static_cast<void>(next(i));
    visit(values, [&](auto* data) {
      using T = std::remove_pointer_t<decltype(data)>;
      for (std::size_t i = 0; i < count; ++i) {
        double value = next(skipped + i);
        if constexpr (std::is_integral_v<T>) {
          value = std::clamp(value, static_cast<double>(std::numeric_limits<T>::min()),
                             std::nexttoward(std::ldexp(1.0, std::numeric_limits<T>::digits), 0));
        }
        data[first + i] = static_cast<T>(value);
      }
    });
  }

  void check() {
    const std::string object = text({"ObjectType"});
    if (!object.empty() && object != "Image") {
      refuse(fmt::format("the file is a MetaIO {}, not an image", object),
             "give a file with ObjectType = Image");
    }
    const std::string dimensions = text({"NDims"});
    if (dimensions.empty()) refuse("the header has no NDims", kCorrectHeader);
    if (dimensions != "3" && dimensions != "4") {
      refuse(fmt::format("the image has {} dimensions", dimensions),
             "give an image with 3 dimensions, or with 4, of which the last is time");
    }
    dimensions_ = dimensions == "4" ? 4 : 3;
    const std::vector<double> sizes = this->sizes();
    if (sizes.empty()) refuse("the header has no DimSize", kCorrectHeader);
    double each = type().bytes;
    if (const auto channels = numbers({"ElementNumberOfChannels"}, 1); !channels.empty()) {
      if (!(channels[0] >= 1.0) || channels[0] > 1000.0 || channels[0] != std::floor(channels[0])) {
        refuse(fmt::format("ElementNumberOfChannels is {}, not a whole number from 1 to 1000",
                           channels[0]),
               kCorrectHeader);
      }
      each *= channels[0];
    }
    if (dimensions_ == 4 && sizes[3] > kMostParts) {
      refuse(fmt::format("the header states {} time steps, more than 100000", sizes[3]),
             kCorrectHeader);
    }
    const double bytes = bytesOf(file_, sizes, each);
    for (const char* key :
         {"ElementSpacing", "ElementSize", "Offset", "Position", "Origin", "CenterOfRotation"}) {
      static_cast<void>(numbers({key}, dimensions_));
    }
    for (const char* key : {"TransformMatrix", "Rotation", "Orientation"}) {
      static_cast<void>(numbers({key}, dimensions_ * dimensions_));
    }
    checkTimeAxis();
    for (const char* key :
         {"ElementToIntensityFunctionSlope", "ElementToIntensityFunctionOffset", "HeaderSize"}) {
      static_cast<void>(numbers({key}, 1));
    }
    checkData(bytes, sizes);
  }

  /// Throws VolumeError if a matrix of four axes does not keep time apart from space.
  void checkTimeAxis() const {
    const std::vector<double> directions = matrix();
    if (dimensions_ != 4 || directions.empty()) return;
    bool apart = directions[15] > 0.0;
    for (const std::size_t i : {3U, 7U, 11U, 12U, 13U, 14U}) {
      apart = apart && directions[i] == 0.0;
    }
    if (apart) return;
    refuse("the TransformMatrix turns or inverts the fourth axis, which palpate reads as time",
           "export the image with 0 0 0 1 as the last row and the last column of the matrix");
  }

  /// Checks, before memory is allocated, that the files can hold the values.
  void checkData(double bytes, const std::vector<double>& sizes) {
    const double slices = sizes[2] * (dimensions_ == 4 ? sizes[3] : 1.0);
    const std::string name = text({"ElementDataFile"});
    if (name.empty()) refuse("the header has no ElementDataFile", kCorrectHeader);
    std::vector<std::string> files{name};
    if (name.find('%') != std::string::npos) files = numbered(name, sizes.back());
    if (name.rfind("LIST", 0) == 0) files = list_;
    if (files.empty()) refuse("the header lists no data files", kCorrectHeader);
    const double share = bytes / static_cast<double>(files.size());
    if (std::fmod(slices, static_cast<double>(files.size())) != 0.0) {
      refuse(fmt::format("{} slices cannot be divided among {} data files", slices, files.size()),
             kCorrectHeader);
    }
    if (isTrue({"CompressedData"}) && files.size() != 1) {
      refuse("the values are compressed in several files", "export the image uncompressed");
    }
    const auto skipped = numbers({"HeaderSize"}, 1);
    for (const std::string& data : files) {
      const bool local = data == "LOCAL" || data == "Local" || data == "local";
      Part part{local ? file_ : file_.parent_path() / data, local ? offset_ : 0};
      const double size = sizeOfData(file_, part.file, follow_);
      double least = share;
      if (isTrue({"CompressedData"})) least = leastDeflated(share);
      if (isText()) least = leastText(share / type().bytes);
      double offset = static_cast<double>(part.offset);
      if (!skipped.empty() && skipped[0] > 0.0) offset = std::max(offset, skipped[0]);
      if (!skipped.empty() && skipped[0] == -1.0) offset = std::max(offset, size - share);
      const double held = std::max(size - offset, 0.0);
      checkHeld(file_, part.file, held, least);
      part.offset = static_cast<std::uintmax_t>(offset);
      parts_.push_back(part);
    }
  }

  /// Returns a file name for each slice, or each volume of four dimensions, from a pattern such as
  /// "slice%03d.raw 1 93 1".
  [[nodiscard]] std::vector<std::string> numbered(const std::string& field, double slices) const {
    const char* what = dimensions_ == 4 ? "volumes" : "slices";
    if (slices > kMostParts) {
      refuse(fmt::format("the header states {} {}, more than 100000", slices, what),
             kCorrectHeader);
    }
    std::istringstream words(field);
    std::string pattern;
    int first = 1;
    int last = static_cast<int>(slices);
    int step = 1;
    words >> pattern;
    if (words >> first) words >> last >> step;
    const auto at = pattern.find('%') + 1;
    auto end = at;
    while (end < pattern.size() && std::isdigit(static_cast<unsigned char>(pattern[end])) != 0) {
      ++end;
    }
    if (end >= pattern.size() || pattern[end] != 'd' || end - at > 2 ||
        pattern.find('%', end) != std::string::npos) {
      refuse(fmt::format("the pattern of data files \"{}\" is invalid", pattern),
             "write one %d, as in slice%03d.raw");
    }
    const std::string format = fmt::format("{{:{}}}", pattern.substr(at, end - at + 1));
    std::vector<std::string> files;
    for (long n = first; n <= last && step > 0 && static_cast<double>(files.size()) < slices;
         n += step) {
      files.push_back(pattern.substr(0, at - 1) + fmt::format(fmt::runtime(format), n) +
                      pattern.substr(end + 1));
    }
    if (static_cast<double>(files.size()) != slices) {
      refuse(fmt::format("the pattern names {} data files, but the image has {} {}", files.size(),
                         slices, what),
             kCorrectHeader);
    }
    return files;
  }

  fs::path file_;
  bool follow_;
  std::map<std::string, std::string> fields_;
  std::vector<std::string> list_;
  std::vector<Part> parts_;
  std::uintmax_t offset_ = 0;
  std::size_t dimensions_ = 3;
  bool sound_ = false;
};

class MetaImageReader final : public Reader {
 public:
  explicit MetaImageReader(const Request& request) : request_(request), header_(request) {}

  [[nodiscard]] std::vector<double> times() const override {
    std::vector<double> times;
    if (header_.steps() == 1) return times;
    const std::vector<double> spacing = header_.spacing();
    const std::vector<double> origin = header_.origin();
    const double step = spacing.empty() || !(spacing[3] > 0.0) ? 1.0 : spacing[3];
    const double start = origin.empty() ? 0.0 : origin[3];
    for (std::size_t i = 0; i < header_.steps(); ++i) {
      times.push_back(start + step * static_cast<double>(i));
    }
    return times;
  }

  Content read(std::size_t step) override {
    Content content;
    Piece image;
    const std::vector<double> sizes = header_.sizes();
    for (std::size_t a = 0; a < 3; ++a) image.size[a] = static_cast<int>(sizes[a]);
    // Positions are in ITK's space: x to the left, y to the back. As in ITK, AnatomicalOrientation
    // does not change positions; otherwise a CT and its dose could be misaligned.
    const Mat3 turn = Vec3(-1.0, -1.0, 1.0).asDiagonal();
    const std::string axes = header_.text({"AnatomicalOrientation"});
    content.patient = !axes.empty() && axes.find('?') == std::string::npos;
    if (!content.patient) {
      content.notes.emplace_back(
          "AnatomicalOrientation is missing or unknown: as in ITK, x points to the patient's left "
          "and y to the back; the result is in RAS, so the signs of x and y are reversed");
    }
    image.file_from_index = place(turn, content.notes);
    const Slab slices = header_.isSeekable() ? slicesToRead(request_, image) : image.slices();
    const Values values = header_.values(step, slices, request_);
    image.arrays.push_back(named(values, turn, content));
    content.pieces.push_back(std::move(image));
    if (header_.text({"Modality"}) == "MET_MOD_CT") content.modality = Modality::kCt;
    if (header_.text({"Modality"}) == "MET_MOD_MR") content.modality = Modality::kMr;
    content.description = header_.text({"Comment", "Name"});
    const std::string unit = header_.text({"DistanceUnits"});
    content.length_unit = unit.empty() || unit == "?" ? "mm" : unit;  // default unit of MetaIO
    return content;
  }

 private:
  [[nodiscard]] Affine place(const Mat3& turn, std::vector<std::string>& notes) const {
    Affine map;
    const auto spacing = header_.spacing();
    if (spacing.empty()) {
      notes.emplace_back("the header has no ElementSpacing: a spacing of 1 is assumed");
    }
    const auto matrix = header_.matrix();
    for (int axis = 0; axis < 3; ++axis) {
      for (int d = 0; d < 3 && !matrix.empty(); ++d) {
        map.linear(d, axis) = matrix[header_.dimensions() * static_cast<std::size_t>(axis) +
                                     static_cast<std::size_t>(d)];
      }
      if (!spacing.empty()) map.linear.col(axis) *= spacing[static_cast<std::size_t>(axis)];
    }
    const auto origin = header_.origin();
    if (!origin.empty()) map.origin = Vec3(origin[0], origin[1], origin[2]);
    const auto centre = header_.numbers({"CenterOfRotation"}, header_.dimensions());
    const bool centred = std::any_of(centre.begin(), centre.end(), [](double c) { return c != 0; });
    if (centred && !matrix.empty()) {
      notes.emplace_back("CenterOfRotation is ignored, as in ITK");
    }
    map.linear = turn * map.linear;
    map.origin = turn * map.origin;
    return map;
  }

  Array named(Values values, const Mat3& turn, Content& content) const {
    const int channels = values.components();
    const auto number = [&](const char* key, double otherwise) {
      const auto found = header_.numbers({key}, 1);
      return found.empty() ? otherwise : found[0];
    };
    const double slope = number("ElementToIntensityFunctionSlope", 1.0);
    const double offset = number("ElementToIntensityFunctionOffset", 0.0);
    if (slope != 1.0 || offset != 0.0) {
      content.notes.push_back(fmt::format("values are {} * stored + {}", slope, offset));
    }
    values = rescaled(values, slope, offset);
    if (channels == 1) {
      return {"density", values, "", "", false};
    }
    if (channels == 3) {
      return {"vector", turned(values, turn), "", "", false};
    }
    if (channels == 6 && request_.as == "tensor") {
      content.notes.emplace_back(
          "six channels are read as the tensor xx xy xz yy yz zz, the order of ITK");
      return {"tensor", turned(picked(values, kUpperTriangle), turn), "", "", false};
    }
    header_.refuse(
        fmt::format("the image has {} channels, not 1 or 3", channels),
        channels == 6 ? "add --as tensor if they are a symmetric tensor" : "export one channel");
  }

  Request request_;
  Header header_;
};

}  // namespace

std::unique_ptr<Reader> openMetaImage(const Request& request) {
  return std::make_unique<MetaImageReader>(request);
}

}  // namespace palpate::importer
