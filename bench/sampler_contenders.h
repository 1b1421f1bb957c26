/// The samplers that are compared (palpate's, OpenVDB's and NanoVDB's) behind one interface, and
/// the grids that they read. Grids have voxels of one unit, and the hand's world is the file's
/// space. Positions are thus in index space for all samplers. This favours OpenVDB, because
/// palpate's sampler maps positions all the same.
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

/// A way to read a grid, with the state that one thread keeps of the grid.
class Sampler {
 public:
  Sampler() = default;
  Sampler(const Sampler&) = delete;
  Sampler& operator=(const Sampler&) = delete;
  virtual ~Sampler() = default;

  /// Returns value and gradient; for a vector field, the sum of its components and a zero gradient.
  [[nodiscard]] virtual Sampled at(const Vec3& p) = 0;
  /// Reads at all points, one after the other. Returns the time [ns].
  [[nodiscard]] virtual double timeAll(std::span<const Vec3> points) = 0;
  /// Returns the time of a single call, the clock included [ns].
  [[nodiscard]] virtual double timeOne(const Vec3& p) = 0;
};

/// Result of a call.
enum class Reads : std::uint8_t { kValue, kValueAndGradient, kValueAndJacobian };

/// "V", "V+G" or "V+J".
[[nodiscard]] const char* wordFor(Reads reads) noexcept;

struct Contender {
  std::string method;
  Reads reads = Reads::kValue;
  std::string note;  ///< Remark on the method for readers.
  std::unique_ptr<Sampler> sampler;
};

/// Makes a sampler without readings, to time the loops and the clock by themselves.
[[nodiscard]] Contender makeNothing();

/// A grid, and the samplers that read it.
struct Contest {
  std::uint64_t active_voxels = 0;
  std::uint64_t memory = 0;  ///< [bytes]
  std::vector<Contender> contenders;
};

/// Returns whether NanoVDB was found at build time.
[[nodiscard]] bool hasNanoVdb() noexcept;

/// Makes a dense block of voxels [0, n)^3 with the values of a function of the position.
[[nodiscard]] Contest overBlock(int n, const std::function<double(const Vec3&)>& f);

/// Makes the level set of a ball, with a half-width of three voxels.
[[nodiscard]] Contest overBall(const Vec3& centre, double radius);

/// Makes a velocity field, a rotation about the centre, in the same voxels.
[[nodiscard]] Contest overSpinningBall(const Vec3& centre, double radius);

}  // namespace palpate::bench
