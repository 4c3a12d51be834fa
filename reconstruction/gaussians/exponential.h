// Elementary functions that compilers turn into vector code inside a loop.
#pragma once
#include <cstdint>
#include <cstring>

namespace s4 {

// exp on [-700, 700] and log on [1, 1e9] that vectorise; 1e-11 relative and absolute.
inline double exp_lane(double x) {
    constexpr double kRound = 0x1.8p52, kLn2Hi = 0x1.62e42fefa0000p-1, kLn2Lo = 0x1.cf79abc9e3b3ap-40;
    const double shifted = x * 0x1.71547652b82fep0 + kRound, n = shifted - kRound;
    const double r = (x - n * kLn2Hi) - n * kLn2Lo;
    double e = 1.0 / 362880;
    e = 1.0 / 40320 + r * e, e = 1.0 / 5040 + r * e, e = 1.0 / 720 + r * e, e = 1.0 / 120 + r * e;
    e = 1.0 / 24 + r * e, e = 1.0 / 6 + r * e, e = 0.5 + r * e, e = 1.0 + r * e, e = 1.0 + r * e;
    uint64_t bits;
    std::memcpy(&bits, &shifted, 8);
    bits = (bits + 1023) << 52;
    double power;
    std::memcpy(&power, &bits, 8);
    return e * power;
}

// The same in float, on [-87, 88]; 2e-7 relative.
inline float exp_lane(float x) {
    constexpr float kRound = 0x1.8p23f, kLn2Hi = 0x1.62e400p-1f, kLn2Lo = 0x1.7f7d1cp-20f;
    const float shifted = x * 0x1.715476p0f + kRound, n = shifted - kRound;
    const float r = (x - n * kLn2Hi) - n * kLn2Lo;
    float e = 1.f / 5040;
    e = 1.f / 720 + r * e, e = 1.f / 120 + r * e, e = 1.f / 24 + r * e, e = 1.f / 6 + r * e;
    e = 0.5f + r * e, e = 1 + r * e, e = 1 + r * e;
    uint32_t bits;
    std::memcpy(&bits, &shifted, 4);
    bits = (bits + 127) << 23;
    float power;
    std::memcpy(&power, &bits, 4);
    return e * power;
}

inline double log_lane(double x) {
    constexpr double kRoot2 = 0x1.6a09e667f3bcdp0, kHalfLn2 = 0x1.62e42fefa39efp-2;
    uint64_t bits;
    std::memcpy(&bits, &x, 8);
    const uint64_t exponent_bits = ((bits >> 52) - 1023) | 0x4330000000000000u;
    const uint64_t mantissa_bits = (bits & 0xfffffffffffffu) | 0x3ff0000000000000u;
    double exponent, m;
    std::memcpy(&exponent, &exponent_bits, 8);
    std::memcpy(&m, &mantissa_bits, 8);
    const double s = (m - kRoot2) / (m + kRoot2), s2 = s * s;
    double t = 1.0 / 13;
    t = 1.0 / 11 + s2 * t, t = 1.0 / 9 + s2 * t, t = 1.0 / 7 + s2 * t;
    t = 1.0 / 5 + s2 * t, t = 1.0 / 3 + s2 * t, t = 1.0 + s2 * t;
    return (exponent - 0x1p52) * (2 * kHalfLn2) + kHalfLn2 + 2 * s * t;
}

}  // namespace s4
