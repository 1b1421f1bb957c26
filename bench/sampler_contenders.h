/// The compared samplers (palpate's, OpenVDB's and NanoVDB's) and their grids. World positions are
/// index positions, which favours OpenVDB: palpate's sampler maps positions even here.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "palpate/engine/types.h"

namespace palpate::bench {

struct Sampled {
  double value = 0.0;
  Vec3 gradient = Vec3::Zero();
};

/// A method to read a grid, with the data that a thread keeps between readings.
class Sampler {
 public:
  Sampler() = default;
  Sampler(const Sampler&) = delete;
  Sampler& operator=(const Sampler&) = delete;
  virtual ~Sampler() = default;

  /// Returns value and gradient. If the sampler reads only values, the gradient is zero. For a
  /// vector field, the value is the sum of the components, and the gradient is zero.
  [[nodiscard]] virtual Sampled at(const Vec3& p) = 0;
  /// Reads at all points, one after the other. Returns the time [ns].
  [[nodiscard]] virtual double timeAll(std::span<const Vec3> points) = 0;
  /// Returns the time of a single call, including the time of reading the clock [ns].
  [[nodiscard]] virtual double timeOne(const Vec3& p) = 0;
};

/// The quantities that a call returns.
enum class Reads : std::uint8_t { kValue, kValueAndGradient, kValueAndJacobian };

[[nodiscard]] const char* wordFor(Reads reads) noexcept;

struct Contender {
  std::string method;
  Reads reads = Reads::kValue;
  std::string note;  ///< Remark on the method, for the reader of a chart.
  std::unique_ptr<Sampler> sampler;
};

/// Makes an empty sampler, to time the loops and the clock alone.
[[nodiscard]] Contender makeNothing();

struct Contest {
  std::uint64_t active_voxels = 0;
  std::uint64_t memory = 0;  ///< [bytes]
  std::vector<Contender> contenders;
};

[[nodiscard]] bool hasNanoVdb() noexcept;

/// Makes a dense block of voxels [0, n)^3 with the values f(position).
[[nodiscard]] Contest overBlock(int n, const std::function<double(const Vec3&)>& f);

/// Makes the level set of a ball, with a half-width of three voxels.
[[nodiscard]] Contest overBall(const Vec3& centre, double radius);

/// Makes the velocity field of a rotation about the centre, in the voxels of the ball's level set.
[[nodiscard]] Contest overSpinningBall(const Vec3& centre, double radius);

}  // namespace palpate::bench
