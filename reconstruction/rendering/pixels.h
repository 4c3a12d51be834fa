// Blocks of 4x4 pixels, sixteen floats in the widest vectors of this build: one register on x86-64-v4, two on v3.
// Vectors of the compiler's own, so the same source serves every processor; only the comparison to bits is spelt out.
#pragma once
#include <cstdint>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace s4 {

#if defined(__AVX512F__)
constexpr int kNative = 16;
#elif defined(__AVX__)
constexpr int kNative = 8;
#else
constexpr int kNative = 4;
#endif
constexpr int kBlock = 16;  // floats, and blocks a tile
constexpr int kParts = kBlock / kNative;
constexpr uint32_t kAllOfBlock = 0xffff;
using Native = float __attribute__((vector_size(4 * kNative)));

struct alignas(64) Block {
    Native part[kParts];
};

#define S4_EACH_PART _Pragma("GCC unroll 4") for (int h = 0; h < kParts; ++h)

inline Native all(float x) { return Native{} + x; }
#if defined(__AVX512F__)  // a comparison and a select would be two instructions
inline Native least(Native a, Native b) { return _mm512_maskz_min_ps(0xffff, a, b); }
inline Native most(Native a, Native b) { return _mm512_maskz_max_ps(0xffff, a, b); }
#else
inline Native least(Native a, Native b) { return a < b ? a : b; }
inline Native most(Native a, Native b) { return a > b ? a : b; }
#endif

// Bit i is set where a[i] <= b[i].
inline uint32_t bits_at_most(Native a, Native b) {
#if defined(__AVX512F__)
    return _mm512_cmp_ps_mask(a, b, _CMP_LE_OQ);
#elif defined(__AVX__)
    return uint32_t(_mm256_movemask_ps(_mm256_cmp_ps(a, b, _CMP_LE_OQ)));
#elif defined(__x86_64__)
    return uint32_t(_mm_movemask_ps(_mm_cmple_ps(a, b)));
#else
    uint32_t bits = 0;
    for (int i = 0; i < kNative; ++i) bits |= uint32_t(a[i] <= b[i]) << i;
    return bits;
#endif
}

// Bit i is bit 7 - `shift` of bytes[i], for kCount bytes.
template <int kCount>
inline uint64_t top_bits(const uint8_t *bytes, int shift) {
    uint64_t bits = 0;
#if defined(__AVX2__)
    constexpr int kWide = kCount < 32 ? kCount : 32;
    for (int i = 0; i < kCount; i += kWide) {
        if constexpr (kWide == 32)
            bits |= uint64_t(uint32_t(_mm256_movemask_epi8(_mm256_slli_epi16(*(const __m256i *)(bytes + i), shift)))) << i;
        else
            bits |= uint64_t(uint32_t(_mm_movemask_epi8(_mm_slli_epi16(*(const __m128i *)(bytes + i), shift)))) << i;
    }
#else
    for (int i = 0; i < kCount; ++i) bits |= uint64_t(bytes[i] >> (7 - shift) & 1) << i;
#endif
    return bits;
}

// exp(-sigma) for sigma in [0, 6]: a polynomial of degree 5 for exp(-sigma / 8), to the 8th power; 1e-6 relative.
// Beyond, it is finite or infinite, never NaN where sigma is finite.
inline Native exp_minus(Native sigma) {
    Native e = 9.71009819e-06f + sigma * -1.78428959e-07f;
    e = 0.00781066544f + sigma * (-0.000324167922f + sigma * e);
    e = 0.999999921f + sigma * (-0.124999067f + sigma * e);
    e *= e;
    e *= e;
    return e * e;
}

// Sums of the lanes of eight vectors, in their order, by a transposing tree: each step halves how many there are.
#if defined(__AVX512F__)
inline void totals(const Native (&v)[8], float *out) {
    Native half[4], quarter[2];
    for (int k = 0; k < 4; ++k) {  // pairs (0, 2), (4, 6), (1, 3), (5, 7)
        const int a = (k & 1) * 4 + (k >> 1);
        half[k] = __builtin_shufflevector(v[a], v[a + 2], 0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23) +
                  __builtin_shufflevector(v[a], v[a + 2], 8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30, 31);
    }
    for (int k = 0; k < 2; ++k) {
        const Native a = half[2 * k], b = half[2 * k + 1];
        quarter[k] = __builtin_shufflevector(a, b, 0, 1, 2, 3, 8, 9, 10, 11, 16, 17, 18, 19, 24, 25, 26, 27) +
                     __builtin_shufflevector(a, b, 4, 5, 6, 7, 12, 13, 14, 15, 20, 21, 22, 23, 28, 29, 30, 31);
    }
    const Native a = quarter[0], b = quarter[1];
    const Native pairs = __builtin_shufflevector(a, b, 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29) +
                         __builtin_shufflevector(a, b, 2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31);
    using Eight = float __attribute__((vector_size(32)));
    const Eight sums = __builtin_shufflevector(pairs, pairs, 0, 2, 4, 6, 8, 10, 12, 14) +
                       __builtin_shufflevector(pairs, pairs, 1, 3, 5, 7, 9, 11, 13, 15);
    __builtin_memcpy(out, &sums, sizeof sums);
}
#elif defined(__AVX__)
inline void totals(const Native (&v)[8], float *out) {
    Native half[4], quarter[2];
    for (int k = 0; k < 4; ++k)
        half[k] = __builtin_shufflevector(v[k], v[k + 4], 0, 1, 2, 3, 8, 9, 10, 11) +
                  __builtin_shufflevector(v[k], v[k + 4], 4, 5, 6, 7, 12, 13, 14, 15);
    for (int k = 0; k < 2; ++k)
        quarter[k] = __builtin_shufflevector(half[2 * k], half[2 * k + 1], 0, 1, 8, 9, 4, 5, 12, 13) +
                     __builtin_shufflevector(half[2 * k], half[2 * k + 1], 2, 3, 10, 11, 6, 7, 14, 15);
    const Native sums = __builtin_shufflevector(quarter[0], quarter[1], 0, 2, 8, 10, 4, 6, 12, 14) +
                        __builtin_shufflevector(quarter[0], quarter[1], 1, 3, 9, 11, 5, 7, 13, 15);
    __builtin_memcpy(out, &sums, sizeof sums);
}
#else
inline void totals(const Native (&v)[8], float *out) {
    for (int k = 0; k < 8; k += 4) {
        const Native ab = __builtin_shufflevector(v[k], v[k + 1], 0, 4, 1, 5) +
                          __builtin_shufflevector(v[k], v[k + 1], 2, 6, 3, 7);
        const Native cd = __builtin_shufflevector(v[k + 2], v[k + 3], 0, 4, 1, 5) +
                          __builtin_shufflevector(v[k + 2], v[k + 3], 2, 6, 3, 7);
        const Native sums = __builtin_shufflevector(ab, cd, 0, 1, 4, 5) + __builtin_shufflevector(ab, cd, 2, 3, 6, 7);
        __builtin_memcpy(out + k, &sums, sizeof sums);
    }
}
#endif

}  // namespace s4
