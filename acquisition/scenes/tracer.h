// The shapes of a scene at one instant as one camera sees them, and the light of rays; included by the ray caster alone.
#pragma once
#include <algorithm>
#include <vector>

#include "scenes/shapes.h"

extern "C" {
struct RaycastScene {
  const double* shapes;   // [count][10]: kind, half sizes (3), texture, texels per metre, u0, v0, albedo low, high
  const uint8_t* moving;  // [count]
  const int8_t* ids;      // [count]
  const float* textures;  // [K][texture_size][texture_size], periodic; coarser levels behind
  double sun[3];          // unit, towards the sun
  double white, ambient, background;
  double slope[3], offset, least;  // all light at x is times offset + slope . x, between `least` and 1
  int32_t count, texture_size;     // at most 64 shapes; the size a power of two
  int32_t texture_count, levels;   // one level: textures are sampled as they are, however far away
};
struct RaycastView {
  double fx, fy, cx, cy, rotation[9], center[3];  // cam_from_world
  int32_t width, height, samples, threads;
  const double *slopes, *middles;  // of rays [H][W][samples^2][2] and of pixels' middles [H][W][2]; null for a pinhole
  double reach;                    // largest slope between a pixel's middle and its corners
};
struct RaycastStill {  // per sample [H][W][samples^2], except `foot` [H][W][3], `middle` and `mean` [H][W]
  double *depth, *lit, *unlit, *foot, *middle;
  float* mean;
  int8_t* middle_id;
};
}

namespace raycast {

struct Light {
  Wide lit, unlit;  // with and without the sun
};

struct SunPlane {  // two directions across the sun's, and its own
  Vec u, v, w;
  explicit SunPlane(const double* s) {
    const Vec sun{s[0], s[1], s[2]};
    const Vec helper = std::abs(sun.x) < 0.7 ? Vec{1, 0, 0} : Vec{0, 1, 0};
    const Vec across = helper - dot(helper, sun) * sun;
    u = (1 / std::sqrt(dot(across, across))) * across;
    v = {sun.y * u.z - sun.z * u.y, sun.z * u.x - sun.x * u.z, sun.x * u.y - sun.y * u.x};
    w = sun;
  }
  template <class T>
  Vec3<T> of(const Vec3<T>& x) const {
    return {dot(x, u), dot(x, v), dot(x, w)};
  }
};

class Slopes {  // of the rays through samples and middles of pixels
 public:
  explicit Slopes(const RaycastView& view) : view_(view), across_(view.width * view.samples), down_(view.height * view.samples) {
    const int n = view.samples;
    for (int i = 0; i < view.width * n; ++i) across_[i] = (i / n + (i % n + 0.5) / n - view.cx) / view.fx;
    for (int i = 0; i < view.height * n; ++i) down_[i] = (i / n + (i % n + 0.5) / n - view.cy) / view.fy;
  }

  // Those of all samples of a pixel, row by row.
  void of_samples(int64_t x, int64_t y, double* u, double* v) const {
    const int n = view_.samples;
    const double* bent = view_.slopes ? view_.slopes + 2 * (y * view_.width + x) * n * n : nullptr;
    for (int s = 0; s < n * n; ++s) {
      u[s] = bent ? bent[2 * s] : across_[x * n + s % n];
      v[s] = bent ? bent[2 * s + 1] : down_[y * n + s / n];
    }
  }

  void of_middle(int64_t x, int64_t y, double* u, double* v) const {
    const double* bent = view_.middles ? view_.middles + 2 * (y * view_.width + x) : nullptr;
    *u = bent ? bent[0] : (x + 0.5 - view_.cx) / view_.fx;
    *v = bent ? bent[1] : (y + 0.5 - view_.cy) / view_.fy;
  }

