// What each Gaussian has to do with maps over the picture: sums over pixels of its weight times the map's value.
#include <cstring>
#include <memory>

#include "native.h"
#include "tile.h"

namespace s4 {
namespace {

struct Scratch {
    Group group;
    Block maps[kMoments][kBlock];
    Native sums[kGroup][kMoments];
};

// Adds what the splats of a group take in block b; T as in the forward pass, before the group and then after it.
void add_block(Scratch &s, int b, int maps, Block &T) {
    for (uint64_t word = s.group.words[b]; word; word &= word - 1) {
        const int k = __builtin_ctzll(word);
        S4_EACH_PART {
            const Native w = shade(s.group.splats[k], kGrid.x[b].part[h], kGrid.y[b].part[h], T.part[h]).weight;
            T.part[h] -= w;
            for (int m = 0; m < maps; ++m) s.sums[k][m] += w * s.maps[m][b].part[h];
        }
    }
}

void attribute_tile(Frame &f, const float *maps, int count, int tile, Scratch &s) {
    const Tile t(f, tile);
    const int64_t pixels = int64_t(f.camera.width) * f.camera.height;
    for (int m = 0; m < count; ++m)
        for (int b = 0; b < kBlock; ++b) s.maps[m][b] = load_block(f.camera, t, b, maps + m * pixels);
    Block T[kBlock];
    for (int b = 0; b < kBlock; ++b) T[b] = clear_block(f.camera, t, b);
    const uint64_t *words = f.words.data() + f.group_start[tile] * kBlock;
    const int64_t last = f.tile_start[tile + 1];
    for (int64_t first = f.tile_start[tile]; first < last; first += kGroup, words += kBlock) {
        s.group.count = int(std::min<int64_t>(kGroup, last - first));
        for (int k = 0; k < s.group.count; ++k) bring_near(f.splats[f.entries[first + k]], t, s.group.splats[k]);
        std::memcpy(s.group.words, words, sizeof s.group.words);
        std::memset(s.sums, 0, sizeof s.sums);
        for (int b = 0; b < kBlock; ++b) add_block(s, b, count, T[b]);
        for (int k = 0; k < s.group.count; ++k) {
            const Splat &splat = f.splats[f.entries[first + k]];
            totals(s.sums[k], f.moments[slot_of(splat, t)].value);
        }
    }
}

}  // namespace
}  // namespace s4

// Fills `out` [N, count] from `maps` [count, H, W], at most eight of them, of a frame that was rendered whole; the
// caller hands in zeroed memory.
S4_API void render_attribute(void *handle, const float *maps, int32_t count, float *out, int32_t threads) {
    s4::Frame &f = *static_cast<s4::Frame *>(handle);
    f.moments.resize(f.slots);
#pragma omp parallel num_threads(std::max(threads, 1))
    {
        const std::unique_ptr<s4::Scratch> scratch(new s4::Scratch);
#pragma omp for schedule(dynamic, 4)
        for (int tile = 0; tile < f.tiles_x * f.tiles_y; ++tile) s4::attribute_tile(f, maps, count, tile, *scratch);
#pragma omp for schedule(static)
        for (int64_t i = 0; i < f.visible_count; ++i) {
            const s4::Splat &s = f.splats[f.visible[i]];
            float *sums = out + int64_t(f.visible[i]) * count;
            for (int64_t slot = s.slot; slot < s.slot + s.span.tiles(); ++slot)
                for (int m = 0; m < count; ++m) sums[m] += f.moments[slot].value[m];
        }
    }
}
