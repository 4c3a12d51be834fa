// Tiles of splats to pixels; twin of `composite` in reference.py.
// Letters: T transmittance, w = T alpha weight. A tile's splats are met 64 at a time; each of its sixteen blocks of
// pixels stays in registers while it blends those that its own bits name.
#include <limits>

#include "tile.h"

namespace s4 {
namespace {

struct Canvas {
    Block T[kBlock], intensity[kBlock], depth[kBlock], median[kBlock];
};

constexpr int kNever = kGroup + 1;
constexpr float kHalf = 0.5f;

// Blends splats into block b; returns from which splat on it was opaque, or kNever.
template <bool kMedian>
int blend(const Group &g, int b, Canvas &canvas) {
    Block T = canvas.T[b], intensity = canvas.intensity[b], depth = canvas.depth[b];
    int last = 0, seen = 0;
    bool done = false;
    for (uint64_t word = g.words[b]; word && !done; word &= word - 1) {
        last = __builtin_ctzll(word);
        const Near &s = g.splats[last];
        S4_EACH_PART {
            const Shade shaded = shade(s, kGrid.x[b].part[h], kGrid.y[b].part[h], T.part[h]);
            intensity.part[h] += shaded.weight * s.intensity;
            depth.part[h] += shaded.weight * s.depth;
            const Native after = T.part[h] - shaded.weight;
            if constexpr (kMedian) {
                Native &median = canvas.median[b].part[h];
                median = (T.part[h] > kHalf) & (after <= kHalf) ? all(s.depth) : median;
            }
            T.part[h] = after;
        }
        done = (++seen & 3) == 0 && opaque(T);
    }
    canvas.T[b] = T, canvas.intensity[b] = intensity, canvas.depth[b] = depth;
    return opaque(T) ? last + 1 : kNever;
}

// Loads up to kGroup splats from entry `first` on, and the blocks they meet among the `live` ones.
void load_group(Frame &f, const Tile &t, int64_t first, int64_t last, uint16_t live, Group &g) {
    g.count = int(std::min<int64_t>(kGroup, last - first));
    const int32_t *entries = f.entries.data() + first;
    const Splat *splats = f.splats.data();
    uint16_t blocks[kGroup] = {};
    for (int k = 0; k < std::min(g.count, 12); ++k) __builtin_prefetch(splats + entries[k]);
    for (int k = 0; k < g.count; ++k) {
        __builtin_prefetch(splats + entries[std::min<int64_t>(k + 12, last - first - 1)]);
        const Splat &s = splats[entries[k]];
        bring_near(s, t, g.splats[k]);
        blocks[k] = blocks_met(s, t) & live;
    }
    std::copy_n(blocks, g.count, f.blocks.data() + first);
    transpose(blocks, g);
}

template <bool kMedian>
void forward_tile(Frame &f, const Image &image, int tile) {
    const Tile t(f, tile);
    Canvas canvas = {};
    Group g;
    for (int b = 0; b < kBlock; ++b) {
        canvas.T[b] = clear_block(f.camera, t, b);
        if constexpr (kMedian) S4_EACH_PART canvas.median[b].part[h] = all(std::numeric_limits<float>::quiet_NaN());
    }
    float *checkpoint = f.checkpoints.data() + f.checkpoint_start[tile] * kPixels;
    const int64_t start = f.tile_start[tile], last = f.tile_start[tile + 1];
    uint16_t live = 0xffff;
    for (int64_t first = start; first < last; first += kGroup) {
        if (!live) {
            std::fill(f.blocks.begin() + first, f.blocks.begin() + last, uint16_t(0));
            break;
        }
        if (first > start) {
            __builtin_memcpy(checkpoint, canvas.T, sizeof canvas.T);
            checkpoint += kPixels;
        }
        load_group(f, t, first, last, live, g);
        for (int b = 0; b < kBlock; ++b) {
            if (!g.words[b]) continue;
            const int opaque_from = blend<kMedian>(g, b, canvas);
            if (opaque_from == kNever) continue;
            const uint16_t others = uint16_t(~(1u << b));
            live &= others;
            for (int k = opaque_from; k < g.count; ++k) f.blocks[first + k] &= others;
        }
    }
    for (int b = 0; b < kBlock; ++b) {
        store_block(f.camera, t, b, canvas.intensity[b], image.intensity);
        store_block(f.camera, t, b, canvas.depth[b], image.depth);
        if constexpr (kMedian) store_block(f.camera, t, b, canvas.median[b], image.median);
        S4_EACH_PART canvas.T[b].part[h] = 1.f - canvas.T[b].part[h];
        store_block(f.camera, t, b, canvas.T[b], image.alpha);
    }
}

}  // namespace

void rasterize(Frame &f, const Image &image) {
    const int tiles = f.tiles_x * f.tiles_y;
    const auto forward = image.median ? forward_tile<true> : forward_tile<false>;
#pragma omp for schedule(dynamic, 4) nowait
    for (int tile = 0; tile < tiles; ++tile) forward(f, image, tile);
}

}  // namespace s4
