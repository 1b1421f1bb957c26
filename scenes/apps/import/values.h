/// Numbers as stored in files, and the operations of readers: to scale values, and to turn vectors
/// and tensors with their space.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "palpate/engine/types.h"

namespace palpate::importer {

/// Type of a number in memory.
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

/// Message about numbers that a float could not hold; empty if there was no loss.
using Loss = std::string;

/// The message with the highest priority: these values are lost, not rounded.
inline constexpr const char* kLossBeyond = "values beyond 3.4e38 are read as missing";

/// Numbers of one type, one or more to a tuple, stored tuple by tuple. Copies share the memory. The
/// loss of a conversion to float is kept with them, so that every reader reports it.
class Values {
 public:
  Values() = default;
  /// Allocates values to be filled. Throws std::bad_alloc.
  Values(Type type, int components, std::size_t tuples);
  /// Wraps memory of another owner, which `data` keeps alive.
  Values(Type type, int components, std::size_t tuples, std::shared_ptr<void> data);

  [[nodiscard]] bool none() const { return data_ == nullptr; }
  [[nodiscard]] Type type() const { return type_; }
  [[nodiscard]] int components() const { return components_; }
  [[nodiscard]] std::size_t tuples() const { return tuples_; }
  /// Returns the number of components in all tuples.
  [[nodiscard]] std::size_t size() const { return tuples_ * static_cast<std::size_t>(components_); }
  [[nodiscard]] std::size_t bytesEach() const;

  /// Returns the loss of earlier conversions.
  [[nodiscard]] const Loss& lost() const { return lost_; }
  void setLost(const Loss& loss) {
    if (!loss.empty()) lost_ = loss;
  }

  [[nodiscard]] void* data() const { return data_.get(); }
  /// Returns the numbers; they have to be of type T.
  template <class T>
  [[nodiscard]] T* as() const {
    return static_cast<T*>(data_.get());
  }
  /// Returns tuples [first, first + count); memory is shared.
  [[nodiscard]] Values part(std::size_t first, std::size_t count) const;
  /// Returns one number, converted from its type.
  [[nodiscard]] double at(std::size_t tuple, int component) const;

 private:
  Type type_ = Type::kFloat32;
  int components_ = 1;
  std::size_t tuples_ = 0;
  std::shared_ptr<void> data_;
  Loss lost_;
};

/// Calls f with a pointer to the numbers, in their type.
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

/// Returns the loss of storing slope * value + offset as float, or an earlier loss.
[[nodiscard]] Loss floatLoss(const Values& values, double slope = 1.0, double offset = 0.0);

/// Reverses the bytes of each of `count` numbers.
void swapBytes(void* data, std::size_t count, std::size_t bytes_each);

/// Positions of VTK's six components, xx yy zz xy yz xz, in the upper triangle row by row: xx xy
/// xz yy yz zz; and in the lower one: xx yx yy zx zy zz.
inline const std::vector<int> kUpperTriangle{0, 3, 5, 1, 4, 2};
inline const std::vector<int> kLowerTriangle{0, 2, 5, 1, 4, 3};

/// Returns slope * value + offset as floats; the values themselves if they would not change. In
/// NIfTI and MetaImage a slope that is 0 or not finite means: not scaled.
[[nodiscard]] Values rescaled(const Values& values, double slope, double offset);

/// Returns the values as floats; the values themselves if they are floats.
[[nodiscard]] Values floatsOf(const Values& values);

/// Returns values of the same type; component c of the result is component order[c] of `values`.
[[nodiscard]] Values picked(const Values& values, const std::vector<int>& order);

/// Returns vectors M v, or tensors M D M^T (9 components row by row, or 6 in VTK's order). Changes
/// floats and doubles in place and converts others to floats. For the identity it returns the
/// values themselves.
[[nodiscard]] Values turned(const Values& values, const Mat3& M);

/// Returns one tensor, in the layouts above.
[[nodiscard]] Mat3 tensorOf(const double* six_or_nine, int components);

}  // namespace palpate::importer
