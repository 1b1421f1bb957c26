/// Reads NRRD with teem, which parses the header and decodes the data. This file decides which
/// files are opened and how much is read, since teem trusts the header in both. It also unpacks
/// gzip: teem does not verify the checksum.
#include <algorithm>
#include <array>
#include <bit>
#include <cctype>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <limits>
#include <new>
#include <optional>
#include <set>
#include <sstream>
#include <teem/nrrd.h>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/header_checks.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/unpacked.h"
#include "palpate/scenes/apps/import/values.h"

namespace palpate::importer {
namespace {

namespace fs = std::filesystem;

constexpr const char* kDamaged = "it may be truncated or damaged: copy or export it again";
constexpr const char* kMendHeader = "mend its header";

struct CloseFile {
  void operator()(std::FILE* file) const { std::fclose(file); }
};
using File = std::unique_ptr<std::FILE, CloseFile>;
struct FreeNrrd {
  void operator()(Nrrd* nrrd) const { nrrdNuke(nrrd); }
};
struct FreeState {
  void operator()(NrrdIoState* state) const { nrrdIoStateNix(state); }
};

/// Returns the innermost line of teem's error.
std::string trouble() {
  char* text = biffGetDone(NRRD);
  if (text == nullptr) return "unknown trouble";
  std::istringstream lines(text);
  std::free(text);  // NOLINT(cppcoreguidelines-no-malloc): teem's
  std::string line;
  std::string last;
  while (std::getline(lines, line)) {
    if (!line.empty()) last = line;
  }
  const auto colon = last.find(": ");  // "[nrrd] function: what"
  if (colon != std::string::npos) last.erase(0, colon + 2);
  for (char& c : last) {
    if (std::iscntrl(static_cast<unsigned char>(c)) != 0) c = ' ';
  }
  constexpr std::size_t kLongest = 160;
  if (last.size() > kLongest) last = last.substr(0, kLongest) + " ...";
  return last;
}

std::string lowered(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return text;
}

/// A file with a share of the data.
struct Part {
  fs::path file;
  long offset = 0;           ///< End of an attached header.
  std::optional<long> skip;  ///< Overrides the header's byte skip.
};

/// The header as text, without the fields that locate the data.
struct Header {
  std::vector<std::string> lines;
  std::vector<Part> parts;
  unsigned line_skip = 0;
  long byte_skip = 0;
};

/// Converts "name.%03d" and 7 to "name.007". Does not use printf, which would trust the pattern.
std::string numbered(const std::string& pattern, int number, const std::string& file) {
  const auto at = pattern.find('%');
  std::size_t end = at == std::string::npos ? at : at + 1;
  std::size_t width = 0;
  const bool zeros = end < pattern.size() && pattern[end] == '0';
  while (end < pattern.size() && std::isdigit(static_cast<unsigned char>(pattern[end])) != 0) {
    width = std::min<std::size_t>(10 * width + static_cast<std::size_t>(pattern[end++] - '0'), 99);
  }
  const bool known = end < pattern.size() && std::strchr("diu", pattern[end]) != nullptr;
  if (!known || width > 20 || pattern.find('%', end) != std::string::npos) {
    throw VolumeError(file, fmt::format("its pattern of data files \"{}\" is none", pattern),
                      "write one %d, as in slice%03d.raw");
  }
  std::string digits = std::to_string(number);
  if (digits.size() < width) digits.insert(0, width - digits.size(), zeros ? '0' : ' ');
  return pattern.substr(0, at) + digits + pattern.substr(end + 1);
}

/// Parses the text after "data file:", and the lines after it if it is a list.
std::vector<Part> partsOf(const std::string& field, std::istream& rest, const fs::path& file) {
  constexpr int kMost = 1000000;
  const auto besides = [&](const std::string& name) {
    if (name == "-") {
      throw VolumeError(file.string(), "its data are to come from a pipe", "name a data file");
    }
    return file.parent_path() / name;  // an absolute name stays unchanged
  };
  std::vector<Part> parts;
  std::istringstream words(field);
  std::string first;
  words >> first;
  if (first == "LIST" || first == "SKIPLIST") {
    std::string line;
    while (std::getline(rest, line) && static_cast<int>(parts.size()) < kMost) {
      while (!line.empty() && std::isspace(static_cast<unsigned char>(line.back())) != 0) {
        line.pop_back();
      }
      if (line.empty()) continue;
      Part part;
      if (first == "SKIPLIST") {
        std::istringstream pair(line);
        long skip = 0;
        pair >> skip >> std::ws;
        if (!pair) throw VolumeError(file.string(), "its SKIPLIST is damaged", kMendHeader);
        std::getline(pair, line);
        part.skip = skip;
      }
      part.file = besides(line);
      parts.push_back(part);
    }
  } else if (int lowest = 0, highest = 0, step = 0;
             first.find('%') != std::string::npos && words >> lowest >> highest >> step) {
    if (step == 0 || (highest - static_cast<double>(lowest)) / step > kMost) {
      throw VolumeError(file.string(), "its numbering of data files never ends", kMendHeader);
    }
    for (long n = lowest; step > 0 ? n <= highest : n >= highest; n += step) {
      parts.push_back({besides(numbered(first, static_cast<int>(n), file.string())), 0, {}});
    }
  } else {
    parts.push_back({besides(field), 0, {}});  // may have spaces
  }
  if (parts.empty()) throw VolumeError(file.string(), "it names no data file", kMendHeader);
  return parts;
}

/// Stores a line of the header, unless it locates the data or is not needed.
void takeLine(Header& header, std::string line, const fs::path& file) {
  if (line[0] == '#' || line.find(":=") < line.find(": ")) return;
  std::string key = lowered(line.substr(0, line.find(':')));
  std::erase(key, ' ');
  if (key != "lineskip" && key != "byteskip") {
    // Teem prints error messages into 1024 characters.
    constexpr std::size_t kLongest = 800;
    if (line.size() > kLongest && key == "content") line.resize(kLongest);
    if (line.size() > kLongest) {
      throw VolumeError(file.string(), "its header has a line that is too long", kMendHeader);
    }
    header.lines.push_back(std::move(line));
    // Debian's teem knows this kind's name but not its size.
    std::string& taken = header.lines.back();
    const auto gradient = key == "kinds" ? taken.find("3-gradient") : std::string::npos;
    if (gradient != std::string::npos) taken.replace(gradient, 10, "3-vector");
    return;
  }
  std::istringstream value(line.substr(line.find(':') + 1));
  long count = 0;
  value >> count;
  if (!value || (key == "lineskip" && (count < 0 || count > 1000000))) {
    throw VolumeError(file.string(), fmt::format("its {} is no count", key), kMendHeader);
  }
  if (key == "lineskip") {
    header.line_skip = static_cast<unsigned>(count);
  } else {
    header.byte_skip = count;
  }
}

Header readHeader(const fs::path& file) {
  constexpr std::size_t kLongest = 1U << 20U;
  std::ifstream in(file, std::ios::binary);
  Header header;
  std::string line;
  std::size_t length = 0;
  while (std::getline(in, line)) {
    length += line.size();
    if (length > kLongest) throw VolumeError(file.string(), "its header never ends", kDamaged);
    if (!line.empty() && line.back() == '\r') line.pop_back();
    if (line.empty()) {
      header.parts.push_back({file, static_cast<long>(in.tellg()), {}});
      return header;
    }
    const auto colon = line.find(':');
    const std::string key = lowered(line.substr(0, colon));
    if (colon != std::string::npos && (key == "data file" || key == "datafile")) {
      const auto value = line.find_first_not_of(" \t", colon + 1);
      const std::string field = value == std::string::npos ? "" : line.substr(value);
      header.parts = partsOf(field, in, file);
      if (field.rfind("LIST", 0) == 0 || field.rfind("SKIPLIST", 0) == 0) return header;
      // The lines that follow belong to the header, until an empty line or the end.
      while (std::getline(in, line)) {
        if (!line.empty() && line.back() == '\r') line.pop_back();
        if (line.empty() || header.lines.size() > 10000) break;
        takeLine(header, line, file);
      }
      return header;
    }
    takeLine(header, line, file);
  }
  throw VolumeError(file.string(), "it ends within its header", kDamaged);
}

/// Meaning of a value.
enum class Meaning : std::uint8_t { kScalar, kVector, kTensor, kMaskedTensor };

std::optional<Type> typeOf(int type) {
  switch (type) {
    case nrrdTypeChar:
      return Type::kInt8;
    case nrrdTypeUChar:
      return Type::kUint8;
    case nrrdTypeShort:
      return Type::kInt16;
    case nrrdTypeUShort:
      return Type::kUint16;
    case nrrdTypeInt:
      return Type::kInt32;
    case nrrdTypeUInt:
      return Type::kUint32;
    case nrrdTypeLLong:
      return Type::kInt64;
    case nrrdTypeULLong:
      return Type::kUint64;
    case nrrdTypeFloat:
      return Type::kFloat32;
    case nrrdTypeDouble:
      return Type::kFloat64;
    default:
      return std::nullopt;
  }
}

class NrrdReader final : public Reader {
 public:
  explicit NrrdReader(const Request& request) : request_(request), file_(request.file.string()) {
    nrrdStateVerboseIO = 0;
    Header header = readHeader(request.file);
    parts_ = std::move(header.parts);
    parse(header.lines);
    state_->lineSkip = header.line_skip;
    state_->byteSkip = header.byte_skip;
    classify();
    weigh();
  }

