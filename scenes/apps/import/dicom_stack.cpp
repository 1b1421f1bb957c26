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
#include "palpate/scenes/apps/import/dicom_phases.h"

namespace palpate::importer {
namespace {

/// Largest deviation of a slice from its regular position, relative to the distance of slices.
constexpr double kUneven = 0.05;
/// Largest distance of images that count as at the same position, relative to a pixel's edge.
constexpr double kSamePlace = 1e-3;
/// Tolerance for equal and for perpendicular unit vectors, which files round.
constexpr double kSameDirection = 1e-3;

/// Converts from DICOM's patient axes (+x left, +y back) to RAS (+x right, +y front).
Vec3 toRas(const Vec3& lps) {
  return {-lps.x(), -lps.y(), lps.z()};
}

/// Describes the positions of slices for messages, along the axis nearest to their normal.
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

using Group = Slices;

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

/// Sorts each group by time. Returns the index in kTimeTags of the first tag whose value differs
/// between all images of each group; no value if there is none.
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

bool hasPlace(const File& file) {
  return std::any_of(file.slices.begin(), file.slices.end(),
                     [](const Slice& slice) { return slice.placed; });
}

/// Returns true for a screen save. A capture with a position and without colours counts as a slice,
/// because some programs write slices as captures.
bool isScreenSave(const File& file) {
  return file.is_screen_save || (file.is_capture && (file.is_colour || !hasPlace(file)));
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
    out.map = mapOf(groups, normal, ruler, out);
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

  /// Returns all images. Throws VolumeError unless they state their positions, are grey, and have
  /// equal size, spacing, orientation and format.
  std::vector<Slice> alike() const {
    std::vector<Slice> slices;
    std::vector<std::string> colour;
    std::size_t rescaled = 0;
    for (std::size_t f = 0; f < series_.files.size(); ++f) {
      if (series_.files[f]->is_colour) {
        colour.push_back(series_.files[f]->path.filename().string());
      }
      for (Slice slice : series_.files[f]->slices) {
        slice.file = f;
        if (slice.has_rescale) ++rescaled;
        slices.push_back(std::move(slice));
      }
    }
    if (!colour.empty()) {
      refuse(fmt::format("{} of {} files have colour images, such as {}", colour.size(),
                         series_.files.size(), colour.front()),
             "import the greyscale images from which they were made");
    }
    const auto placed = static_cast<std::size_t>(
        std::count_if(slices.begin(), slices.end(), [](const Slice& s) { return s.placed; }));
    if (placed == 0) {
      refuse(
          "the images do not state their position in the patient (position, orientation or pixel "
          "spacing is missing or invalid): they may be screen captures",
          "import the original series");
    }
    if (placed < slices.size()) {
      const auto stray = std::find_if(slices.begin(), slices.end(),
                                      [](const Slice& slice) { return !slice.placed; });
      refuse(fmt::format("{} of {} images do not state their position in the patient, such as {} "
                         "(position, orientation or pixel spacing is missing or invalid)",
                         slices.size() - placed, slices.size(), fileOf(*stray)),
             withoutStrayImages());
    }
    if (rescaled != 0 && rescaled != slices.size()) {
      const auto stray = std::find_if(slices.begin(), slices.end(),
                                      [](const Slice& slice) { return !slice.has_rescale; });
      refuse(fmt::format("only {} of {} images state the scale of their values (RescaleSlope and "
                         "RescaleIntercept); {} does not",
                         rescaled, slices.size(), fileOf(*stray)),
             "export the series again");
    }
    const auto same = [](const Slice& a, const Slice& b) {
      return a.format == b.format && (a.row - b.row).norm() < kSameDirection &&
             (a.column - b.column).norm() < kSameDirection &&
             std::abs(a.across - b.across) < kSameDirection * a.across &&
             std::abs(a.down - b.down) < kSameDirection * a.down;
    };
    using Sort = std::pair<const Slice*, std::size_t>;
    std::vector<Sort> sorts;
    for (const Slice& slice : slices) {
      auto at = std::find_if(sorts.begin(), sorts.end(),
                             [&](const auto& sort) { return same(*sort.first, slice); });
      if (at == sorts.end()) at = sorts.insert(sorts.end(), {&slice, 0});
      ++at->second;
    }
    const auto fewer = [](const Sort& a, const Sort& b) { return a.second < b.second; };
    const auto [fewest, most] = std::minmax_element(sorts.begin(), sorts.end(), fewer);
    if (most->second != slices.size()) {
      refuse(fmt::format("{} of {} images differ from the others in size, pixel spacing, "
                         "orientation or number format, such as {}: they may be localisers",
                         slices.size() - most->second, slices.size(), fileOf(*fewest->first)),
             withoutStrayImages());
    }
    return slices;
  }

  std::string fileOf(const Slice& slice) const {
    return series_.files[slice.file]->path.filename().string();
  }

  /// Returns the remedy for images that do not fit. Frames of a file cannot be removed.
  std::string withoutStrayImages() const {
    return series_.files.size() == 1 ? "export the series again without them"
                                     : "remove them from the folder";
  }

  /// Returns the remedy for several images at one position.
  std::string withOneImageEach() const {
    return series_.files.size() == 1 ? "export the series again with one image at each position"
                                     : "keep one image at each position";
  }

  /// Finds the times of the steps if there are several images at each position. Throws VolumeError
  /// if no tag states a different time for each of them.
  void separate(std::vector<Group>& groups, const Ruler& ruler, Stack& out) const {
    const auto fewer = [](const Group& a, const Group& b) { return a.size() < b.size(); };
    const auto [fewest, most] = std::minmax_element(groups.begin(), groups.end(), fewer);
    if (most->size() == 1) return;
    const Group& twice = *most;
    const std::size_t count = most->size();
    if (series_.files.size() == 1 && groups.size() == 1) {
      refuse(fmt::format("all {} images are at the same position", count),
             "give a file with images at several positions");
    }
    for (const Group& group : groups) {
      for (const Slice& slice : group) {
        const double same = kSamePlace * std::min(slice.across, slice.down);
        if ((slice.position - group.front().position).norm() > 2.0 * same) {
          refuse(fmt::format("two images lie side by side at {} mm: {} and {}", ruler.at(slice),
                             fileOf(group.front()), fileOf(slice)),
                 withOneImageEach());
        }
        for (std::size_t i = 0; i < kKindTags.size(); ++i) {
          if (slice.kinds[i] == group.front().kinds[i]) continue;
          refuse(fmt::format("{} images at {} mm differ in {}", group.size(), ruler.at(slice),
                             kKindTags[i].name),
                 "export each kind as a separate series");
        }
      }
    }
    const std::optional<std::size_t> tag = sortByTime(groups);
    if (!tag.has_value() || fewest->size() == 1) {
      refuse(fmt::format("{} images are at the same position, {} mm, such as {} and {}", count,
                         ruler.at(twice.front()), fileOf(twice[0]), fileOf(twice[1])),
             withOneImageEach());
    }
    if (fewest->size() != count) {
      refuse(fmt::format("time steps are missing: {} images are at {} mm, but {} at {} mm",
                         fewest->size(), ruler.at(fewest->front()), count, ruler.at(twice.front())),
             "copy or export all images of the series");
    }
    // Acquisition times are times of day, and step numbers may begin with 1, so the first value is
    // subtracted.
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
      const auto words = [](double seconds) {
        return seconds == 0.0 ? std::string("none") : fmt::format("{:.9g} s", seconds);
      };
      refuse(fmt::format("the files state different time steps (TemporalResolution): {} in {}, {} "
                         "in {}",
                         words(step), series_.files.front()->path.filename().string(),
                         words(file->time_step), file->path.filename().string()),
             "export the series again");
    }
    if (kind.seconds == 0.0 && !(step > 0.0)) {
      out.notes.emplace_back("the steps have numbers but no times: a time step of 1 s is assumed");
    }
  }

