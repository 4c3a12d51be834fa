// The geometry between Gaussians and their 2D covariance a a^T + dilation I, sixteen at a time and in double: quaternions
// and scales may be extreme, and needles must keep their determinant.
#pragma once
#include <cstdint>

#include "../gaussians/exponential.h"
#include "frame.h"

namespace s4 {

constexpr int kLanes = 16;
constexpr double kLogScaleMin = -30, kLogScaleMax = 15;
using Lane = double[kLanes];

#define S4_EACH_LANE _Pragma("omp simd") for (int i = 0; i < kLanes; ++i)

struct alignas(64) Geometry {
    Lane mean[3], quat[4], log_scale[3], opacity;      // as stored
    Lane in_cam[3], depth, inverse_depth;  // depth: z, or 1 where the Gaussian is not in front
    Lane unit[4], inverse_norm, rotation[9], scale[3];
    Lane slope[2], slope_free[2];                      // x/z, y/z held near the image, and 1 where that changed nothing
    Lane jacobian[2], jacobian_z[2];                   // df/d(x or y), df/dz
    Lane ray[2][3];                                    // Jacobian times camera rotation
    Lane a[2][3];
    Lane m01, m02, m12;                                // minors of a: det(a a^T) is the sum of their squares
    Lane cov_xx, cov_xy, cov_yy, det, det_blurred;
};

// Fills lane i with Gaussian `source`; lanes beyond the end may repeat one.
inline void load_gaussian(Geometry &g, const Cloud &cloud, int64_t source, int i) {
    for (int k = 0; k < 3; ++k) g.mean[k][i] = cloud.means[3 * source + k];
    for (int k = 0; k < 4; ++k) g.quat[k][i] = cloud.quats[4 * source + k];
    for (int k = 0; k < 3; ++k) g.log_scale[k][i] = cloud.log_scales[3 * source + k];
    g.opacity[i] = cloud.opacities[source];
}

void measure(Geometry &g, const Pinhole &camera);

}  // namespace s4
