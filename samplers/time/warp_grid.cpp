#include "palpate/samplers/time/warp_grid.h"

#include <algorithm>
#include <cmath>
#include <mutex>
#include <sstream>
#include <utility>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>

#include "palpate/engine/error.h"
#include "palpate/samplers/parallel.h"

namespace palpate {
namespace {

constexpr std::size_t kAxes = 3;
/// Number of floats stored for one vector. The last of the four is unused.
constexpr std::size_t kLanes = 4;
using Lanes = Eigen::Array4f;
/// Number of times per interval between two frames at which a warp is checked.
constexpr std::size_t kParts = 4;
/// Largest factor by which a warp may stretch or compress material.
constexpr double kMostStretch = 10.0;
/// Number of floats stored for each node and frame: u and the rate of u.
constexpr std::size_t kNumbers = 2 * kLanes;
/// Two intervals count as equal if the shorter is at least this share of the longer. So times that
/// are rounded, for example to milliseconds, still have even steps.
constexpr double kEven = 0.9;

/// Quadratic B-spline weights of three neighbouring nodes, with their first and second derivatives.
/// `t`: distance from the middle node, |t| <= 1/2 [nodes].
struct Weights {
  explicit Weights(double t)
      : value{0.5 * (0.5 - t) * (0.5 - t), 0.75 - t * t, 0.5 * (0.5 + t) * (0.5 + t)},
        slope{t - 0.5, -2.0 * t, t + 0.5} {}
  std::array<double, 3> value;
  std::array<double, 3> slope;
  std::array<double, 3> bend{1.0, -2.0, 1.0};
};

/// Weights of u and of its rate in two neighbouring frames, and the weights' time derivatives.
struct Moment {
  std::size_t frame = 0;  ///< The earlier of the two frames.
  std::array<double, 4> value{1.0, 0.0, 0.0, 0.0};
  std::array<double, 4> rate{};
};

/// Returns the rate of a number in a frame: the slope of the parabola through the frame and its two
/// neighbours. d0 and d1 are the mean rates in the intervals h0 [s] before and h1 [s] after the
/// frame. If the intervals differ, that parabola may turn within an interval, and the cubic would
/// overshoot its frames. The limits of Fritsch and Carlson (SIAM J. Numer. Anal. 17, 1980) keep the
/// cubic monotone: the rate is 0 at a turning point and beside an interval of rest. Elsewhere it is
/// at most three times the smaller mean rate.
double rateOf(double d0, double d1, double h0, double h1) {
  const double parabola = (d0 * h1 + d1 * h0) / (h0 + h1);
  if (std::min(h0, h1) >= kEven * std::max(h0, h1)) return parabola;
  if (!(d0 * d1 > 0.0)) return 0.0;
  const double most = 3.0 * std::min(std::abs(d0), std::abs(d1));
  return std::clamp(parabola, -most, most);
}

class GridWarp final : public Warp {
 public:
  GridWarp(const DisplacementFrames& of, const WarpTimes& when)
      : size_(of.size),
        padded_{of.size[0] + 2, of.size[1] + 2, of.size[2] + 2},
        count_(of.frames.size()),
        second_(count_ > 1 ? kNumbers : 0),
        times_(when.times),
        repeat_(when.repeat),
        origin_(of.origin),
        index_from_rest_(of.axes.inverse()) {
    nodes_.resize(static_cast<std::size_t>(padded_[0]) * static_cast<std::size_t>(padded_[1]) *
                  static_cast<std::size_t>(padded_[2]) * count_ * kNumbers);
    inParallel(count_, [&](std::size_t frame) { take(of.frames[frame], frame); });
    takeRates();
  }

