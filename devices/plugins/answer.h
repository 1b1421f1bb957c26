/// Private to devices: helpers for plug-ins in C++.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdarg>
#include <cstddef>
#include <cstdio>
#include <cstring>
#include <exception>

#include "plugin.h"

namespace palpate_plugins {

/// Returns a copy of the host's struct. Fields that its version lacks are zero.
template <class T>
T known(const T* theirs) {
  T ours{};
  std::memcpy(&ours, theirs, std::min<std::size_t>(theirs->size, sizeof ours));
  ours.size = sizeof ours;
  return ours;
}

/// Fills in the fields for which the host's struct has room, except `size`.
template <class T>
void give(T* theirs, const T& ours) {
  const std::size_t size = std::min<std::size_t>(theirs->size, sizeof ours);
  constexpr std::size_t kHead = sizeof ours.size;
  if (size <= kHead) return;
  std::memcpy(reinterpret_cast<char*>(theirs) + kHead, reinterpret_cast<const char*>(&ours) + kHead,
              size - kHead);
}

/// Returns entry i of an array. Its entries have the size of the host's version of the struct.
inline palpate_plugin_found* at(palpate_plugin_found* found, int i) {
  return reinterpret_cast<palpate_plugin_found*>(reinterpret_cast<char*>(found) +
                                                 static_cast<std::size_t>(i) * found->size);
}

template <std::size_t kRoom>
void copy(char (&to)[kRoom], const char* from) {
  std::snprintf(to, kRoom, "%s", from != nullptr ? from : "");
}

[[gnu::format(printf, 3, 4)]] inline void tell(char* error, std::size_t room, const char* format,
                                               ...) {
  std::va_list words;
  va_start(words, format);
  std::vsnprintf(error, room, format, words);
  va_end(words);
}

/// Runs `work` and returns its result. If `work` throws, writes the cause into `error` and returns
/// `otherwise`.
template <class Result, class Work>
Result safely(const char* plugin, char* error, std::size_t room, Result otherwise,
              Work work) noexcept {
  try {
    return work();
  } catch (const std::exception& e) {
    tell(error, room, "%s: %s; try again", plugin, e.what());
  } catch (...) {
    tell(error, room, "%s: its library failed; try again", plugin);
  }
  return otherwise;
}

/// The rotation from the arm's axes D to W. Row i is W's axis i in the arm's axes.
struct Frame {
  double W_from_D[3][3];

  void toW(const double (&in_D)[3], double scale, double (&in_W)[3]) const {
    for (int i = 0; i < 3; ++i) {
      in_W[i] = 0.0;
      for (int j = 0; j < 3; ++j) in_W[i] += W_from_D[i][j] * in_D[j] * scale;
    }
  }

  void toD(const double (&in_W)[3], double (&in_D)[3]) const {
    for (int i = 0; i < 3; ++i) {
      in_D[i] = 0.0;
      for (int j = 0; j < 3; ++j) in_D[i] += W_from_D[j][i] * in_W[j];
    }
  }

  /// Converts the handle's rotation to a quaternion w, x, y, z in W. Maps the identity to itself.
  void toW(const double (&turned_D)[3][3], double (&q)[4]) const {
    double r[3][3] = {};
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        for (int k = 0; k < 3; ++k) {
          for (int l = 0; l < 3; ++l) {
            r[i][j] += W_from_D[i][k] * turned_D[k][l] * W_from_D[j][l];
          }
        }
      }
    }
    // Starts with the largest component, to avoid division by a small number.
    const double trace = r[0][0] + r[1][1] + r[2][2];
    int first = 0;
    double most = trace;
    for (int i = 0; i < 3; ++i) {
      if (r[i][i] > most) {
        most = r[i][i];
        first = i + 1;
      }
    }
    if (first == 0) {
      const double s = 2.0 * std::sqrt(1.0 + trace);
      q[0] = s / 4.0;
      q[1] = (r[2][1] - r[1][2]) / s;
      q[2] = (r[0][2] - r[2][0]) / s;
      q[3] = (r[1][0] - r[0][1]) / s;
      return;
    }
    const int i = first - 1;
    const int j = (i + 1) % 3;
    const int k = (i + 2) % 3;
    const double s = 2.0 * std::sqrt(1.0 + r[i][i] - r[j][j] - r[k][k]);
    q[0] = (r[k][j] - r[j][k]) / s;
    q[1 + i] = s / 4.0;
    q[1 + j] = (r[j][i] + r[i][j]) / s;
    q[1 + k] = (r[k][i] + r[i][k]) / s;
  }
};

}  // namespace palpate_plugins
