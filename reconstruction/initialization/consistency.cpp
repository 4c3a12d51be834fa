// Which depths of one view another view confirms; twin of `confirmations_reference` in consistency.py.
#include <cmath>
#include <cstdint>

#include "native.h"

// Adds 1 to votes [H, W] where the point at a depth [H, W], carried by `other_from_pixel` (rows of R K^-1, then t) into
// a pinhole fx fy cx cy with depths [Ho, Wo], has an inverse depth there within `tolerance` (1/m) of its own.
S4_API void confirm_depths(const float *depth, int32_t height, int32_t width, const double *other_from_pixel,
                           const double *pinhole, const float *other, int32_t other_height, int32_t other_width,
                           double tolerance, uint8_t *votes) {
    const double *m = other_from_pixel, *t = m + 9;
    for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; ++x) {
            const int64_t i = int64_t(y) * width + x;
            const double u = x + 0.5, v = y + 0.5, d = depth[i];
            const double z = (m[6] * u + m[7] * v + m[8]) * d + t[2];
            if (!(z > 1e-6)) continue;  // also where the depth is unknown
            const double column = ((m[0] * u + m[1] * v + m[2]) * d + t[0]) / z * pinhole[0] + pinhole[2];
            const double row = ((m[3] * u + m[4] * v + m[5]) * d + t[1]) / z * pinhole[1] + pinhole[3];
            if (!(column >= 0 && row >= 0 && column < other_width && row < other_height)) continue;
            const double there = other[int64_t(row) * other_width + int64_t(column)];
            votes[i] += std::abs(1 / there - 1 / z) <= tolerance;
        }
    }
}
