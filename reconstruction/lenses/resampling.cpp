// Reads a picture between its pixels, 8 rows and columns a place; twin of `read_between_reference` in the tests.
#include <cstdint>

#include "native.h"

// Sets `values` [places] to the sums over 8 rows and columns of a picture, from `start` of a place on, weighed by its
// `down` and `across`. Of the arrays start [all], down and across [all, 8] those places count that are `chosen` [places].
S4_API void read_between(const float *picture, int64_t stride, const int64_t *start, const float *down,
                         const float *across, const int64_t *chosen, int64_t places, float *values) {
    constexpr int kTaps = 8;
    for (int64_t place = 0; place < places; ++place) {
        const float *rows = down + chosen[place] * kTaps, *columns = across + chosen[place] * kTaps;
        const float *at = picture + start[chosen[place]];
        float lines[kTaps] = {};
        for (int row = 0; row < kTaps; ++row, at += stride) {
#pragma omp simd
            for (int column = 0; column < kTaps; ++column) lines[column] += at[column] * rows[row];
        }
        float value = 0;
        for (int column = 0; column < kTaps; ++column) value += lines[column] * columns[column];
        values[place] = value;
    }
}
