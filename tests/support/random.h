/// Seeded random numbers, and numbers of random cases.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "palpate/engine/balance/primitive.h"

namespace palpate::test {

/// The number of cases, and the usual number, of the call of cases() with the largest usual number
/// since the test began.
struct AskedCases {
  long run = 0;
  long usual = 0;
};
inline AskedCases& askedCases() {
  static AskedCases asked;
  return asked;
}

/// Returns true if the tested room (a top folder, in PALPATE_ROOM) is listed in PALPATE_CHANGED.
inline bool roomHasChanged() {
  const char* room = std::getenv("PALPATE_ROOM");
  const char* changed = std::getenv("PALPATE_CHANGED");
  if (room == nullptr || changed == nullptr) return false;
  return (' ' + std::string(changed) + ' ').find(' ' + std::string(room) + ' ') !=
         std::string::npos;
}

/// Returns the number of random cases to run, at least 1. PALPATE_CASES can be a number, or a
/// percentage of `usual` ("10%"). For a room that has changed, a percentage is at least 100 %.
/// Default: `usual`.
inline long cases(long usual) {
  const char* text = std::getenv("PALPATE_CASES");
  long run = usual;
  if (text != nullptr) {
    char* end = nullptr;
    const double number = std::strtod(text, &end);
    const bool share = *end == '%';
    run = static_cast<long>(share ? number / 100.0 * static_cast<double>(usual) : number);
    if (share && roomHasChanged()) run = std::max(run, usual);
  }
  run = std::max(1L, run);
  AskedCases& asked = askedCases();
  if (usual >= asked.usual) asked = {run, usual};
  return run;
}

/// Like cases(), for laps, slices or runs: at most `usual`.
inline long share(long usual) {
  return std::min(cases(usual), usual);
}

/// Random numbers. A seed gives the same numbers on every machine, except that logUniform() may
/// round differently.
class Random {
 public:
  explicit Random(std::uint64_t seed) : engine_(seed) {}

  /// Returns a number in [low, high).
  double uniform(double low = 0.0, double high = 1.0) {
    return low + (high - low) * (static_cast<double>(engine_() >> 11) * 0x1p-53);
  }
  double logUniform(double low, double high) {
    return std::exp(uniform(std::log(low), std::log(high)));
  }
  int integer(int count) { return static_cast<int>(engine_() % static_cast<std::uint64_t>(count)); }
  Vec3 inCube(double half) {
    return {uniform(-half, half), uniform(-half, half), uniform(-half, half)};
  }
  Vec3 direction() {
    for (;;) {
      const Vec3 v = inCube(1.0);
      const double n = v.norm();
      if (n > 0.1 && n < 1.0) return v / n;
    }
  }
  /// Returns a primitive of a random kind. Coordinates are up to +-2 mm, strengths up to 3 N.
  Primitive primitive() {
    return {static_cast<PrimitiveKind>(integer(4)), inCube(2e-3), direction(), uniform(0.0, 3.0)};
  }

 private:
  std::mt19937_64 engine_;
};

/// Returns a problem as text for `palpate solve`.
inline std::string describe(const Vec3& probe, double stiffness,
                            const std::vector<Primitive>& primitives) {
  static constexpr const char* kKinds[] = {"force", "point", "line", "plane"};
  std::ostringstream out;
  out.precision(17);
  const auto vec = [&](const Vec3& v) {
    out << '[' << v.x() << ',' << v.y() << ',' << v.z() << ']';
  };
  out << "{\"stiffness\":" << stiffness << ",\"probe\":";
  vec(probe);
  out << ",\"primitives\":[";
  for (std::size_t i = 0; i < primitives.size(); ++i) {
    const Primitive& p = primitives[i];
    out << (i == 0 ? "" : ",") << "{\"kind\":\"" << kKinds[static_cast<int>(p.kind)]
        << "\",\"position\":";
    vec(p.position);
    out << ",\"direction\":";
    vec(p.direction);
    out << ",\"strength\":" << p.strength << '}';
  }
  out << "]}";
  return out.str();
}

}  // namespace palpate::test
