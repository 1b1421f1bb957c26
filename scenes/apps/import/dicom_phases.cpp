#include "palpate/scenes/apps/import/dicom_phases.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <optional>

#include <fmt/format.h>

namespace palpate::importer {
namespace {

/// A series, and its number in lists for the user.
struct Candidate {
  Series series;
  std::size_t number = 0;
  double key = kUnsaid;  ///< Time or phase, by which the series are sorted; NaN: not stated.
  double end = kUnsaid;  ///< AcquisitionTime of the last image [s]; NaN: not used.
};

std::size_t indexOf(DC::EnumType tag) {
  const auto* const at = std::find_if(kTimeTags.begin(), kTimeTags.end(),
                                      [&](const TimeTag& t) { return t.tag == tag; });
  return static_cast<std::size_t>(at - kTimeTags.begin());
}

Slices slicesOf(const Series& series) {
  Slices slices;
  for (const File* file : series.files) {
    slices.insert(slices.end(), file->slices.begin(), file->slices.end());
  }
  return slices;
}

/// Returns the value of a tag that is the same in all images; NaN if they differ.
double commonTime(const Series& series, std::size_t tag) {
  const Slices slices = slicesOf(series);
  const double first = slices.empty() ? kUnsaid : slices.front().times[tag];
  const bool is_same = std::all_of(slices.begin(), slices.end(),
                                   [&](const Slice& s) { return s.times[tag] == first; });
  return is_same ? first : kUnsaid;
}

/// Returns the number before the first "%" that follows a number; NaN if there is none.
double percentIn(const std::string& text) {
  for (std::size_t end = text.find('%'); end != std::string::npos; end = text.find('%', end + 1)) {
    std::size_t last = end;
    while (last > 0 && text[last - 1] == ' ') --last;
    std::size_t first = last;
    while (first > 0 && (std::isdigit(static_cast<unsigned char>(text[first - 1])) != 0 ||
                         text[first - 1] == '.')) {
      --first;
    }
    double value = kUnsaid;
    const char* stop = text.data() + last;
    const auto parsed = std::from_chars(text.data() + first, stop, value);
    if (parsed.ec == std::errc() && parsed.ptr == stop) return value;
  }
  return kUnsaid;
}

/// Returns the difference of two series that cannot be steps of one volume; "" if they can.
std::string differenceOf(const Series& a, const Series& b) {
  const File& first = *a.files.front();
  const File& second = *b.files.front();
  if (first.modality != second.modality) return "modality";
  if (first.frame_of_reference != second.frame_of_reference) return "frame of reference";
  Slices one = slicesOf(a);
  Slices other = slicesOf(b);
  if (one.size() != other.size()) return "number of images";
  const Vec3 normal = one.front().row.cross(one.front().column);
  for (Slices* slices : {&one, &other}) {
    for (Slice& slice : *slices) slice.depth = normal.dot(slice.position);
    std::stable_sort(slices->begin(), slices->end(),
                     [](const Slice& p, const Slice& q) { return p.depth < q.depth; });
  }
  constexpr double kSame = 1e-3;  // relative to a pixel's edge, or of unit vectors
  for (std::size_t i = 0; i < one.size(); ++i) {
    const Slice& p = one[i];
    const Slice& q = other[i];
    if (p.format[0] != q.format[0] || p.format[1] != q.format[1]) return "size of the images";
    const double same = kSame * std::min(p.across, p.down);
    if (!p.placed || !q.placed || (p.position - q.position).norm() > same) return "positions";
    if ((p.row - q.row).norm() > kSame || (p.column - q.column).norm() > kSame) {
      return "orientation";
    }
    if (std::abs(p.across - q.across) > same || std::abs(p.down - q.down) > same) {
      return "pixel spacing";
    }
  }
  return "";
}

/// Sorts by the keys. Returns the numbers of two series with the same key, if there are any.
std::optional<std::pair<std::size_t, std::size_t>> sortByKey(std::vector<Candidate>& candidates) {
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return a.key < b.key; });
  const auto twice =
      std::adjacent_find(candidates.begin(), candidates.end(),
                         [](const Candidate& a, const Candidate& b) { return a.key == b.key; });
  if (twice == candidates.end()) return std::nullopt;
  return std::pair{twice->number, (twice + 1)->number};
}

/// Sets the keys, and erases candidates without a key, if at least two have one. Otherwise changes
/// nothing and returns false.
template <class Key>
bool keepKeyed(std::vector<Candidate>& candidates, std::vector<std::string>& notes,
               const Key& key) {
  std::vector<Candidate> keyed;
  std::vector<std::string> skipped;
  for (const Candidate& candidate : candidates) {
    keyed.push_back(candidate);
    keyed.back().key = key(candidate.series);
    if (!std::isnan(keyed.back().key)) continue;
    skipped.push_back(fmt::format("skipped series {}: it states no phase or time",
                                  nameOf(candidate.number, candidate.series)));
    keyed.pop_back();
  }
  if (keyed.size() < 2) return false;
  candidates = std::move(keyed);
  notes.insert(notes.end(), skipped.begin(), skipped.end());
  return true;
}

