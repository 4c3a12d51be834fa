// Plane sweep of one reference view: the smoothing of its costs along four paths, the winning hypothesis, its parabola.
// Horizontal paths go through a row turned round, [W, D]; vertical ones through strips of columns, both ways in a thread.
// Sums are whole numbers: the same for any number of threads.
#include "sweep.h"

#include <vector>

#include "native.h"

namespace s4 {
namespace {

constexpr int kStrip = 64;  // columns

inline uint16_t least(uint16_t a, uint16_t b) { return a < b ? a : b; }

// What a path costs with hypothesis d here, from what the pixel before it cost with d - 1, d and d + 1.
inline uint16_t step_on(uint16_t cost, uint16_t below, uint16_t same, uint16_t above, uint16_t lowest, const Levels &l) {
    const uint16_t beside = uint16_t(least(below, above) + l.step), jump = uint16_t(lowest + l.jump);
    return uint16_t(cost + least(least(same, jump), beside) - lowest);
}

void turn(const uint16_t *from, int rows, int columns, uint16_t *to) {
    constexpr int kSide = 16;
    for (int i0 = 0; i0 < rows; i0 += kSide)
        for (int j0 = 0; j0 < columns; j0 += kSide)
            for (int i = i0; i < std::min(i0 + kSide, rows); ++i)
                for (int j = j0; j < std::min(j0 + kSide, columns); ++j) to[j * rows + i] = from[i * columns + j];
}

// One path over `length` pixels of D costs each, `stride` apart, added to `total`.
void follow(const uint16_t *cost, int length, int stride, int planes, const Levels &levels, uint16_t *total,
            std::vector<uint16_t> &previous, std::vector<uint16_t> &current) {
    std::fill(previous.begin(), previous.end(), uint16_t(0));
    std::fill(current.begin(), current.end(), kNoPath);
    uint16_t lowest = 0;
    for (int i = 0; i < length; ++i, cost += stride, total += stride) {
        const uint16_t *before = previous.data();
        uint16_t *now = current.data(), next = kNoPath;
        for (int d = 0; d < planes; ++d) {
            const uint16_t value = step_on(cost[d], before[d], before[d + 1], before[d + 2], lowest, levels);
            now[d + 1] = value;
            total[d] = uint16_t(total[d] + value);
            next = least(next, value);
        }
        lowest = next;
        std::swap(previous, current);
        current.front() = current.back() = previous.front() = previous.back() = kNoPath;
    }
}

void smooth_rows(const Costs &cost, int height, int width, int planes, const Levels &levels, int threads,
                 uint16_t *total) {
    const int64_t row = int64_t(planes) * width;
#pragma omp parallel num_threads(threads) if (threads > 1)
    {
        std::vector<uint16_t> turned(row), sums(row), previous(planes + 2), current(planes + 2);
#pragma omp for schedule(dynamic, 8)
        for (int y = 0; y < height; ++y) {
            turn(cost.get() + y * row, planes, width, turned.data());
            std::fill(sums.begin(), sums.end(), uint16_t(0));
            follow(turned.data(), width, planes, planes, levels, sums.data(), previous, current);
            follow(turned.data() + row - planes, width, -planes, planes, levels, sums.data() + row - planes, previous,
                   current);
            turn(sums.data(), width, planes, total + y * row);
        }
    }
}

struct Strip {  // [D + 2, kStrip] path costs of the row before and of this one, [kStrip] the lowest of the row before
    std::vector<uint16_t> previous, current;
    uint16_t lowest[kStrip];
    explicit Strip(int planes) : previous((planes + 2) * kStrip), current((planes + 2) * kStrip) {}

    void begin() {
        std::fill(previous.begin(), previous.end(), uint16_t(0));
        std::fill(lowest, lowest + kStrip, uint16_t(0));
    }

