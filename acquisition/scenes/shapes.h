// Convex shapes, where rays enter them and what lies there; included by the ray caster alone.
#pragma once
#include <vector>

#include "scenes/wide.h"

namespace raycast {

constexpr double kNear = 1e-4, kSlack = 1e-6;
enum Kind { kRectangle, kBox, kSphere, kCylinder };

struct Placed {  // one shape at one instant, as one camera sees it
  Kind kind;
  double a, b, c, radius;    // half sizes; bounding radius with slack
  const double *row, *pose;  // shape row; world_from_shape rotation [9]
  Vec position, eye;         // the shape in the world; the camera in the shape
  double cone;               // cosine limit times distance of the pixel test; -inf: always
  uint64_t blockers;         // shapes that may stand between this one and the sun
  Vec half;                  // of the box around it along its own axes, with slack
  Vec sunward, reach;        // middle and half size of its box across the sun's direction (x, y) and towards the sun (z)
};

// Origins and directions are of numbers or of lanes, at least one of them of lanes.
template <class O, class D>
inline Wide entry_sphere(double a, const Vec3<O>& o, const Vec3<D>& d) {
  const auto dd = dot(d, d);
  const Wide od = dot(o, d), disc = od * od - dd * (dot(o, o) - a * a);
  return pick(disc < 0, kInfinity, (-od - root(disc)) / dd);
}

template <class O, class D>
inline Wide entry_rectangle(double a, double b, const Vec3<O>& o, const Vec3<D>& d) {
  const Wide t = -o.z / d.z;
  return pick((magnitude(o.x + t * d.x) <= a) & (magnitude(o.y + t * d.y) <= b), t, kInfinity);
}

template <class O, class D>
inline void clip(double h, const O& o, const D& d, Wide& in, Wide& out) {
  const auto s = 1 / d;
  const Wide t0 = (-h - o) * s, t1 = (h - o) * s;
  const Wide low = pick(t0 < t1, t0, t1), high = pick(t0 < t1, t1, t0);
  in = pick(low > in, low, in);
  out = pick(high < out, high, out);
}

template <class O, class D>
inline Wide entry_box(const Placed& p, const Vec3<O>& o, const Vec3<D>& d) {
  Wide in = wide(-kInfinity), out = wide(kInfinity);
  clip(p.a, o.x, d.x, in, out);
  clip(p.b, o.y, d.y, in, out);
  clip(p.c, o.z, d.z, in, out);
  return pick(in <= out, in, kInfinity);
}

template <class O, class D>
inline Wide entry_cylinder(double radius, double half, const Vec3<O>& o, const Vec3<D>& d) {
  const Wide dd = wide(d.x * d.x + d.y * d.y), od = o.x * d.x + o.y * d.y;
  const Wide rest = wide(o.x * o.x + o.y * o.y - radius * radius), disc = od * od - dd * rest, edge = root(disc);
  const Mask slanted = dd > 0, misses = (slanted & (disc < 0)) | (~slanted & (rest > 0));
  Wide in = pick(slanted, (-od - edge) / dd, -kInfinity), out = pick(slanted, (-od + edge) / dd, kInfinity);
  clip(half, o.z, d.z, in, out);
  return pick(~misses & (in <= out), in, kInfinity);
}

// Where rays enter the shape, beyond `least`; infinity where they do not. `o` and `d` in the shape's frame.
template <class O, class D>
inline Wide entry(const Placed& p, const Vec3<O>& o, const Vec3<D>& d, double least) {
  Wide t = wide(kInfinity);
  switch (p.kind) {
    case kRectangle: t = entry_rectangle(p.a, p.b, o, d); break;
    case kBox: t = entry_box(p, o, d); break;
    case kSphere: t = entry_sphere(p.a, o, d); break;
    case kCylinder: t = entry_cylinder(p.a, p.b, o, d); break;
  }
  return pick(t > least, t, kInfinity);
}

template <class C, class D, class S>
inline Mask misses_sphere(const Vec3<C>& to_center, const Vec3<D>& d, const S& dd, double radius) {
  const Wide along = dot(to_center, d);
  return dot(to_center, to_center) * dd - along * along > wide(radius * radius * dd);
}

struct Surface {
  WideVec normal;  // outward, in the shape's frame
  Wide u, v, face;
};

// The largest of three coordinates decides the face; texture coordinates are the two others, in metres.
inline Surface on_face(const WideVec& at, const WideVec& scaled, const WideVec& normal) {
  const Wide x = magnitude(scaled.x), y = magnitude(scaled.y), z = magnitude(scaled.z);
  const Mask first = (x >= y) & (x >= z), second = ~first & (y >= z);
  const Wide deep = pick(scaled.z > 0, 4.0, 5.0), high = pick(scaled.y > 0, 2.0, 3.0);
  const Wide face = pick(first, pick(scaled.x > 0, 0.0, 1.0), pick(second, high, deep));
  return {normal, pick(first, at.y, at.x), pick(first | second, at.z, at.y), face};
}

inline Surface on_box(const Placed& p, const WideVec& at) {
  const Wide none = wide(0);
  Surface s = on_face(at, {at.x / p.a, at.y / p.b, at.z / p.c}, {none, none, none});
  const Mask odd = (s.face == 1) | (s.face == 3) | (s.face == 5);
  const Wide sign = pick(odd, -1.0, 1.0);
  const Mask first = s.face < 2, last = s.face >= 4;
  s.normal = {pick(first, sign, 0.0), pick(~first & ~last, sign, 0.0), pick(last, sign, 0.0)};
  return s;
}

inline Surface on_cylinder(const Placed& p, const WideVec& at) {
  const Mask end = magnitude(at.z) >= p.b * (1 - 1e-9);
  const Wide none = wide(0);
  Wide around = at.x;
  for (int i = 0; i < kLanes; ++i)
    if (!end[i]) around[i] = std::atan2(at.y[i], at.x[i]) * p.a;
  const WideVec outward{at.x / p.a, at.y / p.a, none}, along{none, none, pick(at.z > 0, 1.0, -1.0)};
  return {pick(end, along, outward), around, pick(end, at.y, at.z), pick(end, pick(at.z > 0, 1.0, 2.0), none)};
}

inline Surface surface(const Placed& p, const WideVec& at) {
  switch (p.kind) {
    case kSphere: return on_face(at, at, (1 / p.a) * at);
    case kBox: return on_box(p, at);
    case kCylinder: return on_cylinder(p, at);
    default: return {{wide(0), wide(0), wide(1)}, at.x, at.y, wide(0)};
  }
}

// Textures [count][size][size], periodic, each level half as wide as the one before and behind it in memory.
struct Pyramid {
  const float* data;
  int64_t size;
  int levels;
  std::vector<int64_t> starts;  // of texture i at level l: number i levels + l

