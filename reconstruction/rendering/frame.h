// One rendered image in the kernels: splats, tile lists in depth order, and the values that backward needs again.
// The stages are called by every thread of a team and share their work among it. A barrier costs a sleep and a wake
// where threads do not spin, so there are as few as can be: `prepare` makes the room before the team starts.
#pragma once
#include <cstdint>
#include <vector>

namespace s4 {

constexpr int kTile = 16;                  // pixels a side: 4x4 blocks of 4x4 pixels
constexpr int kPixels = kTile * kTile;
constexpr int kGroup = 64;                 // splats of a tile between two checkpoints of the transmittance
constexpr float kAlphaMax = 0.99f;
constexpr float kTransmittanceMin = 1e-4f;

struct Pinhole {  // filled by Python: 18 doubles, two int32
    double rotation[9], translation[3], fx, fy, cx, cy, near_m;
    double dilation;  // px^2 added to the projected covariance
    int32_t width, height;
};

struct Cloud {  // [N, 3], [N, 4], [N, 3], [N], [N]
    const float *means, *quats, *log_scales, *opacities, *intensities;
    int64_t count;
};

struct Span {  // tiles a splat may touch, inclusive
    uint16_t x_first, x_last, y_first, y_last;
    int across() const { return x_last - x_first + 1; }
    int64_t tiles() const { return int64_t(across()) * (y_last - y_first + 1); }
};

// A projected Gaussian: alpha = exp(-(u^2 + v^2 + veil)), where that is at least 1/255, with u = p dx + q dy, v = r dy:
// a Cholesky factor of half the conic, so that needles lose nothing to cancellation; veil = -log(opacity).
// Along a column alpha is most at dy = lean_y dx, along a row at dx = lean_x dy.
struct alignas(64) Splat {
    float x, y, p, q, r, veil, intensity, depth, lean_x, lean_y;
    Span span;
    int64_t slot;  // where its per-tile moments start
};
constexpr float kVeilMax = 5.541263545158426f;  // log 255

// Sums over pixels of g = dL/dalpha * alpha: g, g u, g v, g u^2, g u v, g v^2; and dL/dintensity, dL/ddepth.
constexpr int kMoments = 8;
struct Moments {
    float value[kMoments];
};

struct Frame {
    Pinhole camera;
    int tiles_x, tiles_y;
    std::vector<uint8_t> wanted;              // by tile; empty where all are
    std::vector<int32_t> wanted_before;       // [tiles_y + 1, tiles_x + 1]: wanted tiles above and left of a corner
    std::vector<Splat> splats;                // by Gaussian
    std::vector<Span> spans;                  // by Gaussian
    std::vector<int32_t> visible;             // which Gaussians became splats, in their order; visible_count of them
    std::vector<uint64_t> keys, keys_scratch; // depth and Gaussian, as many
    std::vector<int64_t> part_visible, part_slots;  // by thread
    std::vector<int64_t> tile_start;          // [tiles + 1]
    std::vector<int64_t> cursor;
    std::vector<int32_t> entries;             // Gaussians, tile after tile, nearest first
    std::vector<int64_t> group_start;         // [tiles + 1]: groups of kGroup entries in the tiles before
    std::vector<uint64_t> words;              // by group and block: bit k is set where entry k was blended into it
    std::vector<float> checkpoints;           // by group: transmittance of the tile before it
    std::vector<Moments> moments;             // by slot: one a splat and tile
    int64_t visible_count, slots;

    bool wants(int tile) const { return wanted.empty() || wanted[tile]; }
    bool wants(const Span &s) const {  // any tile of it
        if (wanted.empty()) return true;
        const int across = tiles_x + 1, top = s.y_first * across, below = (s.y_last + 1) * across;
        const int left = s.x_first, right = s.x_last + 1;
        return wanted_before[below + right] - wanted_before[below + left] - wanted_before[top + right] +
                   wanted_before[top + left] >
               0;
    }
};

struct Image {
    float *intensity, *depth, *alpha;  // [H, W] each
    float *median;                     // [H, W]: depth of the splat that takes the light to a half; or null, not wanted
};
struct ImageGradient {
    const float *intensity, *depth, *alpha;  // [H, W] each, or null
};
struct CloudGradient {
    float *means, *quats, *log_scales, *opacities, *intensities;
};

void prepare(Frame &frame, const Cloud &cloud, const uint8_t *wanted, int threads);  // before the team
void project(Frame &frame, const Cloud &cloud, int32_t *radii);
void sort_and_count(Frame &frame);
void fill_tiles(Frame &frame);
void rasterize(Frame &frame, const Image &image);
void rasterize_backward(Frame &frame, const ImageGradient &gradient, int64_t given);
void project_backward(const Frame &frame, const Cloud &cloud, const CloudGradient &out, int64_t given);

}  // namespace s4
