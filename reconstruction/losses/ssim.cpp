// Structural similarity under a separable Gaussian window, and its gradient; twin of `ssim_map_reference` in ssim.py.
// Letters: x, y images; mx, my, e, c the windowed means of x, y, (x - y)^2, x y: with the difference instead of the
// squares, rounding leaves equal images at one. Windows are cut at the border and normalised again.
#include <algorithm>
#include <cmath>
#include <vector>

#include "native.h"

namespace {

constexpr int kReach = 5, kTaps = 2 * kReach + 1;

struct Window {
    float tap[kTaps];
    Window() {
        double sum = 0, weight[kTaps];
        for (int k = 0; k < kTaps; ++k) sum += weight[k] = std::exp(-0.5 * (k - kReach) * (k - kReach) / (1.5 * 1.5));
        for (int k = 0; k < kTaps; ++k) tap[k] = float(weight[k] / sum);
    }
};

// Filters along a row: `padded` holds the row between kReach zeros on either side.
void along_row(const Window &window, const float *padded, int width, float *out) {
#pragma omp simd
    for (int i = 0; i < width; ++i) {
        float sum = 0;
        for (int k = 0; k < kTaps; ++k) sum += window.tap[k] * padded[i + k];
        out[i] = sum;
    }
}

// Filters `plane` down the columns, for row j; taps beyond the image weigh nothing.
void down_columns(const Window &window, const float *plane, int width, int height, int j, float *out) {
    const float *row[kTaps];
    float tap[kTaps];
    for (int k = 0; k < kTaps; ++k) {
        const int at = j + k - kReach;
        tap[k] = at >= 0 && at < height ? window.tap[k] : 0.f;
        row[k] = plane + int64_t(std::clamp(at, 0, height - 1)) * width;
    }
#pragma omp simd
    for (int i = 0; i < width; ++i) {
        float sum = 0;
        for (int k = 0; k < kTaps; ++k) sum += tap[k] * row[k][i];
        out[i] = sum;
    }
}

// Return one over the sum of the taps that fall inside 0 .. size - 1, around each place.
std::vector<float> inverse_masses(const Window &window, int size) {
    std::vector<float> out(size);
    for (int i = 0; i < size; ++i) {
        float mass = 0;
        for (int k = 0; k < kTaps; ++k)
            if (i + k - kReach >= 0 && i + k - kReach < size) mass += window.tap[k];
        out[i] = 1 / mass;
    }
    return out;
}

}  // namespace

// `similarity` [H, W]; `slopes` [3, H, W]; `scratch` [4, H, W]; c1, c2 the stabilising constants.
S4_API void ssim_forward(const float *x, const float *y, int32_t width, int32_t height, float c1, float c2,
                         float *similarity, float *slopes, float *scratch, int32_t threads) {
    const Window window;
    const int64_t n = int64_t(width) * height;
    const std::vector<float> inverse_x = inverse_masses(window, width), inverse_y = inverse_masses(window, height);
#pragma omp parallel num_threads(threads)
    {
        const int padded = width + 2 * kReach;
        std::vector<float> lines(4 * size_t(padded), 0.f);
        float *const a = lines.data() + kReach, *const b = a + padded, *const e = b + padded, *const c = e + padded;
#pragma omp for schedule(static)
        for (int j = 0; j < height; ++j) {
            const float *xs = x + int64_t(j) * width, *ys = y + int64_t(j) * width;
#pragma omp simd
            for (int i = 0; i < width; ++i) {
                const float difference = xs[i] - ys[i];
                a[i] = xs[i], b[i] = ys[i];
                e[i] = difference * difference;
                c[i] = xs[i] * ys[i];
            }
            for (int k = 0; k < 4; ++k)
                along_row(window, lines.data() + size_t(k) * padded, width, scratch + k * n + int64_t(j) * width);
        }
#pragma omp for schedule(static)
        for (int j = 0; j < height; ++j) {
            for (int k = 0; k < 4; ++k)
                down_columns(window, scratch + k * n, width, height, j, lines.data() + size_t(k) * padded);
            const float *la = lines.data(), *lb = la + padded, *le = lb + padded, *lc = le + padded;
            float *s = similarity + int64_t(j) * width, *sa = slopes + int64_t(j) * width, *se = sa + n, *sc = se + n;
#pragma omp simd
            for (int i = 0; i < width; ++i) {
                const float inverse = inverse_x[i] * inverse_y[j];
                const float mx = la[i] * inverse, my = lb[i] * inverse, apart = mx - my, product = 2 * mx * my;
                const float a1 = product + c1, b1 = a1 + apart * apart;
                const float a2 = 2 * lc[i] * inverse - product + c2;
                const float variances = a2 + (le[i] * inverse - apart * apart);
                const float b2 = variances > 0.5f * c2 ? variances : 0.5f * c2;  // less than c2 is rounding
                const float inverse_b = 1 / (b1 * b2), value = a1 * a2 * inverse_b;
                s[i] = value;
                sa[i] = 2 * my * (a2 - a1) * inverse_b - 2 * mx * value * (b2 - b1) * inverse_b;
                se[i] = -value * b1 * inverse_b;
                sc[i] = 2 * (a1 - value * b1) * inverse_b;
            }
        }
    }
}

// `gradient` [H, W] of the map to `out` [H, W] of x; `scratch` [3, H, W].
S4_API void ssim_backward(const float *x, const float *y, const float *gradient, const float *slopes, int32_t width,
                          int32_t height, float *out, float *scratch, int32_t threads) {
    const Window window;
    const int64_t n = int64_t(width) * height;
    const std::vector<float> inverse_x = inverse_masses(window, width), inverse_y = inverse_masses(window, height);
#pragma omp parallel num_threads(threads)
    {
        const int padded = width + 2 * kReach;
        std::vector<float> lines(3 * size_t(padded), 0.f);
#pragma omp for schedule(static)
        for (int j = 0; j < height; ++j) {
            for (int k = 0; k < 3; ++k) {
                float *line = lines.data() + size_t(k) * padded + kReach;
                const float *slope = slopes + k * n + int64_t(j) * width, *v = gradient + int64_t(j) * width;
                const float inverse = inverse_y[j];
#pragma omp simd
                for (int i = 0; i < width; ++i) line[i] = v[i] * slope[i] * inverse_x[i] * inverse;
                along_row(window, line - kReach, width, scratch + k * n + int64_t(j) * width);
            }
        }
#pragma omp for schedule(static)
        for (int j = 0; j < height; ++j) {
            for (int k = 0; k < 3; ++k)
                down_columns(window, scratch + k * n, width, height, j, lines.data() + size_t(k) * padded);
            const float *a = lines.data(), *e = a + padded, *c = e + padded;
            const float *xs = x + int64_t(j) * width, *ys = y + int64_t(j) * width;
            float *to = out + int64_t(j) * width;
#pragma omp simd
            for (int i = 0; i < width; ++i) to[i] = a[i] + 2 * (xs[i] - ys[i]) * e[i] + ys[i] * c[i];
        }
    }
}
