// Gaussians to splats (EWA projection); twin of `project` in reference.py.
#include <algorithm>
#include <cmath>

#include "geometry.h"

namespace s4 {
namespace {

struct alignas(64) Outline {  // what a splat is on the image
    Lane x, y, p, q, r, opacity, sigma_max, reach_x, reach_y;
};

void outline(const Geometry &g, const Pinhole &c, Outline &o) {
    S4_EACH_LANE {
        const double det_blurred = g.det_blurred[i], xx = g.cov_xx[i], yy = g.cov_yy[i];
        // A splat smaller than a pixel was widened by the dilation; the opacity pays for it, so that its energy stays.
        const double opacity = g.opacity[i] * std::sqrt(g.det[i] / det_blurred);
        const double seen = 255 * opacity > 1 ? 255 * opacity : 1;
        const double sigma_max = log_lane(seen), p = std::sqrt(0.5 * yy / det_blurred);
        o.x[i] = c.fx * g.in_cam[0][i] / g.depth[i] + c.cx;
        o.y[i] = c.fy * g.in_cam[1][i] / g.depth[i] + c.cy;
        o.p[i] = p;
        o.q[i] = -p * g.cov_xy[i] / yy;
        o.r[i] = std::sqrt(0.5 / yy);
        o.opacity[i] = opacity;
        o.sigma_max[i] = sigma_max;
        o.reach_x[i] = std::sqrt(2 * sigma_max * xx);
        o.reach_y[i] = std::sqrt(2 * sigma_max * yy);
    }
}

// Inclusive range of pixels whose centres lie within `reach` of `center`; empty where first > last.
void span(double center, double reach, int size, int32_t &first, int32_t &last) {
    first = int32_t(std::ceil(std::clamp(center - reach - 0.5, 0.0, double(size))));
    last = int32_t(std::floor(std::clamp(center + reach - 0.5, -1.0, double(size - 1))));
}

// The splat of lane i, and its radius; 0 where it reaches no pixel.
int32_t splat_of(const Geometry &g, const Outline &o, const Pinhole &c, int i, Splat &s) {
    if (!(g.in_cam[2][i] >= c.near_m) || !(255 * o.opacity[i] > 1)) return 0;
    span(o.x[i], o.reach_x[i], c.width, s.x_first, s.x_last);
    span(o.y[i], o.reach_y[i], c.height, s.y_first, s.y_last);
    if (s.x_first > s.x_last || s.y_first > s.y_last) return 0;
    s.x = float(o.x[i]), s.y = float(o.y[i]);
    s.p = float(o.p[i]), s.q = float(o.q[i]), s.r = float(o.r[i]);
    s.sigma_max = float(o.sigma_max[i]), s.opacity = float(o.opacity[i]), s.depth = float(g.depth[i]);
    return int32_t(std::min(std::ceil(std::max(o.reach_x[i], o.reach_y[i])), 1e9));
}

}  // namespace

void project(Frame &frame, const Cloud &cloud, int32_t *radii, int threads) {
    frame.projected.resize(cloud.count);
    const int64_t blocks = (cloud.count + kLanes - 1) / kLanes;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t block = 0; block < blocks; ++block) {
        const int64_t first = block * kLanes;
        Geometry g;
        Outline o;
        for (int i = 0; i < kLanes; ++i) load_gaussian(g, cloud, std::min(first + i, cloud.count - 1), i);
        measure(g, frame.camera);
        outline(g, frame.camera, o);
        for (int i = 0; i < std::min<int64_t>(kLanes, cloud.count - first); ++i) {
            Splat &s = frame.projected[first + i];
            radii[first + i] = splat_of(g, o, frame.camera, i, s);
            s.intensity = cloud.intensities[first + i];
        }
    }
    frame.keys.clear();
    frame.visible.clear();
    frame.slots = 0;
    for (int64_t i = 0; i < cloud.count; ++i) {
        if (radii[i] == 0) continue;
        Splat &s = frame.projected[i];
        s.slot = frame.slots;
        frame.slots += int64_t(s.tiles_across()) * s.tiles_down();
        uint32_t depth_bits;
        std::memcpy(&depth_bits, &s.depth, 4);  // positive floats order as their bits do
        frame.keys.push_back(uint64_t(depth_bits) << 32 | uint32_t(i));
        frame.visible.push_back(int32_t(i));
    }
}

}  // namespace s4
