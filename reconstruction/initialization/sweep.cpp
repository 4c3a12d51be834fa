// Plane sweep of one reference view: ZNCC over square windows against several sources, best two kept, four-path
// semi-global smoothing, sub-plane parabola. Depth hypotheses are uniform in inverse depth.
//
// Letters: H rows, W columns, D inverse depths, S sources. Cost is 1 - ZNCC in [0, 2]; 1 where a source sees nothing.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

#include "native.h"

namespace {

constexpr float UNSEEN = 1.0f;

// Sums over a (2r+1)^2 window, clipped at the border, of `in` into `out`; `column` is scratch of one row.
void box_sum(const float* in, int height, int width, int r, float* out, std::vector<float>& column) {
  column.assign(width, 0.0f);
  for (int y = 0; y < std::min(r, height); ++y)
    for (int x = 0; x < width; ++x) column[x] += in[y * width + x];
  for (int y = 0; y < height; ++y) {
    if (y + r < height)
      for (int x = 0; x < width; ++x) column[x] += in[(y + r) * width + x];
    if (y - r - 1 >= 0)
      for (int x = 0; x < width; ++x) column[x] -= in[(y - r - 1) * width + x];
    float sum = 0;
    for (int x = 0; x < std::min(r, width); ++x) sum += column[x];
    for (int x = 0; x < width; ++x) {
      if (x + r < width) sum += column[x + r];
      if (x - r - 1 >= 0) sum -= column[x - r - 1];
      out[y * width + x] = sum;
    }
  }
}

// Warps `source` into the reference by the plane at inverse depth w: x_s ~ K_s (R + t n^T w) K_r^-1 x_r.
// `h` is H0 = K_s R K_r^-1 (nine numbers) and `e` = K_s t; the plane is fronto-parallel to the reference.
void warp(const float* source, int height, int width, const double* h, const double* e, double w, int ref_height,
          int ref_width, float* out, float* seen) {
  for (int y = 0; y < ref_height; ++y) {
    const float v = y + 0.5f;
    const float a0 = float(h[1] * v + h[2] + e[0] * w), b0 = float(h[4] * v + h[5] + e[1] * w),
                c0 = float(h[7] * v + h[8] + e[2] * w);
    const float a1 = float(h[0]), b1 = float(h[3]), c1 = float(h[6]);
    for (int x = 0; x < ref_width; ++x) {
      const float u = x + 0.5f, c = c0 + c1 * u, scale = c > 1e-6f ? 1.0f / c : 0.0f;
      const float sx = (a0 + a1 * u) * scale - 0.5f, sy = (b0 + b1 * u) * scale - 0.5f;
      const bool inside = scale > 0 && sx >= 0 && sy >= 0 && sx < float(width - 1) && sy < float(height - 1);
      const int ix = inside ? int(sx) : 0, iy = inside ? int(sy) : 0;
      const float fx = sx - ix, fy = sy - iy;
      const float* p = source + iy * width + ix;
      const int right = inside ? 1 : 0, down = inside ? width : 0;
      const float value = (p[0] * (1 - fx) + p[right] * fx) * (1 - fy) + (p[down] * (1 - fx) + p[down + right] * fx) * fy;
      out[y * ref_width + x] = inside ? value : 0.0f;
      seen[y * ref_width + x] = inside ? 1.0f : 0.0f;
    }
  }
}

struct Reference {
  const float* image;
  int height, width, radius;
  std::vector<float> mean, deviation, area;  // over the window, unclipped at the border by `area`
};

struct Scratch {
  std::vector<float> warped, seen, product, sum, sum_squares, sum_product, column, best, second;
  explicit Scratch(int pixels)
      : warped(pixels), seen(pixels), product(pixels), sum(pixels), sum_squares(pixels), sum_product(pixels),
        best(pixels), second(pixels) {}
};

Reference prepare(const float* image, int height, int width, int radius) {
  const int pixels = height * width;
  Reference ref{image, height, width, radius, std::vector<float>(pixels), std::vector<float>(pixels),
                std::vector<float>(pixels)};
  std::vector<float> ones(pixels, 1.0f), squares(pixels), sum(pixels), sum_squares(pixels), column;
  for (int i = 0; i < pixels; ++i) squares[i] = image[i] * image[i];
  box_sum(ones.data(), height, width, radius, ref.area.data(), column);
  box_sum(image, height, width, radius, sum.data(), column);
  box_sum(squares.data(), height, width, radius, sum_squares.data(), column);
  for (int i = 0; i < pixels; ++i) {
    ref.mean[i] = sum[i] / ref.area[i];
    ref.deviation[i] = std::sqrt(std::max(0.0f, sum_squares[i] / ref.area[i] - ref.mean[i] * ref.mean[i]));
  }
  return ref;
}

// Costs of one source at one plane into best and second best of each pixel. A window that leaves the source is unseen.
void match(const Reference& ref, float floor, Scratch& s) {
  const int pixels = ref.height * ref.width, h = ref.height, w = ref.width, r = ref.radius;
  box_sum(s.warped.data(), h, w, r, s.sum.data(), s.column);
  for (int i = 0; i < pixels; ++i) s.product[i] = s.warped[i] * s.warped[i];
  box_sum(s.product.data(), h, w, r, s.sum_squares.data(), s.column);
  for (int i = 0; i < pixels; ++i) s.product[i] = s.warped[i] * ref.image[i];
  box_sum(s.product.data(), h, w, r, s.sum_product.data(), s.column);
  for (int i = 0; i < pixels; ++i) {
    const float mean = s.sum[i] / ref.area[i];
    const float variance = std::max(0.0f, s.sum_squares[i] / ref.area[i] - mean * mean);
    const float covariance = s.sum_product[i] / ref.area[i] - mean * ref.mean[i];
    // `floor` keeps noise on flat patches from looking like texture
    const float zncc = covariance / (std::sqrt(variance + floor * floor) * std::sqrt(ref.deviation[i] * ref.deviation[i] + floor * floor));
    const float cost = s.seen[i] > 0 ? 1.0f - zncc : UNSEEN + 1.0f;
    const float second = std::min(std::max(cost, s.best[i]), s.second[i]);
    s.best[i] = std::min(cost, s.best[i]);
    s.second[i] = second;
  }
}

// One path of semi-global matching along `step` pixels, added to `total` [H, W, D].
void smooth_line(const float* cost, int64_t start, int64_t step, int length, int planes, float p1, float p2,
                 float* total, std::vector<float>& previous, std::vector<float>& current) {
  float lowest = 0;
  std::fill(previous.begin(), previous.end(), 0.0f);
  for (int i = 0; i < length; ++i) {
    const float* c = cost + (start + i * step) * planes;
    float* sum = total + (start + i * step) * planes;
    float next_lowest = 1e30f;
    const float jump = lowest + p2;
    for (int d = 0; d < planes; ++d) {
      const float below = previous[d] + p1, above = previous[d + 2] + p1;
      const float best = std::min(std::min(previous[d + 1], jump), std::min(below, above));
      const float value = c[d] + best - lowest;
      current[d + 1] = value;
      sum[d] += value;
      next_lowest = std::min(next_lowest, value);
    }
    current[0] = current[planes + 1] = 1e30f;
    lowest = next_lowest;
    std::swap(previous, current);
  }
}

void smooth(const float* cost, int height, int width, int planes, float p1, float p2, float* total) {
  struct Line { int64_t start, step; int length; };
  const int64_t w = width, last = int64_t(height - 1) * width;
  for (int pass = 0; pass < 4; ++pass) {  // right, left, down, up: lines of one pass touch different pixels
    const int lines = pass < 2 ? height : width;
#pragma omp parallel
    {
      std::vector<float> previous(planes + 2), current(planes + 2);
#pragma omp for schedule(static)
      for (int i = 0; i < lines; ++i) {
        const Line line = pass == 0   ? Line{i * w, 1, width}
                          : pass == 1 ? Line{i * w + w - 1, -1, width}
                          : pass == 2 ? Line{i, w, height}
                                      : Line{last + i, -w, height};
        smooth_line(cost, line.start, line.step, line.length, planes, p1, p2, total, previous, current);
      }
    }
  }
}

}  // namespace

