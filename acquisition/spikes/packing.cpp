// Unpacking and counting of spike planes. Two threads help little here (memory bound), so both kernels are serial.
#include <cstring>
#include <vector>

#include "native.h"

namespace {

struct Spread {  // byte -> eight bytes of 0 or 1, first pixel first
  uint64_t lsb[256], msb[256];
  Spread() {
    for (int value = 0; value < 256; ++value) {
      uint8_t low[8], high[8];
      for (int bit = 0; bit < 8; ++bit) {
        low[bit] = (value >> bit) & 1;
        high[bit] = (value >> (7 - bit)) & 1;
      }
      std::memcpy(&lsb[value], low, 8);
      std::memcpy(&msb[value], high, 8);
    }
  }
};

const uint64_t* spread_table(bool msb) {
  static const Spread spread;
  return msb ? spread.msb : spread.lsb;
}

void spread(const uint8_t* packed, int64_t bytes, const uint64_t* table, uint8_t* out) {
  for (int64_t byte = 0; byte < bytes; ++byte) std::memcpy(out + byte * 8, &table[packed[byte]], 8);
}

template <typename Value>
void copy_rows(const Value* pixels, int64_t width, int64_t height, bool bottom_first, Value* out) {
  for (int64_t row = 0; row < height; ++row) {
    const int64_t from = bottom_first ? height - 1 - row : row;
    std::memcpy(out + row * width, pixels + from * width, width * sizeof(Value));
  }
}

typedef uint64_t Words __attribute__((vector_size(64)));  // 512 pixels, in as few registers as the processor has them

// counts[pixel] += bit over at most 255 planes, kept in eight bit-sliced counters of 512 pixels each:
// adding a word to a counter is a ripple of and/xor, one addition for all its pixels.
void add_sliced(const uint8_t* packed, int64_t planes, int64_t plane_bytes, const uint64_t* table, uint32_t* counts) {
  constexpr int64_t block = sizeof(Words);
  for (int64_t start = 0; start < plane_bytes; start += block) {
    const int64_t bytes = plane_bytes - start < block ? plane_bytes - start : block;
    Words slice[8] = {};
    for (int64_t plane = 0; plane < planes; ++plane) {
      const uint8_t* from = packed + plane * plane_bytes + start;
      Words carry = {};
      if (bytes == block) std::memcpy(&carry, from, block);
      else std::memcpy(&carry, from, bytes);
      for (Words& level : slice) {
        const Words next = level & carry;
        level ^= carry;
        carry = next;
      }
    }
    uint8_t slices[8][block];
    std::memcpy(slices, slice, sizeof slices);
    for (int64_t byte = 0; byte < bytes; ++byte) {
      uint64_t lanes = 0;
      for (int level = 0; level < 8; ++level) lanes += table[slices[level][byte]] << level;
      uint8_t lane[8];
      std::memcpy(lane, &lanes, 8);
      for (int bit = 0; bit < 8; ++bit) counts[(start + byte) * 8 + bit] += lane[bit];
    }
  }
}

}  // namespace

S4_API void unpack_planes(const uint8_t* packed, int64_t planes, int32_t width, int32_t height, int32_t msb,
                          int32_t bottom_first, uint8_t* out) {
  const int64_t pixels = int64_t(width) * height, plane_bytes = (pixels + 7) / 8;
  const uint64_t* table = spread_table(msb);
  const bool whole_rows = width % 8 == 0;  // rows begin at a byte: straight to where they belong
  std::vector<uint8_t> plane(whole_rows ? 0 : plane_bytes * 8);
  for (int64_t t = 0; t < planes; ++t, packed += plane_bytes, out += pixels) {
    if (whole_rows) {
      for (int64_t row = 0; row < height; ++row)
        spread(packed + row * width / 8, width / 8, table,
               out + (bottom_first ? height - 1 - row : row) * width);
    } else {
      spread(packed, plane_bytes, table, plane.data());
      copy_rows(plane.data(), width, height, bottom_first, out);
    }
  }
}

S4_API void count_planes(const uint8_t* packed, int64_t planes, int32_t width, int32_t height, int32_t msb,
                         int32_t bottom_first, uint32_t* out) {
  const int64_t pixels = int64_t(width) * height, plane_bytes = (pixels + 7) / 8;
  std::vector<uint32_t> total(plane_bytes * 8, 0);
  for (int64_t t = 0; t < planes; t += 255)
    add_sliced(packed + t * plane_bytes, planes - t < 255 ? planes - t : 255, plane_bytes, spread_table(msb),
               total.data());
  copy_rows(total.data(), width, height, bottom_first, out);
}
