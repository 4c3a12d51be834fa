// One tile at work: a group of its splats relative to the tile, and the pixels of its sixteen blocks.
#pragma once
#include <algorithm>

#include "frame.h"
#include "pixels.h"

namespace s4 {

struct Tile {
    int x, y;  // its first pixel
    Tile(const Frame &f, int tile) : x(tile % f.tiles_x * kTile), y(tile / f.tiles_x * kTile) {}
};

// Where the moments of a splat over this tile are.
inline int64_t slot_of(const Splat &s, const Tile &t) {
    return s.slot + int64_t(t.y / kTile - s.span.y_first) * s.span.across() + t.x / kTile - s.span.x_first;
}

struct alignas(32) Near {  // the head of a splat, but u and v at the tile's first pixel centre instead of its place
    float u, v, p, q, r, veil, intensity, depth;
};

struct Group {  // up to kGroup splats, nearest first
    int count;
    Near splats[kGroup];
    alignas(64) uint64_t words[kBlock];  // by block: bit k is set where splat k may touch it
};

// Pixel coordinates within the tile, by block: 4 bx + 0..3 and 4 by + 0..3.
struct Grid {
    Block x[kBlock], y[kBlock];
    Block left, top;  // by block: its first pixel
    Grid() : x{}, y{}, left{}, top{} {
        for (int b = 0; b < kBlock; ++b) {
            left.part[b / kNative][b % kNative] = float(b % 4 * 4);
            top.part[b / kNative][b % kNative] = float(b / 4 * 4);
            for (int i = 0; i < kBlock; ++i) {
                x[b].part[i / kNative][i % kNative] = float(b % 4 * 4 + i % 4);
                y[b].part[i / kNative][i % kNative] = float(b / 4 * 4 + i / 4);
            }
        }
    }
};
inline const Grid kGrid;

inline void bring_near(const Splat &s, const Tile &t, Near &to) {
    const float dx = float(t.x) + 0.5f - s.x, dy = float(t.y) + 0.5f - s.y;
    __builtin_memcpy(&to, &s, sizeof to);
    to.u = s.p * dx + s.q * dy, to.v = s.r * dy;
}

// The blocks of the tile that the splat's ellipse meets: u^2 + v^2 is least at the splat's centre, or on the nearer
// vertical or horizontal edge. Held against a little more than it may be, so that rounding never loses a pixel.
inline uint16_t blocks_met(const Splat &s, const Tile &t) {
    const Native bound = all(1.001f * (kVeilMax - s.veil) + 0.01f), none{}, side = all(3.f);
    uint32_t bits = 0;
    S4_EACH_PART {
        const Native x0 = kGrid.left.part[h] + (float(t.x) + 0.5f - s.x), x1 = x0 + side;
        const Native y0 = kGrid.top.part[h] + (float(t.y) + 0.5f - s.y), y1 = y0 + side;
        const Native ex = most(x0, least(none, x1)), ey = most(y0, least(none, y1));
        const Native on_x = most(y0, least(ex * s.lean_y, y1)), on_y = most(x0, least(ey * s.lean_x, x1));
        const Native u = s.p * ex + s.q * on_x, v = s.r * on_x, u2 = s.p * on_y + s.q * ey, v2 = s.r * ey;
        bits |= bits_at_most(least(u * u + v * v, u2 * u2 + v2 * v2), bound) << (h * kNative);
    }
    return uint16_t(bits);
}

// From a row of blocks a splat, kGroup of them, to a row of splats a block.
inline void words_of(const uint16_t *blocks, uint64_t *words) {
#if defined(__AVX512BW__)
    const __m512i low = _mm512_load_si512(blocks), high = _mm512_load_si512(blocks + kGroup / 2);
    for (int b = 0; b < kBlock; ++b) {
        const __m512i bit = _mm512_set1_epi16(int16_t(1u << b));
        words[b] = uint64_t(_mm512_test_epi16_mask(high, bit)) << 32 | _mm512_test_epi16_mask(low, bit);
    }
#else
    alignas(64) uint8_t bytes[2][kGroup];
    for (int k = 0; k < kGroup; ++k) bytes[0][k] = uint8_t(blocks[k]), bytes[1][k] = uint8_t(blocks[k] >> 8);
    for (int half = 0; half < 2; ++half)
        for (int b = 0; b < 8; ++b) words[8 * half + b] = top_bits<kGroup>(bytes[half], 7 - b);
#endif
}

// The inverse of words_of.
inline void blocks_of(const uint64_t *words, uint16_t *blocks) {
    alignas(64) uint8_t bytes[8][kBlock];
    for (int i = 0; i < 8; ++i)
        for (int b = 0; b < kBlock; ++b) bytes[i][b] = uint8_t(words[b] >> (8 * i));
    for (int i = 0; i < 8; ++i)
        for (int k = 0; k < 8; ++k) blocks[8 * i + k] = uint16_t(top_bits<kBlock>(bytes[i], 7 - k));
}

// The splat's alpha and weight in the light T: zero beyond the reach of its veil and where hardly any light is left.
struct Shade {
    Native alpha, weight;
};
inline Shade shade(const Near &s, Native x, Native y, Native T) {
    const Native u = s.u + s.p * x + s.q * y, v = s.v + s.r * y, t = u * u + (v * v + s.veil);
    const Native alpha = least(exp_minus(t), all(kAlphaMax));
    const auto seen = (t <= kVeilMax) & (T >= kTransmittanceMin);
    return {seen ? alpha : Native{}, seen ? T * alpha : Native{}};
}

inline bool opaque(const Block &T) {
    uint32_t live = 0;
    S4_EACH_PART live |= bits_at_most(all(kTransmittanceMin), T.part[h]);
    return live == 0;
}

// A block of an image, row by row; zero beyond its border.
inline Block load_block(const Pinhole &c, const Tile &t, int b, const float *from) {
    float pixels[kBlock] = {};
    const int x = t.x + b % 4 * 4, y = t.y + b / 4 * 4;
    const int across = std::clamp(c.width - x, 0, 4), down = std::clamp(c.height - y, 0, 4);
    if (from)
        for (int j = 0; j < down; ++j) std::copy_n(from + int64_t(y + j) * c.width + x, across, pixels + 4 * j);
    Block out;
    __builtin_memcpy(&out, pixels, sizeof out);
    return out;
}

inline void store_block(const Pinhole &c, const Tile &t, int b, const Block &block, float *to) {
    float pixels[kBlock];
    __builtin_memcpy(pixels, &block, sizeof pixels);
    const int x = t.x + b % 4 * 4, y = t.y + b / 4 * 4;
    const int across = std::clamp(c.width - x, 0, 4), down = std::clamp(c.height - y, 0, 4);
    for (int j = 0; j < down; ++j) std::copy_n(pixels + 4 * j, across, to + int64_t(y + j) * c.width + x);
}

// Transmittance at a tile's start: one inside the image, zero beyond it.
inline Block clear_block(const Pinhole &c, const Tile &t, int b) {
    Block T;
    S4_EACH_PART {
        const Native inside_x = kGrid.x[b].part[h] < float(c.width - t.x) ? all(1) : Native{};
        T.part[h] = kGrid.y[b].part[h] < float(c.height - t.y) ? inside_x : Native{};
    }
    return T;
}

}  // namespace s4