/// Sets each key to the earliest AcquisitionTime of the series [s]. Returns false unless all images
/// state it.
bool setAcquisitionTimes(std::vector<Candidate>& candidates) {
  const std::size_t tag = indexOf(DC::AcquisitionTime);
  for (Candidate& candidate : candidates) {
    const Slices slices = slicesOf(candidate.series);
    const auto [first, last] = std::minmax_element(
        slices.begin(), slices.end(),
        [&](const Slice& a, const Slice& b) { return a.times[tag] < b.times[tag]; });
    const bool all = std::none_of(slices.begin(), slices.end(),
                                  [&](const Slice& s) { return std::isnan(s.times[tag]); });
    if (!all) return false;
    candidate.key = first->times[tag];
    candidate.end = last->times[tag];
  }
  return true;
}

/// How the steps' times follow from the keys.
struct Clock {
  double seconds = 0.0;  ///< Unit of the keys [s]; 0: the keys are only numbers.
  bool by_rank = false;  ///< True if the steps are numbered in the order of the keys.
};

/// Finds the keys of the steps, and sorts the candidates by key. Sets `problem` if two candidates
/// have equal keys, or if keys are missing.
Clock sortSteps(std::vector<Candidate>& candidates, Phases& out) {
  const auto distinct = [&](const char* what) {
    if (const auto twice = sortByKey(candidates)) {
      out.problem =
          fmt::format("series {} and {} have the same {}", twice->first, twice->second, what);
    }
  };
  for (std::size_t tag = 0; tag < kTimeTags.size(); ++tag) {
    if (kTimeTags[tag].tag == DC::AcquisitionTime) continue;
    std::vector<Candidate> tried = candidates;
    std::vector<std::string> notes;
    const bool is_keyed =
        keepKeyed(tried, notes, [&](const Series& series) { return commonTime(series, tag); });
    if (!is_keyed || sortByKey(tried)) continue;
    candidates = std::move(tried);
    out.notes.insert(out.notes.end(), notes.begin(), notes.end());
    return {kTimeTags[tag].seconds, false};
  }
  if (keepKeyed(candidates, out.notes, [](const Series& series) {
        return percentIn(series.files.front()->description);
      })) {
    distinct("percentage");
    return {0.0, true};
  }
  if (!setAcquisitionTimes(candidates)) {
    out.problem = "they state neither a phase nor a time";
    return {};
  }
  distinct("acquisition time");
  const auto overlap =
      std::adjacent_find(candidates.begin(), candidates.end(),
                         [](const Candidate& a, const Candidate& b) { return a.end >= b.key; });
  return {1.0, overlap != candidates.end()};
}

}  // namespace

Phases phasesOf(const std::vector<Series>& all) {
  Phases out;
  std::vector<Candidate> candidates;
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (const std::string reason = reasonAgainst(all[i]); !reason.empty()) {
      out.notes.push_back(fmt::format("skipped series {}: {}", nameOf(i + 1, all[i]), reason));
      continue;
    }
    candidates.push_back({withoutStrays(all[i], out.notes), i + 1});
  }
  if (candidates.size() < 2) return {{}, {}, "fewer than two of them can be a volume"};
  for (const Candidate& candidate : candidates) {
    for (const File* file : candidate.series.files) {
      if (file->damage.empty()) continue;
      return {{}, {}, fmt::format("{}: {}", file->path.filename().string(), file->damage)};
    }
  }
  const Clock clock = sortSteps(candidates, out);
  for (const Candidate& candidate : candidates) {
    const std::string difference = differenceOf(candidates.front().series, candidate.series);
    if (!out.problem.empty() || difference.empty()) continue;
    out.problem = fmt::format("series {} and {} differ in {}", candidates.front().number,
                              candidate.number, difference);
  }
  if (!out.problem.empty()) return {{}, {}, out.problem};

  const bool has_times = clock.seconds > 0.0 && !clock.by_rank;
  const std::size_t tag =
      indexOf(has_times ? DC::TemporalPositionTimeOffset : DC::TemporalPositionIdentifier);
  const double start = candidates.front().key;
  for (std::size_t rank = 0; rank < candidates.size(); ++rank) {
    const double key = candidates[rank].key - start;
    const double time = clock.by_rank ? static_cast<double>(rank)
                        : has_times   ? key * clock.seconds
                                      : key;
    for (const File* file : candidates[rank].series.files) {
      out.files.push_back(*file);
      out.files.back().series = candidates.front().series.uid;
      for (Slice& slice : out.files.back().slices) {
        slice.times.fill(kUnsaid);
        slice.times[tag] = time;
      }
    }
  }
  return out;
}

}  // namespace palpate::importer
