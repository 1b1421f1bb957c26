/// Reads MINC 1: images in classic netCDF with a patient's axes. Source: Neelin and others, The
/// MINC file format (Montreal Neurological Institute, 1998).
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/netcdf_file.h"
#include "palpate/scenes/apps/import/read_netcdf.h"

namespace palpate::importer {
namespace {

constexpr std::array<const char*, 3> kAxes{"xspace", "yspace", "zspace"};

[[noreturn]] void refuseMinc(const Request& request, const std::string& why) {
  throw VolumeError(request.file.string(), why,
                    "export it again, or convert it to NIfTI with mnc2nii");
}

/// Sets the size and the transform of an image. The last dimension in the file is i.
void placeImage(const Request& request, const NetcdfFile& file, const Variable& image,
                Piece& piece) {
  if (image.dimensions.size() != 3) {
    refuseMinc(request,
               fmt::format("the MINC image has {} dimensions, not 3", image.dimensions.size()));
  }
  std::array<bool, 3> taken{};
  for (std::size_t a = 0; a < 3; ++a) {
    const Dimension& dimension = file.dimension(image.dimensions[2 - a]);
    const auto found = std::find(kAxes.begin(), kAxes.end(), dimension.name);
    const auto axis = static_cast<std::size_t>(found - kAxes.begin());
    if (found == kAxes.end() || std::exchange(taken[axis], true)) {
      refuseMinc(request, fmt::format("the MINC image has the dimension \"{}\" instead of the axes "
                                      "x, y and z",
                                      dimension.name));
    }
    if (dimension.length > static_cast<std::size_t>(std::numeric_limits<int>::max())) {
      refuseMinc(request,
                 fmt::format("the dimension {} has {} points, more than {}", dimension.name,
                             dimension.length, std::numeric_limits<int>::max()));
    }
    piece.size[a] = static_cast<int>(dimension.length);
    const int v = file.variableNamed(dimension.name);
    if (file.text(v, "spacing") == "irregular") {
      refuseMinc(request, fmt::format("the distances along {} are irregular", dimension.name));
    }
    const auto first = [&](const char* name, double otherwise) {
      const std::vector<double> numbers = file.numbers(v, name);
      return numbers.empty() ? otherwise : numbers.front();
    };
    Vec3 direction = Vec3::Unit(static_cast<Eigen::Index>(axis));
    if (const auto given = file.numbers(v, "direction_cosines"); given.size() == 3) {
      direction = Vec3(given[0], given[1], given[2]);
    }
    piece.file_from_index.linear.col(static_cast<Eigen::Index>(a)) = first("step", 1.0) * direction;
    piece.file_from_index.origin += first("start", 0.0) * direction;
  }
}

/// Converts stored numbers to values. Floating-point numbers are the values. For integers, maps the
/// valid range linearly to the range from image-min to image-max, which a file states for the whole
/// image, each slice or each row.
class MincScale {
 public:
  MincScale(const Request& request, const NetcdfFile& file, int v) {
    const Variable& image = file.variable(v);
    real_ = image.type == NC_FLOAT || image.type == NC_DOUBLE;
    if (real_) return;
    const double bits = image.type == NC_BYTE ? 8.0 : image.type == NC_SHORT ? 16.0 : 32.0;
    const std::string sign = file.text(v, "signtype");
    const bool is_unsigned = sign.empty() ? image.type == NC_BYTE : sign.starts_with("unsigned");
    if (is_unsigned) turn_ = std::exp2(bits);
    low_ = is_unsigned ? 0.0 : -std::exp2(bits - 1.0);
    high_ = low_ + std::exp2(bits) - 1.0;
    if (const auto range = file.numbers(v, "valid_range"); range.size() == 2) {
      std::array<double, 2> ends{unsignedOf(range[0]), unsignedOf(range[1])};
      std::sort(ends.begin(), ends.end());
      if (ends[0] < ends[1]) std::tie(low_, high_) = std::tie(ends[0], ends[1]);
    }
    least_ = read(request, file, image, "image-min", 0.0);
    most_ = read(request, file, image, "image-max", 1.0);
    if (least_.size() != most_.size()) {
      refuseMinc(request,
                 "image-min and image-max have different dimensions, or one of them is missing");
    }
  }

