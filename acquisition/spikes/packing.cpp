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

template <typename Value>
void copy_rows(const Value* pixels, int64_t width, int64_t height, bool bottom_first, Value* out) {
  for (int64_t row = 0; row < height; ++row) {
    const int64_t from = bottom_first ? height - 1 - row : row;
    std::memcpy(out + row * width, pixels + from * width, width * sizeof(Value));
  }
}

// counts[pixel] += bit over at most 255 planes, kept in eight bit-sliced counters of 64 pixels each:
// adding a word to a counter is a ripple of and/xor, one addition for 64 pixels.
void add_sliced(const uint8_t* packed, int64_t planes, int64_t plane_bytes, const uint64_t* table, uint32_t* counts) {
  for (int64_t start = 0; start < plane_bytes; start += 8) {
    const int64_t bytes = plane_bytes - start < 8 ? plane_bytes - start : 8;
    uint64_t slice[8] = {};
    for (int64_t plane = 0; plane < planes; ++plane) {
      uint64_t carry = 0;
      std::memcpy(&carry, packed + plane * plane_bytes + start, bytes);
      for (int level = 0; carry && level < 8; ++level) {
        const uint64_t next = slice[level] & carry;
        slice[level] ^= carry;
        carry = next;
      }
    }
    for (int64_t byte = 0; byte < bytes; ++byte) {
      uint64_t lanes = 0;
      for (int level = 0; level < 8; ++level) lanes += table[(slice[level] >> (8 * byte)) & 255] << level;
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
  std::vector<uint8_t> plane(plane_bytes * 8);
  for (int64_t t = 0; t < planes; ++t) {
    for (int64_t byte = 0; byte < plane_bytes; ++byte)
      std::memcpy(&plane[byte * 8], &table[packed[t * plane_bytes + byte]], 8);
    copy_rows(plane.data(), width, height, bottom_first, out + t * pixels);
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