  [[nodiscard]] std::vector<double> times() const override {
    std::vector<double> times;
    if (series_ < 0) return times;
    const NrrdAxisInfo& axis = axisAt(series_);
    double step = axis.spacing;
    if (!AIR_EXISTS(step) && nrrd_->spaceDim == 4) step = axis.spaceDirection[3];
    if (!AIR_EXISTS(step) || step == 0.0) step = 1.0;
    const double start = AIR_EXISTS(axis.min) ? axis.min : 0.0;
    for (std::size_t i = 0; i < axis.size; ++i) {
      times.push_back(start + step * static_cast<double>(i));
    }
    return times;
  }

  Content read(std::size_t step) override {
    Content content;
    content.notes = notes_;
    Piece image;
    image.file_from_index = place(content);
    for (std::size_t a = 0; a < 3; ++a) {
      image.size[a] = static_cast<int>(axisAt(space_[a]).size);
    }
    const Slab slices = isInOrder() ? slicesToRead(request_, image) : image.slices();
    Values values = readValues(step, slices);
    if (meaning_ == Meaning::kMaskedTensor) image.hidden = hiddenOf(values);
    values = inSpace(values, content);
    const char* names[] = {"density", "vector", "tensor", "tensor"};
    const char* name = names[static_cast<int>(meaning_)];
    if (nrrd_->sampleUnits != nullptr) content.value_unit[name] = nrrd_->sampleUnits;
    image.arrays.push_back({name, values, "", "", false});
    content.pieces.push_back(std::move(image));
    if (nrrd_->content != nullptr) content.description = nrrd_->content;
    return content;
  }

