/// All headers that a program needs to render volumes on an arm: scenes, devices, and the loop.
/// Link it with palpate::scenes, palpate::analytic, palpate::hid and palpate::guardian.
#pragma once

#include "palpate/devices/arm/guardian.h"
#include "palpate/devices/arm/servo.h"
#include "palpate/devices/open_device.h"
#include "palpate/engine/error.h"
#include "palpate/engine/loop/haptic_loop.h"
#include "palpate/engine/loop/haptic_thread.h"
#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/analytic_field.h"
#include "palpate/samplers/grid/array_volume.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume.h"
#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/scene_cache.h"
#include "palpate/scenes/library/scene_file.h"
