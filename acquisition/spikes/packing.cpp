// Unpacking and counting of spike planes, straight from packed bits.
#include <vector>

#include "lanes.h"

namespace {

constexpr int kMost = 255;  // planes that eight levels can count

// Three bits of one weight to one of it and a carry of twice the weight.
inline Words carry_save(Words& sum, Words a, Words b) {
  const Words both = sum ^ a, carry = (sum & a) | (both & b);
  sum = both ^ b;
  return carry;
}

// Bit-sliced counts [8] of at most 255 planes of one block; eight planes at a time ripple only from level 3 up.
template <bool whole>
void count_block(const uint8_t* from, int64_t planes, int64_t stride, int64_t bytes, Words* slices) {
  Words sum[8] = {};
  const int64_t length = whole ? kBlock : bytes;
  int64_t plane = 0;
  for (; plane + 8 <= planes; plane += 8) {
    Words fours[2];
    for (Words& four : fours) {
      const Words a = load_block(from, length), b = load_block(from + stride, length);
      const Words c = load_block(from + 2 * stride, length), d = load_block(from + 3 * stride, length);
      const Words low = carry_save(sum[0], a, b);
      four = carry_save(sum[1], low, carry_save(sum[0], c, d));
      from += 4 * stride;
    }
    ripple<5>(sum + 3, carry_save(sum[2], fours[0], fours[1]));
  }
  for (; plane < planes; ++plane, from += stride) ripple<8>(sum, load_block(from, length));
  std::memcpy(slices, sum, sizeof sum);
}

// The counts [512] of a block over at most 255 planes.
void expand(const Words* slices, int levels, bool msb, uint8_t* lanes) {
  for (int word = 0; word < 8; ++word) {
    uint64_t part[8];
    for (int level = 0; level < levels; ++level)
      part[level] = msb ? mirrored(slices[level][word]) : slices[level][word];
    lanes_of(part, levels, lanes + 64 * word);
  }
}

int levels_for(int64_t planes) {
  int levels = 0;
  while (planes >> levels) ++levels;
  return levels;
}

void count_window(const uint8_t* packed, int64_t planes, int64_t plane_bytes, bool msb, const Placing<uint32_t>& out) {
  uint8_t lanes[8 * kBlock];
  uint32_t total[8 * kBlock];
  Words slices[8];
  for (int64_t start = 0; start < plane_bytes; start += kBlock) {
    const int64_t bytes = plane_bytes - start < kBlock ? plane_bytes - start : kBlock;
    const auto count = bytes == kBlock ? count_block<true> : count_block<false>;
    if (planes <= kMost) {
      count(packed + start, planes, plane_bytes, bytes, slices);
      expand(slices, levels_for(planes), msb, lanes);
      out.put(start * 8, bytes * 8, lanes);
      continue;
    }
    std::memset(total, 0, sizeof total);
    for (int64_t plane = 0; plane < planes; plane += kMost) {
      const int64_t some = planes - plane < kMost ? planes - plane : kMost;
      count(packed + plane * plane_bytes + start, some, plane_bytes, bytes, slices);
      expand(slices, levels_for(some), msb, lanes);
      for (int64_t p = 0; p < 8 * kBlock; ++p) total[p] += lanes[p];
    }
    out.put(start * 8, bytes * 8, total);
  }
}

void spread(const uint8_t* packed, int64_t bytes, bool msb, uint8_t* out) {
  int64_t byte = 0;
  for (; byte + 8 <= bytes; byte += 8) {
    uint64_t word;
    std::memcpy(&word, packed + byte, 8);
    if (msb) word = mirrored(word);
    lanes_of(&word, 1, out + byte * 8);
  }
  const uint64_t* table = spread_table(msb);
  for (; byte < bytes; ++byte) std::memcpy(out + byte * 8, &table[packed[byte]], 8);
}

}  // namespace

S4_API void unpack_planes(const uint8_t* packed, int64_t planes, int32_t width, int32_t height, int32_t msb,
                          int32_t bottom_first, uint8_t* out) {
  const int64_t pixels = int64_t(width) * height, plane_bytes = (pixels + 7) / 8;
  const bool whole_rows = width % 8 == 0;  // rows begin at a byte: straight to where they belong
  std::vector<uint8_t> plane(whole_rows ? 0 : plane_bytes * 8);
  for (int64_t t = 0; t < planes; ++t, packed += plane_bytes, out += pixels) {
    if (whole_rows) {
      for (int64_t row = 0; row < height; ++row)
        spread(packed + row * width / 8, width / 8, msb != 0, out + (bottom_first ? height - 1 - row : row) * width);
    } else {
      spread(packed, plane_bytes, msb != 0, plane.data());
      Placing<uint8_t>{width, height, bottom_first != 0, out}.put(0, pixels, plane.data());
    }
  }
}

// Counts [windows][height][width] over planes [bounds[2 w], bounds[2 w + 1]) of each window w.
S4_API void count_windows(const uint8_t* packed, int32_t width, int32_t height, int32_t msb, int32_t bottom_first,
                          const int64_t* bounds, int64_t windows, int32_t threads, uint32_t* out) {
  const int64_t pixels = int64_t(width) * height, plane_bytes = (pixels + 7) / 8;
#pragma omp parallel for num_threads(threads) schedule(dynamic) if (threads > 1)
  for (int64_t w = 0; w < windows; ++w)
    count_window(packed + bounds[2 * w] * plane_bytes, bounds[2 * w + 1] - bounds[2 * w], plane_bytes, msb != 0,
                 {width, height, bottom_first != 0, out + w * pixels});
}

// Sums [kernels][height][width] of weights [kernels][planes] over the spikes of each pixel.
S4_API void weigh_planes(const uint8_t* packed, int64_t planes, int32_t width, int32_t height, int32_t msb,
                         int32_t bottom_first, const uint32_t* weights, int64_t kernels, int32_t threads,
                         uint32_t* out) {
  const int64_t pixels = int64_t(width) * height, plane_bytes = (pixels + 7) / 8;
#pragma omp parallel num_threads(threads) if (threads > 1)
  {
    std::vector<uint32_t> sums(kernels * 64);
#pragma omp for schedule(static)
    for (int64_t start = 0; start < plane_bytes; start += 8) {
      const int64_t bytes = plane_bytes - start < 8 ? plane_bytes - start : 8;
      std::memset(sums.data(), 0, sums.size() * sizeof(uint32_t));
      for (int64_t t = 0; t < planes; ++t) {
        uint64_t word = 0;
        std::memcpy(&word, packed + t * plane_bytes + start, bytes);
        if (word) add_weighted(msb ? mirrored(word) : word, weights + t, planes, kernels, sums.data());
      }
      for (int64_t k = 0; k < kernels; ++k) {
        const Placing<uint32_t> placing = {width, height, bottom_first != 0, out + k * pixels};
        placing.put(start * 8, 64, sums.data() + k * 64);
      }
    }
  }
}
