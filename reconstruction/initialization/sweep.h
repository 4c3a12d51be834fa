// The plane sweep's two halves: costs of every depth hypothesis, then their smoothing and the depth that wins.
// Letters: H rows, W columns, D inverse depths, S sources. Costs lie as [H, D, W] in steps of 1 / Levels::one, so that a
// row's hypotheses are next to each other and sixteen bits hold the sum of four paths.
#pragma once
#include <algorithm>
#include <cstdint>
#include <memory>

namespace s4 {

struct Views {  // images: reference [H, W] and sources [S, Hs, Ws]; homographies [S, 9], epipoles [S, 3]
    const float *reference;
    int height, width;
    const float *sources;
    int count, source_height, source_width;
    const double *homographies, *epipoles;
};

struct Hypotheses {
    const double *inverse_depths;  // [D], equally spaced
    int planes;
    const float *around;  // [H, W]: a pixel's hypotheses are these inverse depths on top of its own; null for none
};

struct Window {  // `floor` keeps noise on flat patches from looking like texture
    int radius;
    float floor;
};

struct Levels {  // a cost of 1, and the penalties, in steps; four paths of at most one + jump fit into 16 bits
    uint16_t one, step, jump;
    Levels(float penalty_step, float penalty_jump) {
        const float p2 = std::max(penalty_jump, 0.f), p1 = std::clamp(penalty_step, 0.f, p2);
        const float scale = 15000.f / (1 + p2);
        one = uint16_t(scale), step = uint16_t(p1 * scale + 0.5f), jump = uint16_t(p2 * scale + 0.5f);
    }
};
constexpr uint16_t kNoPath = 30000;  // more than any path costs

using Costs = std::unique_ptr<uint16_t[]>;

// Mean of the two best costs (1 - ZNCC, at most 1) among the sources, 1 where none sees the pixel.
Costs match(const Views &views, const Hypotheses &hypotheses, const Window &window, const Levels &levels, int threads);

// Four-path semi-global smoothing, the best hypothesis and its parabola; the cost before smoothing there.
void choose(const Costs &cost, const Views &views, const Hypotheses &hypotheses, const Levels &levels, int threads,
            float *depth, float *cost_at_depth);

}  // namespace s4
