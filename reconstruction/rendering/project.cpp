// Gaussians to splats (EWA projection) and splat gradients back to Gaussians; twin of `project` in reference.py.
#include <algorithm>
#include <cmath>

#include "frame.h"

namespace s4 {
namespace {

constexpr double kLogScaleMin = -30, kLogScaleMax = 15;

// Everything between a Gaussian and its 2D covariance a a^T + 0.3 I, in double: quaternions and scales may be extreme.
struct Geometry {
    double in_cam[3], rotation[9], scale[3], unit[4], inverse_norm;
    double jacobian_x, jacobian_xz, jacobian_y, jacobian_yz;
    double slope_x, slope_y;      // x/z, y/z as clamped for the Jacobian
    bool slope_x_free, slope_y_free;
    double ray[2][3];             // Jacobian times camera rotation
    double a[2][3];
    double m01, m02, m12;         // minors of a: det(a a^T) = m01^2 + m02^2 + m12^2, free of cancellation
    double cov_xx, cov_xy, cov_yy, det, det_blurred;
};

void rotate(Geometry &g, const float *quat) {
    double w = quat[0], x = quat[1], y = quat[2], z = quat[3];
    const double squared = w * w + x * x + y * y + z * z;
    g.inverse_norm = squared > 0 ? 1 / std::sqrt(squared) : 0;
    w = squared > 0 ? w * g.inverse_norm : 1;
    x *= g.inverse_norm, y *= g.inverse_norm, z *= g.inverse_norm;
    g.unit[0] = w, g.unit[1] = x, g.unit[2] = y, g.unit[3] = z;
    double *r = g.rotation;
    r[0] = 1 - 2 * (y * y + z * z), r[1] = 2 * (x * y - w * z), r[2] = 2 * (x * z + w * y);
    r[3] = 2 * (x * y + w * z), r[4] = 1 - 2 * (x * x + z * z), r[5] = 2 * (y * z - w * x);
    r[6] = 2 * (x * z - w * y), r[7] = 2 * (y * z + w * x), r[8] = 1 - 2 * (x * x + y * y);
}

void locate(Geometry &g, const Pinhole &c, const float *mean) {
    for (int k = 0; k < 3; ++k)
        g.in_cam[k] = c.rotation[3 * k] * mean[0] + c.rotation[3 * k + 1] * mean[1] +
                      c.rotation[3 * k + 2] * mean[2] + c.translation[k];
}

void measure(Geometry &g, const Pinhole &c, const float *quat, const float *log_scale) {
    rotate(g, quat);
    for (int k = 0; k < 3; ++k)
        g.scale[k] = std::exp(std::clamp(double(log_scale[k]), kLogScaleMin, kLogScaleMax));
    const double inverse_z = 1 / g.in_cam[2];
    const double slope_x = g.in_cam[0] * inverse_z, slope_y = g.in_cam[1] * inverse_z;
    const double margin_x = 0.15 * c.width / c.fx, margin_y = 0.15 * c.height / c.fy;
    g.slope_x = std::clamp(slope_x, -c.cx / c.fx - margin_x, (c.width - c.cx) / c.fx + margin_x);
    g.slope_y = std::clamp(slope_y, -c.cy / c.fy - margin_y, (c.height - c.cy) / c.fy + margin_y);
    g.slope_x_free = g.slope_x == slope_x, g.slope_y_free = g.slope_y == slope_y;
    g.jacobian_x = c.fx * inverse_z, g.jacobian_xz = -c.fx * g.slope_x * inverse_z;
    g.jacobian_y = c.fy * inverse_z, g.jacobian_yz = -c.fy * g.slope_y * inverse_z;
    for (int k = 0; k < 3; ++k) {
        g.ray[0][k] = g.jacobian_x * c.rotation[k] + g.jacobian_xz * c.rotation[6 + k];
        g.ray[1][k] = g.jacobian_y * c.rotation[3 + k] + g.jacobian_yz * c.rotation[6 + k];
    }
    for (int row = 0; row < 2; ++row)
        for (int k = 0; k < 3; ++k)
            g.a[row][k] = g.scale[k] * (g.ray[row][0] * g.rotation[k] + g.ray[row][1] * g.rotation[3 + k] +
                                        g.ray[row][2] * g.rotation[6 + k]);
    const double *a = g.a[0], *b = g.a[1];
    g.m01 = a[0] * b[1] - a[1] * b[0], g.m02 = a[0] * b[2] - a[2] * b[0], g.m12 = a[1] * b[2] - a[2] * b[1];
    const double xx = a[0] * a[0] + a[1] * a[1] + a[2] * a[2], yy = b[0] * b[0] + b[1] * b[1] + b[2] * b[2];
    g.cov_xx = xx + kDilation, g.cov_yy = yy + kDilation;
    g.cov_xy = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    g.det = g.m01 * g.m01 + g.m02 * g.m02 + g.m12 * g.m12;
    g.det_blurred = g.det + kDilation * (xx + yy) + kDilation * kDilation;
}

// Inclusive range of pixels whose centres lie within `reach` of `center`; empty where first > last.
void span(double center, double reach, int size, int32_t &first, int32_t &last) {
    first = int32_t(std::ceil(std::clamp(center - reach - 0.5, 0.0, double(size))));
    last = int32_t(std::floor(std::clamp(center + reach - 0.5, -1.0, double(size - 1))));
}

// The splat of one Gaussian; false where it cannot reach any pixel.
bool splat_of(const Pinhole &c, const Cloud &cloud, int64_t i, Splat &s) {
    Geometry g;
    locate(g, c, cloud.means + 3 * i);
    const double z = g.in_cam[2];
    const double opacity = cloud.opacities[i];
    if (!(z >= c.near_m) || opacity * 255 <= 1) return false;
    measure(g, c, cloud.quats + 4 * i, cloud.log_scales + 3 * i);
    // A splat smaller than a pixel was widened by the dilation; the opacity pays for it, so that its energy stays.
    const double blurred_opacity = opacity * std::sqrt(g.det / g.det_blurred);
    if (!(blurred_opacity * 255 > 1)) return false;
    const double sigma_max = std::log(255 * blurred_opacity);
    const double x = c.fx * g.in_cam[0] / z + c.cx, y = c.fy * g.in_cam[1] / z + c.cy;
    const double reach_x = std::sqrt(2 * sigma_max * g.cov_xx), reach_y = std::sqrt(2 * sigma_max * g.cov_yy);
    span(x, reach_x, c.width, s.x_first, s.x_last);
    span(y, reach_y, c.height, s.y_first, s.y_last);
    if (s.x_first > s.x_last || s.y_first > s.y_last) return false;
    const double p = std::sqrt(0.5 * g.cov_yy / g.det_blurred);
    s.x = float(x), s.y = float(y);
    s.p = float(p), s.q = float(-p * g.cov_xy / g.cov_yy), s.r = float(std::sqrt(0.5 / g.cov_yy));
    s.sigma_max = float(sigma_max), s.opacity = float(blurred_opacity);
    s.intensity = cloud.intensities[i], s.depth = float(z);
    s.source = int32_t(i);
    return true;
}

// dL/dcovariance (symmetric) and dL/d(log det) to dL/da.
void covariance_gradient(const Geometry &g, const Splat &s, const Moments &m, double a_grad[2][3]) {
    const double p = s.p, q = s.q, r = s.r;
    // dL/dcov = 2 L^T (moments - g/2) L with L = [[p, q], [0, r]]: the fit of the shape, and the blurred determinant.
    const double uu = m.guu - 0.5 * m.g, uv = m.guv, vv = m.gvv - 0.5 * m.g;
    const double xx = 2 * p * p * uu, xy = 2 * p * (q * uu + r * uv);
    const double yy = 2 * (q * q * uu + 2 * q * r * uv + r * r * vv);
    const double *a = g.a[0], *b = g.a[1];
    for (int k = 0; k < 3; ++k) {
        a_grad[0][k] = 2 * (xx * a[k] + xy * b[k]);
        a_grad[1][k] = 2 * (xy * a[k] + yy * b[k]);
    }
    const double d = m.g / g.det, d01 = d * g.m01, d02 = d * g.m02, d12 = d * g.m12;
    a_grad[0][0] += d01 * b[1] + d02 * b[2], a_grad[1][0] -= d01 * a[1] + d02 * a[2];
    a_grad[0][1] += d12 * b[2] - d01 * b[0], a_grad[1][1] += d01 * a[0] - d12 * a[2];
    a_grad[0][2] -= d02 * b[0] + d12 * b[1], a_grad[1][2] += d02 * a[0] + d12 * a[1];
}

void quaternion_gradient(const Geometry &g, const double d[9], float *out) {
    const double w = g.unit[0], x = g.unit[1], y = g.unit[2], z = g.unit[3];
    const double unit_grad[4] = {
        2 * (x * (d[7] - d[5]) + y * (d[2] - d[6]) + z * (d[3] - d[1])),
        2 * (w * (d[7] - d[5]) - 2 * x * (d[4] + d[8]) + y * (d[1] + d[3]) + z * (d[2] + d[6])),
        2 * (w * (d[2] - d[6]) + x * (d[1] + d[3]) - 2 * y * (d[0] + d[8]) + z * (d[5] + d[7])),
        2 * (w * (d[3] - d[1]) + x * (d[2] + d[6]) + y * (d[5] + d[7]) - 2 * z * (d[0] + d[4]))};
    double along = 0;
    for (int k = 0; k < 4; ++k) along += unit_grad[k] * g.unit[k];
    for (int k = 0; k < 4; ++k) out[k] = float((unit_grad[k] - along * g.unit[k]) * g.inverse_norm);
}

void gaussian_gradient(const Pinhole &c, const Cloud &cloud, const Splat &s, const Moments &m, const CloudGradient &out) {
    const int64_t i = s.source;
    Geometry g;
    locate(g, c, cloud.means + 3 * i);
    measure(g, c, cloud.quats + 4 * i, cloud.log_scales + 3 * i);
    double a_grad[2][3];
    covariance_gradient(g, s, m, a_grad);
    double ray_grad[2][3] = {}, rotation_grad[9];
    for (int k = 0; k < 3; ++k) {
        double scale_grad = 0;
        for (int row = 0; row < 3; ++row) {
            const double d = g.ray[0][row] * a_grad[0][k] + g.ray[1][row] * a_grad[1][k];
            rotation_grad[3 * row + k] = d * g.scale[k];
            scale_grad += d * g.rotation[3 * row + k];
            for (int j = 0; j < 2; ++j) ray_grad[j][row] += a_grad[j][k] * g.scale[k] * g.rotation[3 * row + k];
        }
        const float l = cloud.log_scales[3 * i + k];
        out.log_scales[3 * i + k] = l < kLogScaleMin || l > kLogScaleMax ? 0.f : float(scale_grad * g.scale[k]);
    }
    quaternion_gradient(g, rotation_grad, out.quats + 4 * i);
    double jx = 0, jxz = 0, jy = 0, jyz = 0;
    for (int k = 0; k < 3; ++k) {
        jx += ray_grad[0][k] * c.rotation[k], jxz += ray_grad[0][k] * c.rotation[6 + k];
        jy += ray_grad[1][k] * c.rotation[3 + k], jyz += ray_grad[1][k] * c.rotation[6 + k];
    }
    const double x_grad = 2 * double(s.p) * m.gu, y_grad = 2 * (double(s.q) * m.gu + double(s.r) * m.gv);
    const double inverse_z = 1 / g.in_cam[2];
    const double slope_x = x_grad * c.fx - (g.slope_x_free ? jxz * c.fx * inverse_z : 0);
    const double slope_y = y_grad * c.fy - (g.slope_y_free ? jyz * c.fy * inverse_z : 0);
    const double in_cam[3] = {
        slope_x * inverse_z, slope_y * inverse_z,
        m.depth - (slope_x * g.in_cam[0] + slope_y * g.in_cam[1]) * inverse_z * inverse_z -
            (jx * g.jacobian_x + jxz * g.jacobian_xz + jy * g.jacobian_y + jyz * g.jacobian_yz) * inverse_z};
    for (int k = 0; k < 3; ++k)
        out.means[3 * i + k] = float(c.rotation[k] * in_cam[0] + c.rotation[3 + k] * in_cam[1] +
                                     c.rotation[6 + k] * in_cam[2]);
    out.opacities[i] = m.g / cloud.opacities[i];
    out.intensities[i] = m.intensity;
}

}  // namespace

void project(Frame &frame, const Cloud &cloud, int32_t *radii, int threads) {
    frame.projected.resize(cloud.count);
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t i = 0; i < cloud.count; ++i) {
        Splat &s = frame.projected[i];
        if (!splat_of(frame.camera, cloud, i, s)) {
            radii[i] = 0;
            continue;
        }
        const float area = s.p * s.r;  // cov_xx = (q^2 + r^2) / (2 p^2 r^2), cov_yy = 1 / (2 r^2)
        const float widest = std::max(std::hypot(s.q, s.r) / area, 1 / s.r);
        radii[i] = int32_t(std::min(std::ceil(std::sqrt(s.sigma_max) * widest), 1e9f));
    }
    frame.keys.clear();
    for (int64_t i = 0; i < cloud.count; ++i) {
        if (radii[i] == 0) continue;
        uint32_t depth_bits;
        __builtin_memcpy(&depth_bits, &frame.projected[i].depth, 4);  // positive floats order as their bits do
        frame.keys.push_back(uint64_t(depth_bits) << 32 | uint32_t(i));
    }
}

void project_backward(const Frame &frame, const Cloud &cloud, const CloudGradient &out, int threads) {
    const int64_t n = int64_t(frame.splats.size());
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t rank = 0; rank < n; ++rank) {
        const Splat &s = frame.splats[rank];
        Moments sum = {};
        const int64_t end = s.slot + int64_t(s.tiles_across()) * s.tiles_down();
        for (int64_t slot = s.slot; slot < end; ++slot) {
            const Moments &m = frame.moments[slot];
            sum.g += m.g, sum.gu += m.gu, sum.gv += m.gv, sum.guu += m.guu, sum.guv += m.guv, sum.gvv += m.gvv;
            sum.intensity += m.intensity, sum.depth += m.depth;
        }
        gaussian_gradient(frame.camera, cloud, s, sum, out);
    }
}

}  // namespace s4
