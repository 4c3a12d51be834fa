// Tiles of splats to pixels and back; twin of `composite` in reference.py.
// Letters: T transmittance, w = T alpha weight, B what lies behind a splat, normalised, times the output gradient.
#include <algorithm>
#include <cstring>

#include "frame.h"

namespace s4 {
namespace {

struct alignas(64) Lanes {
    float row[kTile][kTile];
};

struct Corner {  // a tile's first pixel centre relative to a splat, and the rows the splat covers
    float u, v;
    int first, last;
};

inline Corner corner_of(const Splat &s, int x, int y) {
    const float dx = float(x) + 0.5f - s.x, dy = float(y) + 0.5f - s.y;
    return {s.p * dx + s.q * dy, s.r * dy, std::max(s.y_first - y, 0), std::min(s.y_last - y, kTile - 1)};
}

// exp(-sigma) for sigma in [0, 6]: a polynomial of degree 5 for exp(-sigma / 8), to the 8th power; 1e-6 relative.
inline float exp_minus(float sigma) {
    float e = 9.71009819e-06f + sigma * -1.78428959e-07f;
    e = 0.00781066544f + sigma * (-0.000324167922f + sigma * e);
    e = 0.999999921f + sigma * (-0.124999067f + sigma * e);
    e *= e;
    e *= e;
    return e * e;
}

// Selects, not branches: the loops around it must stay vectors.
inline float alpha_of(float u, float v2, float sigma_max, float opacity, float T) {
    const float sigma = u * u + v2;
    const float bounded = sigma < 6.f ? sigma : 6.f;
    float alpha = opacity * exp_minus(bounded);
    alpha = alpha < kAlphaMax ? alpha : kAlphaMax;
    alpha = sigma <= sigma_max ? alpha : 0.f;
    return T >= kTransmittanceMin ? alpha : 0.f;
}

// Transmittance at a tile's start: one inside the image, zero beyond it.
void clear(const Pinhole &c, int x, int y, Lanes &T) {
    for (int j = 0; j < kTile; ++j)
        for (int i = 0; i < kTile; ++i) T.row[j][i] = x + i < c.width && y + j < c.height ? 1.f : 0.f;
}

bool opaque(const Lanes &T) {
    const float *t = T.row[0];
    int live = 0;
#pragma omp simd reduction(+ : live)
    for (int i = 0; i < kPixels; ++i) live += t[i] >= kTransmittanceMin;
    return live == 0;
}

void blend(const Splat &splat, int x, int y, Lanes &T, Lanes &intensity, Lanes &depth) {
    const Splat s = splat;  // a copy that no store can alias
    const Corner c = corner_of(s, x, y);
    for (int j = c.first; j <= c.last; ++j) {
        const float v = c.v + s.r * float(j), v2 = v * v, u_first = c.u + s.q * float(j);
        float *t = T.row[j], *out = intensity.row[j], *z = depth.row[j];
#pragma omp simd aligned(t, out, z : 64)
        for (int i = 0; i < kTile; ++i) {
            const float w = t[i] * alpha_of(u_first + s.p * float(i), v2, s.sigma_max, s.opacity, t[i]);
            out[i] += w * s.intensity;
            z[i] += w * s.depth;
            t[i] -= w;
        }
    }
}

void forward_tile(Frame &f, const Image &image, int tile) {
    const int x = tile % f.tiles_x * kTile, y = tile / f.tiles_x * kTile;
    Lanes T, intensity = {}, depth = {};
    clear(f.camera, x, y, T);
    float *checkpoint = f.checkpoints.data() + f.checkpoint_start[tile] * kPixels;
    const int64_t start = f.tile_start[tile], last = f.tile_start[tile + 1] - 1;
    int64_t k = start;
    for (; k <= last; ++k) {
        if ((k - start) % kChunk == 0) {
            if (opaque(T)) break;
            std::copy_n(T.row[0], kPixels, checkpoint);
            checkpoint += kPixels;
        }
        __builtin_prefetch(&f.splats[f.entries[std::min(k + 4, last)]]);
        blend(f.splats[f.entries[k]], x, y, T, intensity, depth);
    }
    f.tile_end[tile] = k;
    const int across = std::min(kTile, f.camera.width - x), down = std::min(kTile, f.camera.height - y);
    for (int j = 0; j < down; ++j) {
        const int64_t at = int64_t(y + j) * f.camera.width + x;
        std::copy_n(intensity.row[j], across, image.intensity + at);
        std::copy_n(depth.row[j], across, image.depth + at);
        for (int i = 0; i < across; ++i) image.alpha[at + i] = 1.f - T.row[j][i];
    }
}

struct Scratch {  // one chunk: its splats side by side, their alphas and weights
    Splat splats[kChunk];
    Lanes alpha[kChunk], weight[kChunk];
};

void replay(const Splat &splat, int x, int y, Lanes &T, Lanes &alpha, Lanes &weight) {
    const Splat s = splat;  // a copy that no store can alias
    const Corner c = corner_of(s, x, y);
    for (int j = c.first; j <= c.last; ++j) {
        const float v = c.v + s.r * float(j), v2 = v * v, u_first = c.u + s.q * float(j);
        float *t = T.row[j], *a = alpha.row[j], *w = weight.row[j];
#pragma omp simd aligned(t, a, w : 64)
        for (int i = 0; i < kTile; ++i) {
            const float alpha = alpha_of(u_first + s.p * float(i), v2, s.sigma_max, s.opacity, t[i]);
            const float weight_here = t[i] * alpha;
            a[i] = alpha;
            w[i] = weight_here;
            t[i] -= weight_here;
        }
    }
}

// Sums of four rows at once, by a transposing tree: compilers add a reduction of known length one by one.
using Four = float __attribute__((vector_size(16)));

inline Four quarter(const float *lane) {
    Four part[4];
    std::memcpy(part, lane, sizeof part);
    return (part[0] + part[1]) + (part[2] + part[3]);
}

inline Four totals(const float *a, const float *b, const float *c, const float *d) {
    const Four qa = quarter(a), qb = quarter(b), qc = quarter(c), qd = quarter(d);
    const Four ab = __builtin_shufflevector(qa, qb, 0, 4, 1, 5) + __builtin_shufflevector(qa, qb, 2, 6, 3, 7);
    const Four cd = __builtin_shufflevector(qc, qd, 0, 4, 1, 5) + __builtin_shufflevector(qc, qd, 2, 6, 3, 7);
    return __builtin_shufflevector(ab, cd, 0, 1, 4, 5) + __builtin_shufflevector(ab, cd, 2, 3, 6, 7);
}

struct TileGradient {
    Lanes intensity, depth, alpha;
};

// One splat of one tile, going from back to front: alpha dL/dalpha = w (c . v - B), without a division by 1 - alpha.
Moments unblend(const Splat &splat, int x, int y, const TileGradient &v, const Lanes &alpha, const Lanes &weight,
                Lanes &B) {
    const Splat s = splat;  // a copy that no store can alias
    const Corner c = corner_of(s, x, y);
    alignas(64) float s0[kTile] = {}, s1[kTile] = {}, s2[kTile] = {}, si[kTile] = {}, sz[kTile] = {};
    for (int j = c.first; j <= c.last; ++j) {
        const float *vi = v.intensity.row[j], *vz = v.depth.row[j], *va = v.alpha.row[j];
        const float *a = alpha.row[j], *w = weight.row[j];
        float *b = B.row[j];
        const float step = float(j);
#pragma omp simd aligned(vi, vz, va, a, w, b, s0, s1, s2, si, sz : 64)
        for (int i = 0; i < kTile; ++i) {
            const float d = s.intensity * vi[i] + s.depth * vz[i] + va[i] - b[i];
            b[i] += a[i] * d;
            const float g = a[i] < kAlphaMax ? w[i] * d : 0.f;
            const float gy = g * step;
            s0[i] += g;
            s1[i] += gy;
            s2[i] += gy * step;
            si[i] += w[i] * vi[i];
            sz[i] += w[i] * vz[i];
        }
    }
    alignas(64) float us0[kTile], uus0[kTile], us1[kTile];
#pragma omp simd
    for (int i = 0; i < kTile; ++i) {
        const float u = c.u + s.p * float(i);
        us0[i] = u * s0[i];
        uus0[i] = u * us0[i];
        us1[i] = u * s1[i];
    }
    const Four by_u = totals(s0, us0, uus0, s1), rest = totals(us1, s2, si, sz);
    const float a0 = by_u[0], a1 = by_u[1], a2 = by_u[2], b0 = by_u[3], b1 = rest[0], c0 = rest[1];
    return {{a0,
            a1 + s.q * b0,
            c.v * a0 + s.r * b0,
            a2 + 2 * s.q * b1 + s.q * s.q * c0,
            c.v * (a1 + s.q * b0) + s.r * (b1 + s.q * c0),
            c.v * c.v * a0 + 2 * c.v * s.r * b0 + s.r * s.r * c0,
            rest[2],
            rest[3]}};
}

inline int64_t slot_of(const Splat &s, int tx, int ty) {
    return s.slot + int64_t(ty - s.y_first / kTile) * s.tiles_across() + tx - s.x_first / kTile;
}

void load(const Pinhole &c, int x, int y, const float *from, Lanes &to) {
    to = {};
    if (!from) return;
    const int across = std::min(kTile, c.width - x), down = std::min(kTile, c.height - y);
    for (int j = 0; j < down; ++j) std::copy_n(from + int64_t(y + j) * c.width + x, across, to.row[j]);
}

void backward_tile(Frame &f, const ImageGradient &gradient, int tile, Scratch &scratch) {
    const int tx = tile % f.tiles_x, ty = tile / f.tiles_x, x = tx * kTile, y = ty * kTile;
    TileGradient v;
    load(f.camera, x, y, gradient.intensity, v.intensity);
    load(f.camera, x, y, gradient.depth, v.depth);
    load(f.camera, x, y, gradient.alpha, v.alpha);
    Lanes B = {}, T;
    const int64_t start = f.tile_start[tile], end = f.tile_end[tile];
    for (int64_t chunk = (end - start + kChunk - 1) / kChunk - 1; chunk >= 0; --chunk) {
        const int64_t first = start + chunk * kChunk;
        const int count = int(std::min<int64_t>(kChunk, end - first));
        std::copy_n(f.checkpoints.data() + (f.checkpoint_start[tile] + chunk) * kPixels, kPixels, T.row[0]);
        for (int k = 0; k < count; ++k) scratch.splats[k] = f.splats[f.entries[first + k]];
        for (int k = 0; k < count; ++k) replay(scratch.splats[k], x, y, T, scratch.alpha[k], scratch.weight[k]);
        for (int k = count - 1; k >= 0; --k) {
            const Splat &s = scratch.splats[k];
            f.moments[slot_of(s, tx, ty)] = unblend(s, x, y, v, scratch.alpha[k], scratch.weight[k], B);
        }
    }
    for (int64_t k = end; k < f.tile_start[tile + 1]; ++k) f.moments[slot_of(f.splats[f.entries[k]], tx, ty)] = {};
}

}  // namespace

void rasterize(Frame &f, const Image &image, int threads) {
    const int tiles = f.tiles_x * f.tiles_y;
    f.tile_end.resize(tiles);
    f.checkpoint_start.resize(tiles + 1);
    int64_t chunks = 0;
    for (int tile = 0; tile < tiles; ++tile) {
        f.checkpoint_start[tile] = chunks;
        chunks += (f.tile_start[tile + 1] - f.tile_start[tile] + kChunk - 1) / kChunk;
    }
    f.checkpoint_start[tiles] = chunks;
    f.checkpoints.resize(size_t(chunks) * kPixels);
#pragma omp parallel for schedule(dynamic, 4) num_threads(threads)
    for (int tile = 0; tile < tiles; ++tile) forward_tile(f, image, tile);
}

void rasterize_backward(Frame &f, const ImageGradient &gradient, int threads) {
    const int tiles = f.tiles_x * f.tiles_y;
    f.moments.resize(f.slots);
#pragma omp parallel num_threads(threads)
    {
        static thread_local Scratch scratch;
#pragma omp for schedule(dynamic, 4)
        for (int tile = 0; tile < tiles; ++tile) backward_tile(f, gradient, tile, scratch);
    }
}

}  // namespace s4
