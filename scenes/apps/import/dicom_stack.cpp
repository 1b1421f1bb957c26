#include "palpate/scenes/apps/import/dicom_stack.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <tuple>
#include <utility>

#include <Eigen/Geometry>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include "palpate/engine/error.h"

namespace palpate::importer {
namespace {

/// Largest deviation of a slice from its regular position, as a fraction of the distance between
/// slices.
constexpr double kUneven = 0.05;
/// Images belong to the same position if their distance is below this fraction of a pixel's edge.
constexpr double kSamePlace = 1e-3;
/// Tolerance for equal and for perpendicular unit vectors, because files round them.
constexpr double kSameDirection = 1e-3;

/// Converts DICOM's patient axes (+x left, +y back) to +x right, +y front.
Vec3 toRas(const Vec3& lps) {
  return {-lps.x(), -lps.y(), lps.z()};
}

/// Describes positions of slices for messages: the coordinate along the axis that is closest to the
/// slices' normal.
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

using Group = Slices;  ///< Slices at one position.

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

/// Sorts the slices of each group by time. Returns the index in kTimeTags of the tag that
/// distinguishes their times; no value if there is none.
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

  /// Returns all images. Throws VolumeError unless all have the same size, orientation and number
  /// format.
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
      refuse(fmt::format("{} of {} files have colour images", colour, series_.files.size()),
             "import the greyscale images from which they were made");
    }
    const auto placed = static_cast<std::size_t>(
        std::count_if(slices.begin(), slices.end(), [](const Slice& s) { return s.placed; }));
    if (placed == 0) {
      refuse("the images do not state their position in the patient: they may be screen captures",
             "import the original series");
    }
    if (placed < slices.size()) {
      refuse(fmt::format("{} of {} images do not state their position in the patient",
                         slices.size() - placed, slices.size()),
             "remove them from the folder");
    }
    if (rescaled != 0 && rescaled != slices.size()) {
      refuse(fmt::format("only {} of {} images state the scale of their values (RescaleSlope)",
                         rescaled, slices.size()),
             "export the series again");
    }
    // Compares all images with the format that most images have.
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
      refuse(fmt::format("{} of {} images differ from the others in size, orientation or number "
                         "format: they may be localisers",
                         slices.size() - most, slices.size()),
             "remove them from the folder");
    }
    return slices;
  }

  std::string fileOf(const Slice& slice) const {
    return series_.files[slice.file]->path.filename().string();
  }

  /// Checks that several images at each position are time steps, and sets their times. Throws
  /// VolumeError if they are not.
  void separate(std::vector<Group>& groups, const Ruler& ruler, Stack& out) const {
    const auto fewer = [](const Group& a, const Group& b) { return a.size() < b.size(); };
    const auto [fewest, most] = std::minmax_element(groups.begin(), groups.end(), fewer);
    if (most->size() == 1) return;
    const Group& twice = *most;
    const std::size_t count = most->size();
    if (series_.files.size() == 1 && groups.size() == 1) {
      refuse(fmt::format("all {} images are at the same position", count), "give a volume");
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
          refuse(fmt::format("{} images at each position differ in {}", count, kKindTags[i].name),
                 "export each kind as a separate series");
        }
      }
    }
    const std::optional<std::size_t> tag = sortByTime(groups);
    if (!tag.has_value() || fewest->size() == 1) {
      refuse(fmt::format("{} images are at the same position, {} mm, such as {} and {}", count,
                         ruler.at(twice.front()), fileOf(twice[0]), fileOf(twice[1])),
             "remove all but one");
    }
    if (fewest->size() != count) {
      refuse(fmt::format("time steps are missing: {} images are at {} mm, but {} at {} mm",
                         fewest->size(), ruler.at(fewest->front()), count, ruler.at(twice.front())),
             "copy or export all images of the series");
    }
    // Acquisition times are times of day. Subtracts the first one.
    const TimeTag& kind = kTimeTags[*tag];
    const double step = series_.files.front()->time_step;
    const double start = kind.tag == DC::AcquisitionTime || kind.seconds == 0.0
                             ? groups.front().front().times[*tag]
                             : 0.0;
    for (const Slice& slice : groups.front()) {
      const double time = slice.times[*tag] - start;
      out.times.push_back(time * (kind.seconds > 0.0 ? kind.seconds : step > 0.0 ? step : 1.0));
    }
    for (const File* file : series_.files) {
      if (kind.seconds > 0.0 || file->time_step == step) continue;
      refuse(fmt::format("the files state different time steps: {:.4g} s in {}, {:.4g} s in {}",
                         step, series_.files.front()->path.filename().string(), file->time_step,
                         file->path.filename().string()),
             "export the series again");
    }
    if (kind.seconds == 0.0 && !(step > 0.0)) {
      out.notes.emplace_back("the steps have numbers but no times: a time step of 1 s is assumed");
    }
  }

  /// Computes the transform from voxels to positions. Throws VolumeError if slices are missing or
  /// unevenly spaced. The step between slices follows their positions instead of the normal,
  /// because a tilted gantry shears the volume.
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
          refuse(
              fmt::format(
                  "the slices are not evenly spaced on a line: the slice at {} mm is {:.3g} mm off",
                  ruler.at(slice), (slice.position - even).norm()),
              "resample the series to evenly spaced slices");
        }
      }
      const double tilt = std::acos(std::min(1.0, normal.dot(step) / step.norm()));
      const double degrees = tilt * 180.0 / std::acos(-1.0);
      if (degrees > 80.0) {
        refuse(
            fmt::format("the stack of slices is sheared by {:.0f} degrees, more than 80", degrees),
            "export the series again");
      }
      if (degrees > 0.1) {
        notes.push_back(
            fmt::format("the stack of slices is sheared by {:.1f} degrees, as from a tilted "
                        "gantry: the volume has the same shear",
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
    // For an even number of gaps, takes the lower of the two middle ones: a larger gap may be due
    // to missing slices.
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
            fmt::format("the spacing of the slices is uneven: {:.4g} mm {}, {:.4g} mm elsewhere",
                        gaps[i], ruler.between(groups[i].front(), groups[i + 1].front()), common),
            "resample the series to evenly spaced slices, or copy all of its images");
      }
      if (times < 2.0) continue;
      if (!where.has_value()) where = i;
      missing += static_cast<std::size_t>(times) - 1;
    }
    if (!where.has_value()) return;
    refuse(fmt::format("slices are missing {}: {} of {}{}",
                       ruler.between(groups[*where].front(), groups[*where + 1].front()), missing,
                       groups.size() + missing, missing > 1 ? " in all" : ""),
           "copy or export all images of the series");
  }

  const Series& series_;
  std::string what_;
};

}  // namespace

std::string nameOf(std::size_t number, const Series& series) {
  const File& first = *series.files.front();
  return fmt::format("{}: \"{}\" {} {}", number, first.description, first.modality,
                     series.images == 1 ? "1 image" : fmt::format("{} images", series.images));
}

/// Sorts the series by series number, then by UID.
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

/// Compares the request with the number, the UID and the description of each series.
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
  const char* remedy = "choose a series with --series, by its number, UID or description";
  if (request.series.empty()) {
    throw VolumeError(request.file.string(),
                      fmt::format("the input has {} series ({})", all.size(), list), remedy);
  }
  throw VolumeError(request.file.string(),
                    fmt::format("{} series matches \"{}\" ({})",
                                fits.empty() ? "no" : "more than one", request.series, list),
                    remedy);
}

Stack stackOf(const Series& series, const std::string& what) {
  return Stacker(series, what).stack();
}

}  // namespace palpate::importer
