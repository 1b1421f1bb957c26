#include "palpate/scenes/guess/sampling.h"

namespace palpate::guess {

std::uint64_t hashOf(std::uint64_t x) {  // splitmix64
  x += 0x9e3779b97f4a7c15ULL;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ULL;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebULL;
  return x ^ (x >> 31);
}

std::uint64_t hashOf(const openvdb::Coord& c) {
  std::uint64_t h = 0;
  for (int axis = 0; axis < 3; ++axis) h = hashOf(h ^ static_cast<std::uint32_t>(c[axis]));
  return h;
}

openvdb::Coord voxelOf(const openvdb::CoordBBox& box, std::uint64_t n) {
  const auto y = static_cast<std::uint64_t>(box.dim()[1]);
  const auto z = static_cast<std::uint64_t>(box.dim()[2]);
  return box.min() + openvdb::Coord(static_cast<int>(n / (y * z)), static_cast<int>(n / z % y),
                                    static_cast<int>(n % z));
}

std::vector<openvdb::Coord> facesOf(const openvdb::CoordBBox& box) {
  constexpr int kLines = 32;
  std::vector<openvdb::Coord> at;
  for (int axis = 0; axis < 3; ++axis) {
    const int b = (axis + 1) % 3;
    const int c = (axis + 2) % 3;
    const auto along = [&](int a, int i) {
      return box.min()[a] +
             static_cast<int>(static_cast<std::int64_t>(box.dim()[a] - 1) * i / (kLines - 1));
    };
    for (int i = 0; i < kLines; ++i) {
      for (int j = 0; j < kLines; ++j) {
        for (const int end : {box.min()[axis], box.max()[axis]}) {
          openvdb::Coord p;
          p[axis] = end;
          p[b] = along(b, i);
          p[c] = along(c, j);
          at.push_back(p);
        }
      }
    }
  }
  return at;
}

std::array<double, 3> edgesOf(const openvdb::GridBase& grid) {
  const openvdb::Vec3d origin = grid.transform().indexToWorld(openvdb::Vec3d(0.0));
  std::array<double, 3> edges{};
  for (int axis = 0; axis < 3; ++axis) {
    openvdb::Vec3d p(0.0);
    p[axis] = 1.0;
    edges[static_cast<std::size_t>(axis)] = (grid.transform().indexToWorld(p) - origin).length();
  }
  return edges;
}

std::vector<openvdb::Coord> placesOf(const SuggestInput& input, std::size_t count) {
  return withScalars(input, [&]<class R, class G>(std::type_identity<R>, std::type_identity<G>) {
    return gather<openvdb::Coord, R, G>(input, count,
                                        [](const R&, const openvdb::Coord& c) { return c; });
  });
}

Readings readAt(const SuggestInput& input, const std::vector<openvdb::Coord>& at) {
  return withScalars(input, [&]<class R, class G>(std::type_identity<R>, std::type_identity<G>) {
    const R reader(input);
    Readings read;
    for (const openvdb::Coord& c : at) {
      float value = 0.0F;
      read.active.push_back(reader.probeValue(c, value));
      read.values.push_back(value);
    }
    return read;
  });
}

}  // namespace palpate::guess
