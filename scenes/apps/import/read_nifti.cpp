/// Reads NIfTI-1 and NIfTI-2 (nifti1.h and nifti2.h of nifti.nimh.nih.gov) without libnifti, which
/// reads invalid values as zeros and reports damage only on standard error. The transform to RAS
/// (+x right, +y front, +z up) is the sform, otherwise the qform, otherwise the spacing.
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <new>
#include <string_view>
#include <type_traits>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/header_checks.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/unpacked.h"

namespace palpate::importer {
namespace {

namespace fs = std::filesystem;

constexpr int kDisplacementIntent = 1006;
constexpr int kVectorIntent = 1007;
constexpr const char* kCheckWriter = "check the program that wrote the file";
constexpr const char* kAsFsl =
    "along the voxel axes, as FSL writes them (x is mirrored if the axes are right-handed)";

/// The numbers of a header, independent of version and byte order.
struct Header {
  bool swapped = false;
  /// True if header and values are in one file; false for two files .hdr and .img.
  bool single = false;
  int intent = 0;
  int type = 0;
  int bits = 0;
  /// size[0] is the number of dimensions. Sizes of dimensions beyond this number are 1.
  std::array<std::int64_t, 8> size{};
  std::array<double, 8> spacing{};  ///< spacing[0] is the handedness of the qform.
  double offset = 0.0;
  double slope = 0.0;
  double intercept = 0.0;
  double start = 0.0;
  double step = 0.0;
  int units = 0;
  int qform = 0;
  int sform = 0;
  std::array<double, 3> quaternion{};
  std::array<double, 3> shift{};
  std::array<double, 12> rows{};
  std::string description;
  std::string intent_name;
};

class Fields {
 public:
  Fields(const std::array<char, 540>& bytes, bool swapped) : bytes_(&bytes), swapped_(swapped) {}

  template <class T>
  [[nodiscard]] T at(std::size_t byte) const {
    std::array<char, sizeof(T)> raw{};
    std::memcpy(raw.data(), bytes_->data() + byte, sizeof(T));
    if (swapped_) std::reverse(raw.begin(), raw.end());
    return std::bit_cast<T>(raw);
  }
  template <class T, class Out, std::size_t N>
  void take(std::size_t byte, std::array<Out, N>& out) const {
    for (std::size_t i = 0; i < N; ++i) out[i] = static_cast<Out>(at<T>(byte + i * sizeof(T)));
  }
  [[nodiscard]] std::string text(std::size_t byte, std::size_t most) const {
    const char* first = bytes_->data() + byte;
    return {first, std::find(first, first + most, '\0')};
  }