 private:
  const RaycastView& view_;
  std::vector<double> across_, down_;
};

class Tracer {
 public:
  Tracer(const RaycastScene& scene, const RaycastView& view, const Pyramid& textures, const double* rotations,
         const double* positions)
      : scene_(scene), view_(view), eye_{view.center[0], view.center[1], view.center[2]},
        sun_{scene.sun[0], scene.sun[1], scene.sun[2]}, slope_{scene.slope[0], scene.slope[1], scene.slope[2]},
        plane_(scene.sun), textures_(textures), placed_(scene.count) {
    for (int k = 0; k < scene.count; ++k) {
      place(k, rotations + 9 * k, {positions[3 * k], positions[3 * k + 1], positions[3 * k + 2]});
      (scene.moving[k] ? moving : still) |= uint64_t(1) << k;
    }
    for (int k = 0; k < scene.count; ++k)
      for (int j = 0; j < scene.count; ++j)
        if (j != k && may_block(placed_[j], placed_[k])) placed_[k].blockers |= uint64_t(1) << j;
  }

  uint64_t moving = 0, still = 0;

  const Placed& operator[](int k) const { return placed_[k]; }

  // The rays of slopes u and v.
  WideVec rays(const Wide& u, const Wide& v) const { return turn_back(view_.rotation, WideVec{u, v, wide(1)}); }

  // The nearest of `candidates` before `*depth`, or -1, in each lane.
  Mask nearest(uint64_t candidates, const WideVec& d, Wide* depth) const {
    const Wide dd = dot(d, d);
    Mask found = every(-1);
    for (; candidates; candidates &= candidates - 1) {
      const int k = __builtin_ctzll(candidates);
      const Placed& p = placed_[k];
      const Mask misses = misses_sphere(p.position - eye_, d, dd, p.radius);
      if (!any(~misses)) continue;
      const Wide t = entry(p, p.eye, turn_back(p.pose, d), kNear);
      const Mask nearer = ~misses & (t < *depth);
      *depth = pick(nearer, t, *depth);
      found = nearer ? every(k) : found;
    }
    return found;
  }

  // The lanes whose points at `depth` any of `candidates` shades.
  Mask in_shadow(uint64_t candidates, const WideVec& d, const Wide& depth, const Mask& lanes) const {
    const WideVec point = eye_ + depth * d, at = plane_.of(point);
    Mask shaded = {};
    for (; candidates; candidates &= candidates - 1) {
      const Placed& p = placed_[__builtin_ctzll(candidates)];
      const WideVec away = at - p.sunward;
      const Mask beside = (magnitude(away.x) > p.reach.x) | (magnitude(away.y) > p.reach.y) | (away.z > p.reach.z);
      const Mask open = lanes & ~shaded & ~beside;
      if (!any(open)) continue;
      const Mask misses = misses_sphere(p.position - point, sun_, 1.0, p.radius);
      const Wide t = entry(p, turn_back(p.pose, point - p.position), turn_back(p.pose, sun_), 0);
      shaded |= open & ~misses & (t < kInfinity);
    }
    return shaded;
  }

  // Light of the hits (found, depth), their sun taken away where one of `candidates` that can stand in the way does.
  Light seen(const Mask& found, uint64_t candidates, const WideVec& d, const Wide& depth, int count) const {
    Light light{wide(scene_.background), wide(scene_.background)};
    Mask left = first_lanes(count) & (found >= every(0));
    for (int i = 0; i < count; ++i) {
      if (!left[i]) continue;
      const int k = int(found[i]);
      const Mask lanes = left & (found == every(k));
      left &= ~lanes;
      const Light shaded = shade(k, d, depth, lanes);
      const Mask sunlit = lanes & (shaded.lit > shaded.unlit);
      const Mask dark = any(sunlit) ? in_shadow(candidates & placed_[k].blockers, d, depth, sunlit) : Mask{};
      light.lit = pick(lanes, pick(dark, shaded.unlit, shaded.lit), light.lit);
      light.unlit = pick(lanes, shaded.unlit, light.unlit);
    }
    return light;
  }