  [[nodiscard]] Displacement at(const Vec3& x, double time) const noexcept override {
    const Vec3 index = index_from_rest_ * (x - origin_);
    std::array<int, 3> middle{};
    std::array<Weights, 3> w{Weights(0.0), Weights(0.0), Weights(0.0)};
    for (std::size_t a = 0; a < kAxes; ++a) {
      const double last = size_[a] - 1;
      const double i = index[static_cast<Eigen::Index>(a)];
      const double within = i > 0.0 ? std::min(i, last) : 0.0;  // 0 if i is NaN
      const int below = static_cast<int>(within);
      middle[a] = within - below < 0.5 ? below : below + 1;
      w[a] = Weights(within - middle[a]);
      if (within != i) w[a].slope = w[a].bend = {};
    }
    const Moment moment = momentAt(time);
    const auto lanes = [](const float* at) { return Lanes(Eigen::Map<const Lanes>(at)); };
    std::array<float, 4> of{};
    std::array<float, 4> by_time{};
    for (std::size_t m = 0; m < 4; ++m) {
      of[m] = static_cast<float>(moment.value[m]);
      by_time[m] = static_cast<float>(moment.rate[m]);
    }
    std::array<Lanes, 11> sum;
    sum.fill(Lanes::Zero());
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t j = 0; j < 3; ++j) {
        // Sums along the last axis: u, its first and second derivative, and its rate.
        Lanes u = Lanes::Zero();
        Lanes along = Lanes::Zero();
        Lanes bent = Lanes::Zero();
        Lanes rate = Lanes::Zero();
        const float* node =
            nodeAt(middle[0] + static_cast<int>(i), middle[1] + static_cast<int>(j), middle[2]) +
            moment.frame * kNumbers;
        for (std::size_t k = 0; k < 3; ++k, node += count_ * kNumbers) {
          const Lanes u0 = lanes(node);
          const Lanes r0 = lanes(node + kLanes);
          const Lanes u1 = lanes(node + second_);
          const Lanes r1 = lanes(node + second_ + kLanes);
          const Lanes value = of[0] * u0 + of[1] * r0 + of[2] * u1 + of[3] * r1;
          u += static_cast<float>(w[2].value[k]) * value;
          along += static_cast<float>(w[2].slope[k]) * value;
          bent += static_cast<float>(w[2].bend[k]) * value;
          rate += static_cast<float>(w[2].value[k]) *
                  (by_time[0] * u0 + by_time[1] * r0 + by_time[2] * u1 + by_time[3] * r1);
        }
        const auto weight = [](double a, double b) { return static_cast<float>(a * b); };
        const float here = weight(w[0].value[i], w[1].value[j]);
        sum[0] += here * u;
        sum[1] += here * rate;
        sum[2] += weight(w[0].slope[i], w[1].value[j]) * u;
        sum[3] += weight(w[0].value[i], w[1].slope[j]) * u;
        sum[4] += here * along;
        // Second derivatives by the pairs of indices 00, 11, 22, 01, 02 and 12.
        sum[5] += weight(w[0].bend[i], w[1].value[j]) * u;
        sum[6] += weight(w[0].value[i], w[1].bend[j]) * u;
        sum[7] += here * bent;
        sum[8] += weight(w[0].slope[i], w[1].slope[j]) * u;
        sum[9] += weight(w[0].slope[i], w[1].value[j]) * along;
        sum[10] += weight(w[0].value[i], w[1].slope[j]) * along;
      }
    }
    Displacement out;
    const auto taken = [&](std::size_t n) { return Vec3(sum[n].head<3>().cast<double>()); };
    out.shift = taken(0);
    out.rate = taken(1);
    Mat3 by_index;
    by_index << taken(2), taken(3), taken(4);
    const std::array<Vec3, 6> twice{taken(5), taken(6), taken(7), taken(8), taken(9), taken(10)};
    out.slope = by_index * index_from_rest_;
    for (std::size_t c = 0; c < kAxes; ++c) {
      const auto n = static_cast<Eigen::Index>(c);
      Mat3 S;
      S << twice[0][n], twice[3][n], twice[4][n],  //
          twice[3][n], twice[1][n], twice[5][n],   //
          twice[4][n], twice[5][n], twice[2][n];
      out.bend[c] = index_from_rest_.transpose() * S * index_from_rest_;
    }
    return out;
  }

  [[nodiscard]] Box shifts() const override { return shifts_; }
  [[nodiscard]] double topSpeed() const override { return top_speed_; }
  [[nodiscard]] double topAcceleration() const noexcept override { return top_acceleration_; }

  /// Checks the warp at nodes and middles of cells, at frames and between them. Throws SceneError
  /// if the warp folds space or stretches too much. Sets the bounds of shifts, speed and
  /// acceleration.
  void look(const std::string& path) {
    boundShifts();
    std::mutex mutex;
    const auto planes = static_cast<std::size_t>(2 * size_[0] - 1);
    const Mat3 rest_from_index = index_from_rest_.inverse();
    inParallel(planes, [&](std::size_t plane) {
      double speed = 0.0;
      for (int j = 0; j < 2 * size_[1] - 1; ++j) {
        for (int k = 0; k < 2 * size_[2] - 1; ++k) {
          // The indices count half cells. Only nodes and middles of cells are checked.
          const bool even = plane % 2 == 0;
          if ((j % 2 == 0) != even || (k % 2 == 0) != even) continue;
          const Vec3 x = origin_ + rest_from_index * (0.5 * Vec3(static_cast<double>(plane), j, k));
          for (std::size_t part = 0; part <= kParts * (count_ - 1); ++part) {
            speed = std::max(speed, speedAt(x, part, path));
          }
        }
      }
      const std::lock_guard lock(mutex);
      top_speed_ = std::max(top_speed_, speed);
    });
  }

