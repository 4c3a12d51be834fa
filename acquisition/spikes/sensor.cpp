// The integrate-and-fire sensor: charge in fixed point, so no accumulation ever drifts.
//
// Every random number is a hash of (pixel key, tick), so neither threads nor the size of a call change a byte.
#include <algorithm>
#include <cmath>
#include <vector>

#include "draws.h"
#include "native.h"

namespace {

constexpr double kThreshold = 1099511627776.0;  // 2^40 units of charge make a spike
constexpr uint64_t kResetSalt = 0xD6E8FEB86659FD93u;
constexpr int64_t kBlock = 1024;

// `not below` and `not above` in this order turn NaN into 0.
uint64_t units(double charge) {
  charge = charge > 0 ? charge : 0;
  charge = charge < 1 ? charge : 1;
  return uint64_t(int64_t(charge * kThreshold + 0.5));
}

// A number of units that may be negative, to be added.
uint64_t offset(double amount) { return uint64_t(int64_t(std::floor(amount + 0.5))); }

inline void fire(uint64_t* charge, const uint64_t* added, const uint64_t* limit, int64_t pixels, uint8_t* spikes) {
  for (int64_t p = 0; p < pixels; ++p) {
    const uint64_t total = charge[p] + added[p];
    const bool spike = total >= limit[p];
    charge[p] = spike ? total - limit[p] : total;
    spikes[p] = spike;
  }
}

}  // namespace

// Planes of 0 and 1 [n][pixels] from light [n][pixels], spikes per tick, by gain and dark current (spikes per tick) of
// each pixel, shot noise of `electrons` to a spike, and the pixel's own threshold `full`, in units; every reset leaves the
// next one off by `thermal` units (normal). `charge` and `limit`, the threshold that is waited for now, [pixels] carry on.
S4_API void sensor_real(const float* light, int64_t n, int64_t pixels, uint64_t* charge, uint8_t* spikes,
                        int32_t threads, const uint64_t* keys, const double* gain, const double* dark,
                        const uint64_t* full, uint64_t* limit, double electrons, double thermal, int64_t first_tick) {
#pragma omp parallel for num_threads(threads)
  for (int64_t start = 0; start < pixels; start += kBlock) {
    const int64_t count = pixels - start < kBlock ? pixels - start : kBlock;
    uint64_t added[kBlock], bits[kBlock], waiting[kBlock];
    std::copy(limit + start, limit + start + count, waiting);
    for (int64_t t = 0; t < n; ++t) {
      const uint64_t tick = uint64_t(first_tick + t) * kTickStep;
      uint8_t* fired = spikes + t * pixels + start;
      for (int64_t p = 0; p < count; ++p) {
        const double raw = light[t * pixels + start + p], seen = raw > 0 ? raw : 0;
        const double mean = (seen < 1e6 ? seen : 1e6) * gain[start + p] + dark[start + p];
        bits[p] = mix(keys[start + p] + tick);
        added[p] = units(mean + std::sqrt(mean / electrons) * normal(bits[p]));
      }
      fire(charge + start, added, waiting, count, fired);
      for (int64_t p = 0; p < count; ++p)
        if (fired[p]) waiting[p] = full[start + p] + offset(thermal * normal(mix(bits[p] ^ kResetSalt)));
    }
    std::copy(waiting, waiting + count, limit + start);
  }
}
