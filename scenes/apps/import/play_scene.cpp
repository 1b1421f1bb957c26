#include "palpate/scenes/apps/import/play_scene.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "palpate/scenes/guess/scene_json.h"

namespace palpate::importer {
namespace {

/// Returns the number with `digits` significant digits.
double rounded(double value, int digits) {
  return std::stod(fmt::format("{:.{}g}", value, digits));
}

/// Returns increasing times [s], of which the first is 0. If the file's times do not increase, or
/// are too close or too far apart, the steps get a distance of 1 s.
std::vector<double> playTimes(const PlayedSteps& steps, std::vector<std::string>& notes) {
  const std::vector<double>& given = steps.times;
  const double unit = steps.unit.value_or(1.0);
  constexpr double kLeast = 1e-30;  // [s]
  constexpr double kMost = 1e30;    // [s]; beyond, rates and speeds could not be computed
  const bool is_finite = unit * (given.back() - given.front()) <= kMost;
  const bool ascends =
      is_finite && std::adjacent_find(given.begin(), given.end(), [&](double a, double b) {
                     return !(unit * (b - a) >= kLeast);
                   }) == given.end();
  if (!ascends) {
    notes.emplace_back(
        fmt::format("the times of the steps do not increase, or their distances are not from {:g} "
                    "s to {:g} s: the scene plays one step a second",
                    kLeast, kMost));
  } else if (!steps.unit) {
    notes.emplace_back(
        "the file states no unit of its times that palpate knows: the scene takes them as "
        "seconds");
  }
  constexpr int kDigits = 9;
  std::vector<double> times;
  for (std::size_t i = 0; i < given.size(); ++i) {
    times.push_back(ascends ? rounded((given[i] - given.front()) * unit, kDigits)
                            : static_cast<double>(i));
  }
  return times;
}

/// Returns true if all steps have equal distances, within kUneven.
bool isEven(const std::vector<double>& times) {
  constexpr double kUneven = 1e-4;  // relative to the distance: files round times to floats
  const double step = times.back() / static_cast<double>(times.size() - 1);
  for (std::size_t i = 0; i < times.size(); ++i) {
    if (std::abs(times[i] - step * static_cast<double>(i)) > kUneven * step) return false;
  }
  return true;
}

/// Returns the speed of play for distances of steps in ascending order: 1, the speed of the data,
/// unless the median step would take longer than 1 s or less than 0.01 s.
double speedFor(const std::vector<double>& distances) {
  constexpr double kLongest = 1.0;
  constexpr double kShortest = 0.01;
  constexpr double kComfortable = 0.2;  // [s]: time of the median step if the speed is not 1
  const double middle = distances[distances.size() / 2];
  if (middle >= kShortest && middle <= kLongest) return 1.0;
  return rounded(middle / kComfortable, 2);
}

}  // namespace

std::string playScene(const std::string& scene, const PlayedSteps& steps,
                      std::vector<std::string>& notes) {
  const std::vector<double> times = playTimes(steps, notes);
  std::vector<double> distances;
  for (std::size_t i = 1; i < times.size(); ++i) distances.push_back(times[i] - times[i - 1]);
  std::sort(distances.begin(), distances.end());
  const double speed = speedFor(distances);

  guess::Json frames;
  if (isEven(times)) {
    frames["rate"] = rounded(static_cast<double>(times.size() - 1) / times.back(), 6);
  } else {
    frames["times"] = times;
  }
  // The frames that play needs in memory (FrameSequence::neededFor), with a reserve for the data
  // that a volume adds to its grid.
  constexpr double kDefault = 1024.0;  // [MiB]
  constexpr double kReserve = 1.2;
  const double needed = std::min(static_cast<double>(times.size()),
                                 6.0 + std::ceil(0.05 * speed / distances.front()));
  const double budget =
      std::ceil(kReserve * needed * static_cast<double>(steps.largest) / (1024.0 * 1024.0));
  if (budget > kDefault) frames["budget_mb"] = budget;

  guess::Json json = guess::Json::parse(scene);
  for (auto& [name, volume] : json["volumes"].items()) {
    if (volume.contains("axial")) {
      volume["file"] = steps.file_of_guess;
      notes.push_back(fmt::format("{}: axial vectors cannot play: the scene keeps those of {}",
                                  name, steps.file_of_guess));
    } else {
      volume["frames"] = frames;
    }
  }
  json["play"] = guess::Json{{"speed", speed}, {"repeat", true}};
  if (speed != 1.0) {
    json["play"]["description"] =
        std::string("about 5 steps a second") +
        (steps.unit ? "; with the speed 1, the data change as in reality" : "");
  }
  return guess::indented(json) + "\n";
}

}  // namespace palpate::importer
