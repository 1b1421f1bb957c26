/// Reads NRRD. teem parses the header, and decodes data that are not gzipped (nrrd_data.h).
#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <new>
#include <optional>
#include <string>
#include <teem/nrrd.h>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/nrrd_data.h"
#include "palpate/scenes/apps/import/nrrd_header.h"
#include "palpate/scenes/apps/import/nrrd_segments.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/values.h"

namespace palpate::importer {
namespace {

struct FreeNrrd {
  void operator()(Nrrd* nrrd) const { nrrdNuke(nrrd); }
};
struct FreeState {
  void operator()(NrrdIoState* state) const { nrrdIoStateNix(state); }
};

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
    NrrdHeader header = readNrrdHeader(request.file);
    parse(header.lines);
    state_->lineSkip = header.line_skip;
    state_->byteSkip = header.byte_skip;
    classify();
    if (meaning_ == Meaning::kScalar) {
      segments_ = segmentsIn(header.pairs, series_ < 0 ? 1 : axisAt(series_).size, notes_);
    }
    // The layers of a segmentation are not steps.
    if (series_ >= 0 && !segments_) times_ = timesOf(header);
    data_.emplace(request_, std::move(header.parts), nrrd_.get(), state_.get());
  }

  [[nodiscard]] std::vector<double> times() const override { return times_; }

  [[nodiscard]] std::optional<double> timeUnit() const override {
    if (series_ < 0) return std::nullopt;
    const char* units = axisAt(series_).units;
    if (units == nullptr && nrrd_->spaceDim == 4) units = nrrd_->spaceUnits[3];
    return units == nullptr ? std::nullopt : secondsIn(units);
  }

  Content read(std::size_t step) override {
    Content content;
    content.notes = notes_;
    if (nrrd_->content != nullptr) content.description = nrrd_->content;
    Piece image;
    image.file_from_index = place(content);
    for (std::size_t a = 0; a < 3; ++a) {
      image.size[a] = static_cast<int>(axisAt(space_[a]).size);
    }
    const bool is_packed = state_->encoding != nrrdEncodingRaw;
    const Slab slices = isInOrder() ? slicesToRead(request_, image, is_packed) : image.slices();
    if (segments_) {
      addLayers(slices, image);
      content.pieces.push_back(std::move(image));
      return content;
    }
    Values values = readValues(step, slices);
    if (meaning_ == Meaning::kMaskedTensor) image.hidden = hiddenOf(values);
    values = inSpace(values, content);
    const char* names[] = {"density", "vector", "tensor", "tensor"};
    const char* name = names[static_cast<int>(meaning_)];
    if (nrrd_->sampleUnits != nullptr) content.value_unit[name] = nrrd_->sampleUnits;
    image.arrays.push_back({name, values, "", "", false});
    content.pieces.push_back(std::move(image));
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
    const NrrdFile in(fmemopen(text.data(), text.size(), "rb"));
    return in != nullptr && nrrdRead(nrrd_.get(), in.get(), state_.get()) == 0;
  }

  void parse(std::vector<std::string> lines) {
    if (!tryParse(lines)) {
      const std::string why = teemError();
      // NRRD forbids spacings with space directions, but some programs write both.
      const auto begins = [](const std::string& line, const char* with) {
        return lowered(line).rfind(with, 0) == 0;
      };
      const bool directed = std::any_of(lines.begin(), lines.end(), [&](const auto& line) {
        return begins(line, "space directions:");
      });
      std::vector<std::string> dropped;
      std::erase_if(lines, [&](const auto& line) {
        const bool drops = begins(line, "spacings:") || begins(line, "axis mins:") ||
                           begins(line, "axis maxs:") || begins(line, "units:");
        if (drops) dropped.push_back(lowered(line.substr(0, line.find(':'))));
        return drops;
      });
      if (!directed || dropped.empty() || !tryParse(lines)) {
        if (directed && !dropped.empty()) std::free(biffGetDone(NRRD));  // NOLINT
        refuse(fmt::format("the NRRD header is damaged ({})", why), kCorrectNrrdHeader);
      }
      notes_.push_back(
          fmt::format("the header has space directions, so these fields are ignored: {}; the unit "
                      "of length is read only from the field space units",
                      fmt::join(dropped, ", ")));
    }
    if (!typeOf(nrrd_->type)) {
      refuse("the values are blocks of bytes", "export the values as integers or floats");
    }
    if (state_->encoding->available() == 0 && state_->encoding != nrrdEncodingGzip) {
      refuse(fmt::format("the installed teem cannot decode {}", state_->encoding->name),
             "export the values raw or gzipped");
    }
  }