 private:
  [[noreturn]] void refuse(const std::string& why, const std::string& remedy) const {
    throw VolumeError(file_, why, remedy);
  }

  [[nodiscard]] const NrrdAxisInfo& axisAt(int axis) const { return nrrd_->axis[axis]; }

  // ------------------------------------------------------------------ the header

  bool tryParse(const std::vector<std::string>& lines) {
    std::string text = fmt::format("{}\n\n", fmt::join(lines, "\n"));
    nrrd_.reset(nrrdNew());
    state_.reset(nrrdIoStateNew());
    state_->skipData = 1;
    const File in(fmemopen(text.data(), text.size(), "rb"));
    return in != nullptr && nrrdRead(nrrd_.get(), in.get(), state_.get()) == 0;
  }

  void parse(std::vector<std::string> lines) {
    if (!tryParse(lines)) {
      const std::string why = trouble();
      // Space directions exclude spacings and similar fields; some programs write both.
      const auto begins = [](const std::string& line, const char* with) {
        return lowered(line).rfind(with, 0) == 0;
      };
      const bool directed = std::any_of(lines.begin(), lines.end(), [&](const auto& line) {
        return begins(line, "space directions:");
      });
      const auto dropped = std::erase_if(lines, [&](const auto& line) {
        return begins(line, "spacings:") || begins(line, "axis mins:") ||
               begins(line, "axis maxs:") || begins(line, "units:");
      });
      if (!directed || dropped == 0 || !tryParse(lines)) {
        if (directed && dropped > 0) std::free(biffGetDone(NRRD));  // NOLINT
        refuse(fmt::format("its NRRD header is damaged ({})", why), kMendHeader);
      }
      notes_.emplace_back("its space directions are taken, its spacings are not");
    }
    if (!typeOf(nrrd_->type)) {
      refuse("its values are blocks of bytes", "export it as integers or floats");
    }
    if (state_->encoding->available() == 0 && state_->encoding != nrrdEncodingGzip) {
      refuse(fmt::format("this teem cannot decode {}", state_->encoding->name),
             "export it raw or gzipped");
    }
  }

