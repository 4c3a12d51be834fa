// One rendered image as the kernels see it: splats in depth order, tile lists, and what backward needs again.
#pragma once
#include <cstdint>
#include <vector>

namespace s4 {

constexpr int kTile = 16;                  // pixels a side; one row of a tile is one 512-bit vector
constexpr int kPixels = kTile * kTile;
constexpr int kChunk = 32;                 // splats between two checkpoints of the transmittance
constexpr float kAlphaMax = 0.99f;
constexpr float kTransmittanceMin = 1e-4f;
constexpr double kDilation = 0.3;          // px^2 added to the projected covariance

struct Pinhole {  // the layout Python fills: 17 doubles, two int32
    double rotation[9], translation[3], fx, fy, cx, cy, near_m;
    int32_t width, height;
};

struct Cloud {  // [N, 3], [N, 4], [N, 3], [N], [N]
    const float *means, *quats, *log_scales, *opacities, *intensities;
    int64_t count;
};

// A projected Gaussian. sigma = u^2 + v^2 with u = p dx + q dy, v = r dy: a Cholesky factor of half the conic, so that
// needles lose nothing to cancellation.
struct alignas(64) Splat {
    float x, y, p, q, r, sigma_max, opacity, intensity, depth;
    int32_t x_first, x_last, y_first, y_last;  // pixels whose centre may lie inside, inclusive
    int64_t slot;                              // where its per-tile moments start
    int tiles_across() const { return x_last / kTile - x_first / kTile + 1; }
    int tiles_down() const { return y_last / kTile - y_first / kTile + 1; }
};

// Sums over pixels of g = dL/dalpha * alpha: g, g u, g v, g u^2, g u v, g v^2; and dL/dintensity, dL/ddepth.
constexpr int kMoments = 8;
struct Moments {
    float value[kMoments];
};

struct Frame {
    Pinhole camera;
    int tiles_x, tiles_y;
    std::vector<Splat> projected, splats;     // by Gaussian; in depth order
    std::vector<int32_t> visible;             // which Gaussians became splats, in their order
    std::vector<uint64_t> keys, keys_scratch;
    std::vector<int64_t> tile_start;          // [tiles + 1]
    std::vector<int64_t> cursor;
    std::vector<int32_t> entries;             // splat ranks, tile after tile, nearest first
    std::vector<int64_t> tile_end;            // where a tile became opaque
    std::vector<int64_t> checkpoint_start;    // [tiles + 1], in chunks
    std::vector<float> checkpoints;           // transmittance of a tile before each chunk
    std::vector<Moments> moments;            // by slot: one a splat and tile
    int64_t slots;
};

struct Image {
    float *intensity, *depth, *alpha;  // [H, W] each
};
struct ImageGradient {
    const float *intensity, *depth, *alpha;  // [H, W] each, or null
};
struct CloudGradient {
    float *means, *quats, *log_scales, *opacities, *intensities;
};

void project(Frame &frame, const Cloud &cloud, int32_t *radii, int threads);
void sort_by_depth(Frame &frame);
void bin(Frame &frame, int threads);
void rasterize(Frame &frame, const Image &image, int threads);
void rasterize_backward(Frame &frame, const ImageGradient &gradient, int threads);
void project_backward(const Frame &frame, const Cloud &cloud, const CloudGradient &out, int threads);

}  // namespace s4
