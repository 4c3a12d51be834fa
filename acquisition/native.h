// The plain C interface every native kernel of this project stands behind.
#pragma once
#include <cstdint>

#define S4_API extern "C" __attribute__((visibility("default")))