  /// Classifies an axis that is not a direction of space.
  void takeKind(int axis, int kind) {
    const std::size_t size = axisAt(axis).size;
    const auto component = [&](Meaning meaning) {
      if (component_ >= 0) refuse("its values have two axes of components", "export one of them");
      component_ = axis;
      meaning_ = meaning;
    };
    switch (kind) {
      case nrrdKindStub:
      case nrrdKindScalar:
        return;
      case nrrdKindVector:
      case nrrdKindCovariantVector:
      case nrrdKindNormal:
      case nrrdKind3Vector:
      case nrrdKind3Gradient:
      case nrrdKind3Normal:
        if (size != 3) {
          refuse(fmt::format("its vectors have {} components, not 3", size),
                 "call that axis a list in its header if it is a series");
        }
        return component(Meaning::kVector);
      case nrrdKind3DSymMatrix:
      case nrrdKind3DMatrix:
        return component(Meaning::kTensor);
      case nrrdKind3DMaskedSymMatrix:
      case nrrdKind3DMaskedMatrix:
        return component(Meaning::kMaskedTensor);
      case nrrdKindUnknown:
      case nrrdKindDomain:
      case nrrdKindSpace:
      case nrrdKindTime:
      case nrrdKindList:
        if (size == 1) return;
        if (series_ >= 0) refuse("it is a series in two ways", "export one of them");
        series_ = axis;
        return;
      default:
        refuse(fmt::format("its values are of kind {}, which cannot be felt",
                           airEnumStr(nrrdKind, kind)),
               "export scalars, vectors or symmetric tensors");
    }
  }

  /// Finds the axes of space, of components and of a series.
  void classify() {
    const int dim = static_cast<int>(nrrd_->dim);
    const auto directed = [&](int axis) {  // within space, not along its time
      const double* d = axisAt(axis).spaceDirection;
      return nrrd_->spaceDim >= 3 && AIR_EXISTS(d[0]) &&
             (d[0] != 0.0 || d[1] != 0.0 || d[2] != 0.0);
    };
    std::vector<int> space;
    for (int a = 0; a < dim; ++a) {
      if (directed(a)) space.push_back(a);
    }
    directed_ = !space.empty();
    if (!directed_) {
      for (int a = 0; a < dim; ++a) {
        const int kind = axisAt(a).kind;
        if (kind == nrrdKindSpace || kind == nrrdKindDomain) space.push_back(a);
      }
      // Old files have no kinds: a fourth axis is one of components, or a series.
      if (space.empty()) space = guess();
    }
    if (space.size() < 3) {
      refuse("it is flat: it has no three axes of space", "give an image with thickness");
    }
    // If four domain axes have no directions, the last is time.
    if (space.size() > 3 && (directed_ || space.size() > 4)) {
      refuse(fmt::format("it has {} axes of space, not 3", space.size()), kMendHeader);
    }
    std::copy_n(space.begin(), 3, space_.begin());
    for (int a = 0; a < dim; ++a) {
      if (std::find(space_.begin(), space_.end(), a) != space_.end()) continue;
      takeKind(a, axisAt(a).kind == nrrdKindUnknown ? guessed_ : axisAt(a).kind);
    }
  }

