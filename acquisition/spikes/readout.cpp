// How light reaches the pixels: rows that are read early or late, and saturated pixels that overflow.
#include <algorithm>
#include <vector>

#include "draws.h"
#include "native.h"

namespace {

// By how many ticks row `key` is read late at `tick`.
double late(uint64_t key, int64_t tick, double jitter) { return jitter * normal(mix(key + uint64_t(tick) * kTickStep)); }

// What overflows from `level` [height][width] is cut off; a `share` goes on to the neighbours, `reach` times.
void bloom(std::vector<double>& level, int64_t height, int64_t width, double share, int32_t reach) {
  const int64_t pixels = height * width;
  std::vector<double> over(pixels), next(pixels);
  bool any = false;
  for (int64_t p = 0; p < pixels; ++p) {
    over[p] = level[p] > 1 ? level[p] - 1 : 0;
    any |= over[p] > 0;
  }
  for (int32_t pass = 0; any && pass < reach; ++pass) {
    any = false;
    for (int64_t y = 0; y < height; ++y)
      for (int64_t x = 0; x < width; ++x) {
        const int64_t p = y * width + x;
        double around = y > 0 ? over[p - width] : 0;
        around += y + 1 < height ? over[p + width] : 0;
        around += x > 0 ? over[p - 1] : 0;
        around += x + 1 < width ? over[p + 1] : 0;
        const double got = share * 0.25 * around, held = level[p] > 1 ? level[p] : 1;
        level[p] += got;
        next[p] = level[p] > held ? level[p] - held : 0;
        any |= next[p] > 0;
      }
    std::swap(over, next);
  }
}

}  // namespace

// Light that reaches the pixels [n][height][width] from light in front of them, spikes per tick. Row r draws by keys[r].
S4_API void sensor_readout(const float* light, int64_t n, int64_t height, int64_t width, int64_t first_tick,
                           const uint64_t* keys, double jitter, double share, int32_t reach, float* reached,
                           int32_t threads) {
#pragma omp parallel for num_threads(threads)
  for (int64_t t = 0; t < n; ++t) {
    const int64_t start = t * height * width;
    std::vector<double> level(height * width);
    for (int64_t y = 0; y < height; ++y) {
      const int64_t tick = first_tick + t;
      const double wanted = 1 + (late(keys[y], tick, jitter) - late(keys[y], tick - 1, jitter));
      const double lasts = wanted > 0 ? wanted : 0;
      for (int64_t x = 0; x < width; ++x) {
        const double raw = light[start + y * width + x], seen = raw > 0 ? raw : 0;
        level[y * width + x] = (seen < 1e6 ? seen : 1e6) * lasts;
      }
    }
    if (share > 0) bloom(level, height, width, share, reach);
    for (int64_t p = 0; p < height * width; ++p) reached[start + p] = float(level[p]);
  }
}
