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

constexpr float kHalf = 0.5f;

// Blends into block b the splats that its word names, and keeps in the word those that show there. Returns whether the
// block is opaque now.
template <bool kMedian>
bool blend(Group &g, int b, Canvas &canvas) {
    Block T = canvas.T[b], intensity = canvas.intensity[b], depth = canvas.depth[b];
    uint64_t shown = 0;
    bool done = false;
    int seen = 0;
    for (uint64_t word = g.words[b]; word && !done; word &= word - 1) {
        const int k = __builtin_ctzll(word);
        const Near &s = g.splats[k];
        uint32_t none = 0;
        S4_EACH_PART {
            const Native w = shade(s, kGrid.x[b].part[h], kGrid.y[b].part[h], T.part[h]).weight;
            none |= bits_at_most(w, Native{}) << (h * kNative);
            intensity.part[h] += w * s.intensity;
            depth.part[h] += w * s.depth;
            const Native after = T.part[h] - w;
            if constexpr (kMedian) {
                Native &median = canvas.median[b].part[h];
                median = (T.part[h] > kHalf) & (after <= kHalf) ? all(s.depth) : median;
            }
            T.part[h] = after;
        }
        shown |= uint64_t(none != kAllOfBlock) << k;
        done = (++seen & 3) == 0 && opaque(T);
    }
    canvas.T[b] = T, canvas.intensity[b] = intensity, canvas.depth[b] = depth;
    g.words[b] = shown;
    return opaque(T);
}

// Loads up to kGroup splats from entry `first` on, and the blocks they meet among the `live` ones.
void load_group(const Frame &f, const Tile &t, int64_t first, int64_t last, uint16_t live, Group &g) {
    g.count = int(std::min<int64_t>(kGroup, last - first));
    const int32_t *entries = f.entries.data() + first;
    const Splat *splats = f.splats.data();
    alignas(64) uint16_t blocks[kGroup] = {};
    for (int k = 0; k < std::min(g.count, 12); ++k) __builtin_prefetch(splats + entries[k]);
    for (int k = 0; k < g.count; ++k) {
        __builtin_prefetch(splats + entries[std::min<int64_t>(k + 12, last - first - 1)]);
        const Splat &s = splats[entries[k]];
        bring_near(s, t, g.splats[k]);
        blocks[k] = blocks_met(s, t) & live;
    }
    words_of(blocks, g.words);
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
    const int64_t start = f.tile_start[tile], last = f.tile_start[tile + 1];
    uint64_t *words = f.words.data() + f.group_start[tile] * kBlock;
    float *checkpoint = f.checkpoints.data() + f.group_start[tile] * kPixels;
    uint16_t live = 0xffff;
    for (int64_t first = start; first < last; first += kGroup, words += kBlock, checkpoint += kPixels) {
        if (!live) {
            std::fill_n(words, kBlock, uint64_t(0));
            continue;
        }
        __builtin_memcpy(checkpoint, canvas.T, sizeof canvas.T);
        load_group(f, t, first, last, live, g);
        for (int b = 0; b < kBlock; ++b)
            if (g.words[b] && blend<kMedian>(g, b, canvas)) live &= uint16_t(~(1u << b));
        __builtin_memcpy(words, g.words, sizeof g.words);
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
    for (int tile = 0; tile < tiles; ++tile)
        if (f.wants(tile)) forward(f, image, tile);
}

}  // namespace s4
