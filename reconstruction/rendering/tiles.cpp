// Splats in depth order, and for each tile the splats that may touch it.
#include <omp.h>

#include <algorithm>

#include "frame.h"

namespace s4 {
namespace {

// Stable radix sort of the upper 32 bits, 11 bits a pass: equal depths keep the order of the Gaussians.
void radix_sort(std::vector<uint64_t> &keys, std::vector<uint64_t> &scratch, int64_t count) {
    constexpr int kBits = 11, kBuckets = 1 << kBits, kPasses = 3;
    scratch.resize(keys.size());
    std::vector<uint32_t> start(kPasses * kBuckets);
    for (int64_t i = 0; i < count; ++i)
        for (int pass = 0; pass < kPasses; ++pass)
            ++start[pass * kBuckets + ((keys[i] >> (32 + kBits * pass)) & (kBuckets - 1))];
    for (int pass = 0; pass < kPasses; ++pass) {
        uint32_t *place = start.data() + pass * kBuckets, total = 0;
        for (int bucket = 0; bucket < kBuckets; ++bucket) {
            const uint32_t n = place[bucket];
            place[bucket] = total;
            total += n;
        }
        const uint64_t *from = keys.data();
        uint64_t *to = scratch.data();
        for (int64_t i = 0; i < count; ++i) to[place[(from[i] >> (32 + kBits * pass)) & (kBuckets - 1)]++] = from[i];
        keys.swap(scratch);
    }
}

// How many splats may touch each tile: corners of their spans, summed along both axes, whatever the spans' sizes.
void count_entries(Frame &f) {
    const int across = f.tiles_x + 1;
    f.cursor.assign(size_t(across) * (f.tiles_y + 1), 0);
    for (int64_t i = 0; i < f.visible_count; ++i) {
        const Span s = f.spans[f.visible[i]];
        int64_t *top = f.cursor.data() + s.y_first * across, *below = f.cursor.data() + (s.y_last + 1) * across;
        ++top[s.x_first], --top[s.x_last + 1];
        --below[s.x_first], ++below[s.x_last + 1];
    }
    f.tile_start.resize(f.tiles_x * f.tiles_y + 1);
    f.group_start.resize(f.tile_start.size());
    int64_t total = 0, groups = 0;
    for (int y = 0; y < f.tiles_y; ++y) {
        int64_t row = 0;
        for (int x = 0; x < f.tiles_x; ++x) {
            int64_t &here = f.cursor[size_t(y) * across + x];
            row += here;
            here = row + (y ? f.cursor[size_t(y - 1) * across + x] : 0);
            f.tile_start[y * f.tiles_x + x] = total;
            f.group_start[y * f.tiles_x + x] = groups;
            total += here;
            groups += (here + kGroup - 1) / kGroup;
        }
    }
    f.tile_start.back() = total;
    f.group_start.back() = groups;
    f.cursor.assign(f.tile_start.begin(), f.tile_start.end() - 1);
    f.entries.resize(total);
    f.words.resize(size_t(groups) * (kPixels / 16));
    f.checkpoints.resize(size_t(groups) * kPixels);
}

// The first tile of a thread's share: whole rows of tiles, about as many entries for each.
int first_row(const Frame &f, int rank, int threads) {
    const int64_t wanted = f.tile_start.back() * rank / threads;
    int row = 0;
    while (row < f.tiles_y && f.tile_start[size_t(row) * f.tiles_x] < wanted) ++row;
    return rank == threads ? f.tiles_y : row;
}

}  // namespace

void sort_and_count(Frame &f) {
#pragma omp sections
    {
#pragma omp section
        radix_sort(f.keys, f.keys_scratch, f.visible_count);
#pragma omp section
        count_entries(f);
    }
}

// Every thread reads all splats in depth order and fills its own rows: no sort by tile, the same for any threads.
void fill_tiles(Frame &f) {
    const int threads = omp_get_num_threads(), rank = omp_get_thread_num();
    const int top = first_row(f, rank, threads), bottom = first_row(f, rank + 1, threads) - 1;
    for (int64_t rank_in_depth = 0; rank_in_depth < f.visible_count; ++rank_in_depth) {
        const int32_t source = int32_t(uint32_t(f.keys[rank_in_depth]));
        const Span s = f.spans[source];
        for (int y = std::max<int>(s.y_first, top); y <= std::min<int>(s.y_last, bottom); ++y)
            for (int x = s.x_first; x <= s.x_last; ++x) f.entries[f.cursor[y * f.tiles_x + x]++] = source;
    }
#pragma omp barrier
}

}  // namespace s4
