// Gaussians to splats (EWA projection); twin of `project` in reference.py.
#include <omp.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "geometry.h"

namespace s4 {
namespace {

constexpr double kLog255 = 5.541263545158426;
using Column = float[kLanes];

struct alignas(64) Outline {  // a splat on the image, as it is stored
    Column stored[10];        // x, y, p, q, r, veil, intensity, depth, lean_x, lean_y
    Lane reach, first[2], last[2];  // px, and the pixels whose centres may lie inside
    Lane seen;                // 1 where there are any
};

// Range of pixels whose centres lie within `reach` of `center`; empty where first > last.
void span(Outline &o, int axis, const Lane &center, const Lane &reach, double size) {
    S4_EACH_LANE {
        const double low = center[i] - reach[i] - 0.5, high = center[i] + reach[i] - 0.5;
        const double from = low > 0 ? low : 0, to = high < size - 1 ? high : size - 1;
        o.first[axis][i] = std::ceil(from < size ? from : size);
        o.last[axis][i] = std::floor(to > -1 ? to : -1);
    }
}

void outline(const Geometry &g, const Pinhole &c, Outline &o) {
    Lane x, y, reach_x, reach_y;
    S4_EACH_LANE {
        const double xx = g.cov_xx[i], xy = g.cov_xy[i], yy = g.cov_yy[i];
        const double inverse_det = 1 / g.det_blurred[i], inverse_yy = 1 / yy, inverse_z = g.inverse_depth[i];
        // A splat smaller than a pixel was widened by the dilation; the opacity pays for it, so that its energy stays.
        const double opacity = 255 * g.opacity[i] * std::sqrt(g.det[i] * inverse_det);
        const double sigma_max = log_lane(opacity > 1 ? opacity : 1), p = std::sqrt(0.5 * yy * inverse_det);
        const bool front = g.in_cam[2][i] >= c.near_m;
        x[i] = c.fx * g.in_cam[0][i] * inverse_z + c.cx;
        y[i] = c.fy * g.in_cam[1][i] * inverse_z + c.cy;
        reach_x[i] = std::sqrt(2 * sigma_max * xx);
        reach_y[i] = std::sqrt(2 * sigma_max * yy);
        o.reach[i] = reach_x[i] > reach_y[i] ? reach_x[i] : reach_y[i];
        const double shown = opacity > 1 ? 1 : 0;
        o.seen[i] = front ? shown : 0;
        o.stored[0][i] = float(x[i]), o.stored[1][i] = float(y[i]);
        o.stored[2][i] = float(p), o.stored[3][i] = float(-p * xy * inverse_yy);
        o.stored[4][i] = float(std::sqrt(0.5 * inverse_yy));
        o.stored[5][i] = float(kLog255 - sigma_max);
        o.stored[7][i] = float(g.depth[i]);
        o.stored[8][i] = float(xy * inverse_yy), o.stored[9][i] = float(xy / xx);
    }
    span(o, 0, x, reach_x, c.width);
    span(o, 1, y, reach_y, c.height);
    S4_EACH_LANE {
        const double across = o.last[0][i] >= o.first[0][i] ? o.seen[i] : 0;
        o.seen[i] = o.last[1][i] >= o.first[1][i] ? across : 0;
    }
}

// The splat of lane i, and its radius; 0 where it reaches no pixel.
int32_t splat_of(const Outline &o, int i, Splat &s) {
    if (o.seen[i] == 0) return 0;
    float *to = &s.x;
    for (int k = 0; k < 10; ++k) to[k] = o.stored[k][i];
    const auto tile = [](double pixel) { return uint16_t(int32_t(pixel) / kTile); };
    s.span = {tile(o.first[0][i]), tile(o.last[0][i]), tile(o.first[1][i]), tile(o.last[1][i])};
    return int32_t(std::min(std::ceil(o.reach[i]), 1e9));
}

struct Part {  // a thread's share of `count`
    int64_t first, last;
    Part(int64_t count, int rank, int threads) : first(count * rank / threads), last(count * (rank + 1) / threads) {}
};

void project_block(Frame &frame, const Cloud &cloud, int32_t *radii, int64_t first) {
    Geometry g;
    Outline o;
    for (int i = 0; i < kLanes; ++i) load_gaussian(g, cloud, std::min(first + i, cloud.count - 1), i);
    measure(g, frame.camera);
    outline(g, frame.camera, o);
    for (int i = 0; i < kLanes; ++i) o.stored[6][i] = cloud.intensities[std::min(first + i, cloud.count - 1)];
    for (int i = 0; i < std::min<int64_t>(kLanes, cloud.count - first); ++i) {
        Splat &s = frame.splats[first + i];
        const int32_t radius = splat_of(o, i, s);
        radii[first + i] = radius && frame.wants(s.span) ? radius : 0;
        frame.spans[first + i] = s.span;
    }
}

}  // namespace

void prepare(Frame &frame, const Cloud &cloud, const uint8_t *wanted, int threads) {
    frame.wanted.assign(wanted, wanted ? wanted + frame.tiles_x * frame.tiles_y : wanted);
    const int across = frame.tiles_x + 1;
    frame.wanted_before.assign(frame.wanted.empty() ? 0 : size_t(across) * (frame.tiles_y + 1), 0);
    for (int y = 0; y < frame.tiles_y && wanted; ++y) {
        int32_t row = 0;
        for (int x = 0; x < frame.tiles_x; ++x) {
            row += wanted[y * frame.tiles_x + x] != 0;
            frame.wanted_before[(y + 1) * across + x + 1] = frame.wanted_before[y * across + x + 1] + row;
        }
    }
    frame.splats.resize(cloud.count);
    frame.spans.resize(cloud.count);
    frame.visible.resize(cloud.count);
    frame.keys.resize(cloud.count);
    frame.part_visible.assign(threads, 0);
    frame.part_slots.assign(threads, 0);
}

void project(Frame &frame, const Cloud &cloud, int32_t *radii) {
    const int threads = omp_get_num_threads(), rank = omp_get_thread_num();
    const Part blocks((cloud.count + kLanes - 1) / kLanes, rank, threads);
    const int64_t first = blocks.first * kLanes, last = std::min(blocks.last * kLanes, cloud.count);
    int64_t visible = 0, slots = 0;
    for (int64_t block = first; block < last; block += kLanes) project_block(frame, cloud, radii, block);
    for (int64_t i = first; i < last; ++i)
        if (radii[i]) ++visible, slots += frame.spans[i].tiles();
    frame.part_visible[rank] = visible;
    frame.part_slots[rank] = slots;
#pragma omp barrier
    int64_t at = std::accumulate(frame.part_visible.begin(), frame.part_visible.begin() + rank, int64_t(0));
    int64_t slot = std::accumulate(frame.part_slots.begin(), frame.part_slots.begin() + rank, int64_t(0));
    if (rank == threads - 1) frame.visible_count = at + visible, frame.slots = slot + slots;
    for (int64_t i = first; i < last; ++i) {
        if (!radii[i]) continue;
        frame.splats[i].slot = slot;
        slot += frame.spans[i].tiles();
        uint32_t depth_bits;
        std::memcpy(&depth_bits, &frame.splats[i].depth, 4);  // positive floats order as their bits do
        frame.keys[at] = uint64_t(depth_bits) << 32 | uint32_t(i);
        frame.visible[at++] = int32_t(i);
    }
#pragma omp barrier
}

}  // namespace s4
