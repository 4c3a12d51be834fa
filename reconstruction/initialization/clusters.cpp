// Connected points: those within a distance of each other, directly or through others; twin of `linked_reference` in
// stereo.py.
#include <cstddef>
#include <cstdint>
#include <vector>

#include "native.h"

// Writes for each of n points [n, 3] the number of its cluster, from 0, in the order of their first points.
S4_API void link_points(const double *points, int32_t count, double gap, int32_t *clusters) {
    std::vector<double> left[3];  // by column: the points that are in no cluster yet
    std::vector<int32_t> names(count), edge;
    for (int k = 0; k < 3; ++k) {
        left[k].resize(count);
        for (int i = 0; i < count; ++i) left[k][i] = points[3 * i + k];
    }
    for (int i = 0; i < count; ++i) names[i] = i;
    std::vector<uint8_t> near(count);
    int remaining = count, cluster = 0;
    const double most = gap * gap;
    while (remaining) {
        edge.assign(1, names[0]);
        for (std::size_t next = 0; next < edge.size(); ++next) {
            const double *at = points + 3 * edge[next], x = at[0], y = at[1], z = at[2];
            clusters[edge[next]] = cluster;
            const double *px = left[0].data(), *py = left[1].data(), *pz = left[2].data();
            uint8_t *linked = near.data();
#pragma omp simd
            for (int i = 0; i < remaining; ++i) {
                const double dx = px[i] - x, dy = py[i] - y, dz = pz[i] - z;
                linked[i] = dx * dx + dy * dy + dz * dz <= most;
            }
            int kept = 0;
            for (int i = 0; i < remaining; ++i) {
                const bool own = names[i] == edge[next];
                if (linked[i] && !own) clusters[names[i]] = cluster, edge.push_back(names[i]);
                if (linked[i] || own) continue;
                for (auto &column : left) column[kept] = column[i];
                names[kept++] = names[i];
            }
            remaining = kept;
        }
        ++cluster;
    }
}