 private:
  const std::array<char, 540>* bytes_;
  bool swapped_;
};

Header headerFrom(const std::array<char, 540>& bytes, bool second) {
  Header out;
  const int length = second ? 540 : 348;
  out.swapped = Fields(bytes, false).at<std::int32_t>(0) != length;
  const Fields in(bytes, out.swapped);
  if (second) {
    out.single = bytes[5] == '+';
    out.type = in.at<std::int16_t>(12);
    out.bits = in.at<std::int16_t>(14);
    in.take<std::int64_t>(16, out.size);
    in.take<double>(104, out.spacing);
    out.offset = static_cast<double>(in.at<std::int64_t>(168));
    out.slope = in.at<double>(176);
    out.intercept = in.at<double>(184);
    out.start = in.at<double>(216);
    out.description = in.text(240, 80);
    out.qform = in.at<std::int32_t>(344);
    out.sform = in.at<std::int32_t>(348);
    in.take<double>(352, out.quaternion);
    in.take<double>(376, out.shift);
    in.take<double>(400, out.rows);
    out.units = in.at<std::int32_t>(500);
    out.intent = in.at<std::int32_t>(504);
    out.intent_name = in.text(508, 16);
  } else {
    out.single = bytes[345] == '+';
    in.take<std::int16_t>(40, out.size);
    out.intent = in.at<std::int16_t>(68);
    out.type = in.at<std::int16_t>(70);
    out.bits = in.at<std::int16_t>(72);
    in.take<float>(76, out.spacing);
    out.offset = static_cast<double>(in.at<float>(108));
    out.slope = static_cast<double>(in.at<float>(112));
    out.intercept = static_cast<double>(in.at<float>(116));
    out.units = in.at<std::uint8_t>(123);
    out.start = static_cast<double>(in.at<float>(136));
    out.description = in.text(148, 80);
    out.qform = in.at<std::int16_t>(252);
    out.sform = in.at<std::int16_t>(254);
    in.take<float>(256, out.quaternion);
    in.take<float>(268, out.shift);
    in.take<float>(280, out.rows);
    out.intent_name = in.text(328, 16);
  }
  out.step = out.spacing[4];
  for (std::size_t i = 1; i < 8; ++i) {
    if (static_cast<std::int64_t>(i) > out.size[0]) out.size[i] = 1;
  }
  // In a single file, the values cannot begin within the header.
  if (out.single) out.offset = std::max(out.offset, length + 4.0);
  return out;
}

enum class Meaning : std::uint8_t { kScalar, kVector, kTensor };

class NiftiReader final : public Reader {
 public:
  explicit NiftiReader(const Request& request) : request_(request), file_(request.file.string()) {
    std::array<char, 540> bytes{};
    Unpacked in(request.file, request.file);
    const std::size_t there = in.readSome(bytes.data(), bytes.size());
    const std::string_view magic(bytes.data() + 344, 3);
    const bool second = magic != "n+1" && magic != "ni1";
    if (const std::size_t least = second ? 540U : 348U; there < least) {
      refuse(fmt::format("the NIfTI header is truncated: it has {} of {} bytes", there, least),
             "copy or export the file again");
    }
    header_ = headerFrom(bytes, second);
    if (header_.size[0] < 1 || header_.size[0] > 7) {
      refuse(fmt::format("the NIfTI header states {} dimensions (dim[0]), not 1 to 7",
                         header_.size[0]),
             kCheckWriter);
    }
    if (std::isnan(header_.offset)) {
      refuse("the offset of the voxels (vox_offset) is not a number", kCheckWriter);
    }
    classify();
    weigh();
    findDirections();
    if (series_ && !hasStep()) {
      notes_.emplace_back("the header has no valid time step (pixdim[4]): a step of 1 is assumed");
    }
  }

  [[nodiscard]] std::vector<double> times() const override {
    std::vector<double> times;
    if (!series_) return times;
    const double step = hasStep() ? header_.step : 1.0;
    const double start = std::isfinite(header_.start) ? header_.start : 0.0;
    for (std::int64_t i = 0; i < header_.size[4]; ++i) {
      times.push_back(start + step * static_cast<double>(i));
    }
    return times;
  }

  [[nodiscard]] std::optional<double> timeUnit() const override {
    switch (header_.units & 0x38) {
      case 8:
        return 1.0;
      case 16:
        return 1e-3;
      case 24:
        return 1e-6;
      default:
        return std::nullopt;
    }
  }

  Content read(std::size_t step) override {
    Content content;
    content.notes = notes_;
    Piece image;
    for (std::size_t a = 0; a < 3; ++a) image.size[a] = static_cast<int>(header_.size[a + 1]);
    image.file_from_index = place(content.notes);
    const Slab slices = slicesToRead(request_, image, isGzip(dataFile()));
    Values values =
        rescaled(readValues(series_ ? step : 0, slices), header_.slope, header_.intercept);
    if (meaning_ == Meaning::kTensor) {
      values = picked(values, as_components_ ? kUpperTriangle : kLowerTriangle);
    }
    if (as_components_) values = turned(values, fslFrame(image.file_from_index));
    const char* units[] = {"", "m", "mm", "um"};
    if ((header_.units & 7) < 4) content.length_unit = units[header_.units & 7];
    if (isDisplacement()) values = turned(values, fromItk(content.length_unit));
    const char* names[] = {"density", "vector", "tensor"};
    image.arrays.push_back({names[static_cast<int>(meaning_)], values, "", "", axial_});
    content.pieces.push_back(std::move(image));
    content.description = header_.description;
    content.patient = hasForm();
    return content;
  }

 private:
  [[noreturn]] void refuse(const std::string& why, const std::string& remedy) const {
    throw VolumeError(file_, why, remedy);
  }

