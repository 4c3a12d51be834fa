// Bits to bytes: how a word of 64 packed pixels becomes 64 lanes of a byte each, first pixel first.
#pragma once
#include <cstring>

#include "native.h"

#if defined(__AVX512BW__)
#include <immintrin.h>
#endif

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

inline const uint64_t* spread_table(bool msb) {
  static const Spread spread;
  return msb ? spread.msb : spread.lsb;
}

// The eight bits of every byte the other way round: MSB-first pixels come to stand LSB first.
inline uint64_t mirrored(uint64_t word) {
  word = ((word >> 1) & 0x5555555555555555u) | ((word & 0x5555555555555555u) << 1);
  word = ((word >> 2) & 0x3333333333333333u) | ((word & 0x3333333333333333u) << 2);
  return ((word >> 4) & 0x0F0F0F0F0F0F0F0Fu) | ((word & 0x0F0F0F0F0F0F0F0Fu) << 4);
}

// lanes[p] = sum over levels of bit p of slices[level] << level, for 64 pixels stored LSB first and at most 8 levels.
inline void lanes_of(const uint64_t* slices, int levels, uint8_t* lanes) {
#if defined(__AVX512BW__)
  __m512i sum = _mm512_setzero_si512();
  for (int level = 0; level < levels; ++level)
    sum = _mm512_mask_add_epi8(sum, slices[level], sum, _mm512_set1_epi8(char(1 << level)));
  _mm512_storeu_si512(lanes, sum);
#else
  const uint64_t* table = spread_table(false);
  for (int byte = 0; byte < 8; ++byte) {
    uint64_t sum = 0;
    for (int level = 0; level < levels; ++level) sum += table[(slices[level] >> (8 * byte)) & 255] << level;
    std::memcpy(lanes + 8 * byte, &sum, 8);
  }
#endif
}

// sums[k][p] += weights[k * stride] where pixel p of 64 stored LSB first has fired, for each kernel k.
inline void add_weighted(uint64_t word, const uint32_t* weights, int64_t stride, int64_t kernels, uint32_t* sums) {
#if !defined(__AVX512BW__)
  uint8_t lanes[64];
  lanes_of(&word, 1, lanes);
#endif
  for (int64_t k = 0; k < kernels; ++k, sums += 64) {
    const uint32_t weight = weights[k * stride];
    if (!weight) continue;
#if defined(__AVX512BW__)
    const __m512i added = _mm512_set1_epi32(int(weight));
    for (int quarter = 0; quarter < 4; ++quarter) {
      const __m512i sum = _mm512_loadu_si512(sums + 16 * quarter);
      _mm512_storeu_si512(sums + 16 * quarter, _mm512_mask_add_epi32(sum, __mmask16(word >> 16 * quarter), sum, added));
    }
#else
    for (int p = 0; p < 64; ++p) sums[p] += weight & (0u - lanes[p]);
#endif
  }
}

typedef uint64_t Words __attribute__((vector_size(64)));  // 512 pixels, in as few registers as the processor has them
constexpr int64_t kBlock = sizeof(Words);                  // bytes

// 512 pixels of a plane from byte `start` on; what lies behind `bytes` is zero.
inline Words load_block(const uint8_t* from, int64_t bytes) {
  Words block = {};
  if (bytes >= kBlock) {
    __builtin_prefetch(from + 2 * kBlock);
    std::memcpy(&block, from, kBlock);
  }
  else std::memcpy(&block, from, bytes);
  return block;
}

inline bool none(const Words& mask) {
#if defined(__AVX512BW__)
  const __m512i bits = (__m512i)mask;
  return _mm512_test_epi64_mask(bits, bits) == 0;
#else
  uint64_t any = 0;
  for (int word = 0; word < 8; ++word) any |= mask[word];
  return any == 0;
#endif
}

// One more bit for every pixel of bit-sliced counters: a ripple of and/xor through the levels.
template <int levels>
inline void ripple(Words* slices, Words carry) {
  for (int level = 0; level < levels; ++level) {
    const Words next = slices[level] & carry;
    slices[level] ^= carry;
    carry = next;
  }
}

// Sends values of consecutive stored pixels to where they belong in an image [height][width], row 0 at the top.
template <typename Value>
struct Placing {
  int64_t width, height;
  bool bottom_first;
  Value* out;

  // `values` of the pixels from stored pixel `pixel` on, as many of `count` as the image has.
  template <typename From>
  void put(int64_t pixel, int64_t count, const From* __restrict values) const {
    count = count < width * height - pixel ? count : width * height - pixel;
    int64_t row = pixel / width, column = pixel % width;
    while (count > 0) {
      const int64_t length = count < width - column ? count : width - column;
      Value* __restrict to = out + (bottom_first ? height - 1 - row : row) * width + column;
      for (int64_t i = 0; i < length; ++i) to[i] = Value(values[i]);
      values += length;
      count -= length;
      column = 0;
      ++row;
    }
  }
};
