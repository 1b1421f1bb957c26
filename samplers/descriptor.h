/// An owner of a file descriptor.
#pragma once

#include <unistd.h>
#include <utility>

namespace palpate {

/// Owns a file descriptor, and closes it when destroyed.
class Descriptor {
 public:
  /// Takes over an open descriptor; -1: none.
  explicit Descriptor(int number = -1) noexcept : number_(number) {}
  /// Takes over the other object's descriptor.
  Descriptor(Descriptor&& other) noexcept : number_(other.release()) {}
  /// Exchanges the descriptors of both objects.
  Descriptor& operator=(Descriptor&& other) noexcept {
    std::swap(number_, other.number_);
    return *this;
  }
  ~Descriptor() { (void)close(); }

  /// Returns the descriptor; -1: none.
  [[nodiscard]] int get() const noexcept { return number_; }
  /// Returns the descriptor, which the caller must close.
  [[nodiscard]] int release() noexcept { return std::exchange(number_, -1); }
  /// Closes the descriptor if there is one. Returns false on an error: the system may report a
  /// failed write only at this time.
  bool close() noexcept {
    const int number = release();
    return number < 0 || ::close(number) == 0;
  }

 private:
  int number_;
};

}  // namespace palpate