  /// Returns the transform. Its step between slices follows their positions, because a tilted
  /// gantry shears the volume. Sets `out.depths` if distances vary. Throws VolumeError if slices
  /// are missing or not on a line, or if the shear exceeds 80 degrees.
  Affine mapOf(const std::vector<Group>& groups, const Vec3& normal, const Ruler& ruler,
               Stack& out) const {
    const Slice& first = groups.front().front();
    Vec3 step = normal;
    if (groups.size() > 1) {
      step = stepOf(groups, ruler, out);
      const double tilt = std::acos(std::min(1.0, normal.dot(step) / step.norm()));
      const double degrees = tilt * 180.0 / std::acos(-1.0);
      if (degrees > 80.0) {
        refuse(
            fmt::format("the stack of slices is sheared by {:.0f} degrees, more than 80", degrees),
            "export the series again");
      }
      if (degrees > 0.1) {
        out.notes.push_back(
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

  Vec3 stepOf(const std::vector<Group>& groups, const Ruler& ruler, Stack& out) const {
    const Slice& first = groups.front().front();
    const Vec3 whole = groups.back().front().position - first.position;
    const double length = groups.back().front().depth - first.depth;
    const auto even = static_cast<double>(groups.size() - 1);
    std::vector<double> gaps;
    for (std::size_t i = 1; i < groups.size(); ++i) {
      gaps.push_back(groups[i].front().depth - groups[i - 1].front().depth);
    }
    checkMissing(groups, gaps, ruler);

    std::vector<double> sorted = gaps;
    const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>((sorted.size() - 1) / 2);
    std::nth_element(sorted.begin(), middle, sorted.end());
    bool is_even = std::all_of(gaps.begin(), gaps.end(), [&](double gap) {
      return std::abs(gap / *middle - 1.0) <= kUneven;
    });
    for (std::size_t i = 0; i < groups.size(); ++i) {
      const Slice& slice = groups[i].front();
      const double depth = slice.depth - first.depth;
      const Vec3 off = slice.position - first.position - whole * (depth / length);
      if (off.norm() > kUneven * whole.norm() / even) {
        refuse(
            fmt::format(
                "the slices are not on a line: the slice at {} mm is {:.3g} mm away from the line",
                ruler.at(slice), off.norm()),
            series_.files.size() == 1
                ? "export the slices before this slice and the others as two series"
                : "copy the slices before this slice to one folder and the others to another, and "
                  "import each folder");
      }
      const double deviation = depth - length * static_cast<double>(i) / even;
      is_even = is_even && std::abs(deviation) <= kUneven * length / even;
    }
    if (is_even) return whole / even;
    const auto [least, most] = std::minmax_element(gaps.begin(), gaps.end());

    const double steps = evenSteps(gaps, length);
    for (const Group& group : groups) {
      out.depths.push_back((group.front().depth - first.depth) / length * steps);
    }
    out.depths.back() = steps;
    const double scale = whole.norm() / length;  // along the line of slices, which may be tilted
    out.notes.push_back(fmt::format(
        "the slices are {:.4g} to {:.4g} mm apart: they are resampled every {:.4g} mm, linearly "
        "between slices",
        *least * scale, *most * scale, whole.norm() / steps));
    return whole / steps;
  }

  /// Returns the number of equal steps for slices at varying distances. The step is the smallest
  /// length that two successive gaps do not exceed: a single smaller gap is due to a displaced
  /// slice. There are at most kVoxelsPerPoint steps per gap.
  static double evenSteps(const std::vector<double>& gaps, double length) {
    double finest = gaps.size() == 1 ? gaps.front() : std::max(gaps[0], gaps[1]);
    for (std::size_t i = 1; i < gaps.size(); ++i) {
      finest = std::min(finest, std::max(gaps[i - 1], gaps[i]));
    }
    return std::round(
        std::min(length / finest, kVoxelsPerPoint * static_cast<double>(gaps.size())));
  }

  /// Returns the differences of successive image numbers, divided by the smallest difference and
  /// rounded down; empty if the numbers are unknown or out of order.
  static std::vector<double> jumpsOf(const std::vector<Group>& groups) {
    std::vector<double> jumps;
    for (std::size_t i = 1; i < groups.size(); ++i) {
      jumps.push_back(groups[i].front().number - groups[i - 1].front().number);
    }
    const bool is_falling = !jumps.empty() && jumps.front() < 0.0;
    for (double& jump : jumps) {
      jump = is_falling ? -jump : jump;
      if (!(jump > 0.0)) return {};
    }
    const double unit = *std::min_element(jumps.begin(), jumps.end());
    for (double& jump : jumps) jump = std::floor(jump / unit);
    return jumps;
  }

  /// Returns the number of slices missing in gap i. Slices are missing if the image numbers jump in
  /// the gap, and the gap is at least 1.5 times a neighbouring gap. Without numbers, the gap must
  /// be a multiple, at least twofold, of each neighbouring gap.
  static std::size_t missingIn(const std::vector<double>& gaps, const std::vector<double>& jumps,
                               std::size_t i) {
    std::vector<double> ratios;  // relative to the neighbouring gaps; for i = 0, i - 1 is not a gap
    for (const std::size_t beside : {i - 1, i + 1}) {
      if (beside < gaps.size()) ratios.push_back(gaps[i] / gaps[beside]);
    }
    if (ratios.empty()) return 0;
    const auto [least, most] = std::minmax_element(ratios.begin(), ratios.end());
    double times = jumps.empty() ? *least : std::min(jumps[i], std::round(*most));
    if (jumps.empty()) {
      const bool multiples = std::all_of(ratios.begin(), ratios.end(), [](double ratio) {
        return std::abs(ratio - std::round(ratio)) <= kUneven;
      });
      times = multiples ? std::round(times) : 0.0;
    }
    return times >= 2.0 ? static_cast<std::size_t>(times) - 1 : 0;
  }

  void checkMissing(const std::vector<Group>& groups, const std::vector<double>& gaps,
                    const Ruler& ruler) const {
    const std::vector<double> jumps = jumpsOf(groups);
    std::size_t missing = 0;
    std::optional<std::size_t> where;
    for (std::size_t i = 0; i < gaps.size(); ++i) {
      const std::size_t here = missingIn(gaps, jumps, i);
      if (here > 0 && !where.has_value()) where = i;
      missing += here;
    }
    if (!where.has_value()) return;
    refuse(fmt::format("slices are missing {}: {} of {}{}",
                       ruler.between(groups[*where].front(), groups[*where + 1].front()), missing,
                       groups.size() + missing, missing > 1 ? " in all" : ""),
           series_.files.size() == 1
               ? "export all images of the series"
               : "copy or export all images of the series; if none is missing, import the slices "
                 "before and after this gap from two folders");
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

std::string reasonAgainst(const Series& series) {
  const auto all = [&](const auto& is) {
    return std::all_of(series.files.begin(), series.files.end(),
                       [&](const File* file) { return file->damage.empty() && is(*file); });
  };
  if (all([](const File& file) { return file.is_localiser; })) return "a localiser";
  if (all(isScreenSave)) return "a screen save";
  if (all([](const File& file) { return !hasPlace(file); })) return "its images state no position";
  if (series.images == 1 && all([](const File&) { return true; })) return "a single image";
  return "";
}

const Series& chosen(const std::vector<Series>& all, const Request& request,
                     std::vector<std::string>& notes) {
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
  if (request.series.empty() && all.size() > 1) {
    std::vector<std::string> skipped;
    std::vector<const Series*> volumes;
    for (std::size_t i = 0; i < all.size(); ++i) {
      const std::string reason = reasonAgainst(all[i]);
      if (reason.empty()) {
        volumes.push_back(&all[i]);
      } else {
        skipped.push_back(fmt::format("skipped series {} in {}: {}", names[i],
                                      all[i].files.front()->path.filename().string(), reason));
      }
    }
    if (volumes.size() == 1) {
      notes.insert(notes.end(), skipped.begin(), skipped.end());
      return *volumes.front();
    }
  }
  if (fits.size() == 1) return *fits.front();
  const std::string list = fmt::format("{}", fmt::join(names, "; "));
  const std::string remedy = "choose a series with --series, by its number, UID or description";
  if (request.series.empty()) {
    const std::string problem = phasesOf(all).problem;
    throw VolumeError(
        request.file.string(),
        fmt::format(
            "the input has {} series ({}){}", all.size(), list,
            request.timed ? ", which are not the time steps of one volume: " + problem : ""),
        problem.empty() ? "import them as time steps with --time all, or " + remedy : remedy);
  }
  throw VolumeError(request.file.string(),
                    fmt::format("{} series matches \"{}\" ({})",
                                fits.empty() ? "no" : "more than one", request.series, list),
                    remedy);
}

Series withoutStrays(const Series& series, std::vector<std::string>& notes) {
  Series rest{series.uid, {}, 0};
  std::vector<const File*> strays;
  for (const File* file : series.files) {
    if (file->is_localiser || isScreenSave(*file)) {
      strays.push_back(file);
    } else {
      rest.files.push_back(file);
      rest.images += std::max<std::size_t>(1, file->slices.size());
    }
  }
  if (strays.empty() || rest.files.empty()) return series;
  notes.push_back(fmt::format("skipped {} of {} files, such as {}: {}", strays.size(),
                              series.files.size(), strays.front()->path.filename().string(),
                              strays.front()->is_localiser ? "a localiser" : "a screen save"));
  return rest;
}

Stack stackOf(const Series& series, const std::string& what) {
  return Stacker(series, what).stack();
}

}  // namespace palpate::importer
