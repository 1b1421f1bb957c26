/// The samplers that are compared, ours, OpenVDB's and NanoVDB's, behind one face, and the grids
/// that they read. Grids have voxels of one unit and the hand's world is the file's: positions are
/// index space to all of them, in OpenVDB's favour, since ours maps them all the same.
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

/// One way to read a grid, with the state that one thread keeps of it.
class Sampler {
 public:
  Sampler() = default;
  Sampler(const Sampler&) = delete;
  Sampler& operator=(const Sampler&) = delete;
  virtual ~Sampler() = default;

  /// Value and gradient, of a vector field the value's sum and nothing.
  [[nodiscard]] virtual Sampled at(const Vec3& p) = 0;
  /// Reads at all points, one after the other [ns].
  [[nodiscard]] virtual double timeAll(std::span<const Vec3> points) = 0;
  /// One call by itself, the clock included [ns].
  [[nodiscard]] virtual double timeOne(const Vec3& p) = 0;
};

/// What a call returns.
enum class Reads : std::uint8_t { kValue, kValueAndGradient, kValueAndJacobian };

/// "V", "V+G" or "V+J".
[[nodiscard]] const char* wordFor(Reads reads) noexcept;

struct Contender {
  std::string method;
  Reads reads = Reads::kValue;
  std::string note;  ///< What one should know of it.
  std::unique_ptr<Sampler> sampler;
};

/// Reads nothing: what the loops and the clock take by themselves.
[[nodiscard]] Contender makeNothing();

/// What is read, and by whom.
struct Contest {
  std::uint64_t active_voxels = 0;
  std::uint64_t memory = 0;  ///< [bytes]
  std::vector<Contender> contenders;
};

/// Whether NanoVDB was found when this was built.
[[nodiscard]] bool hasNanoVdb() noexcept;

/// A dense block of voxels [0, n)^3 with the values of a function of the position.
[[nodiscard]] Contest overBlock(int n, const std::function<double(const Vec3&)>& f);

/// The level set of a ball, half-width three voxels.
[[nodiscard]] Contest overBall(const Vec3& centre, double radius);

/// A velocity, rotation about the centre, in the same voxels.
[[nodiscard]] Contest overSpinningBall(const Vec3& centre, double radius);

}  // namespace palpate::bench
