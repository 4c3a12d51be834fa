// The geometry between Gaussians and their 2D covariance a a^T + 0.3 I, sixteen at a time and in double: quaternions
// and scales may be extreme, and needles must keep their determinant.
#pragma once
#include <cstdint>
#include <cstring>

#include "frame.h"

namespace s4 {

constexpr int kLanes = 16;
constexpr double kLogScaleMin = -30, kLogScaleMax = 15;
using Lane = double[kLanes];

#define S4_EACH_LANE _Pragma("omp simd") for (int i = 0; i < kLanes; ++i)

struct alignas(64) Geometry {
    Lane mean[3], quat[4], log_scale[3], opacity;      // as stored
    Lane in_cam[3], depth;                             // depth: z, or 1 where the Gaussian is not in front
    Lane unit[4], inverse_norm, rotation[9], scale[3];
    Lane slope[2], slope_free[2];                      // x/z, y/z held near the image, and 1 where that changed nothing
    Lane jacobian[2], jacobian_z[2];                   // df/d(x or y), df/dz
    Lane ray[2][3];                                    // Jacobian times camera rotation
    Lane a[2][3];
    Lane m01, m02, m12;                                // minors of a: det(a a^T) is the sum of their squares
    Lane cov_xx, cov_xy, cov_yy, det, det_blurred;
};

// exp on [-30, 15] and log on [1, 1e9] that vectorise; 1e-11 relative and absolute.
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

// Fills lane i with Gaussian `source`; lanes beyond the end may repeat one.
inline void load_gaussian(Geometry &g, const Cloud &cloud, int64_t source, int i) {
    for (int k = 0; k < 3; ++k) g.mean[k][i] = cloud.means[3 * source + k];
    for (int k = 0; k < 4; ++k) g.quat[k][i] = cloud.quats[4 * source + k];
    for (int k = 0; k < 3; ++k) g.log_scale[k][i] = cloud.log_scales[3 * source + k];
    g.opacity[i] = cloud.opacities[source];
}

void measure(Geometry &g, const Pinhole &camera);

}  // namespace s4
