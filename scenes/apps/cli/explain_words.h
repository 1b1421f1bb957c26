/// Prints the result of `palpate explain` as text.
#pragma once

#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {

/// `json`: as docs/formats.md defines it.
void printTick(const OrderedJson& json);

}  // namespace palpate::cli
