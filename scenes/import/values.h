/// Numbers as files have them, and what readers do to them: scaling, and turning vectors and
/// tensors with their space.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "palpate/engine/types.h"

namespace palpate::importer {

/// What a number is in memory.
enum class Type : std::uint8_t {
  kInt8,
  kUint8,
  kInt16,
  kUint16,
  kInt32,
  kUint32,
  kInt64,
  kUint64,
  kFloat32,
  kFloat64
};

/// What a float could not hold of numbers: as it is told, or empty.
using Loss = std::string;

/// The worst that there is.
inline constexpr const char* kLossBeyond = "values beyond 3.4e38 are no data";

/// Numbers of one type, one or more to a tuple, tuple by tuple. Copies share them. They know what
/// was lost when they became floats, so that no reader can forget to tell.
class Values {
 public:
  Values() = default;
  /// To be filled. Throws std::bad_alloc.
  Values(Type type, int components, std::size_t tuples);
  /// Somebody else's, kept alive by `data`.
  Values(Type type, int components, std::size_t tuples, std::shared_ptr<void> data);

  [[nodiscard]] bool none() const { return data_ == nullptr; }
  [[nodiscard]] Type type() const { return type_; }
  [[nodiscard]] int components() const { return components_; }
  [[nodiscard]] std::size_t tuples() const { return tuples_; }
  /// Of all components.
  [[nodiscard]] std::size_t size() const { return tuples_ * static_cast<std::size_t>(components_); }
  [[nodiscard]] std::size_t bytesEach() const;

  /// What was lost of them already.
  [[nodiscard]] const Loss& lost() const { return lost_; }
  void setLost(const Loss& loss) {
    if (!loss.empty()) lost_ = loss;
  }

  [[nodiscard]] void* data() const { return data_.get(); }
  /// The numbers, if they are of type T.
  template <class T>
  [[nodiscard]] T* as() const {
    return static_cast<T*>(data_.get());
  }
  /// Tuples [first, first + count) of them, shared.
  [[nodiscard]] Values part(std::size_t first, std::size_t count) const;
  /// One of them, whatever its type.
  [[nodiscard]] double at(std::size_t tuple, int component) const;

 private:
  Type type_ = Type::kFloat32;
  int components_ = 1;
  std::size_t tuples_ = 0;
  std::shared_ptr<void> data_;
  Loss lost_;
};

/// Calls f with a pointer to the numbers, of their type.
template <class F>
auto visit(const Values& values, F&& f) {
  switch (values.type()) {
    case Type::kInt8:
      return f(values.as<std::int8_t>());
    case Type::kUint8:
      return f(values.as<std::uint8_t>());
    case Type::kInt16:
      return f(values.as<std::int16_t>());
    case Type::kUint16:
      return f(values.as<std::uint16_t>());
    case Type::kInt32:
      return f(values.as<std::int32_t>());
    case Type::kUint32:
      return f(values.as<std::uint32_t>());
    case Type::kInt64:
      return f(values.as<std::int64_t>());
    case Type::kUint64:
      return f(values.as<std::uint64_t>());
    case Type::kFloat32:
      return f(values.as<float>());
    case Type::kFloat64:
      break;
  }
  return f(values.as<double>());
}

/// What a float cannot hold of slope * value + offset, or what was lost before.
[[nodiscard]] Loss floatLoss(const Values& values, double slope = 1.0, double offset = 0.0);

/// Turns the bytes of each of `count` numbers round.
void swapBytes(void* data, std::size_t count, std::size_t bytes_each);

/// Where xx yy zz xy yz xz, VTK's order of six, are in the upper triangle row by row: xx xy xz yy
/// yz zz; and in the lower one: xx yx yy zx zy zz.
inline const std::vector<int> kUpperTriangle{0, 3, 5, 1, 4, 2};
inline const std::vector<int> kLowerTriangle{0, 2, 5, 1, 4, 3};

/// slope * value + offset, as floats; the values themselves where that changes nothing. A slope
/// that is 0 or not finite is NIfTI's and MetaImage's way to say that there is none.
[[nodiscard]] Values rescaled(const Values& values, double slope, double offset);

/// As floats; the values themselves if they are.
[[nodiscard]] Values floatsOf(const Values& values);

/// Component c of the result is component order[c] of `values`, of the same type.
[[nodiscard]] Values picked(const Values& values, const std::vector<int>& order);

/// Vectors M v, or tensors M D M^T (9 components row by row, or 6 in VTK's order). Floats and
/// doubles are changed in place, others become floats; the values themselves for the identity.
[[nodiscard]] Values turned(const Values& values, const Mat3& M);

/// As above, of one tensor.
[[nodiscard]] Mat3 tensorOf(const double* six_or_nine, int components);

}  // namespace palpate::importer
