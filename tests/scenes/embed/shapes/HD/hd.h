// A stub of OpenHaptics' header with the names that docs/embed.md's program uses. Its arm moves
// down from 100 mm at 0.1 m/s, in steps of 1 ms; y is up.
#pragma once

using HDdouble = double;
using HDenum = unsigned;
using HHD = unsigned;
using HDCallbackCode = unsigned;
#define HDCALLBACK

enum : HDenum {
  HD_CURRENT_POSITION,
  HD_CURRENT_FORCE,
  HD_NOMINAL_MAX_FORCE,
  HD_NOMINAL_MAX_STIFFNESS,
  HD_INSTANTANEOUS_UPDATE_RATE,
  HD_CALLBACK_CONTINUE,
};

namespace hd_shape {
inline int ticks = 0;
inline double sent[3] = {0.0, 0.0, 0.0};
}  // namespace hd_shape

inline HHD hdGetCurrentDevice() {
  return 0;
}
inline void hdBeginFrame(HHD) {}
inline void hdEndFrame(HHD) {}
inline void hdGetDoublev(HDenum what, HDdouble* out) {
  switch (what) {
    case HD_CURRENT_POSITION:
      out[0] = 0.0;
      out[1] = 100.0 - 0.1 * hd_shape::ticks++;
      out[2] = 0.0;
      break;
    case HD_NOMINAL_MAX_FORCE:
      *out = 3.3;
      break;
    case HD_NOMINAL_MAX_STIFFNESS:
      *out = 0.5;  // [N/mm]
      break;
    default:
      *out = 1000.0;
  }
}
inline void hdSetDoublev(HDenum what, const HDdouble* in) {
  if (what != HD_CURRENT_FORCE) return;
  for (int i = 0; i < 3; ++i) hd_shape::sent[i] = in[i];
}
