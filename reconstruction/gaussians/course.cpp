// Moving Gaussians at one instant, and back; twin of `evaluated_reference` in course.py.
// Letters: s time since a Gaussian's own instant, d its duration, both in clips; c_k the coefficients of s^k.
#include <algorithm>
#include <cstdint>
#include <cstring>

#include "exponential.h"
#include "native.h"

namespace {

constexpr int kOrders = 3;

struct Motion {  // filled by Python; [M, 3] or [M] each, coefficients beyond the order are null
    const float *means, *logits, *instants, *log_durations, *coefficients[kOrders];
    int64_t count;
    double instant, least_log_duration, most_log_duration;
};

struct MotionGradient {
    float *logits, *instants, *log_durations, *coefficients[kOrders];
};

// Comparisons are written so that NaN comes out as NaN: the renderer refuses it.
inline double sigmoid(double logit) {
    const double low = logit < -700 ? -700 : logit, held = low > 700 ? 700 : low;
    return 1 / (1 + s4::exp_lane(-held));
}

// The gate exp(-(s / d)^2 / 2) and s / d.
struct Gate {
    double value, ratio, inverse_duration, free;
};
inline Gate gate_of(const Motion &m, double since, double log_duration) {
    const double low = log_duration < m.least_log_duration ? m.least_log_duration : log_duration;
    const double held = low > m.most_log_duration ? m.most_log_duration : low;
    const double inverse = s4::exp_lane(-held), ratio = since * inverse, exponent = -0.5 * ratio * ratio;
    return {s4::exp_lane(exponent < -700 ? -700 : exponent), ratio, inverse, held == log_duration ? 1.0 : 0.0};
}

}  // namespace

// `means` [M, 3] and `opacities` [M] at the instant.
S4_API void motion_forward(const Motion *motion, float *means, float *opacities, int32_t threads) {
    const Motion m = *motion;
#pragma omp parallel num_threads(threads)
    {
#pragma omp for simd schedule(static) nowait
        for (int64_t i = 0; i < m.count; ++i) {
            const double since = m.instant - m.instants[i];
            opacities[i] = float(sigmoid(m.logits[i]) * gate_of(m, since, m.log_durations[i]).value);
        }
#pragma omp for schedule(static)
        for (int64_t i = 0; i < m.count; ++i) {
            const double since = m.instant - m.instants[i];
            double offset[3] = {};
            for (int k = kOrders - 1; k >= 0; --k)
                if (m.coefficients[k])
                    for (int axis = 0; axis < 3; ++axis)
                        offset[axis] = (offset[axis] + m.coefficients[k][3 * i + axis]) * since;
            for (int axis = 0; axis < 3; ++axis) means[3 * i + axis] = float(m.means[3 * i + axis] + offset[axis]);
        }
    }
}

// Gradients of the tensors from those of both outputs; the gradient of the means is the output's own.
S4_API void motion_backward(const Motion *motion, const float *to_means, const float *to_opacities,
                            const MotionGradient *gradient, int32_t threads) {
    const Motion m = *motion;
    const MotionGradient out = *gradient;
#pragma omp parallel num_threads(threads)
    {
#pragma omp for simd schedule(static)
        for (int64_t i = 0; i < m.count; ++i) {
            const double since = m.instant - m.instants[i], p = sigmoid(m.logits[i]);
            const Gate gate = gate_of(m, since, m.log_durations[i]);
            const double along = to_opacities[i] * p * gate.value * gate.ratio;
            out.logits[i] = float(to_opacities[i] * gate.value * p * (1 - p));
            out.log_durations[i] = float(along * gate.ratio * gate.free);
            out.instants[i] = float(along * gate.inverse_duration);
        }
#pragma omp for schedule(static)
        for (int64_t i = 0; i < m.count; ++i) {
            const double since = m.instant - m.instants[i];
            const float *g = to_means + 3 * i;
            double power = 1, speed = 0;
            for (int k = 0; k < kOrders; ++k) {
                if (!m.coefficients[k]) break;
                const float *c = m.coefficients[k] + 3 * i;
                speed += (k + 1) * power * (double(g[0]) * c[0] + double(g[1]) * c[1] + double(g[2]) * c[2]);
                power *= since;
                for (int axis = 0; axis < 3; ++axis) out.coefficients[k][3 * i + axis] = float(g[axis] * power);
            }
            out.instants[i] -= float(speed);
        }
    }
}