  [[nodiscard]] bool isReal() const { return real_; }
  /// Returns the value of a number stored in row j of slice k; an image has `rows` rows. Returns
  /// NaN for an integer outside the valid range.
  [[nodiscard]] double operator()(double stored, std::size_t k, std::size_t j,
                                  std::size_t rows) const {
    if (real_) return stored;
    const double value = unsignedOf(stored);
    if (value < low_ || value > high_) return std::numeric_limits<double>::quiet_NaN();
    const std::size_t n = rank_ == 0 ? 0 : rank_ == 1 ? k : k * rows + j;
    return least_[n] + (value - low_) / (high_ - low_) * (most_[n] - least_[n]);
  }

 private:
  [[nodiscard]] double unsignedOf(double stored) const {
    return stored < 0.0 ? stored + turn_ : stored;
  }
  /// Reads image-min or image-max. Without this variable, returns `otherwise`.
  std::vector<double> read(const Request& request, const NetcdfFile& file, const Variable& image,
                           const char* name, double otherwise) {
    const int v = file.variableNamed(name);
    if (v < 0) return {otherwise};
    const std::vector<int>& own = file.variable(v).dimensions;
    if (own.size() > 2 || !std::equal(own.begin(), own.end(), image.dimensions.begin())) {
      refuseMinc(
          request,
          fmt::format("the dimensions of {} are not the first one or two of the image", name));
    }
    rank_ = own.size();
    std::vector<std::size_t> count;
    double total = 1.0;
    for (const int d : own) {
      count.push_back(file.dimension(d).length);
      total *= static_cast<double>(count.back());
    }
    file.checkAbsurd(total);
    std::vector<double> out(static_cast<std::size_t>(total));
    file.read(v, std::vector<std::size_t>(own.size(), 0), count, out.data());
    return out;
  }

  bool real_ = false;
  double turn_ = 0.0;  ///< 2^bits, added to negative numbers of an unsigned type.
  double low_ = 0.0;
  double high_ = 1.0;
  std::size_t rank_ = 0;  ///< Number of dimensions of image-min and image-max.
  std::vector<double> least_;
  std::vector<double> most_;
};

Content readMinc(const Request& request) {
  const NetcdfFile file(request.file);
  const int v = file.variableNamed("image");
  const Variable& image = file.variable(v);
  Content content;
  Piece piece;
  placeImage(request, file, image, piece);
  const MincScale scale(request, file, v);
  const auto columns = static_cast<std::size_t>(piece.size[0]);
  const auto rows = static_cast<std::size_t>(piece.size[1]);
  file.checkAbsurd(static_cast<double>(columns) * static_cast<double>(rows) *
                   static_cast<double>(piece.size[2]));
  const Slab slices = slicesToRead(request, piece);
  const bool is_float = image.type == NC_FLOAT || image.type == NC_BYTE || image.type == NC_SHORT;
  Values values(is_float ? Type::kFloat32 : Type::kFloat64, 1,
                columns * rows * static_cast<std::size_t>(slices.count));
  std::vector<double> plane(columns * rows);
  visit(values, [&](auto* to) {
    using T = std::remove_pointer_t<decltype(to)>;
    for (int s = slices.first; s < slices.end(); ++s) {
      const auto k = static_cast<std::size_t>(s);
      file.read(v, {k, 0, 0}, {1, rows, columns}, plane.data());
      for (std::size_t n = 0; n < plane.size(); ++n) {
        *to++ = static_cast<T>(scale(plane[n], k, n / columns, rows));
      }
      if (request.progress) request.progress(static_cast<double>(s + 1) / slices.end());
    }
  });
  piece.arrays.push_back({"image", std::move(values), file.text(v, "units"), ""});
  content.pieces.push_back(std::move(piece));
  content.patient = true;
  content.length_unit = "mm";
  if (const int study = file.variableNamed("study"); study >= 0) {
    const std::string modality = file.text(study, "modality");
    if (modality.starts_with("CT")) content.modality = Modality::kCt;
    if (modality.starts_with("MR")) content.modality = Modality::kMr;
  }
  return content;
}

}  // namespace

std::unique_ptr<Reader> openMinc(const Request& request) {
  const NetcdfFile file(request.file);
  if (file.variableNamed("image") < 0) return nullptr;
  const bool axes = std::all_of(kAxes.begin(), kAxes.end(),
                                [&](const char* name) { return file.dimensionNamed(name) >= 0; });
  return axes ? oneStep(request, readMinc) : nullptr;
}

}  // namespace palpate::importer