 private:
  /// Returns a node by its indices in the lattice with one more node at each end.
  [[nodiscard]] const float* nodeAt(int i, int j, int k) const noexcept {
    const auto row = static_cast<std::size_t>(i) * static_cast<std::size_t>(padded_[1]) +
                     static_cast<std::size_t>(j);
    return nodes_.data() +
           (row * static_cast<std::size_t>(padded_[2]) + static_cast<std::size_t>(k)) * count_ *
               kNumbers;
  }
  [[nodiscard]] float* nodeAt(int i, int j, int k) noexcept {
    return const_cast<float*>(std::as_const(*this).nodeAt(i, j, k));
  }

  [[nodiscard]] Moment momentAt(double time) const noexcept {
    Moment out;
    if (count_ < 2) return out;
    const double from = times_.front();
    const double to = times_.back();
    if (repeat_ && std::isfinite(time)) {
      time = from + std::fmod(time - from, to - from);
      if (time < from) time += to - from;
    }
    const bool held = !(time > from) || !(time < to);
    const auto next = std::upper_bound(times_.begin() + 1, times_.end() - 1, time);
    out.frame = static_cast<std::size_t>(next - times_.begin()) - 1;
    const double length = times_[out.frame + 1] - times_[out.frame];
    const double s = time > from ? std::min((time - times_[out.frame]) / length, 1.0) : 0.0;
    out.value = {1.0 + s * s * (2.0 * s - 3.0), length * s * (s - 1.0) * (s - 1.0),
                 s * s * (3.0 - 2.0 * s), length * s * s * (s - 1.0)};
    if (held && !repeat_) return out;
    const double bend = 6.0 * s * (s - 1.0) / length;
    out.rate = {bend, (s - 1.0) * (3.0 * s - 1.0), -bend, s * (3.0 * s - 2.0)};
    return out;
  }

  /// Computes the coefficients of the spline of one frame, axis by axis. Along each line of nodes,
  /// c[i-1] / 8 + 6 c[i] / 8 + c[i+1] / 8 = u[i]. At the ends c[-1] = 2 c[0] - c[1], so that the
  /// curvature is zero.
  void take(const std::vector<float>& u, std::size_t frame) {
    std::vector<double> c(u.begin(), u.end());
    const std::array<std::size_t, 3> size{static_cast<std::size_t>(size_[0]),
                                          static_cast<std::size_t>(size_[1]),
                                          static_cast<std::size_t>(size_[2])};
    const std::array<std::size_t, 3> stride{kAxes * size[1] * size[2], kAxes * size[2], kAxes};
    for (std::size_t axis = 0; axis < kAxes; ++axis) {
      const std::size_t b = (axis + 1) % kAxes;
      const std::size_t d = (axis + 2) % kAxes;
      std::vector<double> sweep(size[axis]);
      for (std::size_t m = 0; m < size[b]; ++m) {
        for (std::size_t n = 0; n < size[d]; ++n) {
          for (std::size_t component = 0; component < kAxes; ++component) {
            filter(c.data() + m * stride[b] + n * stride[d] + component, stride[axis], sweep);
          }
        }
      }
    }
    for (int i = 0; i < padded_[0]; ++i) {
      for (int j = 0; j < padded_[1]; ++j) {
        for (int k = 0; k < padded_[2]; ++k) {
          float* to = nodeAt(i, j, k) + frame * kNumbers;
          for (std::size_t component = 0; component < kAxes; ++component) {
            to[component] =
                static_cast<float>(reflected(c, {i - 1, j - 1, k - 1}, stride, component));
          }
        }
      }
    }
  }

  /// Solves the equations of take() for one line, by Thomas' algorithm for tridiagonal systems.
  static void filter(double* line, std::size_t stride, std::vector<double>& sweep) {
    const std::size_t last = sweep.size() - 1;
    // At the ends the coefficient equals u.
    sweep[0] = 0.0;
    for (std::size_t i = 1; i < last; ++i) {
      const double pivot = 0.75 - 0.125 * sweep[i - 1];
      sweep[i] = 0.125 / pivot;
      line[i * stride] = (line[i * stride] - 0.125 * line[(i - 1) * stride]) / pivot;
    }
    for (std::size_t i = last; i-- > 1;) line[i * stride] -= sweep[i] * line[(i + 1) * stride];
  }

