// The loss of one render against its target, and its gradients, in one pass over cells of 32x32 pixels that stay in
// the cache; twin of `picture_loss_reference` in picture.py.
// Letters: x render, y target; mx, my, e, c the windowed means of x, y, (x - y)^2, x y: with the difference instead of
// the squares, rounding leaves equal images at one. Windows are cut at the border and normalised again.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

#include "native.h"

namespace {

constexpr int kCell = 32, kReach = 5, kTaps = 2 * kReach + 1;
constexpr int kWide = kCell + 2 * kReach;  // a cell and all that its windows reach
constexpr int kLine = 48;                  // floats of a stored row of kWide: whole vectors

struct Picture {  // filled by Python
    const float *intensity, *depth, *alpha, *target;  // [H, W]
    const float *empty, *inverse_depth;               // [H, W], or null: nothing is empty, no depth is known
    float *to_intensity, *to_depth, *to_alpha;        // [H, W]: gradients
    double *losses, *squares;                         // [cells], row by row: sums over a cell's pixels
    float *scratch;                                   // [cells, kWide, kLine]
    double white, ssim, solid, shared, hold, most, c1, c2;
    int32_t width, height;
};

struct Taps {
    float of[kTaps];
    Taps() {
        double sum = 0, weight[kTaps];
        for (int k = 0; k < kTaps; ++k) sum += weight[k] = std::exp(-0.5 * (k - kReach) * (k - kReach) / (1.5 * 1.5));
        for (int k = 0; k < kTaps; ++k) of[k] = float(weight[k] / sum);
    }
};
const Taps kTap;

// One over the sum of the taps that fall inside 0 .. size - 1, around each place; zero beyond the end.
std::vector<float> inverse_masses(int size) {
    std::vector<float> out((size + kCell - 1) / kCell * kCell, 0.f);
    for (int i = 0; i < size; ++i) {
        float mass = 0;
        for (int k = 0; k < kTaps; ++k)
            if (i + k - kReach >= 0 && i + k - kReach < size) mass += kTap.of[k];
        out[i] = 1 / mass;
    }
    return out;
}

template <int kCount>
inline void filtered(const float *from, int stride, float *to) {
    float sum[kCount] = {};
    for (int k = 0; k < kTaps; ++k)
#pragma omp simd
        for (int i = 0; i < kCount; ++i) sum[i] += kTap.of[k] * from[i + k * stride];
    std::memcpy(to, sum, sizeof sum);
}

struct Grid {
    int across, down;
    explicit Grid(const Picture &p) : across((p.width + kCell - 1) / kCell), down((p.height + kCell - 1) / kCell) {}
    int cells() const { return across * down; }
};

struct alignas(64) Patch {  // what a thread works with; rows and columns begin kReach before the cell
    float x[kWide][kLine], y[kWide][kLine];
    float rows[4][kWide][kCell];                       // filtered along the rows
    float slopes[3][kWide + kTaps - 1][kCell];         // of the similarity, by mx, e, c; zero around the cell
    float lines[3][kLine + kTaps - 1 + 6];             // slopes filtered down the columns, zero around the cell
    Patch() : x{}, y{}, rows{}, slopes{}, lines{} {}
};

// The render and its target around a cell, zero beyond the picture.
void load(const Picture &p, int x0, int y0, Patch &patch) {
    const int first = std::max(kReach - x0, 0), last = std::min(kWide, p.width - x0 + kReach);
    std::memset(patch.x, 0, sizeof patch.x);
    std::memset(patch.y, 0, sizeof patch.y);
    for (int j = std::max(kReach - y0, 0); j < std::min(kWide, p.height - y0 + kReach); ++j) {
        const int64_t at = int64_t(y0 + j - kReach) * p.width + x0 - kReach + first;
        std::copy_n(p.intensity + at, last - first, patch.x[j] + first);
        std::copy_n(p.target + at, last - first, patch.y[j] + first);
    }
}

void filter_rows(Patch &patch) {
    float a[4][kLine];
    for (int j = 0; j < kWide; ++j) {
        const float *x = patch.x[j], *y = patch.y[j];
#pragma omp simd
        for (int i = 0; i < kLine; ++i) {
            const float difference = x[i] - y[i];
            a[0][i] = x[i], a[1][i] = y[i], a[2][i] = difference * difference, a[3][i] = x[i] * y[i];
        }
        for (int k = 0; k < 4; ++k) filtered<kCell>(a[k], 1, patch.rows[k][j]);
    }
}

// The similarity of row j of a cell, and its slopes, each times `share`.
void compare(const Picture &p, const float *inverse_x, float inverse_y, float share, int j, Patch &patch, float *value) {
    float mean[4][kCell];
    for (int k = 0; k < 4; ++k) filtered<kCell>(patch.rows[k][j], kCell, mean[k]);
    float *sa = patch.slopes[0][j + kTaps - 1], *se = patch.slopes[1][j + kTaps - 1], *sc = patch.slopes[2][j + kTaps - 1];
    const float c1 = float(p.c1), c2 = float(p.c2);
#pragma omp simd
    for (int i = 0; i < kCell; ++i) {
        const float inverse = inverse_x[i] * inverse_y;
        const float mx = mean[0][i] * inverse, my = mean[1][i] * inverse, apart = mx - my, product = 2 * mx * my;
        const float a1 = product + c1, b1 = a1 + apart * apart, a2 = 2 * mean[3][i] * inverse - product + c2;
        const float variances = a2 + (mean[2][i] * inverse - apart * apart);
        const float b2 = variances > 0.5f * c2 ? variances : 0.5f * c2;  // less than c2 is rounding
        const float inverse_b = 1 / (b1 * b2), s = a1 * a2 * inverse_b, by = share * inverse;
        value[i] = inverse > 0 ? s : 0.f;
        sa[i] = by * (2 * my * (a2 - a1) * inverse_b - 2 * mx * s * (b2 - b1) * inverse_b);
        se[i] = by * (-s * b1 * inverse_b);
        sc[i] = by * (2 * (a1 - s * b1) * inverse_b);
    }
}

// From slopes to the gradient of the render around the cell: the windows' adjoint, row by row.
void spread(Patch &patch, float *to) {
    float sums[3][kLine];
    for (int j = 0; j < kWide; ++j) {
        for (int k = 0; k < 3; ++k) {
            filtered<kCell>(patch.slopes[k][j], kCell, patch.lines[k] + kTaps - 1);
            filtered<kLine>(patch.lines[k], 1, sums[k]);
        }
        const float *x = patch.x[j], *y = patch.y[j];
#pragma omp simd
        for (int i = 0; i < kLine; ++i)
            to[j * kLine + i] = sums[0][i] + 2 * (x[i] - y[i]) * sums[1][i] + y[i] * sums[2][i];
    }
}

inline float sign(float x) { return float(x > 0) - float(x < 0); }

struct Sums {
    double loss = 0, square = 0;
};

// The losses of single pixels of a row, and their gradients of depth and alpha; those of the render go to `to`.
Sums pixels(const Picture &p, int64_t at, int count, float weight, const float *x, const float *y, const float *similar,
            float *to) {
    const float light = float(p.shared * (1 - p.ssim) / p.white), through = float(p.shared * p.solid);
    const float alike = float(p.shared * p.ssim), solid = float(p.solid), hold = float(p.hold), most = float(p.most);
    const float none[kCell] = {}, *empty = p.empty ? p.empty + at : none;
    const float *known = p.inverse_depth ? p.inverse_depth + at : none, *alpha = p.alpha + at, *depth = p.depth + at;
    float *to_alpha = p.to_alpha + at, *to_depth = p.to_depth + at, loss = 0, square = 0;
#pragma omp simd reduction(+ : loss, square)
    for (int i = 0; i < count; ++i) {
        const float gap = x[i] - y[i], off = depth[i] * known[i] - alpha[i], far = std::abs(off);
        const float holds = known[i] > 0 ? hold : 0.f, pull = far > most ? 0.f : holds * sign(off);
        const float own = light * std::abs(gap) + alike * (1 - similar[i]) + through * (1 - alpha[i]);
        loss += own + solid * empty[i] * (2 * alpha[i] - 1) + holds * (far < most ? far : most);
        square += gap * gap;
        to[i] += weight * light * sign(gap);
        to_alpha[i] = weight * (2 * solid * empty[i] - through - pull);
        to_depth[i] = weight * pull * known[i];
    }
    return {loss, square};
}

Sums look(const Picture &p, const float *inverse_x, const float *inverse_y, int x0, int y0, float weight, Patch &patch,
          float *to) {
    const int across = std::min(kCell, p.width - x0), down = std::min(kCell, p.height - y0);
    load(p, x0, y0, patch);
    filter_rows(patch);
    float similar[kCell][kCell];
    const float share = -float(p.shared * p.ssim) * weight;
    for (int j = 0; j < kCell; ++j)
        compare(p, inverse_x + x0, inverse_y[y0 + j], share, j, patch, similar[j]);
    spread(patch, to);
    Sums sums;
    for (int j = 0; j < down; ++j) {
        const int row = j + kReach;
        const Sums one = pixels(p, int64_t(y0 + j) * p.width + x0, across, weight, patch.x[row] + kReach,
                                patch.y[row] + kReach, similar[j], to + row * kLine + kReach);
        sums.loss += one.loss, sums.square += one.square;
    }
    return sums;
}

// The render's gradient in a cell: what the cell and those around it have for its pixels.
void assemble(const Picture &p, const Grid &grid, int cell) {
    const int cx = cell % grid.across, cy = cell / grid.across, x0 = cx * kCell, y0 = cy * kCell;
    const int across = std::min(kCell, p.width - x0), down = std::min(kCell, p.height - y0);
    for (int j = 0; j < down; ++j) std::fill_n(p.to_intensity + int64_t(y0 + j) * p.width + x0, across, 0.f);
    for (int ny = std::max(cy - 1, 0); ny <= std::min(cy + 1, grid.down - 1); ++ny)
        for (int nx = std::max(cx - 1, 0); nx <= std::min(cx + 1, grid.across - 1); ++nx) {
            const int near = ny * grid.across + nx;
            const float *from = p.scratch + int64_t(near) * kWide * kLine;
            const int dx = x0 - nx * kCell + kReach, dy = y0 - ny * kCell + kReach;  // of the cell in its neighbour's rows
            const int left = std::max(0, -dx), right = std::min(across, kWide - dx);
            for (int j = std::max(0, -dy); j < std::min(down, kWide - dy); ++j) {
                float *to = p.to_intensity + int64_t(y0 + j) * p.width + x0;
                const float *row = from + (j + dy) * kLine + dx;
#pragma omp simd
                for (int i = left; i < right; ++i) to[i] += row[i];
            }
        }
}

}  // namespace

// Fills the gradients of the mean loss of `picture`, and the sums of its cells.
S4_API void picture_loss(const Picture *picture, int32_t threads) {
    const Picture &p = *picture;
    const Grid grid(p);
    const std::vector<float> inverse_x = inverse_masses(p.width), inverse_y = inverse_masses(p.height);
    const float weight = float(1 / (double(p.width) * p.height));
#pragma omp parallel num_threads(std::max(threads, 1))
    {
        Patch patch;
#pragma omp for schedule(dynamic)
        for (int cell = 0; cell < grid.cells(); ++cell) {
            const int x0 = cell % grid.across * kCell, y0 = cell / grid.across * kCell;
            float *around = p.scratch + int64_t(cell) * kWide * kLine;
            const Sums sums = look(p, inverse_x.data(), inverse_y.data(), x0, y0, weight, patch, around);
            p.losses[cell] = sums.loss, p.squares[cell] = sums.square;
        }
#pragma omp for schedule(static)
        for (int cell = 0; cell < grid.cells(); ++cell) assemble(p, grid, cell);
    }
}
