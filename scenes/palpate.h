/// All that a program of one's own needs to feel volumes on an arm: scenes, devices, and the loop.
/// Link palpate::scenes, palpate::analytic, palpate::hid and palpate::guardian.
#pragma once

#include "palpate/devices/guardian.h"
#include "palpate/devices/open_device.h"
#include "palpate/engine/error.h"
#include "palpate/engine/haptic_loop.h"
#include "palpate/engine/haptic_thread.h"
#include "palpate/engine/step.h"
#include "palpate/samplers/analytic_field.h"
#include "palpate/samplers/vdb_field.h"
#include "palpate/samplers/volume.h"
#include "palpate/scenes/build_scene.h"
#include "palpate/scenes/scene_file.h"