  std::vector<int> guess() {
    std::vector<int> rest;
    for (int a = 0; a < static_cast<int>(nrrd_->dim); ++a) {
      if (axisAt(a).kind == nrrdKindUnknown) rest.push_back(a);
    }
    if (rest.size() != 4) return rest;
    switch (axisAt(rest.front()).size) {
      case 3:
        guessed_ = nrrdKind3Vector;
        break;
      case 7:
        guessed_ = nrrdKind3DMaskedSymMatrix;
        break;
      case 9:
        guessed_ = nrrdKind3DMatrix;
        break;
      default:
        notes_.emplace_back("no kinds of axes: the last one is taken as a series");
        rest.pop_back();
        return rest;
    }
    notes_.push_back(fmt::format("no kinds of axes: the first one is taken as a {}",
                                 airEnumStr(nrrdKind, guessed_)));
    rest.erase(rest.begin());
    return rest;
  }

  /// Checks that the files can hold what the header states, before memory is allocated.
  void weigh() {
    std::vector<double> sizes;
    sizes.reserve(nrrd_->dim);
    for (int a = 0; a < static_cast<int>(nrrd_->dim); ++a) {
      sizes.push_back(static_cast<double>(axisAt(a).size));
    }
    static_cast<void>(
        bytesOf(request_.file, sizes, static_cast<double>(nrrdElementSize(nrrd_.get()))));
    const std::size_t count = nrrdElementNumber(nrrd_.get());
    if (count == 0 || count % parts_.size() != 0) {
      refuse(fmt::format("{} values do not divide among {} data files", count, parts_.size()),
             kMendHeader);
    }
    part_values_ = count / parts_.size();
    const double bytes = static_cast<double>(part_values_ * nrrdElementSize(nrrd_.get()));
    for (const Part& part : parts_) {
      const double size = sizeOfData(request_.file, part.file, request_.follow);
      double least = bytes;
      if (state_->encoding == nrrdEncodingGzip) least = leastDeflated(bytes);
      if (state_->encoding == nrrdEncodingAscii) {
        least = leastText(static_cast<double>(part_values_));
      }
      if (state_->encoding == nrrdEncodingHex) least = 2.0 * bytes;
      if (state_->encoding == nrrdEncodingBzip2 || state_->encoding == nrrdEncodingZRL) least = 0.0;
      checkHeld(request_.file, part.file, size - static_cast<double>(part.offset), least);
    }
  }

  // ------------------------------------------------------------------ the data

  /// Rejects long words: teem reads text into a buffer of 1024 characters without a check.
  void checkWords(std::FILE* in) const {
    const long start = std::ftell(in);
    constexpr int kLongest = 500;
    int length = 0;
    for (int c = std::fgetc(in); c != EOF; c = std::fgetc(in)) {
      length = std::isspace(c) != 0 ? 0 : length + 1;
      if (length > kLongest) refuse("its text has no numbers", kDamaged);
    }
    std::fseek(in, start, SEEK_SET);
  }

  /// Unpacks `bytes` bytes of the values of a gzipped part, which begins at `offset`. The first
  /// call verifies the whole part.
  void unpackPart(const Part& part, long offset, long skip, std::size_t first, std::size_t bytes,
                  char* to) {
    const auto open = [&] {
      return std::make_unique<Unpacked>(request_.file, part.file, Packing::kExpected,
                                        static_cast<std::uint64_t>(offset));
    };
    auto before = static_cast<std::uint64_t>(std::max(skip, 0L));
    if (skip < 0) {  // counted from the end, known only after unpacking; -1: no skip
      const std::uint64_t needed =
          part_values_ * nrrdElementSize(nrrd_.get()) + (static_cast<std::uint64_t>(-(skip + 1)));
      const std::uint64_t there = open()->finish();
      if (there < needed) refuse("its packed values are too few", kDamaged);
      before = there - needed;
    }
    const std::unique_ptr<Unpacked> in = open();
    in->skip(before + first);
    in->read(to, bytes);
    if (sound_.insert(part.file).second) in->finish();
  }

