/// A module of another palpate release, which the loader must refuse.
#include "palpate/samplers/module.h"

extern "C" const palpate::ModuleVersion palpate_module{"0.0.1"};
