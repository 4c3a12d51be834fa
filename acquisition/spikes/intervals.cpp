// The interval that holds an instant, for every pixel: a search outward from the instant over packed planes, 512
// pixels at a time, that stops where all of them have fired on both sides.
#include "lanes.h"

namespace {

constexpr int kLevels = 16;

void mark(Words* slices, int64_t distance, const Words& pixels) {
  for (uint64_t bits = uint64_t(distance); bits; bits &= bits - 1) slices[__builtin_ctzll(bits)] |= pixels;
}

// Bit-sliced silent planes [16] before each wanted pixel's first spike, `planes` where there is none; which fired.
Words search(const uint8_t* from, int64_t step, int64_t planes, int64_t bytes, Words pending, Words* slices) {
  for (int level = 0; level < kLevels; ++level) slices[level] = Words{};
  const Words wanted = pending;
  for (int64_t distance = 0; distance < planes && !none(pending); ++distance, from += step) {
    const Words fired = load_block(from, bytes) & pending;
    pending ^= fired;
    if (!none(fired)) mark(slices, distance, fired);
  }
  mark(slices, planes, pending);
  return wanted & ~pending;
}

void expand(const Words* slices, int word, bool msb, int levels, uint16_t* ticks) {
  uint8_t lanes[64];
  uint64_t part[8];
  for (int first = 0; first < levels; first += 8) {
    for (int level = 0; level < 8; ++level)
      part[level] = msb ? mirrored(slices[first + level][word]) : slices[first + level][word];
    lanes_of(part, 8, lanes);
    for (int p = 0; p < 64; ++p) ticks[p] = uint16_t(ticks[p] + (lanes[p] << first));
  }
}

struct Images {
  Placing<uint16_t> ticks, since;
  Placing<uint8_t> sides;
};

// `wanted` is a plane of the pixels to look at, or null for all; blocks without one are left as they are.
void find_intervals(const uint8_t* packed, const uint8_t* wanted, int64_t back, int64_t ahead, int64_t plane_bytes,
                    bool msb, const Images& out) {
  Words before[kLevels], after[kLevels];
  const Words every = ~Words{};
  for (int64_t start = 0; start < plane_bytes; start += kBlock) {
    const int64_t bytes = plane_bytes - start < kBlock ? plane_bytes - start : kBlock;
    Words pending = {};
    std::memcpy(&pending, wanted ? wanted + start : reinterpret_cast<const uint8_t*>(&every), bytes);
    if (none(pending)) continue;
    const Words fired_before = search(packed + start, -plane_bytes, back, bytes, pending, before);
    const Words fired_after = search(packed + start + plane_bytes, plane_bytes, ahead, bytes, pending, after);
    for (int word = 0; word < 8; ++word) {
      uint16_t since[64] = {}, ticks[64];
      expand(before, word, msb, back > 255 ? 16 : 8, since);
      for (int p = 0; p < 64; ++p) ticks[p] = uint16_t(since[p] + 1);
      expand(after, word, msb, ahead > 255 ? 16 : 8, ticks);
      uint64_t found[2] = {fired_before[word], fired_after[word]};
      if (msb) found[0] = mirrored(found[0]), found[1] = mirrored(found[1]);
      uint8_t sides[64];
      lanes_of(found, 2, sides);
      const int64_t pixel = start * 8 + 64 * word;
      out.ticks.put(pixel, 64, ticks);
      out.since.put(pixel, 64, since);
      out.sides.put(pixel, 64, sides);
    }
  }
}

}  // namespace

// Of every instant's plane: ticks [instants][height][width] from the last spike at or before it to the first after
// it, with `reach` planes looked at on each side and a side without a spike counted whole; the planes since the spike
// before it; sides, bit 0 where there is a spike before, bit 1 where there is one after.
S4_API void spike_intervals(const uint8_t* packed, int64_t planes, int32_t width, int32_t height, int32_t msb,
                            int32_t bottom_first, const uint8_t* wanted, const int64_t* instants, int64_t count,
                            int64_t reach, int32_t threads, uint16_t* ticks, uint16_t* since, uint8_t* sides) {
  const int64_t pixels = int64_t(width) * height, plane_bytes = (pixels + 7) / 8;
  const bool flip = bottom_first != 0;
#pragma omp parallel for num_threads(threads) schedule(dynamic) if (threads > 1)
  for (int64_t i = 0; i < count; ++i) {
    const int64_t at = instants[i], behind = planes - 1 - at;
    const Images images = {{width, height, flip, ticks + i * pixels},
                           {width, height, flip, since + i * pixels},
                           {width, height, flip, sides + i * pixels}};
    find_intervals(packed + at * plane_bytes, wanted, at + 1 < reach + 1 ? at + 1 : reach + 1,
                   behind < reach ? behind : reach, plane_bytes, msb != 0, images);
  }
}