  /// Reads values [first, first + count) of a part.
  void readPart(const Part& part, std::size_t first, std::size_t count, char* to) {
    const std::string name = part.file.filename().string();
    const File in(std::fopen(part.file.c_str(), "rb"));
    if (in == nullptr) refuse(fmt::format("its data file {} cannot be read", name), kMendHeader);
    std::fseek(in.get(), part.offset, SEEK_SET);
    if (nrrdLineSkip(in.get(), state_.get()) != 0) refuse(trouble(), kDamaged);
    const std::size_t size = nrrdElementSize(nrrd_.get());
    const long skip = part.skip.value_or(state_->byteSkip);
    const NrrdEncoding* encoding = state_->encoding;
    if (encoding == nrrdEncodingGzip) {
      unpackPart(part, std::ftell(in.get()), skip, first * size, count * size, to);
      return;
    }
    bool found = true;
    if (encoding->isCompression == 0 && skip < 0) {  // counted from the end; -1: no skip
      found =
          std::fseek(in.get(), -static_cast<long>(part_values_ * size) + skip + 1, SEEK_END) == 0;
    } else if (encoding->isCompression == 0) {
      found = std::fseek(in.get(), skip, SEEK_CUR) == 0;
    }
    const bool all = first == 0 && count == part_values_;
    if (encoding == nrrdEncodingRaw && !all) {
      found = found && std::fseek(in.get(), static_cast<long>(first * size), SEEK_CUR) == 0;
    }
    if (!found) refuse(fmt::format("{} is too short", name), kDamaged);
    if (encoding == nrrdEncodingAscii) checkWords(in.get());
    const long said = state_->byteSkip;
    state_->byteSkip = skip;
    std::vector<char> whole;
    char* target = to;
    std::size_t values = count;
    if (encoding != nrrdEncodingRaw && !all) {
      whole.resize(part_values_ * size);
      target = whole.data();
      values = part_values_;
    }
    const int failed = encoding->read(in.get(), target, values, nrrd_.get(), state_.get());
    state_->byteSkip = said;
    if (failed != 0) refuse(fmt::format("teem cannot read {} ({})", name, trouble()), kDamaged);
    if (!whole.empty()) std::memcpy(to, whole.data() + first * size, count * size);
  }

  /// Reads values [first, first + count) of all parts together, in this machine's byte order.
  void readSpan(std::size_t first, std::size_t count, char* to) {
    const std::size_t size = nrrdElementSize(nrrd_.get());
    std::size_t done = 0;
    while (done < count) {
      const std::size_t part = (first + done) / part_values_;
      const std::size_t from = (first + done) % part_values_;
      const std::size_t here = std::min(count - done, part_values_ - from);
      readPart(parts_[part], from, here, to + done * size);
      done += here;
      if (request_.progress) {
        request_.progress(static_cast<double>(done) / static_cast<double>(count));
      }
    }
    const bool swap = state_->encoding->endianMatters != 0 && state_->endian != airEndianUnknown &&
                      state_->endian != airMyEndian();
    if (swap) swapBytes(to, count, size);
  }

  /// Returns the product of the sizes of some axes.
  [[nodiscard]] std::size_t sizeBetween(int first, int end) const {
    std::size_t product = 1;
    for (int a = first; a < end; ++a) product *= axisAt(a).size;
    return product;
  }

  /// Returns whether only stubs come before the components, and no axis after the series.
  [[nodiscard]] bool isInOrder() const {
    return (component_ < 0 || sizeBetween(0, component_) == 1) &&
           (series_ < 0 || sizeBetween(series_ + 1, static_cast<int>(nrrd_->dim)) == 1);
  }