  /// Returns a coefficient. Beyond each face of the lattice, c[-1] = 2 c[0] - c[1].
  [[nodiscard]] double reflected(const std::vector<double>& c, std::array<int, 3> node,
                                 const std::array<std::size_t, 3>& stride,
                                 std::size_t component) const {
    for (std::size_t a = 0; a < kAxes; ++a) {
      const int last = size_[a] - 1;
      if (node[a] >= 0 && node[a] <= last) continue;
      std::array<int, 3> face = node;
      std::array<int, 3> inner = node;
      face[a] = node[a] < 0 ? 0 : last;
      inner[a] = node[a] < 0 ? 1 : last - 1;
      return 2.0 * reflected(c, face, stride, component) - reflected(c, inner, stride, component);
    }
    std::size_t at = component;
    for (std::size_t a = 0; a < kAxes; ++a) at += static_cast<std::size_t>(node[a]) * stride[a];
    return c[at];
  }

  /// Computes the rate in each frame from the displacements of the frame and its two neighbours. In
  /// the first and last frame of a warp that does not repeat, the rate is 0.
  void takeRates() {
    const std::size_t all = nodes_.size() / (count_ * kNumbers);
    if (count_ < 2) return;
    inParallel(all, [&](std::size_t n) {
      float* node = nodes_.data() + n * count_ * kNumbers;
      for (std::size_t f = 0; f < count_; ++f) {
        const bool first = f == 0;
        const bool last = f + 1 == count_;
        if ((first || last) && !repeat_) continue;
        const std::size_t before = first ? count_ - 2 : f - 1;
        const std::size_t after = last ? 1 : f + 1;
        const double h0 =
            first ? times_[count_ - 1] - times_[count_ - 2] : times_[f] - times_[before];
        const double h1 = last ? times_[1] - times_[0] : times_[after] - times_[f];
        for (std::size_t c = 0; c < kAxes; ++c) {
          const double here = node[f * kNumbers + c];
          const double d0 = (here - node[before * kNumbers + c]) / h0;
          const double d1 = (node[after * kNumbers + c] - here) / h1;
          node[f * kNumbers + kLanes + c] = static_cast<float>(rateOf(d0, d1, h0, h1));
        }
      }
    });
  }

  /// Sets shifts_ and top_acceleration_: a spline lies in the convex hull of its coefficients.
  void boundShifts() {
    const std::size_t all = nodes_.size() / (count_ * kNumbers);
    for (std::size_t n = 0; n < all; ++n) {
      const float* node = nodes_.data() + n * count_ * kNumbers;
      for (std::size_t f = 0; f < count_; ++f, node += kNumbers) {
        const Vec3 u(node[0], node[1], node[2]);
        const Vec3 rate(node[4], node[5], node[6]);
        shifts_.extend(-u);
        if (f > 0) shifts_.extend(-(u - (times_[f] - times_[f - 1]) / 3.0 * rate));
        if (f + 1 == count_) continue;
        const double h = times_[f + 1] - times_[f];
        shifts_.extend(-(u + h / 3.0 * rate));
        // The second derivative of a cubic is linear, so its magnitude is largest at one of the
        // ends.
        const float* next = node + kNumbers;
        const Vec3 way = (Vec3(next[0], next[1], next[2]) - u) / h;
        const Vec3 after(next[4], next[5], next[6]);
        top_acceleration_ =
            std::max({top_acceleration_, (6.0 * way - 4.0 * rate - 2.0 * after).norm() / h,
                      (6.0 * way - 2.0 * rate - 4.0 * after).norm() / h});
      }
    }
  }

  /// Throws SceneError if the warp is invalid at x, `part` / kParts frames after the start. Returns
  /// the speed of the material there [m/s].
  double speedAt(const Vec3& x, std::size_t part, const std::string& path) const {
    const std::size_t frame = part / kParts;
    double time = times_.empty() ? 0.0 : times_[frame];
    const auto share = static_cast<double>(part % kParts) / kParts;
    if (share > 0.0) time += share * (times_[frame + 1] - times_[frame]);
    const Displacement u = at(x, time);
    const Mat3 F = Mat3::Identity() + u.slope;
    const Mat3 squares = F.transpose() * F;
    Eigen::SelfAdjointEigenSolver<Mat3> stretch;
    stretch.computeDirect(squares, Eigen::EigenvaluesOnly);
    const double least = std::sqrt(std::max(stretch.eigenvalues()[0], 0.0));
    const double most = std::sqrt(std::max(stretch.eigenvalues()[2], 0.0));
    const bool folds = !(F.determinant() > 0.0);
    if (folds || !(least >= 1.0 / kMostStretch) || !(most <= kMostStretch)) {
      std::ostringstream where;
      where.precision(3);
      where << "at (" << x.x() << ", " << x.y() << ", " << x.z() << ") m";
      if (!times_.empty()) where << " and " << time << " s";
      where << " the displacement ";
      if (folds) {
        where << "folds space";
      } else {
        where << "multiplies lengths by " << 1.0 / most << " to " << 1.0 / least
              << " (limits: " << 1.0 / kMostStretch << " and " << kMostStretch << ")";
      }
      throw SceneError(path, where.str(),
                       "check its sign and its unit, smooth it, or scale it down");
    }
    return (F.inverse() * u.rate).norm();
  }

