// Splats in depth order, and for each tile the splats that may touch it.
#include <algorithm>

#include "frame.h"

namespace s4 {
namespace {

// Stable radix sort of the upper 32 bits, 11 bits a pass: equal depths keep the order of the Gaussians.
void radix_sort(std::vector<uint64_t> &keys, std::vector<uint64_t> &scratch) {
    constexpr int kBits = 11, kBuckets = 1 << kBits;
    scratch.resize(keys.size());
    std::vector<int64_t> start(kBuckets);
    for (int shift = 32; shift < 64; shift += kBits) {
        std::fill(start.begin(), start.end(), 0);
        for (uint64_t key : keys) ++start[(key >> shift) & (kBuckets - 1)];
        int64_t total = 0;
        for (int64_t &s : start) {
            const int64_t n = s;
            s = total;
            total += n;
        }
        for (uint64_t key : keys) scratch[start[(key >> shift) & (kBuckets - 1)]++] = key;
        keys.swap(scratch);
    }
}

template <class Visit>
inline void each_tile(const Splat &s, int tiles_x, Visit visit) {
    const int left = s.x_first / kTile, right = s.x_last / kTile, bottom = s.y_last / kTile;
    for (int ty = s.y_first / kTile; ty <= bottom; ++ty)
        for (int tx = left; tx <= right; ++tx) visit(ty * tiles_x + tx);
}

}  // namespace

void sort_by_depth(Frame &frame) {
    radix_sort(frame.keys, frame.keys_scratch);
    const size_t n = frame.keys.size();
    frame.splats.resize(n);
    for (size_t rank = 0; rank < n; ++rank) {
        __builtin_prefetch(&frame.projected[uint32_t(frame.keys[std::min(rank + 8, n - 1)])]);
        frame.splats[rank] = frame.projected[uint32_t(frame.keys[rank])];
    }
}

void bin(Frame &frame, int threads) {
    const int tiles = frame.tiles_x * frame.tiles_y;
    const int64_t n = int64_t(frame.splats.size());
    frame.cursor.assign(size_t(tiles) * threads, 0);
    frame.tile_start.resize(tiles + 1);
    frame.entries.resize(frame.slots);
    // Each part of the splats counts by itself, then fills its own places: depth order without a sort by tile.
#pragma omp parallel for schedule(static, 1) num_threads(threads)
    for (int part = 0; part < threads; ++part) {
        int64_t *count = frame.cursor.data() + size_t(part) * tiles;
        for (int64_t rank = n * part / threads; rank < n * (part + 1) / threads; ++rank)
            each_tile(frame.splats[rank], frame.tiles_x, [&](int tile) { ++count[tile]; });
    }
    int64_t total = 0;
    for (int tile = 0; tile < tiles; ++tile) {
        frame.tile_start[tile] = total;
        for (int part = 0; part < threads; ++part) {
            int64_t &c = frame.cursor[size_t(part) * tiles + tile];
            const int64_t count = c;
            c = total;
            total += count;
        }
    }
    frame.tile_start[tiles] = total;
#pragma omp parallel for schedule(static, 1) num_threads(threads)
    for (int part = 0; part < threads; ++part) {
        int64_t *place = frame.cursor.data() + size_t(part) * tiles;
        for (int64_t rank = n * part / threads; rank < n * (part + 1) / threads; ++rank)
            each_tile(frame.splats[rank], frame.tiles_x,
                      [&](int tile) { frame.entries[place[tile]++] = int32_t(rank); });
    }
}

}  // namespace s4