  void takeKind(int axis, int kind) {
    const std::size_t size = axisAt(axis).size;
    const auto component = [&](Meaning meaning) {
      if (component_ >= 0) refuse("the values have two axes of components", "export one of them");
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
          refuse(fmt::format("axis {} of {} has vectors of {} components, not 3", axis + 1,
                             nrrd_->dim, size),
                 "export vectors of 3 components; or, if this axis is a series, set its kind in "
                 "the header to \"list\"");
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
        if (size == 3 && request_.as == "displacement" &&
            (kind == nrrdKindList || kind == nrrdKindUnknown)) {
          return component(Meaning::kVector);
        }
        if (series_ >= 0) {
          refuse("two axes count as lists or times, and palpate imports only one such axis",
                 "export one of them, or correct the kinds in the header");
        }
        series_ = axis;
        return;
      default:
        refuse(fmt::format("the values are of kind {}, which palpate does not import",
                           airEnumStr(nrrdKind, kind)),
               "export scalars, vectors or symmetric tensors");
    }
  }

  void classify() {
    const int dim = static_cast<int>(nrrd_->dim);
    const auto directed = [&](int axis) {  // false for an axis of time
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
      // Old files have no kinds. If they have four axes, one of these is a list of components or a
      // series.
      if (space.empty()) space = guess();
    }
    if (space.size() < 3) {
      refuse("the image has fewer than three axes of space",
             "give an image with three axes of space, or correct the kinds and space directions in "
             "the header");
    }
    // Of four domain axes without directions, the last one is time.
    if (space.size() > 3 && (directed_ || space.size() > 4)) {
      refuse(fmt::format("the image has {} axes of space, not 3", space.size()),
             kCorrectNrrdHeader);
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
        notes_.emplace_back("the axes have no kinds: the last axis is read as a series");
        rest.pop_back();
        return rest;
    }
    notes_.push_back(fmt::format("the axes have no kinds: the first axis is read as a {}",
                                 airEnumStr(nrrdKind, guessed_)));
    rest.erase(rest.begin());
    return rest;
  }

  [[nodiscard]] std::vector<double> timesOf(const NrrdHeader& header) const {
    const NrrdAxisInfo& axis = axisAt(series_);
    if (auto stated = indexValuesOf(header, series_, axis.size)) return std::move(*stated);
    double step = axis.spacing;
    if (!AIR_EXISTS(step) && nrrd_->spaceDim == 4) step = axis.spaceDirection[3];
    if (!AIR_EXISTS(step) || step == 0.0) step = 1.0;
    const double start = AIR_EXISTS(axis.min) ? axis.min : 0.0;
    std::vector<double> times;
    for (std::size_t i = 0; i < axis.size; ++i) {
      times.push_back(start + step * static_cast<double>(i));
    }
    return times;
  }

  // ------------------------------------------------------------------ the data

  [[nodiscard]] std::size_t sizeBetween(int first, int end) const {
    std::size_t product = 1;
    for (int a = first; a < end; ++a) product *= axisAt(a).size;
    return product;
  }

  /// Returns true if the values of a step are contiguous in the file, with components fastest.
  [[nodiscard]] bool isInOrder() const {
    return (component_ < 0 || sizeBetween(0, component_) == 1) &&
           (series_ < 0 || sizeBetween(series_ + 1, static_cast<int>(nrrd_->dim)) == 1);
  }

