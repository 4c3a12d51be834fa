// Rays through sparse grids, forward and backward; twin of `march_reference` in march.py, which has the formulas.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "native.h"

namespace {

constexpr int BLOCK[3] = {8, 8, 4};   // nodes of a block of `near`
constexpr int KNOT[3] = {16, 16, 8};  // nodes between knots of the offsets
constexpr float EMPTY = -6.0f, SPENT = 1e-6f, MOST = 1e18f;  // MOST: two such densities have a sum

struct Grid {  // filled by Python; `near` says of each block whether a sample in it can meet a cell
    const int32_t *lookup;
    const uint8_t *near;
};

struct Field {  // grids: the still one, and the moving one whose samples are shifted by `offsets` [h, w, d, 3]
    Grid grids[2];
    const float *raws, *intensities, *offsets;
    int64_t cells, offset_count;
    int32_t shape[3], knots[3];
    int32_t parts;
    float step;
};

struct Tap {  // the eight corners around a place
    int64_t index[8];
    float weight[8], slope[8][3];
};

struct Sample {
    Tap tap, knots;
    float raw, sigma, intensity, held;
    bool hit;
};

struct Ray {
    float x, y, dx, dy, stretch, first;
};

bool corners(const float place[3], const int32_t shape[3], Tap &tap) {
    int32_t at[3];
    float f[3];
    for (int a = 0; a < 3; ++a) {
        if (!(place[a] >= 0 && place[a] < float(shape[a] - 1))) return false;
        at[a] = int32_t(place[a]);
        f[a] = place[a] - float(at[a]);
    }
    for (int c = 0; c < 8; ++c) {
        const int up[3] = {c >> 2, (c >> 1) & 1, c & 1};
        float w[3], s[3];
        for (int a = 0; a < 3; ++a) {
            w[a] = up[a] ? f[a] : 1 - f[a];
            s[a] = up[a] ? 1.0f : -1.0f;
        }
        tap.index[c] = (int64_t(at[0] + up[0]) * shape[1] + at[1] + up[1]) * shape[2] + at[2] + up[2];
        tap.weight[c] = w[0] * w[1] * w[2];
        tap.slope[c][0] = s[0] * w[1] * w[2];
        tap.slope[c][1] = w[0] * s[1] * w[2];
        tap.slope[c][2] = w[0] * w[1] * s[2];
    }
    return true;
}

void read(const Field &field, int part, const float place[3], Sample &sample) {
    sample.hit = false;
    const int32_t *shape = field.shape;
    for (int a = 0; a < 3; ++a)
        if (!(place[a] >= 0 && place[a] < float(shape[a] - 1))) return;
    int64_t block = 0;
    for (int a = 0; a < 3; ++a) block = block * ((shape[a] + BLOCK[a] - 1) / BLOCK[a]) + int32_t(place[a]) / BLOCK[a];
    if (!field.grids[part].near[block]) return;
    float moved[3] = {place[0], place[1], place[2]};
    if (part) {
        const float knot[3] = {place[0] / KNOT[0], place[1] / KNOT[1], place[2] / KNOT[2]};
        if (!corners(knot, field.knots, sample.knots)) return;
        for (int c = 0; c < 8; ++c)
            for (int a = 0; a < 3; ++a)
                moved[a] += sample.knots.weight[c] * field.offsets[3 * sample.knots.index[c] + a];
    }
    if (!corners(moved, shape, sample.tap)) return;
    float raw = 0, intensity = 0, held = 0;
    for (int c = 0; c < 8; ++c) {
        const int32_t cell = field.grids[part].lookup[sample.tap.index[c]];
        sample.tap.index[c] = cell;
        raw += sample.tap.weight[c] * (cell < 0 ? EMPTY : field.raws[cell]);
        if (cell < 0) continue;
        intensity += sample.tap.weight[c] * field.intensities[cell];
        held += sample.tap.weight[c];
    }
    if (!(held > 0)) return;
    sample.hit = true;
    sample.raw = raw;
    sample.held = held;
    sample.intensity = intensity / held;
    sample.sigma = raw > 15 ? std::min(raw, MOST) : std::log1p(std::exp(raw));
}

// Calls take(layer, samples, depth, intensity) for every sample that holds anything; take returns whether to go on.
template <class Take>
void walk(const Field &field, const Ray &ray, float jitter, Take take) {
    const float last = float(field.shape[2] - 1);
    Sample samples[2];
    samples[1].hit = false;
    for (int64_t k = 0;; ++k) {
        const float w = ray.first + (float(k) + jitter) * field.step;
        if (!(w < last)) return;
        const float place[3] = {ray.y + w * ray.dy, ray.x + w * ray.dx, w};
        for (int part = 0; part < field.parts; ++part) read(field, part, place, samples[part]);
        float sigma = 0, light = 0;
        for (const Sample &sample : samples)
            if (sample.hit) {
                sigma += sample.sigma;
                light += sample.sigma * sample.intensity;
            }
        if (!(sigma > 0)) continue;
        if (!take(w, samples, place, sigma, light / sigma)) return;
    }
}

struct Gradients {
    float *raws, *intensities, *offsets;
};

void spread(const Field &field, const Sample &sample, bool moving, float by_sigma, float by_light, Gradients &out) {
    const float by_raw = sample.raw > MOST ? 0 : by_sigma / (1 + std::exp(-sample.raw));
    const float by_held = by_light / sample.held;
    float shift[3] = {0, 0, 0};
    for (int c = 0; c < 8; ++c) {
        const int64_t cell = sample.tap.index[c];
        const float raw = cell < 0 ? EMPTY : field.raws[cell];
        float by_weight = by_raw * raw;
        if (cell >= 0) {
            out.raws[cell] += sample.tap.weight[c] * by_raw;
            out.intensities[cell] += sample.tap.weight[c] * by_held;
            by_weight += by_held * (field.intensities[cell] - sample.intensity);
        }
        for (int a = 0; a < 3; ++a) shift[a] += by_weight * sample.tap.slope[c][a];
    }
    if (!moving) return;
    for (int c = 0; c < 8; ++c)
        for (int a = 0; a < 3; ++a) out.offsets[3 * sample.knots.index[c] + a] += sample.knots.weight[c] * shift[a];
}

}  // namespace

