#include "tests/support/motion_problems.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <numbers>

#include <Eigen/Geometry>

#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume.h"
#include "tests/support/fresh_hand.h"
#include "tests/support/percentiles.h"
#include "tests/support/random.h"
#include "tests/support/theorem.h"
#include "tests/support/vdb_files.h"

namespace palpate::bench {
namespace {

using openvdb::Coord;
constexpr double kPi = std::numbers::pi;

template <class GridT>
FieldPtr fieldOf(const typename GridT::Ptr& grid, const std::string& interpolation,
                 bool axial = false) {
  const test::TemporaryFolder folder;
  const auto file = folder / "grid.vdb";
  openvdb::io::File(file.string()).write({grid});
  Placement placement;
  placement.scale = kVoxel;
  return makeVdbField(loadVolume(file, ""), placement,
                      {interpolationNamed(interpolation).value(), axial});
}

template <class GridT, class Value>
typename GridT::Ptr denseGrid(const Coord& size, const typename GridT::ValueType& background,
                              const Value& value) {
  openvdb::initialize();
  auto grid = GridT::create(background);
  grid->setName("grid");
  auto accessor = grid->getAccessor();
  for (int i = 0; i < size.x(); ++i) {
    for (int j = 0; j < size.y(); ++j) {
      for (int k = 0; k < size.z(); ++k) accessor.setValue(Coord(i, j, k), value(Vec3(i, j, k)));
    }
  }
  return grid;
}

/// Returns the first of two orthogonal directions, both oblique to the grid.
const Vec3& firstAxis() {
  static const Vec3 u = Vec3(1, 0.37, -0.21).normalized();
  return u;
}
const Vec3& secondAxis() {
  static const Vec3 w = firstAxis().cross(Vec3(0.2, -0.5, 0.9).normalized()).normalized();
  return w;
}

/// Returns a smooth step of `width` voxels, from 0 outside to 1 inside.
double ramp(double depth, double width) {
  const double t = std::clamp(depth / width + 0.5, 0.0, 1.0);
  return t * t * (3.0 - 2.0 * t);
}

}  // namespace

FieldPtr scalarGrid(int n, const std::function<double(const Vec3&)>& value,
                    const std::string& interpolation, bool level_set, double spacing) {
  const auto at = [&](const Vec3& index) { return static_cast<float>(value(spacing * index)); };
  const auto grid = denseGrid<openvdb::FloatGrid>(Coord(n), level_set ? 3.0F : 0.0F, at);
  grid->setTransform(openvdb::math::Transform::createLinearTransform(spacing));
  grid->setGridClass(level_set ? openvdb::GRID_LEVEL_SET : openvdb::GRID_FOG_VOLUME);
  return fieldOf<openvdb::FloatGrid>(grid, interpolation);
}

FieldPtr vectorGrid(const Vec3& size, const std::function<Vec3(const Vec3&)>& value,
                    const std::string& interpolation, bool axial) {
  const auto grid = denseGrid<openvdb::Vec3SGrid>(
      Coord(static_cast<int>(size.x()), static_cast<int>(size.y()), static_cast<int>(size.z())),
      openvdb::Vec3f(0.0F), [&](const Vec3& p) {
        const Vec3 v = value(p);
        return openvdb::Vec3f(static_cast<float>(v.x()), static_cast<float>(v.y()),
                              static_cast<float>(v.z()));
      });
  return fieldOf<openvdb::Vec3SGrid>(grid, interpolation, axial);
}

Probed::Probed(std::shared_ptr<const ScalarField> field)
    : field_(std::move(field)), cache_(std::make_unique<FieldCache>()) {
  field_->reset(*cache_);
}

double Probed::off(const Vec3& p, double level) {
  const double v = field_->sample(kVoxel * p, *cache_).value;
  return (v - level) / field_->cellGradient(kVoxel * p, *cache_).norm();
}

double Probed::value(const Vec3& p) {
  return field_->sample(kVoxel * p, *cache_).value;
}

SurfaceMotion sphereMotion(const std::string& kind, double radius, double depth,
                           const std::string& interpolation) {
  SurfaceMotion motion;
  const Vec3 c = radius > 30 ? Vec3(52.3, 51.7, 52.45) : Vec3(20.3, 19.7, 20.45);
  const int n = radius > 30 ? 106 : 41;
  motion.name = "sphere " + std::to_string(radius).substr(0, 4) + ", " + kind;
  motion.distance = [=](const Vec3& p) { return (p - c).norm() - radius; };
  if (kind == "level set") {
    motion.field = scalarGrid(n, motion.distance, interpolation);
    motion.floor = 0.25 / radius;
  } else {
    const double width = std::stod(kind.substr(4));
    motion.level = 0.5;
    motion.solid = Solid::kAbove;
    motion.field = scalarGrid(
        n, [=](const Vec3& p) { return ramp(radius - (p - c).norm(), width); }, interpolation,
        false);
  }
  const double r = radius - depth;
  motion.hand = [=](double way) {
    const double a = way / r;
    return Vec3(c + r * (std::cos(a) * firstAxis() + std::sin(a) * secondAxis()));
  };
  motion.outside = c + (radius + 1.5) * firstAxis();
  motion.lap = 2.0 * kPi * r;
  return motion;
}

SurfaceMotion hollowMotion(double radius, double depth) {
  SurfaceMotion motion = sphereMotion("level set", radius, -depth);
  motion.name = "inside of a sphere " + std::to_string(radius).substr(0, 4);
  motion.solid = Solid::kAbove;
  const Vec3 c = radius > 30 ? Vec3(52.3, 51.7, 52.45) : Vec3(20.3, 19.7, 20.45);
  motion.outside = c + (radius - 1.5) * firstAxis();
  const auto distance = motion.distance;
  motion.distance = [distance](const Vec3& p) { return -distance(p); };
  return motion;
}

SurfaceMotion torusMotion(double major, double minor, double depth) {
  SurfaceMotion motion;
  const Vec3 c(52.3, 51.7, 52.45);
  const Vec3& u = firstAxis();
  const Vec3& w = secondAxis();
  const Vec3 n = u.cross(w);
  motion.name = "torus " + std::to_string(major).substr(0, 2) + "/" +
                std::to_string(minor).substr(0, 2) + ", level set";
  motion.distance = [=](const Vec3& p) {
    const Vec3 d = p - c;
    return std::hypot(std::hypot(u.dot(d), w.dot(d)) - major, n.dot(d)) - minor;
  };
  motion.field = scalarGrid(106, motion.distance);
  motion.floor = (1.0 / minor + 1.0 / (major - minor)) / 8.0;
  const double r = minor - depth;
  // The hand goes around the tube three times per lap.
  const double speed = std::hypot(major, 3.0 * r);
  const auto at = [=](double a, double far) {
    const Vec3 ring = std::cos(a) * u + std::sin(a) * w;
    return Vec3(c + major * ring + far * (std::cos(3.0 * a) * ring + std::sin(3.0 * a) * n));
  };
  motion.hand = [=](double way) { return at(way / speed, r); };
  motion.outside = at(0.0, minor + 1.5);
  motion.lap = 2.0 * kPi * speed;
  return motion;
}

SurfaceMotion cubeMotion(double depth, bool turned, bool hollow) {
  SurfaceMotion motion;
  const Vec3 c(32.3, 31.7, 32.45);
  constexpr double kHalf = 20.0;
  Mat3 axes = Mat3::Identity();
  if (turned) axes << firstAxis(), secondAxis(), firstAxis().cross(secondAxis());
  motion.name = std::string(hollow ? "hollow cube" : "cube") + (turned ? ", turned" : "");
  motion.distance = [=](const Vec3& p) {
    const Vec3 d = (axes.transpose() * (p - c)).cwiseAbs() - Vec3::Constant(kHalf);
    const double distance = d.cwiseMax(0.0).norm() + std::min(d.maxCoeff(), 0.0);
    return hollow ? -distance : distance;
  };
  motion.field = scalarGrid(turned ? 66 : 65, motion.distance);
  // A quarter of the path, relative to the cube's centre and axes. The other quarters are copies,
  // rotated by 90, 180 and 270 degrees about the third axis.
  std::vector<Vec3> quarter;
  if (hollow) {
    // The hand slides along the wall into the edge, then along the edge into the corner and back.
    const double h = kHalf + depth;
    quarter = {{h, -h, 3.1}, {h, 0.0, 3.1}, {h, h, 3.1}, {h, h, h}, {h, h, 3.1}};
  } else {
    // The hand slides along a face and beyond its edge, outside around the edge, and onto the next
    // face.
    const double h = kHalf - depth;
    quarter = {{h, -8.0, 3.1}, {h, kHalf + 2.0, 3.1}, {8.0, kHalf + 2.0, 3.1}, {8.0, h, 3.1}};
  }
  std::vector<Vec3> corners;
  for (int i = 0; i < 4; ++i) {
    for (const Vec3& v : quarter) {
      const Vec3 flat = i == 0   ? v
                        : i == 1 ? Vec3(-v.y(), v.x(), v.z())
                        : i == 2 ? Vec3(-v.x(), -v.y(), v.z())
                                 : Vec3(v.y(), -v.x(), v.z());
      corners.push_back(c + axes * flat);
    }
  }
  corners.push_back(corners.front());
  for (std::size_t i = 1; i < corners.size(); ++i) {
    motion.lap += (corners[i] - corners[i - 1]).norm();
  }
  motion.hand = [corners, lap = motion.lap](double way) {
    double s = std::fmod(way, lap);
    for (std::size_t i = 1; i < corners.size(); ++i) {
      const double length = (corners[i] - corners[i - 1]).norm();
      if (s <= length) return Vec3(corners[i - 1] + s / length * (corners[i] - corners[i - 1]));
      s -= length;
    }
    return corners.back();
  };
  const double out = hollow ? kHalf - 1.5 : kHalf + 1.5;
  motion.outside =
      hollow ? Vec3(c + axes * Vec3(out, -out, 3.1)) : Vec3(c + axes * Vec3(out, -8.0, 3.1));
  return motion;
}

namespace {

/// One mode on one field, with a reader and a proxy.
struct Engine {
  std::unique_ptr<const Scene> scene;
  Reader reader;
  ProxyState state{ForceLimits{1e3, 1e12}};

