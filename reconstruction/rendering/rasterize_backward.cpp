// Gradients of pixels back to the moments of splats; the adjoint of rasterize.cpp.
// Letters: v the gradient of the image, w weight, B the light behind a splat, normalised, times v.
#include <cstring>
#include <memory>

#include "tile.h"

namespace s4 {
namespace {

struct Pair {  // a splat in a block: alpha, then g = alpha dL/dalpha; and its weight
    Block g, weight;
};

struct Scratch {
    Group group;
    Pair pairs[kGroup * kBlock];  // block by block, nearest first
    Block B[kBlock], intensity[kBlock], depth[kBlock], alpha[kBlock];
};

// Alphas and weights of block b, from the transmittance `T` before the group; returns how many pairs.
int replay(const Group &g, int b, const Block &before, Pair *pairs) {
    Block T = before;
    int n = 0;
    for (uint64_t word = g.words[b]; word; word &= word - 1) {
        const Near &s = g.splats[__builtin_ctzll(word)];
        S4_EACH_PART {
            const Shade shaded = shade(s, kGrid.x[b].part[h], kGrid.y[b].part[h], T.part[h]);
            pairs[n].g.part[h] = shaded.alpha;
            pairs[n].weight.part[h] = shaded.weight;
            T.part[h] -= shaded.weight;
        }
        ++n;
    }
    return n;
}

// From back to front: alpha dL/dalpha = w (c . v - B), without a division by 1 - alpha.
void unblend(const Group &g, int b, Scratch &s, Pair *pairs) {
    Block B = s.B[b];
    const Block vi = s.intensity[b], vz = s.depth[b], va = s.alpha[b];
    uint64_t word = g.words[b];
    for (Pair *pair = pairs + __builtin_popcountll(word); word;) {
        const int k = 63 - __builtin_clzll(word);
        word &= ~(uint64_t(1) << k);
        --pair;
        S4_EACH_PART {
            const Native alpha = pair->g.part[h], w = pair->weight.part[h];
            const Native seen = g.splats[k].intensity * vi.part[h] + (g.splats[k].depth * vz.part[h] + va.part[h]);
            const Native d = seen - B.part[h];
            B.part[h] += alpha * d;
            pair->g.part[h] = alpha < kAlphaMax ? w * d : Native{};
        }
    }
    s.B[b] = B;
}

// A splat's sums over the blocks of the tile, whose next pairs `at` points to.
Moments gather(const Near &splat, uint32_t blocks, const Scratch &s, const Pair **at) {
    const Near c = splat;  // a copy that no store can alias
    Native sum[kMoments] = {};
    for (; blocks; blocks &= blocks - 1) {
        const int b = __builtin_ctz(blocks);
        const Pair &pair = *at[b]++;
        S4_EACH_PART {
            const Native x = kGrid.x[b].part[h], y = kGrid.y[b].part[h];
            const Native u = c.u + c.p * x + c.q * y, v = c.v + c.r * y;
            const Native g = pair.g.part[h], gu = g * u, gv = g * v, w = pair.weight.part[h];
            sum[0] += g, sum[1] += gu, sum[2] += gv;
            sum[3] += gu * u, sum[4] += gu * v, sum[5] += gv * v;
            sum[6] += w * s.intensity[b].part[h], sum[7] += w * s.depth[b].part[h];
        }
    }
    Moments out;
    totals(sum, out.value);
    return out;
}

// Steps over the pairs of a splat whose sums nobody wants.
inline void pass(uint32_t blocks, const Pair **at) {
    for (; blocks; blocks &= blocks - 1) ++at[__builtin_ctz(blocks)];
}

// Writes the moments of a group's splats, but for those of the first `given` Gaussians.
void backward_group(Frame &f, const Tile &t, int64_t first, const float *before, int64_t given, Scratch &s) {
    Group &g = s.group;
    const Splat *splats = f.splats.data();
    Moments *at_slot[kGroup];
    const int32_t *entries = f.entries.data() + first;
    for (int k = 0; k < std::min(g.count, 12); ++k) __builtin_prefetch(splats + entries[k]);
    for (int k = 0; k < g.count; ++k) {
        __builtin_prefetch(splats + entries[std::min(k + 12, g.count - 1)]);
        bring_near(splats[entries[k]], t, g.splats[k]);
        at_slot[k] = entries[k] < given ? nullptr : f.moments.data() + slot_of(splats[entries[k]], t);
        if (at_slot[k]) __builtin_prefetch(at_slot[k], 1);
    }
    uint16_t blocks[kGroup];
    blocks_of(g.words, blocks);
    Block T[kBlock];
    std::memcpy(T, before, sizeof T);
    const Pair *at[kBlock];
    Pair *pairs = s.pairs;
    for (int b = 0; b < kBlock; ++b) {
        at[b] = pairs;
        if (!g.words[b]) continue;
        const int n = replay(g, b, T[b], pairs);
        unblend(g, b, s, pairs);
        pairs += n;
    }
    for (int k = 0; k < g.count; ++k) {
        if (!at_slot[k]) {
            pass(blocks[k], at);
            continue;
        }
        Moments &to = *at_slot[k];
        if (blocks[k])
            to = gather(g.splats[k], blocks[k], s, at);
        else
            to = {};
    }
}

void backward_tile(Frame &f, const ImageGradient &gradient, int tile, int64_t given, Scratch &s) {
    const Tile t(f, tile);
    for (int b = 0; b < kBlock; ++b) {
        s.intensity[b] = load_block(f.camera, t, b, gradient.intensity);
        s.depth[b] = load_block(f.camera, t, b, gradient.depth);
        s.alpha[b] = load_block(f.camera, t, b, gradient.alpha);
        s.B[b] = {};
    }
    const int64_t start = f.tile_start[tile], last = f.tile_start[tile + 1];
    for (int64_t group = f.group_start[tile + 1] - 1; group >= f.group_start[tile]; --group) {
        const int64_t first = start + (group - f.group_start[tile]) * kGroup;
        s.group.count = int(std::min<int64_t>(kGroup, last - first));
        std::memcpy(s.group.words, f.words.data() + group * kBlock, sizeof s.group.words);
        backward_group(f, t, first, f.checkpoints.data() + group * kPixels, given, s);
    }
}

// Sums of splats over a tile that was not rendered are zero.
void clear_tile(Frame &f, int tile, int64_t given) {
    const Tile t(f, tile);
    for (int64_t i = f.tile_start[tile]; i < f.tile_start[tile + 1]; ++i)
        if (f.entries[i] >= given) f.moments[slot_of(f.splats[f.entries[i]], t)] = {};
}

}  // namespace

void rasterize_backward(Frame &f, const ImageGradient &gradient, int64_t given) {
    const int tiles = f.tiles_x * f.tiles_y;
    const std::unique_ptr<Scratch> scratch(new Scratch);  // thread_local would be looked up in every loop
#pragma omp for schedule(dynamic, 4)
    for (int tile = 0; tile < tiles; ++tile) {
        if (f.wants(tile))
            backward_tile(f, gradient, tile, given, *scratch);
        else
            clear_tile(f, tile, given);
    }
}

}  // namespace s4
