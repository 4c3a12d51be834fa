// Gradients of splats back to the Gaussians they came from; the adjoint of project.cpp.
#include <algorithm>
#include <cmath>

#include "geometry.h"

namespace s4 {
namespace {

struct alignas(64) Gradient {
    Lane sum[kMoments];        // g, gu, gv, guu, guv, gvv, intensity, depth
    Lane p, q, r;              // the splat's factor
    Lane a[2][3], ray[2][3], rotation[9];
    Lane mean[3], quat[4], log_scale[3];
};

void gather(const Frame &frame, const Cloud &cloud, int32_t source, int i, Geometry &g, Gradient &d) {
    const Splat &s = frame.splats[source];
    load_gaussian(g, cloud, source, i);
    const int64_t end = s.slot + s.span.tiles();
    float sum[kMoments] = {};
    for (int64_t slot = s.slot; slot < end; ++slot)
        for (int k = 0; k < kMoments; ++k) sum[k] += frame.moments[slot].value[k];
    for (int k = 0; k < kMoments; ++k) d.sum[k][i] = sum[k];
}

// dL/dcov = 2 L^T (moments - g/2) L with L = [[p, q], [0, r]], for the shape and the blurred determinant; the
// determinant itself goes through its minors.
void to_axes(const Geometry &g, Gradient &d) {
    S4_EACH_LANE {
        // Again in double: along a needle p a0 + q b0 cancels.
        const double p = std::sqrt(0.5 * g.cov_yy[i] / g.det_blurred[i]), q = -p * g.cov_xy[i] / g.cov_yy[i];
        const double r = std::sqrt(0.5 / g.cov_yy[i]), sum = d.sum[0][i];
        d.p[i] = p, d.q[i] = q, d.r[i] = r;
        const double uu = d.sum[3][i] - 0.5 * sum, uv = d.sum[4][i], vv = d.sum[5][i] - 0.5 * sum;
        const double xx = 4 * p * p * uu, xy = 4 * p * (q * uu + r * uv);
        const double yy = 4 * (q * q * uu + 2 * q * r * uv + r * r * vv);
        const double a0 = g.a[0][0][i], a1 = g.a[0][1][i], a2 = g.a[0][2][i];
        const double b0 = g.a[1][0][i], b1 = g.a[1][1][i], b2 = g.a[1][2][i];
        const double by_det = sum / g.det[i];
        const double d01 = by_det * g.m01[i], d02 = by_det * g.m02[i], d12 = by_det * g.m12[i];
        d.a[0][0][i] = xx * a0 + xy * b0 + d01 * b1 + d02 * b2;
        d.a[0][1][i] = xx * a1 + xy * b1 - d01 * b0 + d12 * b2;
        d.a[0][2][i] = xx * a2 + xy * b2 - d02 * b0 - d12 * b1;
        d.a[1][0][i] = xy * a0 + yy * b0 - d01 * a1 - d02 * a2;
        d.a[1][1][i] = xy * a1 + yy * b1 + d01 * a0 - d12 * a2;
        d.a[1][2][i] = xy * a2 + yy * b2 + d02 * a0 + d12 * a1;
    }
}

// a = ray . rotation . diag(scale)
void to_factors(const Geometry &g, Gradient &d) {
    for (int j = 0; j < 3; ++j) {
        S4_EACH_LANE d.ray[0][j][i] = d.ray[1][j][i] = 0;
        for (int k = 0; k < 3; ++k) S4_EACH_LANE {
            const double scaled = g.scale[k][i] * g.rotation[3 * j + k][i];
            d.ray[0][j][i] += d.a[0][k][i] * scaled;
            d.ray[1][j][i] += d.a[1][k][i] * scaled;
        }
    }
    for (int k = 0; k < 3; ++k) {
        S4_EACH_LANE d.log_scale[k][i] = 0;
        for (int j = 0; j < 3; ++j) S4_EACH_LANE {
            const double along = (g.ray[0][j][i] * d.a[0][k][i] + g.ray[1][j][i] * d.a[1][k][i]) * g.scale[k][i];
            d.rotation[3 * j + k][i] = along;
            d.log_scale[k][i] += along * g.rotation[3 * j + k][i];
        }
        S4_EACH_LANE {
            const double l = g.log_scale[k][i], grad = d.log_scale[k][i];
            const double above = l < kLogScaleMin ? 0 : grad;
            d.log_scale[k][i] = l > kLogScaleMax ? 0 : above;
        }
    }
}

void to_quaternion(const Geometry &g, Gradient &d) {
    S4_EACH_LANE {
        const double w = g.unit[0][i], x = g.unit[1][i], y = g.unit[2][i], z = g.unit[3][i];
        const double xw = d.rotation[7][i] - d.rotation[5][i], yw = d.rotation[2][i] - d.rotation[6][i];
        const double zw = d.rotation[3][i] - d.rotation[1][i], xy = d.rotation[1][i] + d.rotation[3][i];
        const double xz = d.rotation[2][i] + d.rotation[6][i], yz = d.rotation[5][i] + d.rotation[7][i];
        const double r0 = d.rotation[0][i], r4 = d.rotation[4][i], r8 = d.rotation[8][i];
        const double dw = 2 * (x * xw + y * yw + z * zw);
        const double dx = 2 * (w * xw - 2 * x * (r4 + r8) + y * xy + z * xz);
        const double dy = 2 * (w * yw + x * xy - 2 * y * (r0 + r8) + z * yz);
        const double dz = 2 * (w * zw + x * xz + y * yz - 2 * z * (r0 + r4));
        const double along = w * dw + x * dx + y * dy + z * dz, inverse = g.inverse_norm[i];
        d.quat[0][i] = (dw - along * w) * inverse;
        d.quat[1][i] = (dx - along * x) * inverse;
        d.quat[2][i] = (dy - along * y) * inverse;
        d.quat[3][i] = (dz - along * z) * inverse;
    }
}

void to_mean(const Geometry &g, const Pinhole &c, Gradient &d) {
    Lane in_cam[3];
    S4_EACH_LANE in_cam[2][i] = d.sum[7][i];
    for (int axis = 0; axis < 2; ++axis) {
        const double f = axis == 0 ? c.fx : c.fy, *direct = c.rotation + 3 * axis, *along_z = c.rotation + 6;
        S4_EACH_LANE {
            const double r0 = d.ray[axis][0][i], r1 = d.ray[axis][1][i], r2 = d.ray[axis][2][i];
            const double jacobian = r0 * direct[0] + r1 * direct[1] + r2 * direct[2];
            const double jacobian_z = r0 * along_z[0] + r1 * along_z[1] + r2 * along_z[2];
            const double gu = d.sum[1][i], gv = d.sum[2][i], inverse_z = g.inverse_depth[i];
            const double center = axis == 0 ? 2 * d.p[i] * gu : 2 * (d.q[i] * gu + d.r[i] * gv);
            const double slope = f * (center - g.slope_free[axis][i] * jacobian_z * inverse_z);
            in_cam[axis][i] = slope * inverse_z;
            in_cam[2][i] -= inverse_z * (slope * g.in_cam[axis][i] * inverse_z + jacobian * g.jacobian[axis][i] +
                                         jacobian_z * g.jacobian_z[axis][i]);
        }
    }
    for (int k = 0; k < 3; ++k) {
        const double r0 = c.rotation[k], r1 = c.rotation[3 + k], r2 = c.rotation[6 + k];
        S4_EACH_LANE d.mean[k][i] = r0 * in_cam[0][i] + r1 * in_cam[1][i] + r2 * in_cam[2][i];
    }
}

void scatter(const Geometry &g, const Gradient &d, int64_t source, int i, const CloudGradient &out) {
    for (int k = 0; k < 3; ++k) out.means[3 * source + k] = float(d.mean[k][i]);
    for (int k = 0; k < 4; ++k) out.quats[4 * source + k] = float(d.quat[k][i]);
    for (int k = 0; k < 3; ++k) out.log_scales[3 * source + k] = float(d.log_scale[k][i]);
    out.opacities[source] = float(d.sum[0][i] / g.opacity[i]);
    out.intensities[source] = float(d.sum[6][i]);
}

}  // namespace

void project_backward(const Frame &frame, const Cloud &cloud, const CloudGradient &out, int64_t given) {
    const auto end = frame.visible.begin() + frame.visible_count;
    const auto own = std::lower_bound(frame.visible.begin(), end, given);
    const int64_t n = end - own, blocks = (n + kLanes - 1) / kLanes;
#pragma omp for schedule(static) nowait
    for (int64_t block = 0; block < blocks; ++block) {
        const int64_t first = block * kLanes;
        Geometry g;
        Gradient d;
        for (int i = 0; i < kLanes; ++i) gather(frame, cloud, own[std::min(first + i, n - 1)], i, g, d);
        measure(g, frame.camera);
        to_axes(g, d);
        to_factors(g, d);
        to_quaternion(g, d);
        to_mean(g, frame.camera, d);
        for (int i = 0; i < std::min<int64_t>(kLanes, n - first); ++i)
            scatter(g, d, own[first + i], i, out);
    }
}

}  // namespace s4
