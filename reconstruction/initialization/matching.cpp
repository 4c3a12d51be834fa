// Soft matches of two samples of points, summed for the rigid fit; twin of `soft_matches_reference` in the tests.
#include <cmath>
#include <vector>

#include "../gaussians/exponential.h"
#include "native.h"

namespace {

struct Model {  // by column: turned by the pose, as it is, its brightness; and the weights of one target point
    std::vector<float> turned[3], own[3], light, weight, squared;

    Model(const float *points, const float *lights, int count, const double *pose)
        : light(lights, lights + count), weight(count), squared(count) {
        for (int k = 0; k < 3; ++k) {
            turned[k].resize(count), own[k].resize(count);
            for (int j = 0; j < count; ++j) {
                const float *p = points + 3 * j;
                own[k][j] = p[k];
                turned[k][j] = float(pose[3 * k] * p[0] + pose[3 * k + 1] * p[1] + pose[3 * k + 2] * p[2]);
            }
        }
    }
};

// Weights of all model points for one target point, seen from where the pose shifts the model's origin to.
void weigh(const float *target, float light, float inverse_width, float inverse_light, float most, Model &m) {
    const float x = target[0], y = target[1], z = target[2];
    const float *mx = m.turned[0].data(), *my = m.turned[1].data(), *mz = m.turned[2].data(), *lights = m.light.data();
    float *weight = m.weight.data(), *squared = m.squared.data();
    const int count = int(m.light.size());
#pragma omp simd
    for (int j = 0; j < count; ++j) {
        const float dx = mx[j] - x, dy = my[j] - y, dz = mz[j] - z, dl = lights[j] - light;
        squared[j] = dx * dx + dy * dy + dz * dz;
        const float exponent = squared[j] * inverse_width + dl * dl * inverse_light;
        weight[j] = s4::exp_lane(-(exponent < most ? exponent : most));
    }
}

double dot(const std::vector<float> &a, const std::vector<float> &b) {
    const float *p = a.data(), *q = b.data();
    const int count = int(a.size());
    float sum = 0;
#pragma omp simd reduction(+ : sum)
    for (int j = 0; j < count; ++j) sum += p[j] * q[j];
    return sum;
}

}  // namespace

// `pose`: target from model, nine numbers of the rotation and three of the shift. `sums` (17 numbers): of the matches,
// of match x squared distance, of match x model point (3), of match x target point (3), of match x target x model (9).
S4_API void soft_matches(const float *model, const float *model_light, int32_t model_count, const float *target,
                         const float *target_light, int32_t target_count, const double *pose, double width,
                         double alike, double most_unlike, double stray, double *sums) {
    Model m(model, model_light, model_count, pose);
    const std::vector<float> ones(model_count, 1.f);
    const float inverse_width = float(0.5 / (width * width)), inverse_light = float(0.5 / (alike * alike));
    std::fill(sums, sums + 17, 0.0);
    for (int i = 0; i < target_count; ++i) {
        const float *t = target + 3 * i;
        const float seen[3] = {float(t[0] - pose[9]), float(t[1] - pose[10]), float(t[2] - pose[11])};
        weigh(seen, target_light[i], inverse_width, inverse_light, float(most_unlike), m);
        const double total = dot(m.weight, ones), share = 1 / (total + stray);
        sums[0] += share * total;
        sums[1] += share * dot(m.weight, m.squared);
        for (int a = 0; a < 3; ++a) {
            const double own = share * dot(m.weight, m.own[a]);
            sums[2 + a] += own;
            sums[5 + a] += share * total * t[a];
            for (int b = 0; b < 3; ++b) sums[8 + 3 * b + a] += own * t[b];
        }
    }
}