  Engine(const ModeSpec& mode, const FieldPtr& field, const StepParams& step) {
    GraphSpec spec;
    spec.modes.push_back(mode);
    spec.modes[0].of = "it";
    scene = makeScene(spec, {{"it", field}}, {kMotionStiffness, 0.0}, step);
  }
  StepReport tick(const Vec3& hand) {
    return provenStep(*scene, reader, {hand}, state, kMotionTick);
  }
};

Ticked tickedOf(const StepReport& r) {
  return {r.proxy,
          r.wanted,
          static_cast<double>(r.samples + r.traced),
          static_cast<double>(r.walked),
          r.injected,
          0.0,
          r.status > StepStatus::kHairpin,
          r.status == StepStatus::kHairpin};
}

/// Computes the hand's positions before the timing starts.
std::vector<Vec3> handsOf(const std::function<Vec3(double)>& hand, double pace, long ticks) {
  std::vector<Vec3> hands;
  hands.reserve(static_cast<std::size_t>(ticks));
  for (long i = 1; i <= ticks; ++i) {
    hands.emplace_back(kVoxel * hand(static_cast<double>(i) * pace));
  }
  return hands;
}

/// Runs all ticks. Returns the median over batches of the time per tick [ns].
double tickAll(const std::vector<Vec3>& hands, const Stepper& method, std::vector<Ticked>& ticked) {
  const std::size_t batch = hands.size() < 640 ? 16 : 64;
  std::vector<double> times;
  ticked.resize(hands.size());
  auto begun = std::chrono::steady_clock::now();
  for (std::size_t i = 0; i < hands.size(); ++i) {
    ticked[i] = method(hands[i]);
    if ((i + 1) % batch != 0) continue;
    const auto now = std::chrono::steady_clock::now();
    times.push_back(std::chrono::duration<double, std::nano>(now - begun).count() /
                    static_cast<double>(batch));
    begun = std::chrono::steady_clock::now();
  }
  // A path of a few ticks is one batch.
  if (times.empty() && !hands.empty()) {
    const auto now = std::chrono::steady_clock::now();
    times.push_back(std::chrono::duration<double, std::nano>(now - begun).count() /
                    static_cast<double>(hands.size()));
  }
  return percentile(times, 0.5);
}

}  // namespace

Stepper engineOn(const SurfaceMotion& motion, ModeKind kind, const StepParams& step,
                 double strength) {
  ModeSpec mode;
  mode.kind = kind;
  mode.strength = strength;
  mode.value = motion.level;
  mode.solid = motion.solid;
  const auto engine = std::make_shared<Engine>(mode, motion.field, step);
  return [engine, kind, level = motion.level](const Vec3& hand) {
    Ticked out = tickedOf(engine->tick(hand));
    out.level = kind == ModeKind::kSurface
                    ? std::get<SurfaceMemory>(engine->state.memory(0).of).level
                    : level;
    return out;
  };
}

MotionResult feelSurface(const SurfaceMotion& motion, ModeKind kind, double speed, double laps,
                         const StepParams& step, double strength) {
  return feelSurface(motion, engineOn(motion, kind, step, strength), speed, laps,
                     kind == ModeKind::kSurface);
}

MotionResult feelSurface(const SurfaceMotion& motion, const Stepper& method, double speed,
                         double laps, bool anywhere) {
  Probed probed(std::get<0>(motion.field));
  const double pace = voxelsPerTick(speed);

  // The hand first moves slowly onto the surface.
  constexpr int kDown = 200;
  Vec3 above = motion.outside;
  if (anywhere) {
    // The method may hold at any value, so the hand starts at the true surface.
    Vec3 below = motion.hand(0.0);
    for (int i = 0; i < 60; ++i) {
      const Vec3 middle = 0.5 * (above + below);
      (motion.distance(middle) > 0.0 ? above : below) = middle;
    }
  }
  for (int i = 0; i <= kDown; ++i) {
    const double t = static_cast<double>(i) / kDown;
    const Vec3 hand = above + t * (motion.hand(0.0) - above);
    (void)method(kVoxel * hand);
  }

  MotionResult out;
  const auto ticks = static_cast<long>(laps * motion.lap / pace);
  // Each of the two parts that the drift compares is a tenth of the run, but at least one lap.
  const auto lap = static_cast<long>(std::max(1.0, laps / 10.0) * motion.lap / pace);
  struct Mean {
    double sum = 0.0;
    double count = 0.0;
    void add(double x) {
      sum += x;
      count += 1.0;
    }
    [[nodiscard]] double mean() const { return count > 0.0 ? sum / count : 0.0; }
  };
  Mean first;
  Mean last;
  double held = 0.0;
  double squares = 0.0;
  double level = 0.0;  // value at the surface in the first tick with a force
  const std::vector<Vec3> hands = handsOf(motion.hand, pace, ticks);
  std::vector<Ticked> ticked;
  out.nanoseconds = tickAll(hands, method, ticked);
  for (long i = 1; i <= ticks; ++i) {
    const Ticked& r = ticked[static_cast<std::size_t>(i - 1)];
    out.samples += r.samples;
    out.cells += r.cells;
    out.most_samples = std::max(out.most_samples, r.samples);
    out.capped += r.capped ? 1.0 : 0.0;
    out.injected += r.injected;
    if (!(r.force.norm() > 1e-6)) {
      const bool below = motion.distance(hands[static_cast<std::size_t>(i - 1)] / kVoxel) < -0.5;
      out.lost += below ? 1.0 : 0.0;
      continue;
    }
    const Vec3 p = r.proxy / kVoxel;
    const double distance = motion.distance(p);
    if (held == 0.0) level = r.level;
    const double off = std::abs(distance) > 1.0 ? distance : probed.off(p, level);
    out.off_max = std::max(out.off_max, std::abs(off));
    out.true_max = std::max(out.true_max, std::abs(distance));
    squares += off * off;
    held += 1.0;
    if (i <= lap) first.add(distance);
    if (i > ticks - lap) last.add(distance);
  }
  const auto n = static_cast<double>(ticks);
  out.off_rms = held > 0.0 ? std::sqrt(squares / held) : 0.0;
  out.drift = last.mean() - first.mean();
  out.samples /= n;
  out.cells /= n;
  out.capped /= n;
  out.lost /= n;
  out.injected /= laps;
  return out;
}

namespace {

/// Returns the exact trilinear interpolation of voxels.
Vec3 blend(const std::function<Vec3(int, int, int)>& voxel, const Eigen::Vector3i& cell,
           const Vec3& p) {
  Vec3 sum = Vec3::Zero();
  const Vec3 w = p - cell.cast<double>();
  for (int c = 0; c < 8; ++c) {
    const int i = c & 1;
    const int j = c >> 1 & 1;
    const int k = c >> 2;
    sum += (i != 0 ? w.x() : 1 - w.x()) * (j != 0 ? w.y() : 1 - w.y()) *
           (k != 0 ? w.z() : 1 - w.z()) * voxel(cell.x() + i, cell.y() + j, cell.z() + k);
  }
  return sum;
}

Eigen::Vector3i cellOf(const Vec3& p) {
  return p.array().floor().cast<int>();
}

/// Caches the eight voxels of a cell, because the tracer reads them many times.
class Cell {
 public:
  Cell(const std::function<Vec3(int, int, int)>& voxel, const Eigen::Vector3i& cell) : cell_(cell) {
    for (int c = 0; c < 8; ++c) {
      at_[static_cast<std::size_t>(c)] =
          voxel(cell.x() + (c & 1), cell.y() + (c >> 1 & 1), cell.z() + (c >> 2));
    }
  }
  [[nodiscard]] Vec3 direction(const Vec3& p) const {
    const Vec3 w = p - cell_.cast<double>();
    Vec3 sum = Vec3::Zero();
    for (int c = 0; c < 8; ++c) {
      sum += ((c & 1) != 0 ? w.x() : 1 - w.x()) * ((c >> 1 & 1) != 0 ? w.y() : 1 - w.y()) *
             ((c >> 2) != 0 ? w.z() : 1 - w.z()) * at_[static_cast<std::size_t>(c)];
    }
    return sum.normalized();
  }
  [[nodiscard]] double beyond(const Vec3& p) const {
    const Vec3 low = cell_.cast<double>();
    return std::max((low - p).maxCoeff(), (p - low).maxCoeff() - 1.0);
  }
  [[nodiscard]] Vec3 rk4(const Vec3& p, double h) const {
    const Vec3 k1 = direction(p);
    const Vec3 k2 = direction(p + 0.5 * h * k1);
    const Vec3 k3 = direction(p + 0.5 * h * k2);
    const Vec3 k4 = direction(p + h * k3);
    return p + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
  }

