#include "palpate/scenes/apps/import/values.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <type_traits>

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>

namespace palpate::importer {
namespace {

struct NumberType {
  const char* name;
  std::size_t bytes;
};
/// In the order of Type.
constexpr std::array kNumberTypes{NumberType{"int8", 1},    NumberType{"uint8", 1},
                                  NumberType{"int16", 2},   NumberType{"uint16", 2},
                                  NumberType{"int32", 4},   NumberType{"uint32", 4},
                                  NumberType{"int64", 8},   NumberType{"uint64", 8},
                                  NumberType{"float32", 4}, NumberType{"float64", 8}};

/// Calls body(first, end) in parallel for ranges that together cover [0, count).
template <class Body>
void forParts(std::size_t count, const Body& body) {
  tbb::parallel_for(
      tbb::blocked_range<std::size_t>(0, count, 4096),
      [&](const tbb::blocked_range<std::size_t>& part) { body(part.begin(), part.end()); });
}

/// Returns the greatest magnitude of slope * value + offset over all finite values; 0 without any.
double greatest(const Values& values, double slope, double offset) {
  return visit(values, [&](const auto* data) {
    return tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, values.size(), 4096), 0.0,
        [=](const tbb::blocked_range<std::size_t>& part, double most) {
          for (std::size_t i = part.begin(); i < part.end(); ++i) {
            const auto value = static_cast<double>(data[i]);
            if (std::isfinite(value)) most = std::max(most, std::abs(slope * value + offset));
          }
          return most;
        },
        [](double a, double b) { return std::max(a, b); });
  });
}

template <class T>
void turnTuples(const Values& values, const Mat3& M) {
  T* data = values.as<T>();
  const auto width = static_cast<std::size_t>(values.components());
  forParts(values.tuples(), [&](std::size_t first, std::size_t end) {
    for (std::size_t i = first; i < end; ++i) {
      T* tuple = data + i * width;
      if (width == 3) {
        const Vec3 v = M * Vec3(tuple[0], tuple[1], tuple[2]);
        for (int c = 0; c < 3; ++c) tuple[c] = static_cast<T>(v[c]);
        continue;
      }
      double numbers[9] = {};
      for (std::size_t c = 0; c < width; ++c) numbers[c] = static_cast<double>(tuple[c]);
      const Mat3 D = M * tensorOf(numbers, values.components()) * M.transpose();
      if (width == 6) {
        const double six[6] = {D(0, 0), D(1, 1), D(2, 2), D(0, 1), D(1, 2), D(0, 2)};
        for (int c = 0; c < 6; ++c) tuple[c] = static_cast<T>(six[c]);
      } else {
        for (int c = 0; c < 9; ++c) tuple[c] = static_cast<T>(D(c / 3, c % 3));
      }
    }
  });
}

}  // namespace

Values::Values(Type type, int components, std::size_t tuples)
    : type_(type), components_(components), tuples_(tuples) {
  const std::size_t bytes = size() * bytesEach();
  data_ = std::shared_ptr<void>(::operator new(std::max<std::size_t>(bytes, 1)),
                                [](void* data) { ::operator delete(data); });
}

Values::Values(Type type, int components, std::size_t tuples, std::shared_ptr<void> data)
    : type_(type), components_(components), tuples_(tuples), data_(std::move(data)) {}

std::size_t bytesOf(Type type) {
  return kNumberTypes[static_cast<std::size_t>(type)].bytes;
}

const char* nameOf(Type type) {
  return kNumberTypes[static_cast<std::size_t>(type)].name;
}

std::optional<Type> typeNamed(const std::string& name) {
  for (std::size_t n = 0; n < kNumberTypes.size(); ++n) {
    if (name == kNumberTypes[n].name) return static_cast<Type>(n);
  }
  return std::nullopt;
}

std::size_t Values::bytesEach() const {
  return bytesOf(type_);
}

Values Values::part(std::size_t first, std::size_t count) const {
  const std::size_t bytes = first * static_cast<std::size_t>(components_) * bytesEach();
  Values out(type_, components_, count,
             std::shared_ptr<void>(data_, static_cast<char*>(data_.get()) + bytes));
  out.setLost(lost_);
  out.setLowestCode(lowest_code_);
  return out;
}

double Values::at(std::size_t tuple, int component) const {
  const std::size_t i =
      tuple * static_cast<std::size_t>(components_) + static_cast<std::size_t>(component);
  return visit(*this, [i](const auto* data) { return static_cast<double>(data[i]); });
}

