/// The error of a grid without data.
#pragma once

#include "palpate/engine/error.h"

namespace palpate {

/// The error of loadVolume for a grid without an active voxel, also after smoothing, and for a name
/// that no grid of the file has. A frame of a sequence may lack data in these ways.
class NoDataError : public VolumeError {
 public:
  using VolumeError::VolumeError;  ///< Takes the subject, the reason and the remedy.
};

}  // namespace palpate