  [[nodiscard]] bool isDisplacement() const { return request_.as == "displacement"; }
  [[nodiscard]] bool hasStep() const { return std::isfinite(header_.step) && header_.step > 0.0; }
  [[nodiscard]] bool hasForm() const { return header_.sform > 0 || header_.qform > 0; }

  /// Returns the map from ITK's vectors, which are along LPS in mm, to RAS in the file's unit.
  static Mat3 fromItk(const std::string& unit) {
    double per_mm = 1.0;
    if (unit == "m") per_mm = 1e-3;
    if (unit == "um") per_mm = 1e3;
    return Vec3(-per_mm, -per_mm, per_mm).asDiagonal();
  }

  /// Throws VolumeError if the header does not describe displacements as ITK writes them.
  void checkDisplacement() const {
    constexpr const char* kByItk =
        "export the field with ITK, ANTs or elastix (saving the field of another program in "
        "another format does not convert its vectors)";
    if (header_.size[5] != 3 ||
        (header_.intent != kDisplacementIntent && header_.intent != kVectorIntent)) {
      refuse(fmt::format("the header has the intent {} and the size {} along the fifth axis, but a "
                         "displacement field needs the intent 1006 or 1007 and the size 3",
                         header_.intent, header_.size[5]),
             kByItk);
    }
    if (header_.intent_name.starts_with("NREG_TRANS")) {
      refuse(
          "NiftyReg wrote the field; its vectors are not displacements along LPS in mm, as ITK "
          "writes them",
          "register with elastix or ANTs, or convert the vectors (saving the field in another "
          "format does not convert them)");
    }
    if (!hasForm()) {
      refuse(
          "the header has neither an sform nor a qform, so the axes of its displacements are "
          "unknown",
          "write the sform of the fixed image into the header, for example with fslorient");
    }
  }

  void classify() {
    const auto& size = header_.size;
    findType();
    if (size[6] != 1 || size[7] != 1) {
      refuse(fmt::format("the image has {} dimensions", size[0]),
             "export the image with 3, 4 or 5 dimensions");
    }
    series_ = size[4] > 1;
    if (size[4] == 3 && size[5] == 1 &&
        (header_.intent == kVectorIntent || header_.intent == kDisplacementIntent)) {
      // Some files store components as time steps, and state by the intent code that they are
      // components.
      header_.size[5] = 3;
      header_.size[4] = 1;
      series_ = false;
    }
    if (isDisplacement()) {
      checkDisplacement();
      meaning_ = Meaning::kVector;
      notes_.emplace_back(
          "components are read along x (left), y (back) and z (up) in mm, as ITK writes them");
      return;
    }
    if (size[5] > 1) {
      constexpr int kSymmetricMatrix = 1005;
      if (size[5] == 3) {
        meaning_ = Meaning::kVector;
      } else if (size[5] == 6 && (header_.intent == kSymmetricMatrix || request_.as == "tensor")) {
        meaning_ = Meaning::kTensor;
      } else {
        refuse(fmt::format("the image has {} values per voxel", size[5]),
               size[5] == 6 ? "add --as tensor if they are a symmetric matrix"
                            : "export one, three (a vector) or six (a symmetric matrix)");
      }
      notes_.emplace_back("components are read along x (right), y (front) and z (up)");
      return;
    }
    if (request_.as.empty()) return;
    const int expected = request_.as == "vector" ? 3 : 6;
    if (size[4] != expected) {
      refuse(fmt::format("the image has {} volumes, not the {} of a {}", size[4], expected,
                         request_.as),
             "omit --as");
    }
    as_components_ = true;
    series_ = false;
    meaning_ = request_.as == "vector" ? Meaning::kVector : Meaning::kTensor;
    notes_.push_back(std::string("components are read ") + kAsFsl);
  }

