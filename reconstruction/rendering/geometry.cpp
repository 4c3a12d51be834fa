#include "geometry.h"

#include <cmath>

namespace s4 {
namespace {

void rotate(Geometry &g) {
    S4_EACH_LANE {
        double w = g.quat[0][i], x = g.quat[1][i], y = g.quat[2][i], z = g.quat[3][i];
        const double squared = w * w + x * x + y * y + z * z;
        const double inverse = squared > 0 ? 1 / std::sqrt(squared) : 0;
        g.inverse_norm[i] = inverse;
        w = squared > 0 ? w * inverse : 1;
        x *= inverse, y *= inverse, z *= inverse;
        g.unit[0][i] = w, g.unit[1][i] = x, g.unit[2][i] = y, g.unit[3][i] = z;
        g.rotation[0][i] = 1 - 2 * (y * y + z * z);
        g.rotation[1][i] = 2 * (x * y - w * z);
        g.rotation[2][i] = 2 * (x * z + w * y);
        g.rotation[3][i] = 2 * (x * y + w * z);
        g.rotation[4][i] = 1 - 2 * (x * x + z * z);
        g.rotation[5][i] = 2 * (y * z - w * x);
        g.rotation[6][i] = 2 * (x * z - w * y);
        g.rotation[7][i] = 2 * (y * z + w * x);
        g.rotation[8][i] = 1 - 2 * (x * x + y * y);
    }
}

void locate(Geometry &g, const Pinhole &c) {
    for (int k = 0; k < 3; ++k) {
        const double *r = c.rotation + 3 * k, t = c.translation[k];
        S4_EACH_LANE g.in_cam[k][i] = r[0] * g.mean[0][i] + r[1] * g.mean[1][i] + r[2] * g.mean[2][i] + t;
    }
    S4_EACH_LANE {
        g.depth[i] = g.in_cam[2][i] >= c.near_m ? g.in_cam[2][i] : 1;
        g.inverse_depth[i] = 1 / g.depth[i];
    }
}

void linearise(Geometry &g, const Pinhole &c) {
    const double focal[2] = {c.fx, c.fy}, principal[2] = {c.cx, c.cy}, size[2] = {double(c.width), double(c.height)};
    for (int axis = 0; axis < 2; ++axis) {
        const double f = focal[axis], margin = 0.15 * size[axis];
        const double low = (-principal[axis] - margin) / f, high = (size[axis] - principal[axis] + margin) / f;
        S4_EACH_LANE {
            const double inverse_z = g.inverse_depth[i], slope = g.in_cam[axis][i] * inverse_z;
            const double above = slope > low ? slope : low, held = above < high ? above : high;
            g.slope[axis][i] = held;
            g.slope_free[axis][i] = held == slope ? 1 : 0;
            g.jacobian[axis][i] = f * inverse_z;
            g.jacobian_z[axis][i] = -f * held * inverse_z;
        }
        for (int k = 0; k < 3; ++k) {
            const double direct = c.rotation[3 * axis + k], along_z = c.rotation[6 + k];
            S4_EACH_LANE g.ray[axis][k][i] = g.jacobian[axis][i] * direct + g.jacobian_z[axis][i] * along_z;
        }
    }
}

void spread(Geometry &g, double dilation) {
    for (int k = 0; k < 3; ++k) {
        S4_EACH_LANE {
            const double l = g.log_scale[k][i], above = l > kLogScaleMin ? l : kLogScaleMin;
            g.scale[k][i] = exp_lane(above < kLogScaleMax ? above : kLogScaleMax);
        }
        for (int row = 0; row < 2; ++row)
            S4_EACH_LANE g.a[row][k][i] =
                g.scale[k][i] * (g.ray[row][0][i] * g.rotation[k][i] + g.ray[row][1][i] * g.rotation[3 + k][i] +
                                 g.ray[row][2][i] * g.rotation[6 + k][i]);
    }
    S4_EACH_LANE {
        const double a0 = g.a[0][0][i], a1 = g.a[0][1][i], a2 = g.a[0][2][i];
        const double b0 = g.a[1][0][i], b1 = g.a[1][1][i], b2 = g.a[1][2][i];
        const double m01 = a0 * b1 - a1 * b0, m02 = a0 * b2 - a2 * b0, m12 = a1 * b2 - a2 * b1;
        const double xx = a0 * a0 + a1 * a1 + a2 * a2, yy = b0 * b0 + b1 * b1 + b2 * b2;
        g.m01[i] = m01, g.m02[i] = m02, g.m12[i] = m12;
        g.cov_xx[i] = xx + dilation, g.cov_yy[i] = yy + dilation;
        g.cov_xy[i] = a0 * b0 + a1 * b1 + a2 * b2;
        g.det[i] = m01 * m01 + m02 * m02 + m12 * m12;
        g.det_blurred[i] = g.det[i] + dilation * (xx + yy) + dilation * dilation;
    }
}

}  // namespace

void measure(Geometry &g, const Pinhole &camera) {
    locate(g, camera);
    rotate(g);
    linearise(g, camera);
    spread(g, camera.dilation);
}

}  // namespace s4
