// Costs of plane hypotheses: every source warped by the plane, ZNCC over square windows, the two best sources kept.
// A plane is met row by row; per source the sums over the rows of a window are kept for each column, and the last rows,
// so that everything stays in the cache.
#include <cmath>
#include <cstring>
#include <vector>

#include "sweep.h"

namespace s4 {
namespace {

using Pair = float __attribute__((vector_size(8)));  // two neighbours of a row
constexpr float kUnseen = 1;  // the cost where a source sees nothing
constexpr int kStripRows = 64;

struct Reference {  // [H, W] each; the window is clipped at the border
    std::vector<float> mean, inverse_area, inverse_spread;
};

struct Line {  // one row of a source as the reference sees it through a plane
    std::vector<float> value, seen;
};

struct Source {  // what is known of a source around the row at work; columns have `radius` zeros at both ends
    std::vector<Line> lines;
    std::vector<float> sum, squares, products;
};

struct Scratch {
    std::vector<Source> sources;
    std::vector<float> fx, fy, pairs, sum, squares, products, best, second;
    std::vector<int32_t> at;
    Scratch(const Views &v, int radius)
        : sources(v.count), fx(v.width), fy(v.width), pairs(2 * v.width), sum(v.width),
          squares(v.width), products(v.width), best(v.width), second(v.width), at(v.width) {
        for (Source &s : sources)
            s.lines.assign(2 * radius + 1, {std::vector<float>(v.width), std::vector<float>(v.width)});
    }
};

// Where row y of the reference falls in a source, by the plane at inverse depth w, on top of `around` [W] for each pixel:
// x_s ~ K_s (R + t n^T w) K_r^-1 x_r.
template <bool bent>
void locate(const Views &views, int source, double w, const float *around, int y, Scratch &s, Line &line) {
    const double *h = views.homographies + 9 * source, *e = views.epipoles + 3 * source;
    const double v = y + 0.5;
    const float a0 = float(h[1] * v + h[2] + e[0] * w), b0 = float(h[4] * v + h[5] + e[1] * w);
    const float c0 = float(h[7] * v + h[8] + e[2] * w), a1 = float(h[0]), b1 = float(h[3]), c1 = float(h[6]);
    const float ea = float(e[0]), eb = float(e[1]), ec = float(e[2]);
    const float right = float(views.source_width - 1), bottom = float(views.source_height - 1);
    const int stride = views.source_width, width = views.width;
    float *fx = s.fx.data(), *fy = s.fy.data(), *seen = line.seen.data();
    int32_t *at = s.at.data();
#pragma omp simd
    for (int x = 0; x < width; ++x) {
        const float u = float(x) + 0.5f;
        float a = a0 + a1 * u, b = b0 + b1 * u, c = c0 + c1 * u;
        if constexpr (bent) a += ea * around[x], b += eb * around[x], c += ec * around[x];
        const float ahead = c > 1e-6f ? c : 1, scale = 1 / ahead;
        const float sx = a * scale - 0.5f, sy = b * scale - 0.5f;
        float inside = c > 1e-6f ? 1 : 0;  // one comparison at a time, so that no branch keeps the loop from vectors
        inside = sx >= 0 ? inside : 0;
        inside = sy >= 0 ? inside : 0;
        inside = sx < right ? inside : 0;
        inside = sy < bottom ? inside : 0;
        const float px = inside > 0 ? sx : 0, py = inside > 0 ? sy : 0;
        const int ix = int(px), iy = int(py);
        fx[x] = px - float(ix), fy[x] = py - float(iy);
        seen[x] = inside;
        at[x] = iy * stride + ix;
    }
}

void warp(const Views &views, int source, Scratch &s, Line &line) {
    const float *image = views.sources + int64_t(source) * views.source_height * views.source_width;
    // A source of one row or column sees nothing, and has no neighbours to read.
    const int down = views.source_width, width = views.width;
    if (std::min(views.source_height, views.source_width) < 2) {
        std::fill(line.value.begin(), line.value.end(), 0.f);
        return;
    }
    float *pairs = s.pairs.data(), *value = line.value.data();
    const float *fx = s.fx.data(), *fy = s.fy.data(), *seen = line.seen.data();
    const int32_t *at = s.at.data();
    for (int x = 0; x < width; ++x) {
        Pair above, below;
        std::memcpy(&above, image + at[x], sizeof above);
        std::memcpy(&below, image + at[x] + down, sizeof below);
        above += fy[x] * (below - above);
        std::memcpy(pairs + 2 * x, &above, sizeof above);
    }
#pragma omp simd
    for (int x = 0; x < width; ++x) {
        const float left = pairs[2 * x], right = pairs[2 * x + 1];
        value[x] = seen[x] > 0 ? left + fx[x] * (right - left) : 0;
    }
}

// Adds a row to the columns' sums, or takes it away.
void gather(const Line &line, const float *reference, float sign, int width, int radius, Source &to) {
    const float *value = line.value.data();
    float *sum = to.sum.data() + radius, *squares = to.squares.data() + radius, *products = to.products.data() + radius;
#pragma omp simd
    for (int x = 0; x < width; ++x) {
        const float signed_value = sign * value[x];
        sum[x] += signed_value;
        squares[x] += signed_value * value[x];
        products[x] += signed_value * reference[x];
    }
}

template <int N>
inline float run(const float *columns) {
    if constexpr (N == 1)
        return *columns;
    else
        return run<N / 2>(columns) + run<N - N / 2>(columns + N / 2);
}

// Sums over windows of 2 radius + 1 columns, one a pixel.
void across(const std::vector<float> &columns, int radius, std::vector<float> &to) {
    const float *from = columns.data();
    float *out = to.data();
    const int width = int(to.size());
    if (radius == 3) {
#pragma omp simd
        for (int x = 0; x < width; ++x) out[x] = run<7>(from + x);
        return;
    }
    if (radius == 2) {
#pragma omp simd
        for (int x = 0; x < width; ++x) out[x] = run<5>(from + x);
        return;
    }
    std::fill(to.begin(), to.end(), 0.f);
    for (int k = 0; k <= 2 * radius; ++k)
        for (int x = 0; x < width; ++x) out[x] += from[x + k];
}

// Costs of one source in one row into the best two of each pixel.
void score(const Source &source, const float *seen, const Reference &ref, int64_t row, float floor, int radius,
           Scratch &s) {
    across(source.sum, radius, s.sum);
    across(source.squares, radius, s.squares);
    across(source.products, radius, s.products);
    const float *sum = s.sum.data(), *squares = s.squares.data(), *products = s.products.data();
    const float *area = ref.inverse_area.data() + row, *ref_mean = ref.mean.data() + row;
    const float *spread = ref.inverse_spread.data() + row;
    float *best = s.best.data(), *second = s.second.data();
    const int width = int(s.best.size());
#pragma omp simd
    for (int x = 0; x < width; ++x) {
        const float mean = sum[x] * area[x];
        const float variance = squares[x] * area[x] - mean * mean;
        const float covariance = products[x] * area[x] - mean * ref_mean[x];
        const float zncc = covariance * spread[x] / std::sqrt((variance > 0 ? variance : 0) + floor * floor);
        const float cost = seen[x] > 0 ? 1 - zncc : kUnseen;
        const float worse = cost > best[x] ? cost : best[x];
        second[x] = worse < second[x] ? worse : second[x];
        best[x] = cost < best[x] ? cost : best[x];
    }
}

Reference prepare(const Views &v, int radius, float floor) {
    const int64_t pixels = int64_t(v.height) * v.width;
    Reference ref{std::vector<float>(pixels), std::vector<float>(pixels), std::vector<float>(pixels)};
    std::vector<double> sums(v.width + 2 * radius), squares(v.width + 2 * radius);
    for (int y = 0; y < v.height; ++y) {
        const int top = std::max(0, y - radius), bottom = std::min(v.height - 1, y + radius);
        for (int x = 0; x < v.width; ++x) {
            double sum = 0, square = 0;
            for (int j = top; j <= bottom; ++j) {
                const double value = v.reference[int64_t(j) * v.width + x];
                sum += value, square += value * value;
            }
            sums[x + radius] = sum, squares[x + radius] = square;
        }
        for (int x = 0; x < v.width; ++x) {
            const int columns = std::min(v.width - 1, x + radius) - std::max(0, x - radius) + 1;
            double sum = 0, square = 0;
            for (int k = 0; k <= 2 * radius; ++k) sum += sums[x + k], square += squares[x + k];
            const int64_t i = int64_t(y) * v.width + x;
            const double area = double(columns) * (bottom - top + 1), mean = sum / area;
            ref.mean[i] = float(mean);
            ref.inverse_area[i] = float(1 / area);
            const double variance = std::max(0.0, square / area - mean * mean);
            ref.inverse_spread[i] = float(1 / std::sqrt(variance + double(floor) * floor));
        }
    }
    return ref;
}

// Costs of hypothesis d in rows [first, last).
void match_plane(const Views &v, const Reference &ref, const Hypotheses &hypotheses, int d, int first, int last,
                 const Window &window, Scratch &s, const Levels &levels, uint16_t *cost, int64_t stride) {
    const int radius = window.radius, rows = 2 * radius + 1, begin = std::max(0, first - radius);
    const double inverse_depth = hypotheses.inverse_depths[d];
    for (Source &source : s.sources)
        for (auto *sums : {&source.sum, &source.squares, &source.products}) sums->assign(v.width + 2 * radius, 0.f);
    for (int y = begin; y < last + radius; ++y) {  // the row that enters the window of row y - radius
        const int64_t entering = int64_t(y) * v.width, middle = int64_t(y - radius) * v.width;
        std::fill(s.best.begin(), s.best.end(), kUnseen);
        std::fill(s.second.begin(), s.second.end(), kUnseen);
        for (int k = 0; k < v.count; ++k) {
            Source &source = s.sources[k];
            Line &line = source.lines[y % rows];
            if (y >= begin + rows)
                gather(line, v.reference + int64_t(y - rows) * v.width, -1, v.width, radius, source);
            if (y < v.height) {
                if (hypotheses.around)
                    locate<true>(v, k, inverse_depth, hypotheses.around + entering, y, s, line);
                else
                    locate<false>(v, k, inverse_depth, nullptr, y, s, line);
                warp(v, k, s, line);
                gather(line, v.reference + entering, 1, v.width, radius, source);
            }
            if (y < first + radius) continue;
            const float *seen = source.lines[(y - radius) % rows].seen.data();
            score(source, seen, ref, middle, window.floor, radius, s);
        }
        if (y < first + radius) continue;
        const float half = 0.5f * levels.one;
        uint16_t *out = cost + (y - radius) * stride;
        for (int x = 0; x < v.width; ++x) out[x] = uint16_t(int32_t(half * (s.best[x] + s.second[x]) + 0.5f));
    }
}

}  // namespace

Costs match(const Views &views, const Hypotheses &hypotheses, const Window &window, const Levels &levels, int threads) {
    const int planes = hypotheses.planes;
    const int64_t stride = int64_t(planes) * views.width;
    Costs cost(new uint16_t[views.height * stride]);
    const Reference ref = prepare(views, window.radius, window.floor);
    // A few hypotheses are cut into strips of rows, so that there is work for every thread.
    const int strip = hypotheses.around ? kStripRows : views.height, strips = (views.height + strip - 1) / strip;
#pragma omp parallel num_threads(threads) if (threads > 1)
    {
        Scratch scratch(views, window.radius);
#pragma omp for schedule(dynamic)
        for (int task = 0; task < planes * strips; ++task) {
            const int d = task / strips, first = task % strips * strip, last = std::min(first + strip, views.height);
            match_plane(views, ref, hypotheses, d, first, last, window, scratch, levels,
                        cost.get() + int64_t(d) * views.width, stride);
        }
    }
    return cost;
}

}  // namespace s4
