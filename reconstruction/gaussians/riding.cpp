// Gaussians that ride on rigid bodies, forward and backward; twin of `carried_reference` in riding.py.
// Letters: A riders, K bodies; (r, a) real part and axis of a body's unit quaternion.
#include <cstddef>
#include <cstdint>
#include <vector>

#include "native.h"

namespace {

struct Vec {
    double x, y, z;
};
inline Vec operator+(Vec a, Vec b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec operator*(double s, Vec a) { return {s * a.x, s * a.y, s * a.z}; }
inline double dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec cross(Vec a, Vec b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
inline Vec load(const float *from) { return {from[0], from[1], from[2]}; }
inline void store(Vec a, float *to) { to[0] = float(a.x), to[1] = float(a.y), to[2] = float(a.z); }

struct Quat {
    double r;
    Vec a;
};
inline Quat load_quat(const float *from) { return {from[0], load(from + 1)}; }
inline void store_quat(double r, Vec a, float *to) { to[0] = float(r), store(a, to + 1); }

struct Riders {  // filled by Python
    const float *means, *quats;          // [A, 3], [A, 4] wxyz, in their body's frame
    const int64_t *bodies;               // [A]
    const float *body_quats, *centers;   // [K, 4], [K, 3]
    int64_t count, body_count;
};

constexpr int kPose = 7;  // gradients of a body: quaternion, centre

}  // namespace

S4_API void ride_forward(const Riders *riders, float *means, float *quats, int32_t threads) {
    const Riders m = *riders;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t i = 0; i < m.count; ++i) {
        const int64_t k = m.bodies[i];
        const Quat q = load_quat(m.body_quats + 4 * k), p = load_quat(m.quats + 4 * i);
        const Vec v = load(m.means + 3 * i), across = 2 * cross(q.a, v);
        store(v + q.r * across + cross(q.a, across) + load(m.centers + 3 * k), means + 3 * i);
        store_quat(q.r * p.r - dot(q.a, p.a), q.r * p.a + p.r * q.a + cross(q.a, p.a), quats + 4 * i);
    }
}

// Gradients of both outputs to those of the riders [A, 3], [A, 4] and of the bodies [K, 7], the same for a given number
// of threads.
S4_API void ride_backward(const Riders *riders, const float *to_means, const float *to_quats, float *means,
                          float *quats, float *poses, int32_t threads) {
    const Riders m = *riders;
    std::vector<double> sums(std::size_t(threads) * m.body_count * kPose);
#pragma omp parallel for schedule(static, 1) num_threads(threads)
    for (int32_t rank = 0; rank < threads; ++rank) {
        double *own = sums.data() + std::size_t(rank) * m.body_count * kPose;
        for (int64_t i = m.count * rank / threads; i < m.count * (rank + 1) / threads; ++i) {
            const int64_t k = m.bodies[i];
            const Quat q = load_quat(m.body_quats + 4 * k), p = load_quat(m.quats + 4 * i);
            const Quat h = load_quat(to_quats + 4 * i);
            const Vec v = load(m.means + 3 * i), g = load(to_means + 3 * i);
            const double av = dot(q.a, v), ga = dot(g, q.a), gv = dot(g, v), aa = dot(q.a, q.a);
            store(g + 2 * q.r * cross(g, q.a) + 2 * ga * q.a + -2 * aa * g, means + 3 * i);
            store_quat(h.r * q.r + dot(h.a, q.a), -h.r * q.a + q.r * h.a + cross(h.a, q.a), quats + 4 * i);
            const Vec turn = 2 * q.r * cross(v, g) + 2 * av * g + 2 * ga * v + -4 * gv * q.a;
            const Vec axis = turn + -h.r * p.a + p.r * h.a + cross(p.a, h.a);
            const double real = 2 * dot(g, cross(q.a, v)) + h.r * p.r + dot(h.a, p.a);
            const double all[kPose] = {real, axis.x, axis.y, axis.z, g.x, g.y, g.z};
            for (int j = 0; j < kPose; ++j) own[k * kPose + j] += all[j];
        }
    }
    for (int64_t j = 0; j < m.body_count * kPose; ++j) {
        double total = 0;
        for (int32_t rank = 0; rank < threads; ++rank) total += sums[std::size_t(rank) * m.body_count * kPose + j];
        poses[j] = float(total);
    }
}
