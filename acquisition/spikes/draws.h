// Random numbers of the sensor: each is a hash, so neither threads nor the size of a call change one.
#pragma once
#include <cstdint>

constexpr uint64_t kTickStep = 0x9E3779B97F4A7C15u;

inline uint64_t mix(uint64_t x) {  // the finaliser of SplitMix64
  x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9u;
  x = (x ^ (x >> 27)) * 0x94D049BB133111EBu;
  return x ^ (x >> 31);
}

// About normal, mean 0 and variance 1: the sum of four 16-bit uniform numbers.
inline double normal(uint64_t bits) {
  const int64_t sum = int64_t(bits & 65535) + int64_t((bits >> 16) & 65535) + int64_t((bits >> 32) & 65535) +
                      int64_t(bits >> 48);
  return (double(sum) - 131070.0) * 2.6428997921e-5;
}
