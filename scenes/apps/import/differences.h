/// Private to the importer: sums differences between values before and after resampling.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "palpate/scenes/apps/import/resample.h"

namespace palpate::importer {

struct Differences {
  struct Sum {
    double squares = 0.0;
    double largest = 0.0;
    std::uint64_t points = 0;

    void add(double difference) {
      squares += difference * difference;
      largest = std::max(largest, difference);
      ++points;
    }
    [[nodiscard]] double rms() const {
      return points == 0 ? 0.0 : std::sqrt(squares / static_cast<double>(points));
    }
  };
  Sum within;
  Sum edge;  ///< Differences at points beside voxels without data.
  std::uint64_t lost_points = 0;

  [[nodiscard]] ResamplingError relativeTo(double range) const {
    ResamplingError error;
    error.points = within.points;
    error.edge_points = edge.points;
    error.lost_points = lost_points;
    if (!(range > 0.0)) return error;
    error.rms = within.rms() / range;
    error.largest = within.largest / range;
    error.edge_rms = edge.rms() / range;
    error.edge_largest = edge.largest / range;
    return error;
  }
};

}  // namespace palpate::importer
