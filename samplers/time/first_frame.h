/// Private: finds the first frame of a sequence that has data.
#pragma once

#include <cstddef>
#include <exception>
#include <utility>
#include <vector>

#include "palpate/samplers/grid/no_data_error.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Returns the index of the first frame that has data, and the result of load(frame) for it. There
/// must be a frame. Throws the error of frame 0 if no frame has data, and all errors of `load`
/// except NoDataError.
template <class Load>
[[nodiscard]] auto firstWithData(const std::vector<VolumeRequest>& frames, Load load)
    -> std::pair<std::size_t, decltype(load(frames.front()))> {
  std::exception_ptr none;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    try {
      return {i, load(frames[i])};
    } catch (const NoDataError&) {
      if (!none) none = std::current_exception();
    }
  }
  std::rethrow_exception(none);
}

}  // namespace palpate
