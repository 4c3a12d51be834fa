// Which pixels change over a clip; twin of `changed_windows_reference` in images.py.
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "native.h"

// Sets `seen` [pixels] to 1 where counts [windows, pixels], each divided by its window's gain, spread by `least` and
// `shot` times the root of their mean.
S4_API void changed_windows(const uint32_t *counts, int32_t windows, int64_t pixels, const double *gains, double least,
                            double shot, uint8_t *seen) {
    constexpr int64_t kBlock = 512;
    for (int64_t start = 0; start < pixels; start += kBlock) {
        const int64_t length = std::min(kBlock, pixels - start);
        double lowest[kBlock], highest[kBlock], sum[kBlock];
        std::fill(sum, sum + length, 0.0);
        for (int window = 0; window < windows; ++window) {
            const uint32_t *count = counts + window * pixels + start;
            const double gain = gains[window];
#pragma omp simd
            for (int64_t i = 0; i < length; ++i) {
                const double value = count[i] / gain;
                lowest[i] = window == 0 || value < lowest[i] ? value : lowest[i];
                highest[i] = window == 0 || value > highest[i] ? value : highest[i];
                sum[i] += value;
            }
        }
        for (int64_t i = 0; i < length; ++i)
            seen[start + i] |= highest[i] - lowest[i] >= least + std::sqrt(sum[i] / windows) * shot;
    }
}
