// The C interface: one frame is rendered, perhaps differentiated, and given back for its memory to be used again.
#include "frame.h"

#include <algorithm>
#include <memory>
#include <mutex>

#include "native.h"

namespace {

constexpr size_t kIdleFrames = 4;
std::mutex idle_mutex;
std::vector<std::unique_ptr<s4::Frame>> idle;

std::unique_ptr<s4::Frame> take_frame() {
    const std::lock_guard<std::mutex> lock(idle_mutex);
    if (idle.empty()) return std::make_unique<s4::Frame>();
    std::unique_ptr<s4::Frame> frame = std::move(idle.back());
    idle.pop_back();
    return frame;
}

}  // namespace

// Renders `cloud` into `image` and `radii` [N]; returns the frame that backward and release want. Tiles that are not
// `wanted` (null: all are) stay as the caller hands them in, and Gaussians that touch no other are not seen.
S4_API void *render_forward(const s4::Pinhole *camera, const s4::Cloud *cloud, const s4::Image *image, int32_t *radii,
                            const uint8_t *wanted, int32_t threads) {
    std::unique_ptr<s4::Frame> frame = take_frame();
    frame->camera = *camera;
    frame->tiles_x = (camera->width + s4::kTile - 1) / s4::kTile;
    frame->tiles_y = (camera->height + s4::kTile - 1) / s4::kTile;
    threads = std::max(threads, 1);
    s4::prepare(*frame, *cloud, wanted, threads);
#pragma omp parallel num_threads(threads)
    {
        s4::project(*frame, *cloud, radii);
        s4::sort_and_count(*frame);
        s4::fill_tiles(*frame);
        s4::rasterize(*frame, *image);
    }
    return frame.release();
}

// Fills `out`, but for Gaussians that were culled and the first `given` ones; the caller hands in zeroed memory.
S4_API void render_backward(void *handle, const s4::Cloud *cloud, const s4::ImageGradient *gradient,
                            const s4::CloudGradient *out, int64_t given, int32_t threads) {
    s4::Frame &frame = *static_cast<s4::Frame *>(handle);
    frame.moments.resize(frame.slots);
#pragma omp parallel num_threads(std::max(threads, 1))
    {
        s4::rasterize_backward(frame, *gradient, given);
        s4::project_backward(frame, *cloud, *out, given);
    }
}

S4_API void render_release(void *handle) {
    std::unique_ptr<s4::Frame> frame(static_cast<s4::Frame *>(handle));
    const std::lock_guard<std::mutex> lock(idle_mutex);
    if (idle.size() < kIdleFrames) idle.push_back(std::move(frame));
}