  /// Detects fibre directions, which FSL stores as three volumes, like a series: nearly all of the
  /// vectors that are not zero have length 1.
  void findDirections() {
    if (!series_ || header_.size[4] != 3 || header_.size[5] != 1 || !request_.as.empty()) return;
    if (type_ != Type::kFloat32 && type_ != Type::kFloat64) return;
    as_components_ = true;
    const Slab all{0, static_cast<int>(header_.size[3])};
    const Values values = rescaled(readValues(0, all), header_.slope, header_.intercept);
    std::size_t there = 0;
    std::size_t unit = 0;
    for (std::size_t i = 0; i < values.tuples(); ++i) {
      const Vec3 v(values.at(i, 0), values.at(i, 1), values.at(i, 2));
      if (v.squaredNorm() == 0.0) continue;
      ++there;
      unit += std::abs(v.norm() - 1.0) < 2e-3 ? 1 : 0;
    }
    constexpr double kNearlyAll = 0.99;
    as_components_ =
        there > 0 && static_cast<double>(unit) >= kNearlyAll * static_cast<double>(there);
    if (!as_components_) return;
    series_ = false;
    axial_ = true;
    meaning_ = Meaning::kVector;
    notes_.push_back(
        std::string("the three volumes are vectors of length 1: they are read as directions ") +
        kAsFsl + ", not as time steps");
  }

  void findType() {
    switch (header_.type) {
      case 2:
        type_ = Type::kUint8;
        break;
      case 4:
        type_ = Type::kInt16;
        break;
      case 8:
        type_ = Type::kInt32;
        break;
      case 16:
        type_ = Type::kFloat32;
        break;
      case 64:
        type_ = Type::kFloat64;
        break;
      case 256:
        type_ = Type::kInt8;
        break;
      case 512:
        type_ = Type::kUint16;
        break;
      case 768:
        type_ = Type::kUint32;
        break;
      case 1024:
        type_ = Type::kInt64;
        break;
      case 1280:
        type_ = Type::kUint64;
        break;
      case 128:
      case 2304:
        refuse("the values are colours, which palpate does not import",
               "export the image in grey values");
      case 32:
      case 1792:
      case 2048:
        refuse("the values are complex numbers, which palpate does not import",
               "export the magnitude");
      default:
        refuse(fmt::format("the type of the values (datatype {}) is unknown", header_.type),
               "export the image as short or float");
    }
    const auto bits = static_cast<int>(8 * Values(type_, 1, 0).bytesEach());
    if (header_.bits != bits) {
      refuse(fmt::format("the header states {} bits per value, but the type of the values has {}",
                         header_.bits, bits),
             kCheckWriter);
    }
  }

  /// Checks, before memory is allocated, that the file can hold the header's values.
  void weigh() const {
    const std::vector<double> sizes(header_.size.begin() + 1, header_.size.end());
    const double bytes = bytesOf(request_.file, sizes, header_.bits / 8.0);
    if (header_.offset < 0) {
      refuse(fmt::format("the offset of the voxels (vox_offset), {} bytes, is negative",
                         header_.offset),
             kCheckWriter);
    }
    const fs::path data = dataFile();
    const double least = bytes + header_.offset;
    checkHeld(request_.file, data, sizeOfData(request_.file, data, true),
              isGzip(data) ? leastDeflated(least) : least);
  }

  /// Returns the file with the values: name.img or name.img.gz if the header is name.hdr.
  [[nodiscard]] fs::path dataFile() const {
    fs::path data = request_.file;
    const bool packed = data.extension() == ".gz";
    if (packed) data.replace_extension();
    if (data.extension() != ".hdr") return request_.file;
    data.replace_extension(".img");
    std::error_code error;
    if (fs::exists(data, error)) return data;
    fs::path gz = data;
    gz += ".gz";
    return packed || fs::exists(gz, error) ? gz : data;
  }