  /// Reads one step, components fastest. Unless isInOrder() is true, `slices` must be all slices.
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
        // teem combines hexadecimal digits with the previous memory content, which must be 0.
        if (state_->encoding == nrrdEncodingHex) std::memset(to, 0, points * width * size);
        const std::size_t before =
            step * axisAt(space_[2]).size + static_cast<std::size_t>(slices.first);
        data_->read(before * slice * width, points * width, to);
        return values;
      }
      // The values of a step are scattered, so reads all data and keeps them for the other steps.
      if (whole_.empty()) {
        whole_.resize(nrrdElementNumber(nrrd_.get()) * size);
        data_->read(0, nrrdElementNumber(nrrd_.get()), whole_.data());
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
      const bool is_raw = state_->encoding == nrrdEncodingRaw;
      refuse("the values need more memory than is free",
             remedyForMemory(request_, static_cast<int>(axisAt(space_[2]).size),
                             !isInOrder() ? "export it with components first and a series last"
                             : is_raw     ? ""
                                          : "export it with raw encoding"));
    }
    if (series_ < 0) whole_ = {};
    return values;
  }

  /// Adds an array of labels for each layer of a segmentation.
  void addLayers(const Slab& slices, Piece& image) {
    for (std::size_t layer = 0; layer < segments_->size(); ++layer) {
      Array array;
      array.name = segments_->size() == 1 ? "labels" : fmt::format("labels_{}", layer);
      array.values = readValues(layer, slices);
      array.labels = (*segments_)[layer];
      image.arrays.push_back(std::move(array));
    }
  }

  /// Returns an array that is not 0 where a tensor's mask excludes the tensor.
  static Values hiddenOf(const Values& masked) {
    Values hidden(Type::kUint8, 1, masked.tuples());
    auto* out = hidden.as<std::uint8_t>();
    for (std::size_t i = 0; i < masked.tuples(); ++i) out[i] = masked.at(i, 0) >= 0.5 ? 0 : 1;
    return hidden;
  }

  // ------------------------------------------------------------------ the space

  /// Returns the rotation or reflection to RAS; without anatomical axes, to right-handed axes.
  [[nodiscard]] Mat3 turn() const {
    switch (nrrd_->space) {
      case nrrdSpaceLeftPosteriorSuperior:
      case nrrdSpaceLeftPosteriorSuperiorTime:
        return Vec3(-1.0, -1.0, 1.0).asDiagonal();
      case nrrdSpaceLeftAnteriorSuperior:
      case nrrdSpaceLeftAnteriorSuperiorTime:
        return Vec3(-1.0, 1.0, 1.0).asDiagonal();
      case nrrdSpace3DLeftHanded:  // mirrored, because W is right-handed
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
      for (std::string& unit : units) {
        if (unit.empty()) unit = "none";
      }
      content.notes.push_back(
          fmt::format("the axes have different units ({}), so the unit of length is unknown",
                      fmt::join(units, ", ")));
    }
    if (nrrd_->space == nrrdSpace3DLeftHanded || nrrd_->space == nrrdSpace3DLeftHandedTime) {
      content.notes.emplace_back(
          "the space is left-handed: y is inverted, so that the volume is not mirrored");
    }
    const bool is_scanner =
        nrrd_->space == nrrdSpaceScannerXYZ || nrrd_->space == nrrdSpaceScannerXYZTime;
    if (directed_ && turn().isIdentity(0.0) && !namesPatient() && !is_scanner) {
      content.notes.emplace_back(
          "the space has no anatomical axes, so positions stay unchanged; if ITK wrote the file (x "
          "to the left, y to the back), the volume does not align with volumes in RAS");
    }
    if (is_scanner) {
      content.notes.emplace_back(
          "positions are in the space of the scanner, not of the patient, and stay unchanged");
    }
    return map;
  }

  static void placeAlong(int c, const NrrdAxisInfo& axis, Affine& map,
                         std::vector<std::string>& notes) {
    // If the centring is not stated, min and max are at the faces of the outer voxels, as in teem.
    const bool node = axis.center == nrrdCenterNode;
    double spacing = axis.spacing;
    if (!AIR_EXISTS(spacing) && AIR_EXISTS(axis.min) && AIR_EXISTS(axis.max)) {
      const double count = static_cast<double>(axis.size) - (node ? 1.0 : 0.0);
      spacing = (axis.max - axis.min) / std::max(count, 1.0);
    }
    if (!AIR_EXISTS(spacing)) {
      spacing = 1.0;
      notes.push_back(
          fmt::format("axis {}: the header has no spacing: a spacing of 1 is assumed", "xyz"[c]));
    }
    map.linear(c, c) = spacing;
    if (AIR_EXISTS(axis.min)) map.origin[c] = axis.min + (node ? 0.0 : 0.5 * spacing);
  }

  /// Converts vectors and tensors to RAS. Drops masks; symmetric tensors get VTK's order.
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
    // teem stores the columns of the measurement frame: M(row, column) is
    // measurementFrame[column][row].
    Mat3 M = Mat3::Identity();
    const auto& frame = nrrd_->measurementFrame;
    if (nrrd_->spaceDim >= 3 && AIR_EXISTS(frame[0][0])) {
      for (int row = 0; row < 3; ++row) {
        for (int column = 0; column < 3; ++column) M(row, column) = frame[column][row];
      }
    } else {
      content.notes.emplace_back(
          "the header has no measurement frame: components are read along the axes of the space");
    }
    if (!M.allFinite())
      refuse("the measurement frame has a number that is not finite", kCorrectNrrdHeader);
    return turned(values, turn() * M);
  }

  Request request_;
  std::string file_;
  std::unique_ptr<Nrrd, FreeNrrd> nrrd_;
  std::unique_ptr<NrrdIoState, FreeState> state_;
  std::optional<NrrdData> data_;
  std::array<int, 3> space_{};
  int component_ = -1;
  int series_ = -1;
  int guessed_ = nrrdKindUnknown;
  bool directed_ = false;
  Meaning meaning_ = Meaning::kScalar;
  /// Labels of each layer, along the axis series_; no value unless the file is a segmentation.
  std::optional<std::vector<std::vector<Label>>> segments_;
  std::vector<double> times_;
  std::vector<char> whole_;
  std::vector<std::string> notes_;
};

}  // namespace

std::unique_ptr<Reader> openNrrd(const Request& request) {
  return std::make_unique<NrrdReader>(request);
}

}  // namespace palpate::importer