// light, alpha, middle [R]: the integral, the share of light taken, and the layer where half is (NaN for less).
S4_API void march_forward(const Field *given, const Ray *rays, const float *jitter, int64_t count, float *const *out,
                          int32_t threads) {
    const Field field = *given;
#pragma omp parallel for num_threads(threads) schedule(dynamic, 256)
    for (int64_t r = 0; r < count; ++r) {
        float through = 1, light = 0, middle = std::numeric_limits<float>::quiet_NaN();
        walk(field, rays[r], jitter[r], [&](float w, const Sample *, const float *, float sigma, float intensity) {
            const float depth = sigma * rays[r].stretch * field.step, after = through * std::exp(-depth);
            light += (through - after) * intensity;
            if (through >= 0.5f && after < 0.5f)
                middle = w + field.step * (std::log(2 * through) / depth - jitter[r]);
            through = after;
            return through > SPENT;
        });
        out[0][r] = light;
        out[1][r] = 1 - through;
        out[2][r] = middle;
    }
}

// Gradients of raws, intensities and offsets are added to `out`; by_light and by_alpha [R] are those of the results.
S4_API void march_backward(const Field *given, const Ray *rays, const float *jitter, int64_t count,
                           const float *const *results, const float *const *wanted, float *const *out,
                           int32_t threads) {
    const Field field = *given;
    const int64_t sizes[3] = {field.cells, field.cells, field.offset_count};
    std::vector<std::vector<float>> spare;
    for (int32_t t = 1; t < threads; ++t)
        for (int64_t size : sizes) spare.emplace_back(size_t(size), 0.0f);
#pragma omp parallel for num_threads(threads) schedule(static, 1)
    for (int32_t t = 0; t < threads; ++t) {
        float *own[3];
        for (int i = 0; i < 3; ++i) own[i] = t ? spare[size_t(3 * (t - 1) + i)].data() : out[i];
        Gradients gradients{own[0], own[1], own[2]};
        for (int64_t r = count * t / threads; r < count * (t + 1) / threads; ++r) {
            const float by_light = wanted[0][r], by_alpha = wanted[1][r], left = 1 - results[1][r];
            float through = 1, seen = 0;
            walk(field, rays[r], jitter[r], [&](float, const Sample *samples, const float *, float sigma, float value) {
                const float length = rays[r].stretch * field.step, after = through * std::exp(-sigma * length);
                const float weight = through - after;
                seen += weight * value;
                const float behind = results[0][r] - seen;
                const float by_sigma = length * (by_light * (after * value - behind) + by_alpha * left);
                for (int part = 0; part < field.parts; ++part) {
                    const Sample &s = samples[part];
                    if (!s.hit) continue;
                    const float by_own = by_light * weight / sigma;
                    spread(field, s, part == 1, by_sigma + by_own * (s.intensity - value), by_own * s.sigma, gradients);
                }
                through = after;
                return through > SPENT;
            });
        }
    }
    for (int i = 0; i < 3; ++i)
        for (int32_t t = 1; t < threads; ++t) {
            const float *part = spare[size_t(3 * (t - 1) + i)].data();
            for (int64_t k = 0; k < sizes[i]; ++k) out[i][k] += part[k];
        }
}
