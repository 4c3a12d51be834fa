// Convex shapes, where a ray enters them and what lies there; included by the ray caster alone.
#pragma once
#include <cmath>
#include <cstdint>
#include <limits>

namespace raycast {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNear = 1e-4, kSlack = 1e-6;
enum Kind { kRectangle, kBox, kSphere, kCylinder };

struct Vec {
  double x, y, z;
};
inline Vec operator+(Vec a, Vec b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec operator-(Vec a, Vec b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vec operator*(double s, Vec a) { return {s * a.x, s * a.y, s * a.z}; }
inline double dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec turn(const double* r, Vec v) {
  return {r[0] * v.x + r[1] * v.y + r[2] * v.z, r[3] * v.x + r[4] * v.y + r[5] * v.z,
          r[6] * v.x + r[7] * v.y + r[8] * v.z};
}
inline Vec turn_back(const double* r, Vec v) {
  return {r[0] * v.x + r[3] * v.y + r[6] * v.z, r[1] * v.x + r[4] * v.y + r[7] * v.z,
          r[2] * v.x + r[5] * v.y + r[8] * v.z};
}

struct Placed {  // one shape at one instant, as one camera sees it
  Kind kind;
  double a, b, c, radius;   // half sizes; bounding radius with slack
  const double *row, *pose;  // shape row; world_from_shape rotation [9]
  Vec position, eye;         // the shape in the world; the camera in the shape
  double cone;               // cosine limit times distance of the pixel test; -inf: always
  uint64_t blockers;         // shapes that may stand between this one and the sun
};

inline double entry_sphere(double a, Vec o, Vec d) {
  const double dd = dot(d, d), od = dot(o, d), disc = od * od - dd * (dot(o, o) - a * a);
  return disc < 0 ? kInfinity : (-od - std::sqrt(disc)) / dd;
}

inline double entry_rectangle(double a, double b, Vec o, Vec d) {
  const double t = -o.z / d.z;
  return std::abs(o.x + t * d.x) <= a && std::abs(o.y + t * d.y) <= b ? t : kInfinity;
}

inline void clip(double h, double o, double d, double& in, double& out) {
  const double s = 1 / d, t0 = (-h - o) * s, t1 = (h - o) * s, low = t0 < t1 ? t0 : t1, high = t0 < t1 ? t1 : t0;
  if (low > in) in = low;
  if (high < out) out = high;
}

inline double entry_box(const Placed& p, Vec o, Vec d) {
  double in = -kInfinity, out = kInfinity;
  clip(p.a, o.x, d.x, in, out);
  clip(p.b, o.y, d.y, in, out);
  clip(p.c, o.z, d.z, in, out);
  return in <= out ? in : kInfinity;
}

inline double entry_cylinder(double radius, double half, Vec o, Vec d) {
  const double dd = d.x * d.x + d.y * d.y, od = o.x * d.x + o.y * d.y, rest = o.x * o.x + o.y * o.y - radius * radius;
  double in = -kInfinity, out = kInfinity;
  if (dd > 0) {
    const double disc = od * od - dd * rest;
    if (disc < 0) return kInfinity;
    const double root = std::sqrt(disc);
    in = (-od - root) / dd;
    out = (-od + root) / dd;
  } else if (rest > 0) {
    return kInfinity;
  }
  clip(half, o.z, d.z, in, out);
  return in <= out ? in : kInfinity;
}

// Where the ray enters the shape, beyond `least`; infinity where it does not. `o` and `d` in the shape's frame.
inline double entry(const Placed& p, Vec o, Vec d, double least) {
  double t = kInfinity;
  switch (p.kind) {
    case kRectangle: t = entry_rectangle(p.a, p.b, o, d); break;
    case kBox: t = entry_box(p, o, d); break;
    case kSphere: t = entry_sphere(p.a, o, d); break;
    case kCylinder: t = entry_cylinder(p.a, p.b, o, d); break;
  }
  return t > least ? t : kInfinity;
}

inline bool misses_sphere(Vec to_center, Vec d, double dd, double radius) {
  const double along = dot(to_center, d);
  return dot(to_center, to_center) * dd - along * along > radius * radius * dd;
}

struct Surface {
  Vec normal;  // outward, in the shape's frame
  double u, v;
  int face;
};

// The largest of three coordinates decides the face; texture coordinates are the two others, in metres.
inline Surface on_face(Vec at, Vec scaled, Vec normal) {
  const double x = std::abs(scaled.x), y = std::abs(scaled.y), z = std::abs(scaled.z);
  if (x >= y && x >= z) return {normal, at.y, at.z, scaled.x > 0 ? 0 : 1};
  if (y >= z) return {normal, at.x, at.z, scaled.y > 0 ? 2 : 3};
  return {normal, at.x, at.y, scaled.z > 0 ? 4 : 5};
}

inline Surface surface(const Placed& p, Vec at) {
  if (p.kind == kRectangle) return {{0, 0, 1}, at.x, at.y, 0};
  if (p.kind == kSphere) return on_face(at, at, (1 / p.a) * at);
  if (p.kind == kBox) {
    Surface s = on_face(at, {at.x / p.a, at.y / p.b, at.z / p.c}, {0, 0, 0});
    const double sign = s.face % 2 ? -1 : 1;
    s.normal = s.face < 2 ? Vec{sign, 0, 0} : s.face < 4 ? Vec{0, sign, 0} : Vec{0, 0, sign};
    return s;
  }
  if (std::abs(at.z) >= p.b * (1 - 1e-9)) return {{0, 0, at.z > 0 ? 1.0 : -1.0}, at.x, at.y, at.z > 0 ? 1 : 2};
  return {{at.x / p.a, at.y / p.a, 0}, std::atan2(at.y, at.x) * p.a, at.z, 0};
}

// Textures [count][size][size], periodic, each level half as wide as the one before and behind it in memory.
struct Pyramid {
  const float* data;
  int64_t count, size;
  int levels;
  const float* image(int index, int level) const {
    const float* start = data;
    for (int l = 0; l < level; ++l) start += count * (size >> l) * (size >> l);
    return start + index * (size >> level) * (size >> level);
  }
};

inline double bilinear(const float* image, int64_t size, double u, double v) {
  const int64_t mask = size - 1;
  const double fu = std::floor(u), fv = std::floor(v), wu = u - fu, wv = v - fv;
  const int64_t x0 = int64_t(fu) & mask, y0 = int64_t(fv) & mask, x1 = (x0 + 1) & mask, y1 = (y0 + 1) & mask;
  const double top = (1 - wu) * image[y0 * size + x0] + wu * image[y0 * size + x1];
  const double bottom = (1 - wu) * image[y1 * size + x0] + wu * image[y1 * size + x1];
  return (1 - wv) * top + wv * bottom;
}

// The texture as rays `spacing` texels apart should see it: between the two levels whose texels are about as wide.
inline double texel(const Pyramid& textures, const double* row, const Surface& s, double spacing) {
  const double shift = 0.37 * double(textures.size) * s.face;  // faces show different parts of the texture
  const double u = s.u * row[5] + row[6] + shift, v = s.v * row[5] + row[7] + shift;
  const int index = int(row[4]);
  if (textures.levels == 1 || spacing <= 1) return bilinear(textures.image(index, 0), textures.size, u, v);
  const int octave = std::ilogb(spacing), last = textures.levels - 1, level = octave < last ? octave : last;
  const auto at = [&](int l) {  // texel centres are whole numbers at every level
    const double scale = 1.0 / double(1 << l);
    return bilinear(textures.image(index, l), textures.size >> l, (u + 0.5) * scale - 0.5, (v + 0.5) * scale - 0.5);
  };
  if (level == last) return at(last);
  const double fine = at(level);
  return fine + (spacing / double(1 << level) - 1) * (at(level + 1) - fine);
}

}  // namespace raycast