  /// Reads one step's values, components fastest.
  /// @param slices  All, or a part if isInOrder().
  Values readValues(std::size_t step, const Slab& slices) {
    const std::size_t size = nrrdElementSize(nrrd_.get());
    const std::size_t width = component_ < 0 ? 1 : axisAt(component_).size;
    const std::size_t slice = axisAt(space_[0]).size * axisAt(space_[1]).size;
    const std::size_t points = slice * static_cast<std::size_t>(slices.count);
    Values values;
    try {
      values = Values(*typeOf(nrrd_->type), static_cast<int>(width), points);
      auto* to = values.as<char>();
      if (isInOrder()) {
        // Teem adds hexadecimal digits to the memory's present content.
        if (state_->encoding == nrrdEncodingHex) std::memset(to, 0, points * width * size);
        const std::size_t before =
            step * axisAt(space_[2]).size + static_cast<std::size_t>(slices.first);
        readSpan(before * slice * width, points * width, to);
        return values;
      }
      // Otherwise the whole data are read once, and kept for the other steps.
      if (whole_.empty()) {
        whole_.resize(nrrdElementNumber(nrrd_.get()) * size);
        readSpan(0, nrrdElementNumber(nrrd_.get()), whole_.data());
      }
      const auto stride = [&](int axis) { return axis < 0 ? 0 : sizeBetween(0, axis) * size; };
      const char* from = whole_.data() + step * stride(series_);
      const std::size_t along[] = {stride(space_[0]), stride(space_[1]), stride(space_[2])};
      for (std::size_t k = 0; k < axisAt(space_[2]).size; ++k) {
        for (std::size_t j = 0; j < axisAt(space_[1]).size; ++j) {
          const char* row = from + k * along[2] + j * along[1];
          for (std::size_t i = 0; i < axisAt(space_[0]).size; ++i) {
            for (std::size_t c = 0; c < width; ++c, to += size) {
              std::memcpy(to, row + i * along[0] + c * stride(component_), size);
            }
          }
        }
      }
    } catch (const std::bad_alloc&) {
      refuse("it takes more memory than there is", "import a part of it");
    }
    if (series_ < 0) whole_ = {};
    return values;
  }

  /// Returns where a masked tensor's mask excludes it.
  static Values hiddenOf(const Values& masked) {
    Values hidden(Type::kUint8, 1, masked.tuples());
    auto* out = hidden.as<std::uint8_t>();
    for (std::size_t i = 0; i < masked.tuples(); ++i) out[i] = masked.at(i, 0) >= 0.5 ? 0 : 1;
    return hidden;
  }

  // ------------------------------------------------------------------ the space

  /// Maps the file's space to RAS, or to a right-handed space if the file names no axes.
  [[nodiscard]] Mat3 turn() const {
    switch (nrrd_->space) {
      case nrrdSpaceLeftPosteriorSuperior:
      case nrrdSpaceLeftPosteriorSuperiorTime:
        return Vec3(-1.0, -1.0, 1.0).asDiagonal();
      case nrrdSpaceLeftAnteriorSuperior:
      case nrrdSpaceLeftAnteriorSuperiorTime:
        return Vec3(-1.0, 1.0, 1.0).asDiagonal();
      case nrrdSpace3DLeftHanded:  // the hand's world is right-handed: else it would be mirrored
      case nrrdSpace3DLeftHandedTime:
        return Vec3(1.0, -1.0, 1.0).asDiagonal();
      default:
        return Mat3::Identity();
    }
  }

  [[nodiscard]] bool namesPatient() const {
    switch (nrrd_->space) {
      case nrrdSpaceRightAnteriorSuperior:
      case nrrdSpaceRightAnteriorSuperiorTime:
      case nrrdSpaceLeftPosteriorSuperior:
      case nrrdSpaceLeftPosteriorSuperiorTime:
      case nrrdSpaceLeftAnteriorSuperior:
      case nrrdSpaceLeftAnteriorSuperiorTime:
        return true;
      default:
        return false;
    }
  }

