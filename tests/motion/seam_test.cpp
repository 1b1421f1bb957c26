/// Tests seams between the surfaces of two volumes, and grooves between two walls of one volume.
#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "tests/support/motion_problems.h"
#include "tests/support/random.h"
#include "tests/support/theorem.h"

namespace palpate::seam_test {
using namespace palpate::bench;
using palpate::test::Random;

namespace {

constexpr double kPi = std::numbers::pi;
constexpr int kSide = 49;
const Vec3 kMiddle = Vec3::Constant(24.0);  // middle of the grids [voxels]

/// Half of a slab with a flat top through `origin`. Columns 0 and 2 of `turn` are the slab's x and
/// z axes.
struct Block {
  double side = 1.0;     ///< 1 or -1: the half of the slab with side * x < overlap / 2.
  double overlap = 0.0;  ///< Overlap of both halves [voxels].
  Mat3 turn = Mat3::Identity();
  Vec3 origin = kMiddle;
  double spacing = 1.0;
  std::string interpolation = "trilinear";

  [[nodiscard]] double distance(const Vec3& p) const {
    const Vec3 at = turn.transpose() * (p - origin);
    return std::clamp(std::max(at.z(), side * at.x() - overlap / 2.0), -3.0 * spacing,
                      3.0 * spacing);
  }
  [[nodiscard]] FieldPtr field() const {
    const int n = static_cast<int>(std::ceil((kSide - 1) / spacing)) + 1;
    return scalarGrid(
        n, [this](const Vec3& p) { return distance(p); }, interpolation, true, spacing);
  }
};

std::unique_ptr<const Scene> solids(const std::vector<FieldPtr>& of, double friction = 0.0,
                                    const std::map<std::string, MotionPtr>& motions = {},
                                    ModeKind kind = ModeKind::kIsosurface) {
  std::map<std::string, FieldPtr> fields;
  GraphSpec spec;
  for (std::size_t i = 0; i < of.size(); ++i) {
    ModeSpec mode;
    mode.kind = kind;
    mode.of = "solid " + std::to_string(i);
    mode.solid = Solid::kBelow;
    mode.strength = 20.0;
    // A surface mode holds the proxy at any value at which the mode has strength. So the strength
    // falls to zero 0.1 voxel above the top.
    if (kind == ModeKind::kSurface) {
      mode.strength = TransferFunction::piecewise({{0.0, 20.0}, {0.1, 0.0}});
    }
    mode.friction = friction;
    spec.modes.push_back(mode);
    fields[mode.of] = of[i];
  }
  spec.motions = motions;
  return makeScene(spec, fields, {kMotionStiffness, 0.0});
}

/// Results of a hand that slides across a seam and back.
struct Slide {
  double back = 0.0;  ///< Largest distance by which the seam holds the proxy back [voxels].
  double off = 0.0;   ///< Largest distance of the proxy from the top [voxels].
  double step = 0.0;  ///< Largest change of the force in a tick [N].
  long capped = 0;    ///< Number of ticks that did not converge.
  std::vector<Vec3> proxies;
};

Slide slide(const Scene& scene, double depth, const Mat3& turn, const Vec3& origin) {
  Slide out;
  Reader reader;
  ProxyState state({1e3, 1e12});
  const auto at = [&](double x, double z) { return Vec3(origin + turn * Vec3(x, 0.2, z)); };
  const double width = 12.0;
  Vec3 force = Vec3::Zero();
  for (int i = -200; i < 1900; ++i) {
    const double x = i < 0 ? -width : -width * std::cos(i / 300.0);
    const double z = i < 0 ? 3.0 - (3.0 + depth) * (i + 200) / 199.0 : -depth;
    const StepReport r = provenStep(scene, reader, {kVoxel * at(x, z)}, state, kMotionTick);
    out.proxies.push_back(r.proxy);
    if (i < 20) {
      force = r.force;
      continue;
    }
    const Vec3 p = turn.transpose() * (r.proxy / kVoxel - origin);
    out.back = std::max(out.back, std::abs(p.x() - x));
    out.off = std::max(out.off, std::abs(p.z()));
    out.step = std::max(out.step, (r.force - force).norm());
    out.capped += r.status == StepStatus::kConverged ? 0 : 1;
    force = r.force;
  }
  return out;
}

}  // namespace

TEST_CASE("a hand slides over a flush seam of two volumes as it does over one volume",
          "[motion][seam][release]") {
  for (const double overlap : {0.0, 0.2, 1.0, 2.0, 3.0}) {
    for (const double depth : {2.0, 5.0}) {
      for (const double spacing : {1.0, 0.5}) {
        if (spacing < 1.0 && (overlap < 2.0 || depth > 2.0)) continue;
        const Block left{1.0, overlap};
        const Block right{-1.0, overlap, Mat3::Identity(), kMiddle, spacing};
        const auto scene = solids({left.field(), right.field()});
        const Slide s = slide(*scene, depth, Mat3::Identity(), kMiddle);
        CAPTURE(overlap, depth, spacing, s.back, s.off, s.step, s.capped);
        CHECK(s.back <= 0.01);
        CHECK(s.off <= 0.01);
        CHECK(s.step <= 0.01);
        CHECK(s.capped == 0);
      }
    }
  }
}

TEST_CASE("a hand slides over a turned seam, which holds the proxy back by at most 0.2 voxel",
          "[motion][seam]") {
  Random random(3);
  for (const double overlap : {2.0, 3.0, 4.0}) {
    for (int n = 0; n < 3; ++n) {
      const Mat3 turn =
          Eigen::AngleAxisd(random.uniform(0.0, kPi), random.direction()).toRotationMatrix();
      const Vec3 origin = kMiddle + random.inCube(0.5);
      const auto scene = solids(
          {Block{1.0, overlap, turn, origin}.field(), Block{-1.0, overlap, turn, origin}.field()});
      const Slide s = slide(*scene, 3.0, turn, origin);
      CAPTURE(overlap, n, s.back, s.off, s.step, s.capped);
      CHECK(s.back <= 0.2);
      CHECK(s.step <= 0.05);
    }
  }
}

TEST_CASE("at a seam of splines a bump holds the proxy back by at most 1.05 times the hand's depth",
          "[motion][seam]") {
  // At the edge of the data, a spline overshoots between voxels. So each block has a bump of about
  // 0.1 voxel on its top. The bump's steep side holds the proxy back, at any overlap. The bump is a
  // part of the interpolated surface, so other normals would not remove the effect.
  constexpr double kDepth = 2.0;
  for (const char* interpolation : {"quadratic", "cubic"}) {
    for (const double overlap : {2.0, 6.0}) {
      const Block left{1.0, overlap, Mat3::Identity(), kMiddle, 1.0, interpolation};
      const Block right{-1.0, overlap, Mat3::Identity(), kMiddle, 1.0, interpolation};
      const FieldPtr field = left.field();
      Probed probed(std::get<0>(field));
      double bump = 0.0;
      for (double x = 0.0; x < overlap / 2.0; x += 0.1) {
        double z = 0.2;
        while (z > 0.0 && probed.value(kMiddle + Vec3(x, 0.2, z)) > 0.0) z -= 1e-3;
        bump = std::max(bump, z);
      }
      const Slide s = slide(*solids({field, right.field()}), kDepth, Mat3::Identity(), kMiddle);
      CAPTURE(interpolation, overlap, bump, s.back, s.off, s.step, s.capped);
      CHECK(bump >= 0.05);
      CHECK(bump <= 0.12);
      CHECK(s.off <= bump + 0.01);
      CHECK(s.back <= 1.05 * kDepth);
      CHECK(s.step <= 0.8);
      CHECK(s.capped == 0);
    }
  }
}

TEST_CASE("at a seam of surface modes the proxy lags by less than the hand's depth",
          "[motion][seam]") {
  // A surface mode holds the proxy at the value at which its contact began. So two surface modes
  // can hold at different heights, and neither completes the other's data.
  for (const double overlap : {3.0, 6.0}) {
    const auto scene = solids({Block{1.0, overlap}.field(), Block{-1.0, overlap}.field()}, 0.0, {},
                              ModeKind::kSurface);
    const Slide s = slide(*scene, 2.0, Mat3::Identity(), kMiddle);
    CAPTURE(overlap, s.back, s.off, s.step, s.capped);
    CHECK(s.back <= 1.3);
    CHECK(s.off <= 0.1);
    CHECK(s.step <= 0.5);
    CHECK(s.capped == 0);
  }
}

TEST_CASE("rotating and shifting both volumes of a seam does the same to the proxy's path",
          "[motion][seam][moving]") {
  const Block left{1.0, 1.0};
  const Block right{-1.0, 1.0};
  const std::vector<FieldPtr> halves{left.field(), right.field()};
  const Mat3 turn = Eigen::AngleAxisd(0.8, Vec3(1, 2, -1).normalized()).toRotationMatrix();
  const Eigen::Quaterniond q(turn);
  const Vec3 shift(0.01, -0.02, 0.005);
  const Keyframe placed{0.0, {q.w(), q.x(), q.y(), q.z()}, shift};
  const std::vector<Keyframe> keys{placed};
  // Two equal motions that stand still, so that each volume is read in its own frame of rest.
  const std::map<std::string, MotionPtr> motions{{"solid 0", std::make_shared<const Motion>(keys)},
                                                 {"solid 1", std::make_shared<const Motion>(keys)}};
  const Slide rest = slide(*solids(halves), 3.0, Mat3::Identity(), kMiddle);
  const Slide moved =
      slide(*solids(halves, 0.0, motions), 3.0, turn, turn * kMiddle + shift / kVoxel);
  double apart = 0.0;
  for (std::size_t i = 0; i < rest.proxies.size(); ++i) {
    apart = std::max(apart, (moved.proxies[i] - (turn * rest.proxies[i] + shift)).norm());
  }
  CAPTURE(apart / kVoxel, moved.back, moved.step);
  CHECK(apart <= 1e-9 * kVoxel);
  CHECK(moved.back <= 0.01);
}

TEST_CASE("a solid 3.2 voxels from the proxy leaves the proxy's path unchanged, bit for bit",
          "[motion][seam]") {
  const Block ground{1.0, 100.0};
  // The wall is 3.2 voxels above the proxy's path.
  const FieldPtr above =
      scalarGrid(kSide, [](const Vec3& p) { return std::clamp(27.2 - p.z(), -3.0, 3.0); });
  const Slide alone = slide(*solids({ground.field()}), 3.0, Mat3::Identity(), kMiddle);
  const Slide beside = slide(*solids({ground.field(), above}), 3.0, Mat3::Identity(), kMiddle);
  bool same = true;
  for (std::size_t i = 200; i < alone.proxies.size(); ++i) {
    same = same && alone.proxies[i] == beside.proxies[i];
  }
  CHECK(same);
}

TEST_CASE("friction in a groove of one volume equals that of its two walls", "[motion][seam]") {
  // With the hand at depth d, two walls of half angle phi bear a load of k d / sin phi. The
  // friction of this load acts along the walls.
  const double friction = 0.4;
  const double press_depth = 2.0;
  // The bottom is on a face of the lattice, or in the middle of a cell. There the interpolated
  // bottom is flat, one voxel wide, and higher than the true bottom.
  for (const double beside : {0.0, 0.5}) {
    for (const double degrees : {75.0, 60.0, 45.0, 30.0}) {
      const double phi = degrees * kPi / 180.0;
      const double depth = press_depth + beside / std::tan(phi);
      const Vec3 first(std::cos(phi), 0.0, std::sin(phi));
      const Vec3 second(-std::cos(phi), 0.0, std::sin(phi));
      const Vec3 bottom = kMiddle + beside * Vec3::UnitX();
      const auto groove = [&](const Vec3& p) {
        const Vec3 at = p - bottom;
        return std::clamp(std::min(first.dot(at), second.dot(at)), -3.0, 3.0);
      };
      const auto scene = solids({scalarGrid(kSide, groove)}, friction);
      Reader reader;
      ProxyState state({1e3, 1e12});
      const double holds = friction * depth / std::sin(phi);
      StepReport r;
      const auto press = [&](double y, double z) {
        r = provenStep(*scene, reader, {kVoxel * (bottom + Vec3(0.0, y, z))}, state, kMotionTick);
      };
      for (int i = 0; i < 300; ++i) press(0.0, std::max(3.0 - 0.025 * i, -press_depth));
      double y = 0.0;
      while (y < 2.0 * holds) press(y += 2e-3 * holds, -press_depth);
      const double lag = y - (r.proxy / kVoxel - bottom).y();
      CAPTURE(degrees, beside, lag / holds);
      CHECK(lag / holds >= 0.99);
      CHECK(lag / holds <= 1.01);
    }
  }
}

TEST_CASE("a thin sheet and a narrow slit have 0.9 to 1.3 times the friction of one wall",
          "[motion][seam]") {
  // In a thin sheet, the smoothed gradient is shorter than 1, because the smoothing includes the
  // opposite face.
  const double friction = 0.3;
  const double depth = 2.0;
  const Vec3 origin = kMiddle + Vec3(0.3, 0.2, 0.4);
  Random random(5);
  const Mat3 turned =
      Eigen::AngleAxisd(random.uniform(0.0, kPi), random.direction()).toRotationMatrix();
  for (const Mat3& turn : {Mat3(Mat3::Identity()), turned}) {
    // Thickness of a sheet, or minus the width of a slit [voxels].
    for (const double thick : {1.2, 1.5, -1.25, -1.5}) {
      const auto distance = [&](const Vec3& p) {
        const double z = turn.col(2).dot(p - origin);
        const double off = thick > 0.0 ? std::max(z, -thick - z) : std::min(z, -thick - z);
        return std::clamp(off, -3.0, 3.0);
      };
      const auto scene = solids({scalarGrid(kSide, distance)}, friction);
      Reader reader;
      ProxyState state({1e3, 1e12});
      StepReport r;
      const auto press = [&](double y, double z) {
        const Vec3 at = origin + turn * Vec3(0.3, y, z);
        r = provenStep(*scene, reader, {kVoxel * at}, state, kMotionTick);
      };
      const double from = thick > 0.0 ? 3.0 : -thick / 2.0;
      for (int i = 0; i < 300; ++i) press(0.0, std::max(from - 0.025 * i, -depth));
      double y = 0.0;
      double sum = 0.0;  // a mean, because the interpolated surface of a turned sheet is rough
      constexpr int kTicks = 1000;
      for (int i = -200; i < kTicks; ++i) {
        press(y += 0.01, -depth);
        if (i >= 0) sum += y - turn.col(1).dot(r.proxy / kVoxel - origin);
      }
      const double lag = sum / kTicks / (friction * depth);
      CAPTURE(thick, turn == turned, lag);
      CHECK(lag >= 0.9);
      CHECK(lag <= (std::abs(thick) < 1.5 ? 1.1 : 1.3));
    }
  }
}

TEST_CASE("the proxy rests while the hand rests on a rough ball", "[motion][seam]") {
  // The noise has wavelengths of 5 to 16 voxels.
  Random random(9);
  std::vector<Vec3> waves;
  std::vector<double> phases;
  for (int i = 0; i < 40; ++i) {
    waves.push_back(random.uniform(0.4, 1.2) * random.direction());
    phases.push_back(random.uniform(0.0, 2.0 * kPi));
  }
  const auto rough = [&](const Vec3& p) {
    double sum = 0.0;
    for (std::size_t i = 0; i < waves.size(); ++i) sum += std::cos(waves[i].dot(p) + phases[i]);
    return (p - kMiddle).norm() - 14.0 + 0.15 * sum;
  };
  const auto scene = solids({scalarGrid(kSide, rough)});
  long differ = 0;
  for (int n = 0; n < 16; ++n) {
    const Vec3 out = random.direction();
    Reader reader;
    ProxyState state({1e3, 1e12});
    StepReport r;
    for (int i = 0; i <= 400; ++i) {
      r = provenStep(*scene, reader, {kVoxel * (kMiddle + (20.0 - 0.02 * i) * out)}, state,
                     kMotionTick);
    }
    const Vec3 hand = kVoxel * (kMiddle + 12.0 * out);
    for (int i = 0; i < 200; ++i) r = provenStep(*scene, reader, {hand}, state, kMotionTick);
    const Vec3 rests = r.proxy;
    for (int i = 0; i < 500; ++i) {
      r = provenStep(*scene, reader, {hand}, state, kMotionTick);
      differ += (r.proxy - rests).norm() > 1e-9 * kVoxel ? 1 : 0;
    }
  }
  CHECK(differ == 0);
}

}  // namespace palpate::seam_test
