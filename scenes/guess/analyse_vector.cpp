#include <algorithm>
#include <array>
#include <cmath>

#include "palpate/scenes/guess/analysis.h"
#include "palpate/scenes/guess/sampling.h"

namespace palpate::guess {
namespace {

struct VectorSample {
  openvdb::Vec3f value{0.0F};
  float curl = -1.0F;  ///< Magnitude of the curl; below 0: unknown.
  float jacobian = 0.0F;
};

/// The grid's axes, treated as orthogonal. Curl and Jacobian have the same magnitude along these
/// axes as in world space.
struct GridAxes {
  std::array<double, 3> edges;  ///< [units of the file]
  std::array<openvdb::Vec3d, 3> axes;
};

GridAxes axesOf(const openvdb::GridBase& grid) {
  GridAxes out{edgesOf(grid), {}};
  const openvdb::Vec3d origin = grid.transform().indexToWorld(openvdb::Vec3d(0.0));
  for (int axis = 0; axis < 3; ++axis) {
    openvdb::Vec3d p(0.0);
    p[axis] = 1.0;
    out.axes[static_cast<std::size_t>(axis)] = (grid.transform().indexToWorld(p) - origin).unit();
  }
  return out;
}

/// Returns the vector of a voxel, and its curl and Jacobian if all neighbours are known.
template <class Reader>
VectorSample sampleVector(const Reader& reader, const openvdb::Coord& c, const SuggestInput& input,
                          const GridAxes& own) {
  VectorSample sample;
  sample.value = reader.getValue(c);
  std::array<std::array<double, 3>, 3> j{};  // d v_row / d x_column
  for (int axis = 0; axis < 3; ++axis) {
    const auto near = neighboursOf(reader, c, axis, input);
    if (!near.known) return sample;
    const auto a = static_cast<std::size_t>(axis);
    const openvdb::Vec3d slope =
        (openvdb::Vec3d(near.after) - openvdb::Vec3d(near.before)) / (2.0 * own.edges[a]);
    for (std::size_t row = 0; row < 3; ++row) j[row][a] = slope.dot(own.axes[row]);
  }
  double norm = 0.0;
  for (const auto& row : j) norm += row[0] * row[0] + row[1] * row[1] + row[2] * row[2];
  const double curl = std::hypot(j[2][1] - j[1][2], j[0][2] - j[2][0], j[1][0] - j[0][1]);
  if (!std::isfinite(norm)) return sample;
  sample.curl = static_cast<float>(curl);
  sample.jacobian = static_cast<float>(std::sqrt(norm));
  return sample;
}

double fastestOf(const std::vector<VectorSample>& samples) {
  std::vector<float> speeds;
  for (const VectorSample& s : samples) {
    if (std::isfinite(s.value.length())) speeds.push_back(s.value.length());
  }
  std::sort(speeds.begin(), speeds.end());
  return percentile(speeds, 99.8);
}

/// Returns VectorAnalysis::turning of vectors longer than `still` with a curl >= `least`.
double coreOf(const std::vector<VectorSample>& samples, double still, double least) {
  double turning = 0.0;
  double changing = 0.0;
  for (const VectorSample& s : samples) {
    if (!(s.value.length() > still) || s.curl < 0.0F || s.curl < least) continue;
    turning += 0.5 * static_cast<double>(s.curl) * s.curl;
    changing += static_cast<double>(s.jacobian) * s.jacobian;
  }
  return changing > 0.0 ? turning / changing : 0.0;
}

}  // namespace

VectorAnalysis analyseVector(const SuggestInput& input) {
  // Slower voxels than this fraction of the greatest speed are noise, or zeros around the flow.
  constexpr double kStill = 0.01;
  // relative to the greatest speed; smaller differences are rounding errors
  constexpr double kRounding = 1e-6;
  constexpr float kLengthOne = 2e-3F;  // tolerance for a length of 1
  const GridAxes own = axesOf(*input.grid);
  const auto samples =
      withVectors(input, [&]<class R, class G>(std::type_identity<R>, std::type_identity<G>) {
        return gather<VectorSample, R, G>(input, kSuggestSamples,
                                          [&](const R& reader, const openvdb::Coord& c) {
                                            return sampleVector(reader, c, input, own);
                                          });
      });
  const double fastest = fastestOf(samples);
  VectorAnalysis flow;
  double turning = 0.0;
  double changing = 0.0;
  const openvdb::Vec3f* first = nullptr;
  for (const VectorSample& s : samples) {
    const double speed = s.value.length();
    if (!std::isfinite(speed)) continue;
    if (first == nullptr) first = &s.value;
    if ((s.value - *first).length() > kRounding * fastest) flow.constant = false;
    if (!(speed > kStill * fastest)) continue;
    flow.speed.push_back(static_cast<float>(speed));
    if (s.curl < 0.0F) continue;
    flow.curl.push_back(s.curl);
    turning += 0.5 * static_cast<double>(s.curl) * s.curl;
    changing += static_cast<double>(s.jacobian) * s.jacobian;
  }
  if (flow.speed.empty()) flow.constant = true;
  if (changing > 0.0) flow.turning = turning / changing;
  const auto is_unit = [](float length) { return std::abs(length - 1.0F) < kLengthOne; };
  flow.unit = static_cast<double>(std::count_if(flow.speed.begin(), flow.speed.end(), is_unit)) /
              std::max(1.0, static_cast<double>(flow.speed.size()));
  std::sort(flow.speed.begin(), flow.speed.end());
  std::sort(flow.curl.begin(), flow.curl.end());
  // The cores of vortices often fill less of a flow than the shear around them.
  constexpr double kFewest = 30.0;  // least number of voxels above the 99th percentile
  for (const double percent : {95.0, 99.0}) {
    if (percent > 95.0 && 0.01 * static_cast<double>(flow.curl.size()) < kFewest) break;
    const double core = coreOf(samples, kStill * fastest, percentile(flow.curl, percent));
    if (core <= flow.core) continue;
    flow.core = core;
    flow.core_percent = percent;
  }
  return flow;
}

}  // namespace palpate::guess
