// Clusters of points that chains of neighbours join; twin of `linked_reference` in stereo.py.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <vector>

#include "native.h"

namespace {

// The first point of the cluster that a point is in, by the `earlier` point of each; the way there is shortened.
int32_t first_of(int32_t point, std::vector<int32_t> &earlier) {
    while (earlier[point] != point) point = earlier[point] = earlier[earlier[point]];
    return point;
}

}  // namespace

// `clusters`: for each of the `count` points (three numbers each, in m) the number of its cluster, from 0 in the order of
// their first points. Points within `gap` metres are of one cluster. In the order of their first coordinate only few can
// be near a point.
S4_API void link_points(const double *points, int32_t count, double gap, int32_t *clusters) {
    std::vector<int32_t> order(count), earlier(count);
    std::iota(order.begin(), order.end(), 0);
    earlier = order;
    const auto across = [&](int32_t i) { return std::isnan(points[3 * i]) ? HUGE_VAL : points[3 * i]; };
    std::sort(order.begin(), order.end(), [&](int32_t a, int32_t b) { return across(a) < across(b); });
    for (int32_t i = 0; i < count; ++i) {
        const double *p = points + 3 * order[i];
        for (int32_t j = i + 1; j < count; ++j) {
            const double *q = points + 3 * order[j], dx = q[0] - p[0], dy = q[1] - p[1], dz = q[2] - p[2];
            if (!(dx <= gap)) break;
            if (!(dx * dx + dy * dy + dz * dz <= gap * gap)) continue;  // nor where one is nowhere
            const int32_t a = first_of(order[i], earlier), b = first_of(order[j], earlier);
            earlier[std::max(a, b)] = std::min(a, b);
        }
    }
    int32_t found = 0;
    for (int32_t i = 0; i < count; ++i) clusters[i] = earlier[i] == i ? found++ : clusters[first_of(i, earlier)];
}