  std::array<int, 3> size_;
  std::array<int, 3> padded_;
  std::size_t count_;
  /// Number of floats from a frame to the next one in a node; 0 if there is a single frame.
  std::size_t second_;
  std::vector<double> times_;
  bool repeat_;
  Vec3 origin_;
  Mat3 index_from_rest_;
  /// Coefficients of u and of its rate, for each node and then for each frame.
  std::vector<float> nodes_;
  Box shifts_;
  double top_speed_ = 0.0;
  double top_acceleration_ = 0.0;
};

void check(const DisplacementFrames& of, const WarpTimes& when, const std::string& path) {
  const std::size_t count = of.frames.size();
  if (count == 0)
    throw SceneError(path, "it does not have a displacement field", "name one or more");
  if (when.times.size() != count && !(count == 1 && when.times.empty())) {
    throw SceneError(path + "/times",
                     std::to_string(when.times.size()) + " times are given for " +
                         std::to_string(count) + " displacement fields",
                     "give one time for each field");
  }
  for (std::size_t i = 0; i < when.times.size(); ++i) {
    const std::string here = path + "/times/" + std::to_string(i);
    if (!(std::abs(when.times[i]) <= 1e9)) {
      throw SceneError(here, "it is not a time within 1e9 s", "give seconds from -1e9 to 1e9");
    }
    if (i > 0 && !(when.times[i] > when.times[i - 1])) {
      throw SceneError(here, "the times do not ascend",
                       "sort the frames by time, and drop frames of equal times");
    }
  }
  checkWarpMemory(of.size, count, path);
  for (std::size_t a = 0; a < kAxes; ++a) {
    if (of.size[a] < 2) {
      throw SceneError(path, "the displacement field is one voxel thick",
                       "give two or more voxels along each axis");
    }
  }
  double most = 0.0;
  for (std::size_t n = 0; n < count; ++n) {
    for (const float u : of.frames[n]) {
      if (!std::isfinite(u)) {
        throw SceneError(path,
                         "a displacement in frame " + std::to_string(n + 1) + " of " +
                             std::to_string(count) + " is not finite, or is too large for 32 bits",
                         "replace it by a finite number, or scale it down");
      }
      most = std::max(most, static_cast<double>(std::abs(u)));
    }
  }
  if (!when.repeat) return;
  if (count < 2)
    throw SceneError(path, "a single frame cannot be repeated", "give two or more frames");
  constexpr double kSame = 1e-4;  // as a share of the largest displacement
  for (std::size_t i = 0; i < of.frames.front().size(); ++i) {
    if (std::abs(of.frames.front()[i] - of.frames.back()[i]) <= kSame * most) continue;
    throw SceneError(path,
                     "the displacement field repeats, but its last frame differs from the first",
                     "end with a copy of the first frame, or remove \"repeat\"");
  }
}

}  // namespace

void checkWarpMemory(const std::array<int, 3>& size, std::size_t frames, const std::string& path) {
  const double nodes = (size[0] + 2.0) * (size[1] + 2.0) * (size[2] + 2.0);
  const double memory = nodes * static_cast<double>(frames * kNumbers * sizeof(float));
  if (memory <= static_cast<double>(kMostWarpMemory)) return;
  throw SceneError(path,
                   std::to_string(frames) + " displacement fields need " +
                       std::to_string(std::lround(memory / 1e6)) + " MB, more than the limit of " +
                       std::to_string(std::lround(static_cast<double>(kMostWarpMemory) / 1e6)) +
                       " MB",
                   "resample them to a coarser lattice, or give fewer fields");
}

WarpPtr makeWarp(const DisplacementFrames& of, const WarpTimes& when, const std::string& path) {
  check(of, when, path);
  auto warp = std::make_shared<GridWarp>(of, when);
  warp->look(path);
  return warp;
}

}  // namespace palpate