  Affine place(Content& content) const {
    Affine map;
    const bool has_origin = nrrd_->spaceDim >= 3 && AIR_EXISTS(nrrd_->spaceOrigin[0]);
    std::array<std::string, 3> units;
    map.linear.setZero();
    for (int c = 0; c < 3; ++c) {
      const NrrdAxisInfo& axis = axisAt(space_[static_cast<std::size_t>(c)]);
      if (directed_) {
        for (int d = 0; d < 3; ++d) map.linear(d, c) = axis.spaceDirection[d];
      } else {
        placeAlong(c, axis, map, content.notes);
      }
      if (has_origin) map.origin[c] = nrrd_->spaceOrigin[c];
      const char* unit = nrrd_->spaceDim >= 3 ? nrrd_->spaceUnits[c] : nullptr;
      if (unit == nullptr) unit = axis.units;
      if (unit != nullptr) units[static_cast<std::size_t>(c)] = unit;
    }
    map.linear = turn() * map.linear;
    map.origin = turn() * map.origin;
    content.patient = directed_ && namesPatient();
    if (units[0] == units[1] && units[1] == units[2]) {
      content.length_unit = units[0];
    } else {
      content.notes.push_back(
          fmt::format("its axes have different units: {}", fmt::join(units, ", ")));
    }
    if (nrrd_->space == nrrdSpace3DLeftHanded || nrrd_->space == nrrdSpace3DLeftHandedTime) {
      content.notes.emplace_back(
          "its space is left-handed: y is turned round, so that nothing is mirrored");
    }
    if (nrrd_->space == nrrdSpaceScannerXYZ || nrrd_->space == nrrdSpaceScannerXYZTime) {
      content.notes.emplace_back("its space is the scanner's, not the patient's: kept as it is");
    }
    return map;
  }

  /// Sets an axis that has a spacing or an extent, but no direction.
  static void placeAlong(int c, const NrrdAxisInfo& axis, Affine& map,
                         std::vector<std::string>& notes) {
    // If the file does not state the centring, min and max refer to the voxels' faces, teem's
    // default.
    const bool node = axis.center == nrrdCenterNode;
    double spacing = axis.spacing;
    if (!AIR_EXISTS(spacing) && AIR_EXISTS(axis.min) && AIR_EXISTS(axis.max)) {
      const double count = static_cast<double>(axis.size) - (node ? 1.0 : 0.0);
      spacing = (axis.max - axis.min) / std::max(count, 1.0);
    }
    if (!AIR_EXISTS(spacing)) {
      spacing = 1.0;
      notes.push_back(fmt::format("axis {}: no spacing: 1 is taken", "xyz"[c]));
    }
    map.linear(c, c) = spacing;
    if (AIR_EXISTS(axis.min)) map.origin[c] = axis.min + (node ? 0.0 : 0.5 * spacing);
  }

  /// Converts vectors and tensors to RAS; drops masks; orders symmetric tensors as VTK does.
  Values inSpace(Values values, Content& content) const {
    if (meaning_ == Meaning::kScalar) return values;
    if (meaning_ != Meaning::kVector) {
      const int skip = meaning_ == Meaning::kMaskedTensor ? 1 : 0;
      const bool symmetric = values.components() - skip == 6;
      std::vector<int> order =
          symmetric ? kUpperTriangle : std::vector<int>{0, 1, 2, 3, 4, 5, 6, 7, 8};
      for (int& c : order) c += skip;
      if (symmetric || skip > 0) values = picked(values, order);
    }
    // M(row, column) is measurementFrame[column][row].
    Mat3 M = Mat3::Identity();
    const auto& frame = nrrd_->measurementFrame;
    if (nrrd_->spaceDim >= 3 && AIR_EXISTS(frame[0][0])) {
      for (int row = 0; row < 3; ++row) {
        for (int column = 0; column < 3; ++column) M(row, column) = frame[column][row];
      }
    } else {
      content.notes.emplace_back(
          "no measurement frame: components are taken along its space's axes");
    }
    if (!M.allFinite()) refuse("its measurement frame is damaged", kMendHeader);
    return turned(values, turn() * M);
  }

  Request request_;
  std::string file_;
  std::vector<Part> parts_;
  std::size_t part_values_ = 0;
  std::set<fs::path> sound_;  ///< Gzipped parts that were verified.
  std::unique_ptr<Nrrd, FreeNrrd> nrrd_;
  std::unique_ptr<NrrdIoState, FreeState> state_;
  std::array<int, 3> space_{};
  int component_ = -1;
  int series_ = -1;
  int guessed_ = nrrdKindUnknown;
  bool directed_ = false;
  Meaning meaning_ = Meaning::kScalar;
  std::vector<char> whole_;
  std::vector<std::string> notes_;
};

}  // namespace

std::unique_ptr<Reader> openNrrd(const Request& request) {
  return std::make_unique<NrrdReader>(request);
}

}  // namespace palpate::importer