  /// Reads a step. In the file, each component is a separate volume.
  [[nodiscard]] Values readValues(std::size_t step, const Slab& slices) {
    const auto& size = header_.size;
    const std::size_t slice = static_cast<std::size_t>(size[1]) * static_cast<std::size_t>(size[2]);
    const std::size_t points = slice * static_cast<std::size_t>(slices.count);
    const auto steps = static_cast<std::size_t>(size[4]);
    const std::size_t components =
        as_components_ ? steps : static_cast<std::size_t>(std::max<std::int64_t>(size[5], 1));
    const std::size_t stride = as_components_ ? 1 : steps;
    const fs::path data = dataFile();
    Unpacked in(request_.file, data);
    std::uint64_t at = 0;
    Values values;
    try {
      values = Values(type_, static_cast<int>(components), points);
      const std::size_t bytes = points * values.bytesEach();
      const auto read_volume = [&](std::size_t volume, char* to, const Progress& progress) {
        const std::size_t before = slice * (volume * static_cast<std::size_t>(size[3]) +
                                            static_cast<std::size_t>(slices.first));
        const auto first = static_cast<std::uint64_t>(header_.offset) + before * values.bytesEach();
        in.skip(first - at);
        in.read(to, bytes, progress);
        at = first + bytes;
      };
      if (components == 1) {
        read_volume(step, values.as<char>(), request_.progress);
      } else {
        Values plane(type_, 1, points);
        for (std::size_t c = 0; c < components; ++c) {
          read_volume(step + c * stride, plane.as<char>(), nullptr);
          visit(plane, [&](const auto* from) {
            using T = std::remove_const_t<std::remove_pointer_t<decltype(from)>>;
            T* to = values.as<T>() + c;
            for (std::size_t p = 0; p < points; ++p) to[p * components] = from[p];
          });
          if (request_.progress) {
            request_.progress(static_cast<double>(c + 1) / static_cast<double>(components));
          }
        }
      }
    } catch (const std::bad_alloc&) {
      // findDirections() reads all slices, also with --bricks.
      const bool reads_all = series_ && as_components_;
      refuse("the values need more memory than is free",
             remedyForMemory(request_, reads_all ? 1 : static_cast<int>(size[3]),
                             isGzip(data) ? "unpack it with gunzip" : ""));
    }
    // Verifies the checksum of the whole file once.
    if (!sound_) in.finish();
    sound_ = true;
    if (header_.swapped) swapBytes(values.data(), values.size(), values.bytesEach());
    return values;
  }

  [[nodiscard]] Affine place(std::vector<std::string>& notes) const {
    Affine map;
    const auto& rows = header_.rows;
    if (header_.sform > 0) {
      for (std::size_t r = 0; r < 3; ++r) {
        const auto row = static_cast<Eigen::Index>(r);
        for (std::size_t c = 0; c < 3; ++c) {
          map.linear(row, static_cast<Eigen::Index>(c)) = rows[4 * r + c];
        }
        map.origin[row] = rows[4 * r + 3];
      }
      return map;
    }
    if (header_.qform > 0) {
      const auto [b, c, d] = header_.quaternion;
      const double rest = 1.0 - (b * b + c * c + d * d);
      // If `rest` is 0, the rotation is by 180 degrees: the quaternion's first component is 0.
      Eigen::Quaterniond turn(std::sqrt(std::max(rest, 0.0)), b, c, d);
      map.linear = turn.normalized().toRotationMatrix();
      if (header_.spacing[0] < 0.0) map.linear.col(2) *= -1.0;
      map.origin = Vec3(header_.shift[0], header_.shift[1], header_.shift[2]);
    }
    for (int axis = 0; axis < 3; ++axis) {
      double spacing = std::abs(header_.spacing[static_cast<std::size_t>(axis) + 1]);
      if (!(spacing > 0.0)) {
        notes.push_back(fmt::format(
            "axis {}: the header has no valid spacing: a spacing of 1 is assumed", "xyz"[axis]));
        spacing = 1.0;
      }
      map.linear.col(axis) *= spacing;
    }
    return map;
  }

  /// Returns the axes of FSL's vectors: the file's voxel axes, with x mirrored if the axes are
  /// right-handed (fsl.fmrib.ox.ac.uk, "What conventions do the bvecs use?").
  static Mat3 fslFrame(const Affine& map) {
    Mat3 axes = map.linear;
    if (axes.determinant() > 0.0) axes.col(0) = -axes.col(0);
    axes.colwise().normalize();
    return axes;
  }

  Request request_;
  std::string file_;
  Header header_;
  Type type_ = Type::kFloat32;
  Meaning meaning_ = Meaning::kScalar;
  bool series_ = false;
  /// True if the fourth dimension counts components, not time steps.
  bool as_components_ = false;
  bool axial_ = false;  ///< True if vectors v and -v mean the same.
  bool sound_ = false;
  std::vector<std::string> notes_;
};

}  // namespace

std::unique_ptr<Reader> openNifti(const Request& request) {
  return std::make_unique<NiftiReader>(request);
}

}  // namespace palpate::importer