Loss floatLoss(const Values& values, double slope, double offset) {
  const bool scaled = slope != 1.0 || offset != 0.0;
  const bool whole = values.type() != Type::kFloat32 && values.type() != Type::kFloat64;
  const bool fits = whole ? values.bytesEach() < 4 : values.type() == Type::kFloat32;
  if (!values.lost().empty() || (fits && !scaled)) return values.lost();
  const double most = greatest(values, slope, offset);
  if (most > static_cast<double>(std::numeric_limits<float>::max())) {
    return kLossBeyond;
  }
  if (!whole) return "";
  // 2^24: up to this number, a float represents all whole numbers
  constexpr double kFloat = 16777216.0;
  // 2^53: the same for doubles, in which slope and offset are applied
  constexpr double kDouble = 9007199254740992.0;
  if (!scaled)
    return most > kFloat ? "whole numbers with a magnitude above 16,777,216 may be rounded" : "";
  const bool rounded = (slope != 0.0 && most > kFloat * std::abs(slope)) ||
                       (values.bytesEach() == 8 && greatest(values, 1.0, 0.0) > kDouble);
  return rounded ? "stored whole numbers may be rounded: after scaling they have more digits than "
                   "a float"
                 : "";
}

void swapBytes(void* data, std::size_t count, std::size_t bytes_each) {
  if (bytes_each < 2) return;
  auto* bytes = static_cast<char*>(data);
  forParts(count, [&](std::size_t first, std::size_t end) {
    for (std::size_t i = first; i < end; ++i) {
      std::reverse(bytes + i * bytes_each, bytes + (i + 1) * bytes_each);
    }
  });
}

Values rescaled(const Values& values, double slope, double offset) {
  const bool none = slope == 0.0 || !std::isfinite(slope) || !std::isfinite(offset);
  if (none || (slope == 1.0 && offset == 0.0)) return values;
  Values out(Type::kFloat32, values.components(), values.tuples());
  out.setLost(floatLoss(values, slope, offset));
  visit(values, [&](const auto* from) {
    using T = std::remove_cv_t<std::remove_pointer_t<decltype(from)>>;
    if constexpr (std::is_integral_v<T> && std::is_signed_v<T> && sizeof(T) > 1) {
      const auto lowest = static_cast<double>(std::numeric_limits<T>::lowest());
      out.setLowestCode(static_cast<double>(static_cast<float>(slope * lowest + offset)));
    }
    auto* to = out.as<float>();
    forParts(values.size(), [&](std::size_t first, std::size_t end) {
      for (std::size_t i = first; i < end; ++i) {
        to[i] = static_cast<float>(slope * static_cast<double>(from[i]) + offset);
      }
    });
  });
  return out;
}

Values floatsOf(const Values& values) {
  if (values.type() == Type::kFloat32) return values;
  Values out(Type::kFloat32, values.components(), values.tuples());
  out.setLost(floatLoss(values));
  visit(values, [&](const auto* from) {
    auto* to = out.as<float>();
    forParts(values.size(), [&](std::size_t first, std::size_t end) {
      for (std::size_t i = first; i < end; ++i) to[i] = static_cast<float>(from[i]);
    });
  });
  return out;
}

Values picked(const Values& values, const std::vector<int>& order) {
  Values out(values.type(), static_cast<int>(order.size()), values.tuples());
  out.setLost(values.lost());
  visit(values, [&](const auto* from) {
    using T = std::remove_const_t<std::remove_pointer_t<decltype(from)>>;
    T* to = out.as<T>();
    const auto stride = static_cast<std::size_t>(values.components());
    const std::size_t width = order.size();
    forParts(values.tuples(), [&](std::size_t first, std::size_t end) {
      for (std::size_t i = first; i < end; ++i) {
        for (std::size_t c = 0; c < width; ++c) {
          to[i * width + c] = from[i * stride + static_cast<std::size_t>(order[c])];
        }
      }
    });
  });
  return out;
}

Values turned(const Values& values, const Mat3& M) {
  if (M.isIdentity(0.0)) return values;
  if (values.type() == Type::kFloat64) {
    turnTuples<double>(values, M);
    return values;
  }
  Values out = floatsOf(values);
  turnTuples<float>(out, M);
  return out;
}

Mat3 tensorOf(const double* six_or_nine, int components) {
  const double* d = six_or_nine;
  Mat3 D;
  if (components == 6) {
    D << d[0], d[3], d[5], d[3], d[1], d[4], d[5], d[4], d[2];
  } else {
    D << d[0], d[1], d[2], d[3], d[4], d[5], d[6], d[7], d[8];
  }
  return D;
}

}  // namespace palpate::importer
