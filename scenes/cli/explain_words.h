/// What `palpate explain` prints, in words.
#pragma once

#include "palpate/scenes/cli/common.h"

namespace palpate::cli {

/// `json`: as docs/formats.md has it.
void printTick(const OrderedJson& json);

}  // namespace palpate::cli
