// Soft matches of two samples of points, summed for the rigid fit; twin of `soft_matches_reference` in matching.py.
#include <cmath>
#include <vector>

#include "../gaussians/exponential.h"
#include "native.h"

namespace {

struct Model {  // by column: moved by the pose, as it is, its brightness; and the weights of one target point
    std::vector<double> moved[3], own[3], light, weight, squared;

    Model(const float *points, const float *lights, int count, const double *pose)
        : light(lights, lights + count), weight(count), squared(count) {
        for (int k = 0; k < 3; ++k) {
            moved[k].resize(count), own[k].resize(count);
            for (int j = 0; j < count; ++j) {
                const float *p = points + 3 * j;
                own[k][j] = p[k];
                moved[k][j] = pose[3 * k] * p[0] + pose[3 * k + 1] * p[1] + pose[3 * k + 2] * p[2] + pose[9 + k];
            }
        }
    }
};

// Weights of all model points for one target point.
void weigh(const float *target, double light, double inverse_width, double inverse_light, double most, Model &m) {
    const double x = target[0], y = target[1], z = target[2];
    const double *mx = m.moved[0].data(), *my = m.moved[1].data(), *mz = m.moved[2].data(), *lights = m.light.data();
    double *weight = m.weight.data(), *squared = m.squared.data();
    const int count = int(m.light.size());
#pragma omp simd
    for (int j = 0; j < count; ++j) {
        const double dx = mx[j] - x, dy = my[j] - y, dz = mz[j] - z, dl = lights[j] - light;
        squared[j] = dx * dx + dy * dy + dz * dz;
        const double exponent = squared[j] * inverse_width + dl * dl * inverse_light;
        weight[j] = s4::exp_lane(-(exponent < most ? exponent : most));
    }
}

double dot(const std::vector<double> &a, const std::vector<double> &b) {
    const double *p = a.data(), *q = b.data();
    const int count = int(a.size());
    double sum = 0;
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
    const std::vector<double> ones(model_count, 1.0);
    std::fill(sums, sums + 17, 0.0);
    for (int i = 0; i < target_count; ++i) {
        const float *t = target + 3 * i;
        weigh(t, target_light[i], 0.5 / (width * width), 0.5 / (alike * alike), most_unlike, m);
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