    // A row's costs, hypotheses `width` apart, added to `total`.
    void pass(const uint16_t *cost, int columns, int width, int planes, const Levels &levels, uint16_t *total) {
        std::fill_n(current.begin(), kStrip, kNoPath);
        std::fill_n(current.end() - kStrip, kStrip, kNoPath);
        uint16_t next[kStrip];
        std::fill(next, next + kStrip, kNoPath);
        for (int d = 0; d < planes; ++d) {
            const uint16_t *before = previous.data() + d * kStrip, *here = cost + int64_t(d) * width;
            uint16_t *now = current.data() + (d + 1) * kStrip, *sum = total + int64_t(d) * width;
#pragma omp simd
            for (int x = 0; x < columns; ++x) {
                const uint16_t value =
                    step_on(here[x], before[x], before[x + kStrip], before[x + 2 * kStrip], lowest[x], levels);
                now[x] = value;
                sum[x] = uint16_t(sum[x] + value);
                next[x] = least(next[x], value);
            }
        }
        std::copy(next, next + kStrip, lowest);
        std::swap(previous, current);
    }
};

// The best hypothesis of each of a strip's pixels in one row.
void best_of(const uint16_t *total, int columns, int width, int planes, uint16_t *index) {
    uint16_t best[kStrip];
    std::fill(best, best + kStrip, uint16_t(0xffff));
    std::fill(index, index + kStrip, uint16_t(0));
    for (int d = 0; d < planes; ++d) {
        const uint16_t *sum = total + int64_t(d) * width;
#pragma omp simd
        for (int x = 0; x < columns; ++x) {
            index[x] = sum[x] < best[x] ? uint16_t(d) : index[x];
            best[x] = least(best[x], sum[x]);
        }
    }
}

// How far beside hypothesis d the parabola through it and its neighbours is lowest, in steps.
double offset_of(const uint16_t *total, int64_t width, int d, int planes) {
    if (d == 0 || d + 1 == planes) return 0;
    const double below = total[(d - 1) * width], here = total[d * width], above = total[(d + 1) * width];
    const double bend = below - 2 * here + above;
    return bend > 0 ? std::clamp(0.5 * (below - above) / bend, -0.5, 0.5) : 0;
}

}  // namespace

void choose(const Costs &cost, const Views &v, const Hypotheses &hypotheses, const Levels &levels, int threads,
            float *depth, float *cost_at_depth) {
    const int width = v.width, planes = hypotheses.planes;
    const int64_t row = int64_t(planes) * width;
    const Costs total(new uint16_t[v.height * row]);
    smooth_rows(cost, v.height, width, planes, levels, threads, total.get());
    const double *w = hypotheses.inverse_depths, gap = planes > 1 ? w[1] - w[0] : 0;
#pragma omp parallel num_threads(threads) if (threads > 1)
    {
        Strip strip(planes);
#pragma omp for schedule(dynamic)
        for (int left = 0; left < width; left += kStrip) {
            const int columns = std::min(kStrip, width - left);
            strip.begin();
            for (int y = 0; y < v.height; ++y)
                strip.pass(cost.get() + y * row + left, columns, width, planes, levels, total.get() + y * row + left);
            strip.begin();
            for (int y = v.height - 1; y >= 0; --y) {
                uint16_t *sums = total.get() + y * row + left, index[kStrip];
                strip.pass(cost.get() + y * row + left, columns, width, planes, levels, sums);
                best_of(sums, columns, width, planes, index);
                for (int x = 0; x < columns; ++x) {
                    const int d = index[x];
                    const int64_t i = int64_t(y) * width + left + x;
                    const double own = hypotheses.around ? hypotheses.around[i] : 0.0;
                    depth[i] = float(1 / (own + w[d] + gap * offset_of(sums + x, width, d, planes)));
                    cost_at_depth[i] = float(cost[y * row + int64_t(d) * width + left + x]) / levels.one;
                }
            }
        }
    }
}

}  // namespace s4

// Writes depth [H, W] and the unsmoothed mean of the two best costs there [H, W]; see Views for the images.
S4_API void plane_sweep(const float *reference, int32_t height, int32_t width, const float *sources, int32_t count,
                        int32_t source_height, int32_t source_width, const double *homographies, const double *epipoles,
                        const double *inverse_depths, int32_t planes, const float *around, int32_t radius, float floor,
                        float penalty_step, float penalty_jump, int32_t threads, float *depth, float *cost_at_depth) {
    const s4::Views views{reference,     height,       width,        sources, count,
                          source_height, source_width, homographies, epipoles};
    const s4::Hypotheses hypotheses{inverse_depths, planes, around};
    const s4::Levels levels(penalty_step, penalty_jump);
    const s4::Costs cost = s4::match(views, hypotheses, {radius, floor}, levels, threads);
    s4::choose(cost, views, hypotheses, levels, threads, depth, cost_at_depth);
}
