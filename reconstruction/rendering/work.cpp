// The amount of work in a frame, which the benches compare with its time.
#include "native.h"
#include "tile.h"

namespace s4 {
namespace {

// Pixels that took something of a splat, over the splats of a group; T as in replay.
int64_t lit_pixels(const Group &g, int b, Block &T) {
    int64_t lit = 0;
    for (uint64_t word = g.words[b]; word; word &= word - 1) {
        const Near &s = g.splats[__builtin_ctzll(word)];
        S4_EACH_PART {
            const Native w = shade(s, kGrid.x[b].part[h], kGrid.y[b].part[h], T.part[h]).weight;
            T.part[h] -= w;
            for (int i = 0; i < kNative; ++i) lit += w[i] > 0;
        }
    }
    return lit;
}

}  // namespace
}  // namespace s4

// `work`: splats, splats in tiles, splats in blocks of 16 pixels, and splats in pixels that they reached.
S4_API void render_work(const void *handle, int64_t *work) {
    const s4::Frame &f = *static_cast<const s4::Frame *>(handle);
    work[0] = f.visible_count;
    work[1] = int64_t(f.entries.size());
    work[2] = work[3] = 0;
    s4::Group g;
    for (int tile = 0; tile < f.tiles_x * f.tiles_y; ++tile) {
        const s4::Tile t(f, tile);
        s4::Block T[s4::kBlock];
        for (int b = 0; b < s4::kBlock; ++b) T[b] = s4::clear_block(f.camera, t, b);
        const uint64_t *words = f.words.data() + f.group_start[tile] * s4::kBlock;
        for (int64_t first = f.tile_start[tile]; first < f.tile_start[tile + 1]; first += s4::kGroup) {
            g.count = int(std::min<int64_t>(s4::kGroup, f.tile_start[tile + 1] - first));
            for (int k = 0; k < g.count; ++k) s4::bring_near(f.splats[f.entries[first + k]], t, g.splats[k]);
            __builtin_memcpy(g.words, words, sizeof g.words);
            words += s4::kBlock;
            for (int b = 0; b < s4::kBlock; ++b) work[2] += __builtin_popcountll(g.words[b]);
            for (int b = 0; b < s4::kBlock; ++b) work[3] += s4::lit_pixels(g, b, T[b]);
        }
    }
}
