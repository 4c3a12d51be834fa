// Analytic ray casting of convex shapes with one texture each, one sun with hard shadows, and ambient light.
//
// Rays are o + t d with d = ((u - cx) / fx, (v - cy) / fy, 1) in the camera, or (slopes, 1) where a lens bends them, so t
// is the depth z. The part of a view
// that never moves is traced once; a frame traces again only the pixels that a moving shape, or the shadow it throws on
// the still part, can touch: conservative tests of bounding spheres, so the values are those of tracing everything.
#include <algorithm>
#include <vector>

#include "native.h"
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

namespace {

using namespace raycast;

struct Light {
  double lit, unlit;  // with and without the sun
};

class Tracer {
 public:
  Tracer(const RaycastScene& scene, const RaycastView& view, const double* rotations, const double* positions)
      : scene_(scene), view_(view), eye_{view.center[0], view.center[1], view.center[2]},
        sun_{scene.sun[0], scene.sun[1], scene.sun[2]}, slope_{scene.slope[0], scene.slope[1], scene.slope[2]},
        textures_{scene.textures, scene.texture_count, scene.texture_size, scene.levels}, placed_(scene.count) {
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

  Vec direction(double u, double v) const {
    return turn_back(view_.rotation, {(u - view_.cx) / view_.fx, (v - view_.cy) / view_.fy, 1});
  }

  Vec ray(int x, int y, int s) const {
    const int n = view_.samples;
    if (!view_.slopes) return direction(x + (s % n + 0.5) / n, y + (s / n + 0.5) / n);
    const double* slope = view_.slopes + 2 * ((int64_t(y) * view_.width + x) * n * n + s);
    return turn_back(view_.rotation, {slope[0], slope[1], 1});
  }

  Vec middle(int x, int y) const {
    if (!view_.middles) return direction(x + 0.5, y + 0.5);
    const double* slope = view_.middles + 2 * (int64_t(y) * view_.width + x);
    return turn_back(view_.rotation, {slope[0], slope[1], 1});
  }

  // The nearest of `candidates` before `*depth`, or -1.
  int nearest(uint64_t candidates, Vec d, double* depth) const {
    const double dd = dot(d, d);
    int found = -1;
    for (; candidates; candidates &= candidates - 1) {
      const int k = __builtin_ctzll(candidates);
      const Placed& p = placed_[k];
      if (misses_sphere(p.position - eye_, d, dd, p.radius)) continue;
      const double t = entry(p, p.eye, turn_back(p.pose, d), kNear);
      if (t < *depth) {
        *depth = t;
        found = k;
      }
    }
    return found;
  }

  bool in_shadow(uint64_t candidates, Vec d, double depth) const {
    const Vec point = eye_ + depth * d;
    for (; candidates; candidates &= candidates - 1) {
      const Placed& p = placed_[__builtin_ctzll(candidates)];
      if (misses_sphere(p.position - point, sun_, 1, p.radius)) continue;
      if (entry(p, turn_back(p.pose, point - p.position), turn_back(p.pose, sun_), 0) < kInfinity) return true;
    }
    return false;
  }

  Light shade(int k, Vec d, double depth) const {
    const Placed& p = placed_[k];
    const Vec ray = turn_back(p.pose, d);
    const Surface s = surface(p, p.eye + depth * ray);
    const Vec normal = turn(p.pose, s.normal);
    const double facing = dot(normal, d) > 0 ? -dot(normal, sun_) : dot(normal, sun_);
    const double spacing = textures_.levels > 1 ? ray_spacing(d, normal, depth) * p.row[5] : 0;
    const double albedo = p.row[8] + (p.row[9] - p.row[8]) * texel(textures_, p.row, s, spacing);
    const double uneven = scene_.offset + dot(slope_, eye_ + depth * d);
    const double white = scene_.white * std::min(1.0, std::max(scene_.least, uneven));
    const double unlit = white * albedo * scene_.ambient;
    return {unlit + white * albedo * (1 - scene_.ambient) * std::max(0.0, facing), unlit};
  }

  // Light of the hit (k, depth), its sun taken away where one of `candidates` that can stand in the way does.
  Light seen(int k, uint64_t candidates, Vec d, double depth) const {
    if (k < 0) return {scene_.background, scene_.background};
    Light light = shade(k, d, depth);
    if (light.lit > light.unlit && in_shadow(candidates & placed_[k].blockers, d, depth)) light.lit = light.unlit;
    return light;
  }

 private:
  // Metres between neighbouring rays on the surface they hit, the mean of both ways where it is seen askew.
  double ray_spacing(Vec d, Vec normal, double depth) const {
    const double facing = std::abs(dot(normal, d)) / std::sqrt(dot(d, d));
    return depth / (view_.fx * view_.samples) / std::sqrt(facing);
  }

  void place(int k, const double* pose, Vec position) {
    const double* row = scene_.shapes + 10 * k;
    Placed& p = placed_[k];
    p = {Kind(int(row[0])), row[1], row[2], row[3], 0, row, pose, position, turn_back(pose, eye_ - position), 0, 0};
    const double squares[] = {p.a * p.a + p.b * p.b, p.a * p.a + p.b * p.b + p.c * p.c, p.a * p.a,
                              p.a * p.a + p.b * p.b};
    p.radius = std::sqrt(squares[p.kind]) + kSlack;
    const Vec m = position - eye_;
    const double distance = std::sqrt(dot(m, m));
    const double half_pixel = (view_.slopes ? view_.reach : 0.5 * std::hypot(1 / view_.fx, 1 / view_.fy)) + kSlack;
    const double angle = p.radius < distance ? std::asin(p.radius / distance) + half_pixel : kInfinity;
    p.cone = angle < 3.14 ? distance * std::cos(angle) : -kInfinity;
  }

  bool may_block(const Placed& blocker, const Placed& blocked) const {
    const Vec m = blocker.position - blocked.position;
    const double along = dot(m, sun_), reach = blocker.radius + blocked.radius;
    return along >= -reach && dot(m, m) - along * along <= reach * reach;
  }

  const RaycastScene& scene_;
  const RaycastView& view_;
  Vec eye_, sun_, slope_;
  Pyramid textures_;
  std::vector<Placed> placed_;
};

struct SunPlane {  // two directions across the sun's
  Vec u, v;
  explicit SunPlane(const double* s) {
    const Vec sun{s[0], s[1], s[2]};
    const Vec helper = std::abs(sun.x) < 0.7 ? Vec{1, 0, 0} : Vec{0, 1, 0};
    const Vec across = helper - dot(helper, sun) * sun;
    u = (1 / std::sqrt(dot(across, across))) * across;
    v = {sun.y * u.z - sun.z * u.y, sun.z * u.x - sun.x * u.z, sun.x * u.y - sun.y * u.x};
  }
};

// The still part of one pixel, and the disc across the sun's direction that its sunlit points fill.
void trace_still(const Tracer& tracer, const RaycastView& view, const SunPlane& plane, int x, int y,
                 const RaycastStill& out) {
  const int n = view.samples;
  const int64_t pixel = int64_t(y) * view.width + x, base = pixel * n * n;
  double least[2] = {kInfinity, kInfinity}, most[2] = {-kInfinity, -kInfinity};
  for (int s = 0; s < n * n; ++s) {
    const Vec d = tracer.ray(x, y, s);
    double depth = kInfinity;
    const int k = tracer.nearest(tracer.still, d, &depth);
    const Light light = tracer.seen(k, tracer.still, d, depth);
    out.depth[base + s] = depth;
    out.lit[base + s] = light.lit;
    out.unlit[base + s] = light.unlit;
    if (!(light.lit > light.unlit)) continue;
    const Vec point = Vec{view.center[0], view.center[1], view.center[2]} + depth * d;
    const double at[2] = {dot(point, plane.u), dot(point, plane.v)};
    for (int i = 0; i < 2; ++i) {
      least[i] = std::min(least[i], at[i]);
      most[i] = std::max(most[i], at[i]);
    }
  }
  const bool sunlit = most[0] >= least[0];
  for (int i = 0; i < 2; ++i) out.foot[3 * pixel + i] = sunlit ? (least[i] + most[i]) / 2 : 0;
  out.foot[3 * pixel + 2] = sunlit ? std::hypot(most[0] - least[0], most[1] - least[1]) / 2 + kSlack : -kInfinity;
}

// Per pixel of a row, the moving shapes that may cover it (`near`) and those that may shade its still part (`dark`).
void mark_row(const Tracer& tracer, const RaycastView& view, const SunPlane& plane, int y, const double* foot,
              uint64_t* near, uint64_t* dark) {
  std::fill(near, near + view.width, 0);
  std::fill(dark, dark + view.width, 0);
  std::vector<double> across(view.width), down(view.width, (y + 0.5 - view.cy) / view.fy);
  for (int x = 0; x < view.width; ++x) across[x] = (x + 0.5 - view.cx) / view.fx;
  if (view.middles)
    for (int x = 0; x < view.width; ++x) {
      across[x] = view.middles[2 * (int64_t(y) * view.width + x)];
      down[x] = view.middles[2 * (int64_t(y) * view.width + x) + 1];
    }
  for (uint64_t left = tracer.moving; left; left &= left - 1) {
    const int k = __builtin_ctzll(left);
    const uint64_t bit = uint64_t(1) << k;
    const Placed& shape = tracer[k];
    const Vec m = turn(view.rotation, shape.position - Vec{view.center[0], view.center[1], view.center[2]});
    const double au = dot(shape.position, plane.u), av = dot(shape.position, plane.v), cone = shape.cone;
    for (int x = 0; x < view.width; ++x) {
      const double p = across[x], q = down[x];
      const bool covered = p * m.x + q * m.y + m.z >= cone * std::sqrt(p * p + q * q + 1);
      near[x] |= covered ? bit : 0;
    }
    for (int x = 0; x < view.width; ++x) {
      const double du = foot[3 * x] - au, dv = foot[3 * x + 1] - av, reach = foot[3 * x + 2] + shape.radius;
      dark[x] |= (reach >= 0) & (du * du + dv * dv <= reach * reach) ? bit : 0;
    }
  }
}

float trace_pixel(const Tracer& tracer, const RaycastView& view, int x, int y, const RaycastStill& still,
                   uint64_t near, uint64_t dark) {
  const int n = view.samples;
  const int64_t base = (int64_t(y) * view.width + x) * n * n;
  double sum = 0;
  for (int s = 0; s < n * n; ++s) {
    const Vec d = tracer.ray(x, y, s);
    double value = still.lit[base + s], depth = still.depth[base + s];
    const int k = tracer.nearest(near, d, &depth);
    if (k >= 0)
      value = tracer.seen(k, tracer.moving | tracer.still, d, depth).lit;
    else if (value > still.unlit[base + s] && tracer.in_shadow(dark, d, depth))
      value = still.unlit[base + s];
    sum += value;
  }
  return float(sum / (n * n));
}

}  // namespace

S4_API void raycast_still(const RaycastScene* scene, const RaycastView* view, const double* rotations,
                          const double* positions, const RaycastStill* out) {
  const Tracer tracer(*scene, *view, rotations, positions);
  const SunPlane plane(scene->sun);
#pragma omp parallel for schedule(dynamic, 4) num_threads(view->threads)
  for (int y = 0; y < view->height; ++y)
    for (int x = 0; x < view->width; ++x) {
      const int64_t pixel = int64_t(y) * view->width + x;
      trace_still(tracer, *view, plane, x, y, *out);
      out->mean[pixel] = trace_pixel(tracer, *view, x, y, *out, 0, 0);
      double depth = kInfinity;
      const int k = tracer.nearest(tracer.still, tracer.middle(x, y), &depth);
      out->middle[pixel] = depth;
      out->middle_id[pixel] = k < 0 ? 0 : scene->ids[k];
    }
}

// Frames of n instants, the light of each times its gain; `depth` and `ids` may both be null.
S4_API void raycast_frames(const RaycastScene* scene, const RaycastView* view, const RaycastStill* still, int64_t n,
                           const double* rotations, const double* positions, const double* gains, float* intensity,
                           float* depth, int8_t* ids) {
  const SunPlane plane(scene->sun);
  const int64_t width = view->width, height = view->height;
  std::vector<Tracer> tracers;
  tracers.reserve(n);
  for (int64_t i = 0; i < n; ++i)
    tracers.emplace_back(*scene, *view, rotations + 9 * i * scene->count, positions + 3 * i * scene->count);
#pragma omp parallel for schedule(dynamic, 8) num_threads(view->threads)
  for (int64_t line = 0; line < n * height; ++line) {
    const Tracer& tracer = tracers[line / height];
    const int y = int(line % height);
    const float gain = float(gains[line / height]);
    std::vector<uint64_t> near(width), dark(width);
    mark_row(tracer, *view, plane, y, still->foot + 3 * y * width, near.data(), dark.data());
    for (int x = 0; x < width; ++x) {
      const int64_t pixel = y * width + x, to = line * width + x;
      const bool touched = near[x] | dark[x];
      intensity[to] =
          gain * (touched ? trace_pixel(tracer, *view, x, y, *still, near[x], dark[x]) : still->mean[pixel]);
      if (!depth) continue;
      double z = still->middle[pixel];
      const int k = near[x] ? tracer.nearest(near[x], tracer.middle(x, y), &z) : -1;
      depth[to] = z < kInfinity ? float(z) : std::numeric_limits<float>::quiet_NaN();
      ids[to] = k >= 0 ? scene->ids[k] : still->middle_id[pixel];
    }
  }
}