 private:
  Eigen::Vector3i cell_;
  std::array<Vec3, 8> at_;
};

Vec3 goOn(const std::function<Vec3(int, int, int)>& voxel, Vec3 p, double way, double longest) {
  const double sense = way < 0.0 ? -1.0 : 1.0;
  double left = std::abs(way);
  for (int guard = 0; left > 1e-13 && guard < 100000; ++guard) {
    const Vec3 d = Cell(voxel, cellOf(p)).direction(p);
    const Cell cell(voxel, cellOf(p + 1e-10 * sense * d));
    double h = std::min(left, longest);
    Vec3 end = cell.rk4(p, sense * h);
    if (cell.beyond(end) > 1e-12) {
      double low = 0.0;
      double high = h;
      for (int i = 0; i < 60; ++i) {
        const double middle = 0.5 * (low + high);
        (cell.beyond(cell.rk4(p, sense * middle)) > 0.0 ? high : low) = middle;
      }
      h = high;
      end = cell.rk4(p, sense * h);
      if (h < 1e-12) {
        h = 1e-11;
        end = p + h * sense * d;
      }
    }
    p = end;
    left -= h;
  }
  return p;
}

/// Returns the distance from p to the course, searched near its point i. Sets i to the nearest
/// point.
double fromCourse(const Stream& s, const Vec3& p, std::size_t& i) {
  const auto last = static_cast<long>(s.x.size()) - 1;
  auto best = static_cast<long>(i);
  double least = 1e99;
  for (long k = std::max(0L, best - 120); k <= std::min(last, static_cast<long>(i) + 160); ++k) {
    const double d = (p - s.x[static_cast<std::size_t>(k)]).squaredNorm();
    if (d < least) {
      least = d;
      best = k;
    }
  }
  i = static_cast<std::size_t>(best);
  const double along = (p - s.x[i]).dot(s.t[i]);
  Vec3 curve = Vec3::Zero();
  const bool inner = best > 0 && best < last;
  if (inner) curve = 0.5 / s.spacing * (s.t[i + 1] - s.t[i - 1]);
  Vec3 off = p - s.x[i] - along * s.t[i] - 0.5 * along * along * curve;
  if (!inner) off -= off.dot(s.t[i]) * s.t[i];
  return off.norm();
}

}  // namespace

double Stream::mostBend(double pull) const {
  double most = 0.0;
  for (std::size_t i = 1; i + 1 < x.size(); ++i) {
    most = std::max(most, pull * (0.5 / spacing * (t[i + 1] - t[i - 1])).dot(n[i]));
  }
  return most;
}

Vec3 Stream::onFrom(const Vec3& p, double way) const {
  return goOn(voxel, p, way, 0.02);
}
Vec3 Stream::directionAt(const Vec3& p) const {
  return blend(voxel, cellOf(p), p).normalized();
}

Stream traceStream(const std::string& name, const std::function<Vec3(int, int, int)>& voxel,
                   const Vec3& start, double length, const std::function<bool(const Vec3&)>& inside,
                   double slowest) {
  Stream s;
  s.name = name;
  s.voxel = voxel;
  Vec3 p = start;
  Vec3 n;
  for (long i = 0; i <= static_cast<long>(length / s.spacing); ++i) {
    const Vec3 v = blend(voxel, cellOf(p), p);
    if (v.norm() < slowest || (inside && !inside(p))) break;
    const Vec3 t = v.normalized();
    const Vec3 other = std::abs(t.x()) < 0.7 ? Vec3(1, 0.3, 0.2) : Vec3(0.2, 1, 0.3);
    n = i == 0 ? Vec3(t.cross(other).normalized()) : Vec3((n - n.dot(t) * t).normalized());
    s.x.push_back(p);
    s.t.push_back(t);
    s.n.push_back(n);
    p = goOn(voxel, p, s.spacing, 0.02);
  }
  return s;
}

FieldPtr fieldAbout(const Stream& s, const std::string& interpolation) {
  openvdb::initialize();
  auto grid = openvdb::Vec3SGrid::create(openvdb::Vec3f(0.0F));
  grid->setName("grid");
  auto accessor = grid->getAccessor();
  constexpr int kAbout = 5;
  for (std::size_t i = 0; i < s.x.size(); i += 25) {
    const Eigen::Vector3i c = cellOf(s.x[i]);
    for (int a = -kAbout; a <= kAbout + 1; ++a) {
      for (int b = -kAbout; b <= kAbout + 1; ++b) {
        for (int d = -kAbout; d <= kAbout + 1; ++d) {
          const Coord at(c.x() + a, c.y() + b, c.z() + d);
          if (accessor.isValueOn(at)) continue;
          const Vec3 v = s.voxel(at.x(), at.y(), at.z());
          accessor.setValue(at, openvdb::Vec3f(static_cast<float>(v.x()), static_cast<float>(v.y()),
                                               static_cast<float>(v.z())));
        }
      }
    }
  }
  return fieldOf<openvdb::Vec3SGrid>(grid, interpolation);
}

namespace {

/// Rounds to floats, as grids store them.
Vec3 stored(const Vec3& v) {
  return v.cast<float>().cast<double>();
}

/// Returns the phase of voxel n in a wave of `wavelength` voxels.
double phase(int n, int wavelength) {
  return 2.0 * kPi * ((n % wavelength + wavelength) % wavelength) / wavelength;
}

}  // namespace

std::function<Vec3(int, int, int)> abcFlow(int wavelength) {
  return [wavelength](int i, int j, int k) {
    const double x = phase(i, wavelength);
    const double y = phase(j, wavelength);
    const double z = phase(k, wavelength);
    return stored(
        {std::sin(z) + std::cos(y), std::sin(x) + std::cos(z), std::sin(y) + std::cos(x)});
  };
}

std::function<Vec3(int, int, int)> taylorGreen(int wavelength) {
  return [wavelength](int i, int j, int k) {
    const double x = phase(i, wavelength);
    const double y = phase(j, wavelength);
    const double z = phase(k, wavelength);
    return stored(
        {std::sin(x) * std::cos(y) * std::cos(z), -std::cos(x) * std::sin(y) * std::cos(z), 0.0});
  };
}

std::vector<Stream> streamsOfFlow(const std::function<Vec3(int, int, int)>& flow, int wavelength,
                                  double length, std::size_t count, double pull,
                                  const std::string& interpolation) {
  // Smallest speed at the start of a stream. Slower parts of a Taylor-Green flow turn too sharply.
  constexpr double kSlow = 0.35;
  test::Random random(7);
  std::vector<Stream> streams;
  while (streams.size() < count) {
    const Vec3 start =
        Vec3::Constant(0.5 * wavelength) + random.inCube(0.5 * static_cast<double>(wavelength));
    const Eigen::Vector3i at = start.array().floor().cast<int>();
    if (flow(at.x(), at.y(), at.z()).norm() < kSlow) continue;
    Stream stream = traceStream("", flow, start, length);
    if (stream.mostBend(pull) >= kMostBend) continue;
    stream.field = fieldAbout(stream, interpolation);
    streams.push_back(std::move(stream));
  }
  return streams;
}

std::vector<Stream> streamsOfFile(const std::string& file, std::size_t count, double length) {
  openvdb::initialize();
  openvdb::io::File in(file);
  in.open(false);
  openvdb::Vec3SGrid::Ptr grid;
  const openvdb::GridPtrVecPtr grids = in.getGrids();
  for (const openvdb::GridBase::Ptr& any : *grids) {
    if (!grid) grid = openvdb::gridPtrCast<openvdb::Vec3SGrid>(any);
  }
  std::vector<Stream> streams;
  if (!grid) return streams;
  const auto accessor =
      std::make_shared<openvdb::Vec3SGrid::ConstAccessor>(grid->getConstAccessor());
  const auto voxel = [grid, accessor](int i, int j, int k) {
    const openvdb::Vec3f v = accessor->getValue(Coord(i, j, k));
    return Vec3(v.x(), v.y(), v.z());
  };
  double fastest = 0.0;
  for (auto it = grid->cbeginValueOn(); it; ++it) {
    fastest = std::max(fastest, static_cast<double>(it->length()));
  }
  const openvdb::CoordBBox box = grid->evalActiveVoxelBoundingBox();
  const auto corner = [](const Coord& c) { return Vec3(c.x(), c.y(), c.z()); };
  const Vec3 low = corner(box.min()) + Vec3::Constant(1.5);
  const Vec3 high = corner(box.max()) - Vec3::Constant(1.5);
  const auto inside = [=](const Vec3& p) {
    return (p.array() >= low.array()).all() && (p.array() <= high.array()).all();
  };
  test::Random random(7);
  constexpr int kTries = 20000;
  constexpr double kLeast = 8.0;
  for (int i = 0; i < kTries && streams.size() < count; ++i) {
    const Vec3 start(random.uniform(low.x(), high.x()), random.uniform(low.y(), high.y()),
                     random.uniform(low.z(), high.z()));
    if (blend(voxel, cellOf(start), start).norm() < 0.1 * fastest) continue;
    Stream stream = traceStream(file, voxel, start, length, inside, 0.02 * fastest);
    if (stream.x.size() < 2 || stream.length() < kLeast) continue;
    stream.field = fieldAbout(stream);
    streams.push_back(std::move(stream));
  }
  return streams;
}

Stepper engineOn(const Stream& stream, const StepParams& step, double strength) {
  ModeSpec mode;
  mode.kind = ModeKind::kFollow;
  mode.strength = strength;
  const auto engine = std::make_shared<Engine>(mode, stream.field, step);
  return [engine](const Vec3& hand) { return tickedOf(engine->tick(hand)); };
}

StreamResult feelStream(const Stream& stream, double speed, double pull, const StepParams& step) {
  return feelStream(stream, engineOn(stream, step), speed, pull);
}

StreamResult feelStream(const Stream& stream, const Stepper& method, double speed, double pull,
                        bool judged) {
  const double pace = voxelsPerTick(speed);
  StreamResult out;
  const auto hand = [&](double way) {
    const double at = way / stream.spacing;
    const auto i = std::min(static_cast<std::size_t>(at), stream.x.size() - 2);
    const double f = at - static_cast<double>(i);
    return Vec3(stream.x[i] + f * (stream.x[i + 1] - stream.x[i]) +
                pull * (stream.n[i] + f * (stream.n[i + 1] - stream.n[i])).normalized());
  };
  std::vector<Vec3> proxies{method(kVoxel * stream.x[0]).proxy / kVoxel};
  const auto ticks = static_cast<long>(stream.length() / pace);
  std::vector<Ticked> ticked;
  out.nanoseconds = tickAll(handsOf(hand, pace, ticks), method, ticked);
  for (std::size_t i = 0; i < ticked.size(); ++i) {
    const Ticked& r = ticked[i];
    proxies.push_back(r.proxy / kVoxel);
    out.samples += r.samples;
    out.most_samples = std::max(out.most_samples, r.samples);
    out.capped += r.capped ? 1.0 : 0.0;
    out.hairpins += r.hairpin ? 1.0 : 0.0;
    if (i > 0) out.force_step = std::max(out.force_step, (r.force - ticked[i - 1].force).norm());
    out.force_most = std::max(out.force_most, r.force.norm());
  }
  std::size_t near = 0;
  for (std::size_t i = 1; i < proxies.size(); ++i) {
    const Vec3& p = proxies[i];
    const double off = fromCourse(stream, p, near);
    // The course is unknown beyond its end.
    if (near + 1 < stream.x.size()) out.off_max = std::max(out.off_max, off);
    if (!judged) continue;
    const Vec3& before = proxies[i - 1];
    // Finds the nearest point on the exact stream through the previous proxy.
    double way = (p - before).dot(stream.directionAt(before));
    Vec3 departure;
    for (int pass = 0; pass < 3; ++pass) {
      way = std::clamp(way, -4.0, 4.0);
      const Vec3 on = stream.onFrom(before, way);
      const Vec3 d = stream.directionAt(on);
      const double along = (p - on).dot(d);
      departure = p - on - along * d;
      way += along;
    }
    out.departures += departure.norm();
  }
  const auto n = static_cast<double>(ticks);
  out.departures *= 1280.0 / stream.length();
  out.samples /= n;
  out.capped /= n;
  out.hairpins /= n;
  return out;
}

Shell makeShell(const std::string& kind, double thickness, double level) {
  constexpr double kRadius = 20.0;
  Shell shell;
  shell.radius = kRadius;
  shell.centre = Vec3(31.6, 32.3, 31.85);
  shell.name = kind + " " + std::to_string(thickness).substr(0, 3);
  const auto height = [c = shell.centre](const Vec3& p) { return (p - c).norm() - kRadius; };
  if (kind == "level set") {
    shell.half = 0.5 * thickness;
    shell.field = scalarGrid(64, [=](const Vec3& p) {
      return std::clamp(std::abs(height(p)) - 0.5 * thickness, -3.0, 3.0);
    });
    return shell;
  }
  shell.solid = Solid::kAbove;
  shell.level = level;
  shell.half = 0.5 * thickness + (0.5 - level);
  const bool binary = kind == "binary fog";
  shell.field = scalarGrid(
      64,
      [=](const Vec3& p) {
        const double d = std::abs(height(p));
        if (binary) return d < 0.5 * thickness ? 1.0 : 0.0;
        return std::clamp(0.5 * thickness + 0.5 - d, 0.0, 1.0);
      },
      "trilinear", false);
  return shell;
}

ShellResult pressShell(const Shell& shell, double degrees, double load, long count,
                       const StepParams& step) {
  constexpr double kStrength = 2.34375;  // [N]; the spring is 6 voxels long
  constexpr double kSpring = 6.0;
  constexpr int kTicks = 8;
  constexpr int kHeld = 25;
  GraphSpec spec;
  spec.modes.resize(1);
  spec.modes[0].kind = ModeKind::kIsosurface;
  spec.modes[0].of = "it";
  spec.modes[0].strength = kStrength;
  spec.modes[0].value = shell.level;
  spec.modes[0].solid = shell.solid;
  const auto scene = makeScene(spec, {{"it", shell.field}}, {kMotionStiffness, 0.0}, step);
  test::FreshHand hand({1e3, 1e12});
  const ProxyState& state = hand.state;
  test::Random random(11);
  ShellResult out;
  const double slant = std::tan(degrees * kPi / 180.0);
  const double pace = voxelsPerTick(2.0);
  double ticks = 0.0;
  for (long i = 0; i < count; ++i) {
    const Vec3 d = random.direction();
    const Vec3 t = d.cross(random.direction()).normalized();
    const Vec3 end = shell.centre + (shell.radius + shell.half - load * kSpring) * d;
    const Vec3 in = (-d + slant * t).normalized();
    const double phase = random.uniform();
    hand.restart();
    bool yielded = false;
    for (int k = 0; k <= kTicks + kHeld; ++k) {
      const double before = std::max(kTicks - k - phase, 0.0) * pace;
      const StepReport r =
          provenStep(*scene, hand.reader, {kVoxel * (end - before * in)}, hand.state, kMotionTick);
      if (k == 0) continue;
      ticks += 1.0;
      out.samples += r.samples;
      out.cells += r.walked;
      out.most_samples = std::max<double>(out.most_samples, r.samples);
      out.most_cells = std::max<double>(out.most_cells, r.walked);
      yielded = yielded || sideOf(state.memory(0)) != Side::kOutside;
    }
    if ((state.proxy() / kVoxel - shell.centre).norm() < shell.radius - 0.05) ++out.crossed;
    if (yielded) ++out.yielded;
  }
  out.samples /= ticks;
  out.cells /= ticks;
  return out;
}

}  // namespace palpate::bench
