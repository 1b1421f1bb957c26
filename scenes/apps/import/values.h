/// Arrays of numbers as files store them, and conversions of their scale and space.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "palpate/engine/types.h"

namespace palpate::importer {

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

/// Returns the size of a number of this type [bytes].
[[nodiscard]] std::size_t bytesOf(Type type);
/// Returns the name of a type, such as "uint8".
[[nodiscard]] const char* nameOf(Type type);
/// Returns the type with a name, or no value for another name.
[[nodiscard]] std::optional<Type> typeNamed(const std::string& name);

/// Message about numbers that a float cannot represent; empty: none.
using Loss = std::string;

/// The most serious loss: values become missing. All other losses only round values.
inline constexpr const char* kLossBeyond = "values beyond 3.4e38 are read as missing";

/// Tuples of numbers of one type. Copies share the memory. A conversion to floats stores its
/// message about losses in the result. The importer then reports the loss.
class Values {
 public:
  Values() = default;
  /// Allocates memory, which the caller fills. Throws std::bad_alloc.
  Values(Type type, int components, std::size_t tuples);
  /// Uses memory of another owner, which `data` keeps alive.
  Values(Type type, int components, std::size_t tuples, std::shared_ptr<void> data);

  [[nodiscard]] bool none() const { return data_ == nullptr; }
  [[nodiscard]] Type type() const { return type_; }
  [[nodiscard]] int components() const { return components_; }
  [[nodiscard]] std::size_t tuples() const { return tuples_; }
  [[nodiscard]] std::size_t size() const { return tuples_ * static_cast<std::size_t>(components_); }
  [[nodiscard]] std::size_t bytesEach() const;

  [[nodiscard]] const Loss& lost() const { return lost_; }
  void setLost(const Loss& loss) {
    if (!loss.empty()) lost_ = loss;
  }

  [[nodiscard]] void* data() const { return data_.get(); }
  /// Returns the value of the stored type's lowest integer after rescaled(). NaN unless rescaled()
  /// has scaled signed integers of at least 2 bytes.
  [[nodiscard]] double lowestCode() const { return lowest_code_; }
  void setLowestCode(double value) { lowest_code_ = value; }

  /// Returns the numbers, which must have the type T.
  template <class T>
  [[nodiscard]] T* as() const {
    return static_cast<T*>(data_.get());
  }
  /// Returns the tuples [first, first + count), in the same memory.
  [[nodiscard]] Values part(std::size_t first, std::size_t count) const;
  [[nodiscard]] double at(std::size_t tuple, int component) const;

 private:
  Type type_ = Type::kFloat32;
  int components_ = 1;
  std::size_t tuples_ = 0;
  std::shared_ptr<void> data_;
  Loss lost_;
  double lowest_code_ = std::numeric_limits<double>::quiet_NaN();
};

/// Calls f with a pointer to the numbers. The pointer has their type, such as std::int8_t*.
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

/// Returns the earlier loss of `values`; if there is none, the loss of converting slope * value +
/// offset to floats.
[[nodiscard]] Loss floatLoss(const Values& values, double slope = 1.0, double offset = 0.0);

void swapBytes(void* data, std::size_t count, std::size_t bytes_each);

/// Orders for `picked`: from an upper triangle (xx xy xz yy yz zz) or a lower triangle (xx yx yy zx
/// zy zz) to VTK's order xx yy zz xy yz xz.
inline const std::vector<int> kUpperTriangle{0, 3, 5, 1, 4, 2};
inline const std::vector<int> kLowerTriangle{0, 2, 5, 1, 4, 3};

/// Returns slope * value + offset as floats, or the values themselves if they stay equal. As in
/// NIfTI, a slope of 0 means no scaling. A slope or offset that is not finite means the same.
[[nodiscard]] Values rescaled(const Values& values, double slope, double offset);

/// Returns the values as floats; floats are returned without a copy.
[[nodiscard]] Values floatsOf(const Values& values);

/// Returns values in which component c is component order[c] of `values`.
[[nodiscard]] Values picked(const Values& values, const std::vector<int>& order);

/// Returns M v for vectors and M D M^T for tensors. Changes floats and doubles in place; converts
/// other types to floats. Returns the values themselves if M is the identity.
[[nodiscard]] Values turned(const Values& values, const Mat3& M);

[[nodiscard]] Mat3 tensorOf(const double* six_or_nine, int components);

}  // namespace palpate::importer
