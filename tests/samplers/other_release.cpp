/// A module of another release of palpate, for the tests of the loader.
#include "palpate/samplers/module.h"

extern "C" const palpate::ModuleVersion palpate_module{"0.0.1"};