  Pyramid(const float* texels, int64_t count, int64_t texels_a_side, int level_count)
      : data(texels), size(texels_a_side), levels(level_count) {
    for (int64_t i = 0; i < count; ++i)
      for (int64_t l = 0, from = 0; l < levels; ++l) {
        starts.push_back(from + i * (size >> l) * (size >> l));
        from += count * (size >> l) * (size >> l);
      }
  }

  // Where the image of a texture begins at the level of each lane.
  Mask images(int index, const Mask& level) const {
    const int64_t* own = starts.data() + int64_t(index) * levels;
    Mask found;
    for (int i = 0; i < kLanes; ++i) found[i] = own[level[i]];
    return found;
  }
};

// Between the four texels around (u, v) of the images that begin at `starts`, `sizes` texels wide.
inline Wide bilinear(const float* data, const Mask& starts, const Mask& sizes, const Wide& u, const Wide& v) {
  const Mask mask = sizes - 1;
  const Wide fu = rounded_down(u), fv = rounded_down(v), wu = u - fu, wv = v - fv;
  const Mask x0 = __builtin_convertvector(fu, Mask) & mask, y0 = __builtin_convertvector(fv, Mask) & mask;
  const Mask x1 = (x0 + 1) & mask, y1 = (y0 + 1) & mask, row0 = starts + y0 * sizes, row1 = starts + y1 * sizes;
  const auto at = [&](const Mask& places) {
    Wide found;
    for (int i = 0; i < kLanes; ++i) found[i] = data[places[i]];
    return found;
  };
  const Wide top = (1 - wu) * at(row0 + x0) + wu * at(row0 + x1);
  const Wide bottom = (1 - wu) * at(row1 + x0) + wu * at(row1 + x1);
  return (1 - wv) * top + wv * bottom;
}

// The texture as rays `spacing` texels apart should see it: between the two levels whose texels are about as wide. Lanes
// that are not wanted see a texel of the first level.
inline Wide texel(const Pyramid& textures, const double* row, const Surface& s, const Wide& spacing, const Mask& lanes) {
  const Wide shift = 0.37 * double(textures.size) * s.face;  // faces show different parts of the texture
  const Wide u = pick(lanes, s.u * row[5] + row[6] + shift, 0.0), v = pick(lanes, s.v * row[5] + row[7] + shift, 0.0);
  const int index = int(row[4]), last = textures.levels - 1;
  const Mask coarse = lanes & (spacing > 1) & every(last > 0 ? -1 : 0);
  const Mask octave = (Mask(spacing) >> 52) - 1023;  // of a number above 1
  const Mask level = coarse & (octave < every(last) ? octave : every(last));
  const auto at = [&](const Mask& here) {  // texel centres are whole numbers at every level
    const Wide scale = Wide((1023 - here) << 52);
    const Wide x = pick(coarse, (u + 0.5) * scale - 0.5, u), y = pick(coarse, (v + 0.5) * scale - 0.5, v);
    return bilinear(textures.data, textures.images(index, here), every(textures.size) >> here, x, y);
  };
  const Wide fine = at(level);
  const Mask blended = coarse & (level < every(last));
  if (!any(blended)) return fine;
  const Wide rough = at(level - blended);  // one level further where it is blended
  return pick(blended, fine + (spacing * Wide((1023 - level) << 52) - 1) * (rough - fine), fine);
}

}  // namespace raycast
