#pragma once
#include <falcon/core/FalconDevice.h>
