// Adam over many tensors in one pass each; twin of torch's in adam.py. Kingma and Ba, ICLR 2015.
#include <cmath>
#include <cstdint>

#include "native.h"

namespace {

struct Leaf {  // what Python fills
    float *values, *means, *squares;
    const float *gradient;
    int64_t count;
    double step_size, inverse_root;  // rate / (1 - beta1^t), 1 / sqrt(1 - beta2^t)
};

}  // namespace

S4_API void adam_step(const Leaf *leaves, int32_t count, double beta1, double beta2, double eps, int32_t threads) {
    const float b1 = float(beta1), b2 = float(beta2), rest1 = float(1 - beta1), rest2 = float(1 - beta2);
#pragma omp parallel num_threads(threads)
    for (int32_t k = 0; k < count; ++k) {
        const Leaf leaf = leaves[k];
        const float size = float(leaf.step_size), root = float(leaf.inverse_root), floor = float(eps);
#pragma omp for simd schedule(static) nowait
        for (int64_t i = 0; i < leaf.count; ++i) {
            const float g = leaf.gradient[i];
            const float mean = b1 * leaf.means[i] + rest1 * g, square = b2 * leaf.squares[i] + rest2 * (g * g);
            leaf.means[i] = mean;
            leaf.squares[i] = square;
            leaf.values[i] -= size * mean / (std::sqrt(square) * root + floor);
        }
    }
}
