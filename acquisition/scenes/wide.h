// Eight numbers at a time: each operation is that of a single number in every lane, so no bit depends on the packing.
#pragma once
#include <cmath>
#include <cstdint>
#include <limits>

#if defined(__AVX512DQ__)
#include <immintrin.h>
#endif

namespace raycast {

constexpr int kLanes = 8;
typedef double Wide __attribute__((vector_size(8 * kLanes)));
typedef int64_t Mask __attribute__((vector_size(8 * kLanes)));  // of each lane all bits or none

constexpr double kInfinity = std::numeric_limits<double>::infinity();

inline Wide wide(double x) { return Wide{x, x, x, x, x, x, x, x}; }
inline Wide wide(const Wide& x) { return x; }
inline Mask every(int64_t x) { return Mask{x, x, x, x, x, x, x, x}; }
inline Wide pick(const Mask& mask, const Wide& a, const Wide& b) { return mask ? a : b; }
inline Wide pick(const Mask& mask, double a, const Wide& b) { return mask ? wide(a) : b; }
inline Wide pick(const Mask& mask, const Wide& a, double b) { return mask ? a : wide(b); }
inline Wide pick(const Mask& mask, double a, double b) { return mask ? wide(a) : wide(b); }
inline bool any(const Mask& mask) {
#if defined(__AVX512DQ__)
  return _mm512_movepi64_mask((__m512i)mask) != 0;
#else
  int64_t found = 0;
  for (int i = 0; i < kLanes; ++i) found |= mask[i];
  return found != 0;
#endif
}
inline Mask first_lanes(int count) { return Mask{0, 1, 2, 3, 4, 5, 6, 7} < every(count); }

inline Wide root(const Wide& x) {
  Wide y;
  for (int i = 0; i < kLanes; ++i) y[i] = std::sqrt(x[i]);
  return y;
}
inline Wide magnitude(const Wide& x) { return Wide(Mask(x) & every(std::numeric_limits<int64_t>::max())); }
inline Wide rounded_down(const Wide& x) {
  Wide y;
  for (int i = 0; i < kLanes; ++i) y[i] = std::floor(x[i]);
  return y;
}
inline double magnitude(double x) { return std::abs(x); }

// A vector of numbers or of lanes of them.
template <class T>
struct Vec3 {
  T x, y, z;
};
typedef Vec3<double> Vec;
typedef Vec3<Wide> WideVec;

template <class A, class B>
inline auto operator+(const Vec3<A>& a, const Vec3<B>& b) {
  return Vec3<decltype(a.x + b.x)>{a.x + b.x, a.y + b.y, a.z + b.z};
}
template <class A, class B>
inline auto operator-(const Vec3<A>& a, const Vec3<B>& b) {
  return Vec3<decltype(a.x - b.x)>{a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class A, class B>
inline auto operator*(const A& s, const Vec3<B>& a) {
  return Vec3<decltype(s * a.x)>{s * a.x, s * a.y, s * a.z};
}
template <class A, class B>
inline auto dot(const Vec3<A>& a, const Vec3<B>& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <class T>
inline Vec3<T> turn(const double* r, const Vec3<T>& v) {
  return {r[0] * v.x + r[1] * v.y + r[2] * v.z, r[3] * v.x + r[4] * v.y + r[5] * v.z,
          r[6] * v.x + r[7] * v.y + r[8] * v.z};
}
template <class T>
inline Vec3<T> turn_back(const double* r, const Vec3<T>& v) {
  return {r[0] * v.x + r[3] * v.y + r[6] * v.z, r[1] * v.x + r[4] * v.y + r[7] * v.z,
          r[2] * v.x + r[5] * v.y + r[8] * v.z};
}
inline WideVec pick(const Mask& mask, const WideVec& a, const WideVec& b) {
  return {pick(mask, a.x, b.x), pick(mask, a.y, b.y), pick(mask, a.z, b.z)};
}

}  // namespace raycast