 private:
  Light shade(int k, const WideVec& d, const Wide& depth, const Mask& lanes) const {
    const Placed& p = placed_[k];
    const WideVec ray = turn_back(p.pose, d);
    const Surface s = surface(p, p.eye + depth * ray);
    const WideVec normal = turn(p.pose, s.normal);
    const Wide towards = dot(normal, sun_), facing = pick(dot(normal, d) > 0, -towards, towards);
    const Wide spacing = textures_.levels > 1 ? ray_spacing(d, normal, depth) * p.row[5] : wide(0);
    const Wide albedo = p.row[8] + (p.row[9] - p.row[8]) * texel(textures_, p.row, s, spacing, lanes);
    const Wide uneven = scene_.offset + dot(slope_, eye_ + depth * d);
    const Wide least = pick(uneven > scene_.least, uneven, scene_.least);
    const Wide white = scene_.white * pick(least < 1, least, 1.0);
    const Wide unlit = white * albedo * scene_.ambient;
    return {unlit + white * albedo * (1 - scene_.ambient) * pick(facing > 0, facing, 0.0), unlit};
  }

  // Metres between neighbouring rays on the surface they hit, the mean of both ways where it is seen askew.
  Wide ray_spacing(const WideVec& d, const WideVec& normal, const Wide& depth) const {
    const Wide facing = magnitude(dot(normal, d)) / root(dot(d, d));
    return depth / (view_.fx * view_.samples) / root(facing);
  }

  void place(int k, const double* pose, Vec position) {
    const double* row = scene_.shapes + 10 * k;
    Placed& p = placed_[k];
    p = {Kind(int(row[0])), row[1], row[2], row[3], 0, row, pose, position, turn_back(pose, eye_ - position), 0, 0,
         {}, {}, {}};
    const double squares[] = {p.a * p.a + p.b * p.b, p.a * p.a + p.b * p.b + p.c * p.c, p.a * p.a,
                              p.a * p.a + p.b * p.b};
    p.radius = std::sqrt(squares[p.kind]) + kSlack;
    enclose(&p);
    const Vec m = position - eye_;
    const double distance = std::sqrt(dot(m, m));
    const double half_pixel = (view_.slopes ? view_.reach : 0.5 * std::hypot(1 / view_.fx, 1 / view_.fy)) + kSlack;
    const double angle = p.radius < distance ? std::asin(p.radius / distance) + half_pixel : kInfinity;
    p.cone = angle < 3.14 ? distance * std::cos(angle) : -kInfinity;
  }

  void enclose(Placed* p) const {
    switch (p->kind) {
      case kRectangle: p->half = {p->a + kSlack, p->b + kSlack, kSlack}; break;
      case kBox: p->half = {p->a + kSlack, p->b + kSlack, p->c + kSlack}; break;
      case kSphere: p->half = {p->radius, p->radius, p->radius}; break;
      case kCylinder: p->half = {p->a + kSlack, p->a + kSlack, p->b + kSlack}; break;
    }
    p->sunward = plane_.of(p->position);
    p->reach = p->half;
    if (p->kind == kSphere) return;
    const auto reach = [&](const Vec& across) {  // of a box is the sum over its axes
      const Vec part = turn_back(p->pose, across);
      return p->half.x * std::abs(part.x) + p->half.y * std::abs(part.y) + p->half.z * std::abs(part.z) + kSlack;
    };
    p->reach = {reach(plane_.u), reach(plane_.v), reach(plane_.w)};
  }

  bool may_block(const Placed& blocker, const Placed& blocked) const {
    const Vec m = blocker.position - blocked.position, away = blocker.sunward - blocked.sunward;
    const Vec most = blocker.reach + blocked.reach;
    const double along = dot(m, sun_), reach = blocker.radius + blocked.radius;
    return along >= -reach && dot(m, m) - along * along <= reach * reach && away.z >= -most.z &&
           std::abs(away.x) <= most.x && std::abs(away.y) <= most.y;
  }

  const RaycastScene& scene_;
  const RaycastView& view_;
  Vec eye_, sun_, slope_;
  SunPlane plane_;
  const Pyramid& textures_;
  std::vector<Placed> placed_;
};

}  // namespace raycast
