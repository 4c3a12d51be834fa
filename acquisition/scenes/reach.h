// Pixels that a moving shape, or its shadow, can reach: never too few; included by the ray caster alone.
#pragma once
#include <vector>

#include "scenes/tracer.h"

namespace raycast {

constexpr int kSegment = 16;     // pixels of a row that are tested for shadows together
constexpr double kAhead = 1e-3;  // least depth, in metres, at which a corner is projected

// The slopes of the corners of the box around a shape in one view.
struct Cover {
  double p[8], q[8];  // bit i of a corner's number: on which side along the shape's axis i
  double least_q = kInfinity, most_q = -kInfinity;
  bool ahead = true;  // all corners are before the camera; otherwise their slopes say nothing

  Cover(const Placed& shape, const RaycastView& view) {
    const Vec eye{view.center[0], view.center[1], view.center[2]};
    for (int corner = 0; corner < 8; ++corner) {
      const auto side = [&](int axis) { return corner >> axis & 1 ? 1.0 : -1.0; };
      const Vec own{side(0) * shape.half.x, side(1) * shape.half.y, side(2) * shape.half.z};
      const Vec m = turn(view.rotation, shape.position + turn(shape.pose, own) - eye);
      ahead = ahead && m.z > kAhead;
      p[corner] = m.x / m.z, q[corner] = m.y / m.z;
      least_q = std::min(least_q, q[corner]), most_q = std::max(most_q, q[corner]);
    }
  }

  // The range of slopes along a row that the shape can fill between the slopes `low` and `high` across it.
  void across(double low, double high, double* least, double* most) const {
    *least = kInfinity, *most = -kInfinity;
    for (int corner = 0; corner < 8; ++corner)
      for (int i = 0; i < 3; ++i) {
        const int other = corner ^ (1 << i);
        if (other < corner) continue;
        const double q0 = q[corner], q1 = q[other], step = p[other] - p[corner];
        if (std::max(q0, q1) < low || std::min(q0, q1) > high) continue;
        for (const double bound : {low, high}) {  // clipped to the strip; an edge along the row stays whole
          const double part = q1 != q0 ? std::min(1.0, std::max(0.0, (bound - q0) / (q1 - q0))) : bound == low;
          *least = std::min(*least, p[corner] + part * step), *most = std::max(*most, p[corner] + part * step);
        }
      }
  }
};

// The box across the sun's direction that the sunlit points of kSegment pixels of a row fill.
struct Segment {
  double least_u = kInfinity, most_u = -kInfinity, least_v = kInfinity, most_v = -kInfinity;

  Segment(const double* foot, int64_t pixels) {
    for (int64_t x = 0; x < pixels; ++x, foot += 3) {
      if (!(foot[2] >= 0)) continue;
      least_u = std::min(least_u, foot[0] - foot[2]), most_u = std::max(most_u, foot[0] + foot[2]);
      least_v = std::min(least_v, foot[1] - foot[2]), most_v = std::max(most_v, foot[1] + foot[2]);
    }
  }

  bool meets(const Placed& shape) const {
    const Vec at = shape.sunward, reach = shape.reach;
    return at.x + reach.x >= least_u && at.x - reach.x <= most_u && at.y + reach.y >= least_v &&
           at.y - reach.y <= most_v;
  }
};

// A row of a pinhole camera: the shape may cover pixels [*first, *last).
inline void covered_row(const Cover& cover, const RaycastView& view, int y, int* first, int* last) {
  *first = 0, *last = view.width;
  if (view.slopes || !cover.ahead) return;
  const double q = (y + 0.5 - view.cy) / view.fy, half = 0.5 / view.fy + kSlack;
  double least, most;
  if (cover.most_q < q - half || cover.least_q > q + half)
    least = kInfinity, most = -kInfinity;
  else
    cover.across(q - half, q + half, &least, &most);
  *first = *last = 0;
  if (!(least <= most)) return;
  const double from = (least - kSlack) * view.fx + view.cx - 1, to = (most + kSlack) * view.fx + view.cx + 1;
  *first = int(std::min(double(view.width), std::max(0.0, from)));
  *last = int(std::min(double(view.width), std::max(0.0, to + 1)));
}

// Per pixel of a row, the moving shapes that may cover it (`near`) and those that may shade its still part (`dark`).
inline void mark_row(const Tracer& tracer, const RaycastView& view, const std::vector<Cover>& covers, int y,
              const double* foot, const Segment* segments, uint64_t* near, uint64_t* dark) {
  std::fill(near, near + view.width, 0);
  std::fill(dark, dark + view.width, 0);
  std::vector<double> across(view.width), down(view.width, (y + 0.5 - view.cy) / view.fy);
  for (int x = 0; x < view.width; ++x) across[x] = (x + 0.5 - view.cx) / view.fx;
  if (view.middles)
    for (int x = 0; x < view.width; ++x) {
      across[x] = view.middles[2 * (int64_t(y) * view.width + x)];
      down[x] = view.middles[2 * (int64_t(y) * view.width + x) + 1];
    }
  const Cover* cover = covers.data();
  for (uint64_t left = tracer.moving; left; left &= left - 1, ++cover) {
    const int k = __builtin_ctzll(left);
    const uint64_t bit = uint64_t(1) << k;
    const Placed& shape = tracer[k];
    const Vec m = turn(view.rotation, shape.position - Vec{view.center[0], view.center[1], view.center[2]});
    const double cone = shape.cone;
    int first, last;
    covered_row(*cover, view, y, &first, &last);
    for (int x = first; x < last; ++x) {
      const double p = across[x], q = down[x];
      const bool covered = p * m.x + q * m.y + m.z >= cone * std::sqrt(p * p + q * q + 1);
      near[x] |= covered ? bit : 0;
    }
    for (int start = 0; start < view.width; start += kSegment) {
      if (!segments[start / kSegment].meets(shape)) continue;
      const int end = std::min(start + kSegment, int(view.width));
      for (int x = start; x < end; ++x) {
        const double du = foot[3 * x] - shape.sunward.x, dv = foot[3 * x + 1] - shape.sunward.y;
        const double more = foot[3 * x + 2], reach = more + shape.radius;
        const bool inside = (std::abs(du) <= shape.reach.x + more) & (std::abs(dv) <= shape.reach.y + more);
        dark[x] |= inside & (reach >= 0) & (du * du + dv * dv <= reach * reach) ? bit : 0;
      }
    }
  }
}

}  // namespace raycast