// images: reference [H, W] and sources [S, Hs, Ws]; homographies [S, 9], epipoles [S, 3] (see warp);
// inverse_depths [D]. Writes depth [H, W] and the unsmoothed mean of the two best costs there [H, W].
S4_API void plane_sweep(const float* reference, int32_t height, int32_t width, const float* sources, int32_t count,
                        int32_t source_height, int32_t source_width, const double* homographies, const double* epipoles,
                        const double* inverse_depths, int32_t planes, int32_t radius, float floor, float p1, float p2,
                        float* depth, float* cost_at_depth) {
  const int64_t pixels = int64_t(height) * width;
  const Reference ref = prepare(reference, height, width, radius);
  std::vector<float> cost(pixels * planes), total(pixels * planes, 0.0f);
#pragma omp parallel
  {
    Scratch s(static_cast<int>(pixels));
#pragma omp for schedule(dynamic)
    for (int d = 0; d < planes; ++d) {
      std::fill(s.best.begin(), s.best.end(), UNSEEN + 1.0f);
      std::fill(s.second.begin(), s.second.end(), UNSEEN + 1.0f);
      for (int k = 0; k < count; ++k) {
        warp(sources + int64_t(k) * source_height * source_width, source_height, source_width, homographies + 9 * k,
             epipoles + 3 * k, inverse_depths[d], height, width, s.warped.data(), s.seen.data());
        match(ref, floor, s);
      }
      for (int64_t i = 0; i < pixels; ++i) {
        const float best = std::min(s.best[i], UNSEEN), second = std::min(s.second[i], UNSEEN);
        cost[i * planes + d] = 0.5f * (best + second);
      }
    }
  }
  smooth(cost.data(), height, width, planes, p1, p2, total.data());
#pragma omp parallel for schedule(static)
  for (int64_t i = 0; i < pixels; ++i) {
    const float* t = &total[i * planes];
    const int d = static_cast<int>(std::min_element(t, t + planes) - t);
    double offset = 0;
    if (d > 0 && d + 1 < planes) {
      const double bend = t[d - 1] - 2.0 * t[d] + t[d + 1];
      if (bend > 1e-12) offset = std::clamp(0.5 * (t[d - 1] - t[d + 1]) / bend, -0.5, 0.5);
    }
    const double step = planes > 1 ? inverse_depths[1] - inverse_depths[0] : 0;
    depth[i] = static_cast<float>(1.0 / (inverse_depths[d] + offset * step));
    cost_at_depth[i] = cost[i * planes + d];
  }
}
