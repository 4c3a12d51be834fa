// A dynamic cloud at one instant, and back; twin of `evaluated_reference` in motion.py.
// Letters: s time since a Gaussian's own instant, d its duration, both in clips; c_k the coefficients of s^k.
#include <algorithm>
#include <cstdint>
#include <cstring>

#include "exponential.h"
#include "native.h"

namespace {

constexpr int kOrders = 3;

struct Motion {  // filled by Python; coefficients beyond the order are null
    const float *coefficients[kOrders];  // [M, 3] each
    const float *instants, *log_durations;
    int64_t still, moving;
    double instant, least_log_duration, most_log_duration;
};

struct Stored {  // [N, 3] and [N] of the still, [M, 3] and [M] of the moving
    const float *still_means, *still_logits, *moving_means, *moving_logits;
};

struct MotionGradient {
    float *coefficients[kOrders], *instants, *log_durations, *logits;  // logits: [N + M]
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

// `means` [N + M, 3] and `opacities` [N + M] at the instant.
S4_API void motion_forward(const Motion *motion, const Stored *stored, float *means, float *opacities,
                           int32_t threads) {
    const Motion m = *motion;
    const Stored from = *stored;
    std::copy_n(from.still_means, 3 * m.still, means);
#pragma omp parallel num_threads(threads)
    {
#pragma omp for simd schedule(static) nowait
        for (int64_t i = 0; i < m.still; ++i) opacities[i] = float(sigmoid(from.still_logits[i]));
#pragma omp for simd schedule(static) nowait
        for (int64_t i = 0; i < m.moving; ++i) {
            const double since = m.instant - m.instants[i];
            opacities[m.still + i] =
                float(sigmoid(from.moving_logits[i]) * gate_of(m, since, m.log_durations[i]).value);
        }
#pragma omp for schedule(static)
        for (int64_t i = 0; i < m.moving; ++i) {
            const double since = m.instant - m.instants[i];
            double offset[3] = {};
            for (int k = kOrders - 1; k >= 0; --k)
                if (m.coefficients[k])
                    for (int axis = 0; axis < 3; ++axis)
                        offset[axis] = (offset[axis] + m.coefficients[k][3 * i + axis]) * since;
            for (int axis = 0; axis < 3; ++axis)
                means[3 * (m.still + i) + axis] = float(from.moving_means[3 * i + axis] + offset[axis]);
        }
    }
}

// Gradients of the stored tensors from those of both outputs; the gradients of the means are the outputs' own.
S4_API void motion_backward(const Motion *motion, const Stored *stored, const float *to_means,
                            const float *to_opacities, const MotionGradient *gradient, int32_t threads) {
    const Motion m = *motion;
    const Stored from = *stored;
    const MotionGradient out = *gradient;
#pragma omp parallel num_threads(threads)
    {
#pragma omp for simd schedule(static) nowait
        for (int64_t i = 0; i < m.still; ++i) {
            const double p = sigmoid(from.still_logits[i]);
            out.logits[i] = float(to_opacities[i] * p * (1 - p));
        }
#pragma omp for simd schedule(static)
        for (int64_t i = 0; i < m.moving; ++i) {
            const double since = m.instant - m.instants[i], p = sigmoid(from.moving_logits[i]);
            const Gate gate = gate_of(m, since, m.log_durations[i]);
            const double to_opacity = to_opacities[m.still + i], along = to_opacity * p * gate.value * gate.ratio;
            out.logits[m.still + i] = float(to_opacity * gate.value * p * (1 - p));
            out.log_durations[i] = float(along * gate.ratio * gate.free);
            out.instants[i] = float(along * gate.inverse_duration);
        }
#pragma omp for schedule(static)
        for (int64_t i = 0; i < m.moving; ++i) {
            const double since = m.instant - m.instants[i];
            const float *g = to_means + 3 * (m.still + i);
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
